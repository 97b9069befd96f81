"""What the offline phase learns from, and the refusal of what does not suit a learner."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Protocol

import numpy as np
import torch

from animarl_algos.learner.validation import Episodes
from animarl_algos.losses.terms import ScoredActionsTemporalDifference
from animarl_algos.replay.batch import SequenceBatch
from animarl_envs.errors import InputError

if TYPE_CHECKING:
    from animarl_algos.learner.algorithm import SequenceQLearning
    from animarl_algos.learner.offline_learner import OfflineLearner


class OfflineDataset(Episodes, Protocol):
    """Demonstrated episodes as sequences; see :mod:`animarl_algos.data.dataset`."""

    def windows(
        self,
        batch_size: int,
        count: int,
        generator: np.random.Generator,
        *,
        length: int,
        burn_in: int = 0,
    ) -> Iterator[SequenceBatch]:
        """``count`` minibatches of pieces, drawn independently."""
        ...

    def input_statistics(self) -> tuple[torch.Tensor, torch.Tensor]:
        """Mean and standard deviation (K, n) of the observations."""
        ...

    @property
    def num_episodes(self) -> int:
        """Episodes with a step that enters a loss."""
        ...

    @property
    def num_steps(self) -> int:
        """Steps of all episodes."""
        ...


class DemonstrationData(Protocol):
    """The two splits that training may see."""

    @property
    def train(self) -> OfflineDataset: ...

    @property
    def val(self) -> OfflineDataset: ...


def refuse_foreign(model: OfflineLearner, data: DemonstrationData) -> None:
    """Demonstrations of other individuals, another observation or other actions are refused."""
    for name, dataset in (("training", data.train), ("validation", data.val)):
        batch = next(iter(dataset.batches(1)), None)
        if batch is None:
            raise InputError(
                f"the {name} split holds no demonstrated episode: split the data again"
            )
        mine = (model.layout.num_individuals, model.observation_size)
        theirs = (batch.num_individuals, batch.observations.shape[-1])
        if mine != theirs:
            raise InputError(
                f"the {name} demonstrations have {theirs[0]} individuals with {theirs[1]} "
                f"observation components, the environment {mine[0]} with {mine[1]}: "
                "make them for this environment"
            )
        known = getattr(dataset, "individuals", None)  # of this package's datasets, if named
        placed = getattr(model.env, "individuals", None)  # of a VecEnv of slots
        if isinstance(known, tuple) and placed is not None and known != tuple(placed):
            raise InputError(
                f"the {name} demonstrations are of {', '.join(known)}, the environment's "
                f"individuals are {', '.join(model.layout.individuals)}: make them for this "
                "environment"
            )
        scored = batch.action_penalties
        highest = int(batch.actions.max()) if scored is None else scored.shape[-1] - 1
        if highest >= model.policy.num_actions:
            raise InputError(
                f"the {name} demonstrations hold action {highest}, the environment has "
                f"{model.policy.num_actions}: make them for this environment"
            )
        recipe = model.offline_recipe
        scores = any(isinstance(t, ScoredActionsTemporalDifference) for t in recipe.offline)
        if scores and scored is None:
            raise InputError(
                f"the {name} demonstrations carry no penalties of all actions, which "
                f"{recipe.name} learns from offline: make the dataset with the fitted dynamics of "
                "their species"
            )


def demonstrated_windows(
    model: SequenceQLearning, updates: int, batch_size: int
) -> Iterator[SequenceBatch]:
    """As many training sequences, of the same form, as ``updates`` draw from the replay memory.

    Drawn by the seed and the number of updates done, so that a resumed run draws the same.
    """
    buffer = model.replay_buffer
    assert buffer is not None
    generator = np.random.default_rng([model.root_seed, model._n_updates])
    train = model.demonstration_data().train
    return train.windows(
        batch_size, updates, generator, length=buffer.stride, burn_in=buffer.burn_in
    )
