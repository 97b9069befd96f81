"""A pair that is shown noise and paid at random, in a world that gives all that a learner may get.

Steps of the world and minibatches drawn are kept in the order in which they came.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import toys
from numpy.typing import NDArray

from animarl_algos.learner.algorithm import SequenceQLearning
from animarl_algos.replay.store import SequenceBatch


@dataclass(frozen=True)
class Step:
    """One step of all copies: ``(copies, K, ...)``, and ``(copies,)`` from ``warmup`` on.

    ``successors`` are the terminal observations where an episode ended, ``returned`` is the reward
    that the step returned, ``rewards`` the task's.
    """

    observations: NDArray[np.float32]
    actions: NDArray[np.int64]
    successors: NDArray[np.float32]
    returned: NDArray[np.float32]
    rewards: NDArray[np.float32]
    penalties: NDArray[np.float32]
    labels: NDArray[np.int64]
    warmup: NDArray[np.bool_]
    condition: NDArray[np.int64]
    terminated: NDArray[np.bool_]
    truncated: NDArray[np.bool_]

    @property
    def done(self) -> NDArray[np.bool_]:
        return self.terminated | self.truncated


class ScriptedPair(toys.Toy):
    """Episodes of 3 to 10 steps, ended by termination or time-out, the first two of warm-up.

    The reward is already shaped, ``task_reward`` less the penalty. A third of the labels is
    missing. With ``flagged`` the last observation component is the condition.
    """

    STATE = ("noise", "condition", "end")
    individuals = ("seeker", "avoider")
    feedback = ("task_reward", "dtw_penalty", "aligned_action", "condition", "warmup")
    num_actions = 3
    time_limit = 10
    WARMUP = 2

    def __init__(self, num_copies: int = 2, seed: int = 0, *, flagged: bool = False) -> None:
        self.condition_flag = flagged
        self.num_observations = 4 + flagged
        self.noise = np.zeros((num_copies, 2, 4), dtype=np.float32)
        self.condition = np.zeros(num_copies, dtype=np.int64)
        self.end = np.zeros(num_copies, dtype=np.int64)
        self.log: list[Step | NDArray[np.int64]] = []
        super().__init__(num_copies, seed)

    @property
    def steps(self) -> list[Step]:
        """The steps of the log alone."""
        return [event for event in self.log if isinstance(event, Step)]

    def begin(self, copies: NDArray[np.intp]) -> None:
        self.noise[copies] = self.rng.normal(size=(len(copies), 2, 4))
        self.condition[copies] = self.rng.integers(2, size=len(copies))
        self.end[copies] = self.rng.integers(3, 14, size=len(copies))

    def advance(self, actions: NDArray[np.integer[Any]]) -> Any:
        pair = (self.num_copies, 2)
        task = self.rng.normal(size=pair).astype(np.float32)
        penalty = self.rng.random(pair).astype(np.float32)
        self.extras = {
            "task_reward": task.ravel(), "dtw_penalty": penalty.ravel(),
            "aligned_action": np.maximum(self.rng.integers(-2, 3, size=pair), -1).ravel(),
            "condition": np.repeat(self.condition, 2),
            "warmup": np.repeat(self.step_count <= self.WARMUP, 2),
        }  # fmt: skip
        self.noise[:] = self.rng.normal(size=self.noise.shape)
        return task - penalty, self.step_count >= self.end

    def observe(self) -> Any:
        if not self.condition_flag:
            return self.noise.copy()
        flag = np.broadcast_to(self.condition[:, None, None], (self.num_copies, 2, 1))
        return np.concatenate([self.noise, flag], axis=-1)

    def step_wait(self) -> Any:
        pair = (self.num_copies, 2)
        before = self._slots(self.observe())
        after, rewards, dones, infos = super().step_wait()
        successors = after.copy()
        truncated = np.zeros(self.num_envs, dtype=bool)
        for s in np.flatnonzero(dones):
            successors[s] = infos[s]["terminal_observation"]
            truncated[s] = infos[s]["TimeLimit.truncated"]
        extras = self.extras
        self.log.append(
            Step(
                observations=before.reshape(*pair, -1), actions=self._actions.copy(),
                successors=successors.reshape(*pair, -1),
                returned=rewards.reshape(pair),
                rewards=extras["task_reward"].reshape(pair),
                penalties=extras["dtw_penalty"].reshape(pair),
                labels=extras["aligned_action"].reshape(pair),
                warmup=extras["warmup"].reshape(pair)[:, 0],
                condition=extras["condition"].reshape(pair)[:, 0],
                terminated=(dones & ~truncated).reshape(pair)[:, 0],
                truncated=truncated.reshape(pair)[:, 0],
            )
        )  # fmt: skip
        return after, rewards, dones, infos


def log_draws(model: SequenceQLearning, env: ScriptedPair) -> None:
    """Put the indices ``(K, B)`` of every minibatch drawn into the log of ``env``."""
    buffer = model.replay_buffer
    assert buffer is not None
    sample = buffer.sample

    def logged(batch_size: int, progress: float = 0.0) -> SequenceBatch:
        batch = sample(batch_size, progress)
        env.log.append(batch.indices)
        return batch

    buffer.sample = logged  # type: ignore[method-assign]
