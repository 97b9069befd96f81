"""Single steps with the network's state before them, of demonstrations and of own episodes.

Axes: (individual, row, ...). A row is trained with the state that was stored beside it, as in R2D2
(Kapturowski et al. 2019); networks without memory pass it through.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
import torch
from numpy.typing import NDArray

from animarl_algos.data.dataset import OfflineDataset
from animarl_algos.data.vec_env import SlotVecEnv
from animarl_algos.networks.networks import StackedQNetwork


@dataclass(frozen=True)
class EndValues:
    """What the state is worth in which an ended episode stays: ``success`` or ``failure``.

    A success is an episode that ended by contact (outcome codes above 0), a failure one that ended
    out of bounds.
    """

    success: float
    failure: float = 0.0

    def of(self, outcome: NDArray[np.integer]) -> NDArray[np.float32]:
        """Values of terminated episodes with these outcome codes."""
        return np.where(outcome > 0, self.success, self.failure).astype(np.float32)


@dataclass(frozen=True)
class Rows:
    """Steps of K individuals.

    Attributes
    ----------
    observations, next_observations : Tensor (K, rows, n)
    previous : Tensor (K, rows) int64
        Action before the observation; the number of actions for none.
    state : Tensor (K, rows, H)
        The network's, before the observation.
    actions : Tensor (K, rows) int64
    absorbed : Tensor (K, rows)
        Value of what follows an end, NaN where the episode goes on or is only cut.
    """

    observations: torch.Tensor
    next_observations: torch.Tensor
    previous: torch.Tensor
    state: torch.Tensor
    actions: torch.Tensor
    absorbed: torch.Tensor

    def __len__(self) -> int:
        return self.actions.shape[1]

    @staticmethod
    def joined(parts: list[Rows]) -> Rows:
        """All rows of all parts."""
        names = [field.name for field in fields(Rows)]
        return Rows(*(torch.cat([getattr(p, name) for p in parts], dim=1) for name in names))

    def sample(self, count: int, generator: torch.Generator) -> Rows:
        """``count`` rows with replacement, drawn for each individual by itself."""
        individuals = torch.arange(self.actions.shape[0]).unsqueeze(1)
        drawn = torch.randint(len(self), (len(individuals), count), generator=generator)
        return Rows(*(getattr(self, field.name)[individuals, drawn] for field in fields(Rows)))

    def q_values(self, network: StackedQNetwork) -> tuple[torch.Tensor, torch.Tensor]:
        """Before and after the step, (K, rows, actions) each."""
        both = network(
            torch.stack((self.observations, self.next_observations), dim=1),
            torch.stack((self.previous, self.actions), dim=1),
            self.state,
        ).q_values
        return both[:, 0], both[:, 1]


@torch.no_grad()
def demonstrated_rows(
    network: StackedQNetwork,
    data: OfflineDataset,
    outcomes: NDArray[np.integer],
    values: EndValues,
    batch_size: int = 64,
) -> Rows:
    """All steps of the demonstrations but the warm-up, with the states that ``network`` is in.

    ``outcomes`` ``(episodes,)`` are those of the demonstrations that ``data`` was made from.
    """
    parts = []
    for batch in data.batches(batch_size):
        state = network.initial_state(batch.batch_size)
        states = []
        for t in range(batch.actions.shape[1]):
            states.append(state)
            if network.recurrent:
                state = network.step(batch.observations[:, t], batch.previous_actions[:, t], state)[
                    1
                ]
        ends = torch.from_numpy(values.of(outcomes[batch.indices])).unsqueeze(1)
        absorbed = torch.where(batch.terminated > 0, ends, torch.nan)
        entering = batch.mask[0] > 0  # the same episodes for every individual
        parts.append(
            Rows(
                batch.observations[:, :-1][:, entering],
                batch.observations[:, 1:][:, entering],
                batch.previous_actions[:, :-1][:, entering],
                torch.stack(states, dim=1)[:, entering],
                batch.actions[:, entering],
                absorbed[:, entering],
            )
        )
    return Rows.joined(parts)


class Collector:
    """Lets a network act in a world, sampling from ``softmax Q``, and keeps its steps.

    Attributes
    ----------
    lengths, outcomes
        Of the episodes that ended in the last collection.
    """

    def __init__(self, network: StackedQNetwork, env: SlotVecEnv, values: EndValues, seed: int):
        self._network, self._env, self._values = network, env, values
        self._rng = np.random.default_rng(seed)
        self._shape = (env.num_copies, len(env.individuals))
        env.seed(seed)
        self._observation = self._stacked(env.reset())
        self._previous = torch.full(self._shape[::-1], network.num_actions)
        self._state = network.initial_state(env.num_copies)
        self.lengths: list[int] = []
        self.outcomes: list[int] = []

    @torch.no_grad()
    def collect(self, steps: int) -> Rows:
        """So many steps of all copies, but those of the warm-up."""
        self.lengths, self.outcomes = [], []
        parts = []
        for _ in range(steps):
            q_values, after = self._network.step(self._observation, self._previous, self._state)
            noise = torch.from_numpy(self._rng.gumbel(size=q_values.shape))
            actions = (q_values + noise).argmax(-1)
            self._env.step_async(actions.T.reshape(-1).numpy())
            slots, _, dones, infos = self._env.step_wait()
            following = slots.copy()
            absorbed = np.full(self._shape, np.nan, dtype=np.float32)
            for slot in np.flatnonzero(dones).tolist():
                info = infos[slot]
                following[slot] = info["terminal_observation"]
                if not info["TimeLimit.truncated"]:
                    end = self._values.of(np.array(info["outcome"]))
                    absorbed[divmod(slot, self._shape[1])] = end
                if "episode" in info:
                    self.lengths.append(info["episode"]["l"])
                    self.outcomes.append(info["outcome"])
            entering = torch.from_numpy(~self._env.extras["warmup"].reshape(self._shape)[:, 0])
            whole = Rows(
                self._observation, self._stacked(following), self._previous, self._state, actions,
                torch.from_numpy(absorbed.T.copy()),
            )  # fmt: skip
            parts.append(Rows(*(getattr(whole, field.name)[:, entering] for field in fields(Rows))))
            fresh = torch.from_numpy(dones.reshape(self._shape)[:, 0])
            self._observation = self._stacked(slots)
            self._previous = torch.where(fresh, self._network.num_actions, actions)
            self._state = torch.where(fresh[:, None], 0.0, after)
        return Rows.joined(parts)

    def _stacked(self, slots: NDArray[np.float32]) -> torch.Tensor:
        """Slots (S, n) to (K, copies, n)."""
        return torch.from_numpy(slots.reshape(*self._shape, -1).transpose(1, 0, 2).copy())
