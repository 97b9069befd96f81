"""One step of acting: choose, step the world, record, and forget where episodes ended."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv

from animarl_algos.learner.recorder import Recorder
from animarl_algos.networks.acting_rule import Acting
from animarl_algos.networks.policies import GruPolicy
from animarl_algos.replay.sequence_buffer import SequenceReplayBuffer

Memory = tuple[NDArray[np.float32], NDArray[np.int64]]
"""Of all slots: recurrent states ``(S, H)`` and previous actions ``(S,)``."""


@dataclass(frozen=True)
class Step:
    """What one step of all slots brought.

    Attributes
    ----------
    actions, rewards, dones
        ``(S,)``.
    observation, memory
        Before the next step; where an episode ended, of the next one.
    infos
        One dictionary per slot.
    finished
        Copies whose episode ended.
    """

    actions: NDArray[np.int64]
    observation: NDArray[Any]
    memory: Memory
    rewards: NDArray[np.floating]
    dones: NDArray[np.bool_]
    infos: list[dict[str, Any]]
    finished: int


class Collector:
    """Acts in a VecEnv by a policy and hands each step to the recorder."""

    def __init__(self, policy: GruPolicy, recorder: Recorder) -> None:
        self._policy, self._recorder = policy, recorder

    def step(
        self,
        env: VecEnv,
        buffer: SequenceReplayBuffer,
        observation: NDArray[Any],
        memory: Memory,
        *,
        epsilon: float,
        at_random: bool,
    ) -> Step:
        """One step of all slots from ``observation``, recorded in ``buffer``."""
        actions, (hidden, _) = self._choose(observation, memory, epsilon, at_random)
        new, rewards, dones, infos = env.step(actions)
        new = np.array(new)  # type: ignore[arg-type]  # an environment may overwrite its own
        ended = self._recorder.record(
            buffer, observation, memory[0], actions, new, rewards, dones, infos
        )
        previous = self._recorder.executed(actions).astype(np.int64)
        if ended.count:  # episodes that begin have no memory and no previous action
            hidden[dones], previous[dones] = 0.0, self._policy.num_actions
        return Step(actions, new, (hidden, previous), rewards, dones, infos, ended.count)

    def _choose(
        self, observation: NDArray[Any], memory: Memory, epsilon: float, at_random: bool
    ) -> tuple[NDArray[np.int64], Memory]:
        """Actions of all slots and the memories after them, by the acting rule or uniformly."""
        policy = self._policy
        policy.epsilon = epsilon
        rule = policy.acting
        if at_random:
            policy.acting = Acting.epsilon_greedy(1.0)
        try:
            actions, (hidden, previous) = policy.predict(observation, memory)
        finally:
            policy.acting = rule
        return actions, (hidden, previous)
