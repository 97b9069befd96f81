"""Callbacks of ``learn``: checkpoints, a progress bar, and returns of every individual.

In a VecEnv of slots each individual is an "environment" to stable-baselines3: its
``evaluate_policy`` averages over predators and prey, and counts an episode of one slot as one of
the world. :func:`evaluate_individuals` does not.
"""

import signal
import sys
import threading
from pathlib import Path
from types import FrameType
from typing import Any, NamedTuple, NoReturn

import numpy as np
from stable_baselines3.common.callbacks import BaseCallback, ConvertCallback
from stable_baselines3.common.logger import HumanOutputFormat, KVWriter, Logger
from stable_baselines3.common.type_aliases import MaybeCallback
from stable_baselines3.common.utils import configure_logger
from stable_baselines3.common.vec_env import VecEnv
from tqdm import tqdm

from animarl_algos.data.slot_layout import SlotLayout, declared_feedback, feedback_of
from animarl_algos.learner.checkpoint import save_checkpoint
from animarl_algos.learner.progress import progress_display
from animarl_envs.array_types import Floats, Ints
from animarl_envs.errors import InputError
from animarl_envs.settings import Count, check_value

TERMINATED = 128 + signal.SIGTERM
"""The exit code after SIGTERM, as a shell gives it."""


class BoundaryCallback(BaseCallback):
    """Is called between updates, when the state of a run is whole, and when ``learn`` ends."""

    model: Any  # a SequenceQLearning, whose list boundary_hooks this joins

    def _init_callback(self) -> None:
        self.model.boundary_hooks.append(self)

    def _on_step(self) -> bool:
        return True

    def at_boundary(self) -> None:
        """Do something between updates and before each offline epoch; the learner calls it."""

    def release(self) -> None:
        """Clean up when ``learn`` ends, also after an error or an interruption."""


class CheckpointCallback(BoundaryCallback):
    """Writes a checkpoint into ``folder`` every ``every`` world steps and after each offline epoch.

    On Ctrl-C (SIGINT) and SIGTERM the update under way is finished, a checkpoint written, and
    ``KeyboardInterrupt`` or ``SystemExit`` raised; a second signal does so at once. One checkpoint
    is kept.
    """

    def __init__(self, folder: str | Path, every: int, verbose: int = 0) -> None:
        super().__init__(verbose)
        if every < 1:
            raise InputError(f"a checkpoint every {every} steps is not possible: give at least 1")
        self.folder = Path(folder)
        self.every = every
        self.interrupted: int | None = None
        self._previous_handlers: dict[int, Any] = {}

    def _init_callback(self) -> None:
        super()._init_callback()
        self.interrupted = None  # the same callback may serve again after a Ctrl-C
        self.due = self.every * (self.model.num_timesteps // self.every + 1)
        self.epochs = 0
        if threading.current_thread() is threading.main_thread():  # signals go there
            for number in (signal.SIGINT, signal.SIGTERM):
                self._previous_handlers[number] = signal.signal(number, self._on_interrupt)

    def _on_interrupt(self, number: int, frame: FrameType | None) -> None:
        if self.interrupted is not None:
            _stop(number)
        self.interrupted = number

    def at_boundary(self) -> None:
        """Write a checkpoint where one is due; stop after it if a signal came."""
        model = self.model
        due = model.num_timesteps >= self.due or model.offline_progress.epoch > self.epochs
        if due or self.interrupted is not None:
            save_checkpoint(model, self.folder)
            self.due = self.every * (model.num_timesteps // self.every + 1)
            self.epochs = model.offline_progress.epoch
        if self.interrupted is not None:
            self.release()
            _stop(self.interrupted)

    def _on_training_end(self) -> None:
        save_checkpoint(self.model, self.folder)
        self.release()

    def release(self) -> None:
        """Give the signals back to whoever had them."""
        while self._previous_handlers:
            signal.signal(*self._previous_handlers.popitem())


def _stop(number: int) -> NoReturn:
    if number == signal.SIGTERM:
        sys.exit(TERMINATED)
    raise KeyboardInterrupt


class ProgressBar(BoundaryCallback):
    """Advances by the world steps done; its line is ended however training ends."""

    _bar: tqdm | None = None

    def _on_training_start(self) -> None:
        self._seen = self.model.num_timesteps
        self._bar = progress_display("online", "step", self.locals["total_timesteps"] - self._seen)

    def _on_step(self) -> bool:
        assert self._bar is not None
        self._bar.update(self.model.num_timesteps - self._seen)
        self._seen = self.model.num_timesteps
        return True

    def release(self) -> None:
        """End the line of the bar."""
        if self._bar is not None:
            self._bar.close()

    def _on_training_end(self) -> None:
        self.release()


def with_progress_bar(callback: MaybeCallback) -> list[BaseCallback]:
    """Return the callbacks that ``learn`` was given, and one that shows progress."""
    given = callback if isinstance(callback, list) else [callback]
    each = [
        c if isinstance(c, BaseCallback) else ConvertCallback(c) for c in given if c is not None
    ]
    return [*each, ProgressBar()]


def open_logger(model: Any, tensorboard: str = "") -> None:
    """Give a model that has no logger one to the terminal, if verbose.

    The one that stable-baselines3 would make leaves an empty temporary folder for each training.
    With ``tensorboard_log`` the model gets one of that name, or stable-baselines3 makes it.
    """
    if hasattr(model, "_logger"):
        return
    if model.tensorboard_log is not None:
        if tensorboard:
            model._logger = configure_logger(model.verbose, model.tensorboard_log, tensorboard)
        return
    terminal: list[KVWriter] = [HumanOutputFormat(sys.stdout)] if model.verbose else []
    model.set_logger(Logger(None, terminal))


# -- returns --------------------------------------------------------------------------------------


class IndividualReturns(NamedTuple):
    """Returns ``(episodes, K)`` in the order of ``individuals``, and lengths [steps]."""

    individuals: tuple[str, ...]
    returns: Floats
    lengths: Ints

    @property
    def mean(self) -> dict[str, float]:
        """Mean return by individual."""
        return dict(zip(self.individuals, self.returns.mean(axis=0).tolist(), strict=True))


def evaluate_individuals(
    model: Any, env: VecEnv, episodes: int = 10, *, deterministic: bool = True
) -> IndividualReturns:
    """Let ``model``, a learner or its policy, act in ``env`` for so many episodes of the world.

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
    check_value("episodes", episodes, Count)
    layout = SlotLayout.of(env)
    copies, K = layout.num_copies, layout.num_individuals
    wanted = np.array([(episodes + b) // copies for b in range(copies)])
    done = np.zeros(copies, dtype=np.int64)
    total, steps = np.zeros((copies, K)), np.zeros(copies, dtype=np.int64)
    returns, lengths = [], []
    observation, names = env.reset(), declared_feedback(env)
    state, starts = None, np.ones(env.num_envs, dtype=bool)
    while (done < wanted).any():
        actions, state = model.predict(observation, state, starts, deterministic)
        observation, rewards, starts, infos = env.step(actions)
        executed = feedback_of(env, names, infos).get("executed", actions)
        state = model.remember(state, executed)
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
        Of the environment and of the policy's draws at each evaluation, so that all are alike;
        ``None``: they go on.

    Attributes
    ----------
    history
        ``(step, returns)`` of all evaluations so far.
    """

    model: Any  # a SequenceQLearning

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
        self.every, self.episodes = (
            check_value("every", every, Count),
            check_value("episodes", episodes, Count),
        )
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
        """Evaluate now, log and keep the returns."""
        policy = self.model.policy
        acting = policy.random_state  # training goes on with the draws it would have had
        if self.seed is not None:
            self.env.seed(self.seed)
            policy.seed(self.seed)
        returns = evaluate_individuals(
            self.model, self.env, self.episodes, deterministic=self.deterministic
        )
        policy.random_state = acting
        for name, mean in returns.mean.items():
            self.logger.record(f"eval/mean_reward/{name}", mean)
            if self.verbose:
                print(f"step {self.model.num_timesteps}: {name} mean return {mean:.3f}")
        self.logger.record("eval/mean_ep_length", float(returns.lengths.mean()))
        self.history.append((self.model.num_timesteps, returns))
        return returns
