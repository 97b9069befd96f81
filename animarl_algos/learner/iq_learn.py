"""IQ-Learn online: a clone acts, and learns what sets the demonstrations apart from its own steps.

Begun from cloned action values as logits, at temperature 1. A clone errs where its own errors lead
it; here it meets those states, and the soft values of its future tell them from the demonstrated
ones. Some 25 collections improve a clone; by 60 it drifts.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from animarl_algos.data.dataset import OfflineDataset
from animarl_algos.data.vec_env import SlotVecEnv
from animarl_algos.learner.transition_rows import (
    Collector,
    EndValues,
    Rows,
    demonstrated_rows,
)
from animarl_algos.losses.iq_learn import ImpliedRewards, value_after
from animarl_algos.losses.losses import clip_grad_norm_per_individual
from animarl_algos.networks.networks import StackedQNetwork
from animarl_algos.networks.value_stream import zero_value_stream
from animarl_algos.ranges import COUNT, NOT_NEGATIVE, POSITIVE, Range
from animarl_envs.errors import InputError

BELOW_ONE = Range(least=0.0, most=0.9999)


@dataclass(frozen=True, kw_only=True)
class IQLearnSettings:
    """Numbers of the online phase.

    Attributes
    ----------
    gamma
        Discount per step; a soft horizon of 20 to 100 steps has worked (.95 to .99).
    collections, steps, kept
        How often the policy acts, for how many steps of each copy, and how many of the last
        collections are learned from.
    updates, rows
        Updates after each collection, with so many demonstrated rows and as many own ones.
    learning_rate, max_grad_norm
        Adam's, and the largest gradient norm of an individual.
    success_reward
        A step's worth in the state in which an episode stays that ended by contact; one that ended
        out of bounds stays where nothing is worth anything.
    """

    gamma: float = 0.97
    collections: int = 25
    steps: int = 96
    kept: int = 15
    updates: int = 40
    rows: int = 256
    learning_rate: float = 3e-4
    max_grad_norm: float = 5.0
    success_reward: float = 0.15

    def __post_init__(self) -> None:
        BELOW_ONE.check("gamma", self.gamma)
        for name in ("collections", "steps", "kept", "updates", "rows"):
            COUNT.check(name, getattr(self, name))
        POSITIVE.check("learning_rate", self.learning_rate)
        POSITIVE.check("max_grad_norm", self.max_grad_norm)
        NOT_NEGATIVE.check("success_reward", self.success_reward)

    @property
    def end_values(self) -> EndValues:
        """``success_reward`` for ever."""
        return EndValues(success=self.success_reward / (1.0 - self.gamma))


@dataclass(frozen=True)
class CollectionReport:
    """What one collection and its updates came to.

    Attributes
    ----------
    episodes, mean_length, success
        How many ended, after how many steps, and which share by contact; NaN where none did.
    loss : Tensor (K,)
        Of the last update.
    """

    episodes: int
    mean_length: float
    success: float
    loss: torch.Tensor


def iq_learn(
    network: StackedQNetwork,
    env: SlotVecEnv,
    data: OfflineDataset,
    outcomes: NDArray[np.integer],
    settings: IQLearnSettings,
    *,
    seed: int = 0,
) -> list[CollectionReport]:
    """Train a cloned network in place.

    Parameters
    ----------
    network
        Whose action values are a clone's logits. Its value stream is set to 0 first.
    env
        Where it acts; its individuals are the network's.
    data, outcomes
        The demonstrations, and the outcome code of each of their episodes.
    seed
        Of acting, of the worlds and of the rows drawn.

    Raises
    ------
    InputError
        If network, world and demonstrations are not of the same individuals, or the loss is not
        finite.
    """
    if not network.individuals == env.individuals == data.names:
        raise InputError(
            f"the network is of {network.individuals}, the world of {env.individuals}, the "
            f"demonstrations of {data.names}: give those of the same individuals"
        )
    zero_value_stream(network)
    collector = Collector(network, env, settings.end_values, seed)
    generator = torch.Generator().manual_seed(seed)
    optimizer = torch.optim.Adam(network.parameters(), lr=settings.learning_rate)
    demonstrated = demonstrated_rows(network, data, outcomes, settings.end_values)
    collected: deque[Rows] = deque(maxlen=settings.kept)
    reports = []
    for number in range(settings.collections):
        collected.append(collector.collect(settings.steps))
        if network.recurrent and number:
            demonstrated = demonstrated_rows(network, data, outcomes, settings.end_values)
        own = Rows.joined(list(collected))
        for _ in range(settings.updates):
            loss = _update(network, optimizer, demonstrated, own, settings, generator)
        lengths, ended = collector.lengths, np.array(collector.outcomes)
        reports.append(
            CollectionReport(
                episodes=len(lengths),
                mean_length=float(np.mean(lengths)) if lengths else np.nan,
                success=float((ended > 0).mean()) if lengths else np.nan,
                loss=loss,
            )
        )
    return reports


def _update(
    network: StackedQNetwork,
    optimizer: torch.optim.Optimizer,
    demonstrated: Rows,
    own: Rows,
    settings: IQLearnSettings,
    generator: torch.Generator,
) -> torch.Tensor:
    """One step of Adam; the loss before it, (K,)."""
    count = settings.rows
    rows = Rows.joined([demonstrated.sample(count, generator), own.sample(count, generator)])
    before, after = rows.q_values(network)
    loss = ImpliedRewards(
        q_values=before,
        actions=rows.actions,
        next_value=value_after(after, rows.absorbed),
        demonstrated=torch.arange(2 * count) < count,
        gamma=settings.gamma,
    ).loss()
    if not bool(loss.isfinite().all()):
        raise InputError(
            f"training diverged (losses per individual: {loss.tolist()}): lower learning_rate"
        )
    optimizer.zero_grad()
    loss.sum().backward()  # type: ignore[no-untyped-call]
    clip_grad_norm_per_individual(network.all_parameters, settings.max_grad_norm)
    optimizer.step()
    return loss.detach()
