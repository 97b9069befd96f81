"""Returns of every individual by itself, where stable-baselines3 would mix them into one mean.

In a VecEnv of slots each individual is an "environment" to stable-baselines3: its
``evaluate_policy`` averages over predators and prey, and counts an episode of one slot as one of
the world.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecEnv

from animarl_algos.data.slots import Feedback, SlotLayout
from animarl_algos.ranges import COUNT

if TYPE_CHECKING:
    from animarl_algos.learner.algorithm import SequenceQLearning


class IndividualReturns(NamedTuple):
    """What :func:`evaluate_individuals` found: ``returns`` ``(episodes, K)`` in the order of
    ``individuals``, and ``lengths`` ``(episodes,)`` [steps].
    """

    individuals: tuple[str, ...]
    returns: NDArray[np.float64]
    lengths: NDArray[np.int64]

    @property
    def mean(self) -> dict[str, float]:
        """Mean return by individual."""
        return dict(zip(self.individuals, self.returns.mean(axis=0).tolist(), strict=True))


def evaluate_individuals(
    model: SequenceQLearning, env: VecEnv, episodes: int = 10, *, deterministic: bool = True
) -> IndividualReturns:
    """Let ``model`` act in ``env`` for so many episodes of the world.

    Each copy of the world contributes the same number of them or one more, as in
    stable-baselines3: short episodes are not preferred.

    Parameters
    ----------
    env
        A VecEnv of slots, such as a :class:`~animarl_algos.data.vec_env.SlotVecEnv`; seed it
        before for the same episodes again.
    deterministic
        The greedy action; otherwise as the policy's acting rule says.
    """
    COUNT.check("episodes", episodes)
    layout = SlotLayout.of(env)
    copies, K = layout.num_copies, layout.num_individuals
    wanted = np.array([(episodes + b) // copies for b in range(copies)])
    done = np.zeros(copies, dtype=np.int64)
    total, steps = np.zeros((copies, K)), np.zeros(copies, dtype=np.int64)
    returns, lengths = [], []
    feedback = Feedback(env)
    observation = env.reset()
    state, starts = None, np.ones(env.num_envs, dtype=bool)
    while (done < wanted).any():
        actions, state = model.predict(
            observation,  # type: ignore[arg-type]
            state,
            starts,
            deterministic,
        )
        observation, rewards, starts, infos = env.step(actions)
        feedback.update(infos)
        state = model.remember(state, feedback.executed(actions))
        total += rewards.reshape(copies, K)
        steps += 1
        for b in np.flatnonzero(starts.reshape(copies, K)[:, 0]):
            if done[b] < wanted[b]:
                returns.append(total[b].copy())
                lengths.append(int(steps[b]))
                done[b] += 1
            total[b], steps[b] = 0.0, 0
    return IndividualReturns(layout.individuals, np.array(returns), np.array(lengths))


class EvaluateIndividuals(BaseCallback):
    """Scores every individual while a learner trains, and logs ``eval/mean_reward/<name>``.

    Parameters
    ----------
    env
        A VecEnv of slots to act in, not the one that is learnt in.
    every
        Steps of the world between evaluations.
    episodes, deterministic
        Of :func:`evaluate_individuals`.
    seed
        Of the environment at each evaluation, so that all start alike; ``None``: they go on.

    Attributes
    ----------
    history
        ``(step, returns)`` of all evaluations so far.
    """

    model: SequenceQLearning  # type: ignore[assignment]

    def __init__(
        self,
        env: VecEnv,
        every: int = 10_000,
        episodes: int = 10,
        *,
        deterministic: bool = True,
        seed: int | None = 0,
        verbose: int = 0,
    ) -> None:
        super().__init__(verbose)
        self.every, self.episodes = COUNT.check("every", every), COUNT.check("episodes", episodes)
        self.env, self.deterministic, self.seed = env, deterministic, seed
        self.history: list[tuple[int, IndividualReturns]] = []
        self._due = self.every

    def _on_training_start(self) -> None:
        self._due = (self.num_timesteps // self.every + 1) * self.every

    def _on_step(self) -> bool:
        now = self.model.num_timesteps
        if now >= self._due:
            self._due = (now // self.every + 1) * self.every
            self.evaluate()
        return True

    def evaluate(self) -> IndividualReturns:
        """Evaluate now, log and keep what was found."""
        if self.seed is not None:
            self.env.seed(self.seed)
        found = evaluate_individuals(
            self.model, self.env, self.episodes, deterministic=self.deterministic
        )
        for name, mean in found.mean.items():
            self.logger.record(f"eval/mean_reward/{name}", mean)
            if self.verbose:
                print(f"step {self.model.num_timesteps}: {name} mean return {mean:.3f}")
        self.logger.record("eval/mean_ep_length", float(found.lengths.mean()))
        self.history.append((self.model.num_timesteps, found))
        return found
