"""The online loop: act, store, learn. SB3's, with a memory, and counting steps of the world."""

from __future__ import annotations

import sys
import time
from abc import abstractmethod
from typing import Any, ClassVar, Protocol, Self

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3.common.callbacks import BaseCallback, ConvertCallback
from stable_baselines3.common.noise import ActionNoise
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from stable_baselines3.common.type_aliases import (
    MaybeCallback,
    RolloutReturn,
    TrainFreq,
    TrainFrequencyUnit,
)
from stable_baselines3.common.utils import polyak_update, safe_mean, should_collect_more_steps
from stable_baselines3.common.vec_env import VecEnv

from animarl_algos.data.slots import SlotLayout
from animarl_algos.learner.exploration import LinearDecay
from animarl_algos.learner.gradient_step import minibatch_values, update
from animarl_algos.learner.progress import ProgressBar
from animarl_algos.learner.recorder import Recorder, check_environment
from animarl_algos.losses.losses import mean_recall, treatment_counts
from animarl_algos.losses.recipe import Recipe
from animarl_algos.losses.terms import Phase
from animarl_algos.networks.policies import GruPolicy
from animarl_algos.replay.sequence_buffer import SequenceReplayBuffer
from animarl_envs.errors import InputError

AS_MANY_AS_STEPS = -1
"""Value of ``gradient_steps``, as in stable-baselines3."""

Memory = tuple[NDArray[np.float32], NDArray[np.int64]]


class BoundaryHook(Protocol):
    """Is told between updates, when the state of a run is whole, and when ``learn`` ends."""

    def at_boundary(self) -> None: ...

    def release(self) -> None: ...


class OnlineLoop(OffPolicyAlgorithm):
    """``learn``, ``collect_rollouts`` and ``train`` for policies with a memory."""

    recipe: ClassVar[Recipe]
    policy: GruPolicy
    replay_buffer: SequenceReplayBuffer | None  # type: ignore[assignment]
    layout: SlotLayout
    boundary_hooks: list[BoundaryHook]
    exploration_schedule: LinearDecay
    target_update: TrainFreq
    updates_per_episode: float
    exploration_initial_eps: float
    exploration_final_eps: float
    exploration_steps: int
    exploration_fraction: float | None
    exploration_rate: float
    _updates_due: float
    _target_count: int
    _rollout_steps: int
    _rollout_episodes: int

    @abstractmethod
    def phase(self, name: str) -> Phase:
        """The numbers of the ``"offline"`` or ``"online"`` phase."""

    @abstractmethod
    def prepare(self, callback: BaseCallback, *, progress_bar: bool) -> None:
        """What comes before the first step in the environment: the offline phase, if any."""

    # -- learn ------------------------------------------------------------------------------------

    def learn(
        self,
        total_timesteps: int,
        callback: MaybeCallback = None,
        log_interval: int | None = 100,
        tb_log_name: str | None = None,
        reset_num_timesteps: bool = True,
        progress_bar: bool = False,
    ) -> Self:
        """Train: first the offline phase if it is due, then ``total_timesteps`` world steps.

        With ``reset_num_timesteps=False`` running episodes and memories are continued. A recipe
        without an online phase (BC) returns after the offline one. ``log_interval`` counts
        episodes.
        """
        self.boundary_hooks = []
        total_timesteps, callback = self._setup_learn(
            total_timesteps,
            callback,
            reset_num_timesteps,
            type(self).__name__ if tb_log_name is None else tb_log_name,
            progress_bar,
        )
        assert self.env is not None and self.replay_buffer is not None
        try:
            self.prepare(callback, progress_bar=progress_bar)
            if self.recipe.online:
                callback.on_training_start(locals(), globals())
                self._alternate(total_timesteps, callback, log_interval)
                callback.on_training_end()
            self.at_boundary()  # where an interruption of the last stretch is raised
        finally:
            for hook in self.boundary_hooks:
                hook.release()
        return self

    def _alternate(
        self, total_timesteps: int, callback: BaseCallback, log_interval: int | None
    ) -> None:
        """Rollouts and updates in turns."""
        while self.num_timesteps < total_timesteps:
            self.at_boundary()
            rollout = self.collect_rollouts(
                self.env,  # type: ignore[arg-type]
                callback=callback,
                train_freq=self.train_freq,  # type: ignore[arg-type]
                replay_buffer=self.replay_buffer,  # type: ignore[arg-type]
                learning_starts=self.learning_starts,
                log_interval=log_interval,
            )
            if not rollout.continue_training:
                break
            self._train_as_due()

    def at_boundary(self) -> None:
        """Between updates: let the hooks (checkpoints) look at a state that is whole."""
        for hook in self.boundary_hooks:
            hook.at_boundary()

    def _setup_learn(
        self,
        total_timesteps: int,
        callback: MaybeCallback = None,
        reset_num_timesteps: bool = True,
        tb_log_name: str = "run",
        progress_bar: bool = False,
    ) -> tuple[int, BaseCallback]:
        if self.env is None:
            raise InputError(
                "there is no environment to learn in: give env=, or call set_env first"
            )
        check_environment(self.env, self.layout, self.recipe)
        fresh = reset_num_timesteps or self._last_obs is None
        if fresh:
            self.memory: Memory = self.policy.initial_state(self.n_envs)
            assert self.replay_buffer is not None
            self.replay_buffer.drop_running()
            self._rollout_steps = self._rollout_episodes = 0
        total_timesteps, callback = super()._setup_learn(
            total_timesteps, callback, reset_num_timesteps, tb_log_name, progress_bar
        )
        self._last_obs = np.array(self._last_obs)
        self._start_averages()
        self._recorder = Recorder(self.env, self.layout, self.recipe)
        steps = self.exploration_steps
        if self.exploration_fraction is not None:
            steps = round(self.exploration_fraction * total_timesteps)
        self.exploration_schedule = LinearDecay(
            self.exploration_initial_eps, self.exploration_final_eps, steps
        )
        self._set_exploration()
        return total_timesteps, callback

    def _init_callback(self, callback: MaybeCallback, progress_bar: bool = False) -> BaseCallback:
        if progress_bar and self.recipe.online:
            given = callback if isinstance(callback, list) else [callback]
            callback = [
                c if isinstance(c, BaseCallback) else ConvertCallback(c)
                for c in given
                if c is not None
            ]
            callback.append(ProgressBar())
        return super()._init_callback(callback)

    # -- act --------------------------------------------------------------------------------------

    def collect_rollouts(
        self,
        env: VecEnv,
        callback: BaseCallback,
        train_freq: TrainFreq,
        replay_buffer: SequenceReplayBuffer,  # type: ignore[override]
        action_noise: ActionNoise | None = None,
        learning_starts: int = 0,
        log_interval: int | None = None,
    ) -> RolloutReturn:
        """Act until ``train_freq`` steps of every copy, or episodes of all copies, are done.

        The end of training and a callback that returns False end it too. What was collected until
        then counts when training is continued, as if it had never been stopped.
        """
        copies, continue_training = self.layout.num_copies, True
        callback.on_rollout_start()
        while (
            continue_training
            and self.num_timesteps < self._total_timesteps
            and should_collect_more_steps(train_freq, self._rollout_steps, self._rollout_episodes)
        ):
            actions, hidden = self._act(learning_starts)
            observation: Any = self._last_obs
            new_obs, rewards, dones, infos = env.step(actions)
            new_obs = np.array(new_obs)  # an environment may overwrite its own
            ended = self._recorder.record(
                replay_buffer, observation, hidden, actions, new_obs, rewards, dones, infos
            )
            self._last_obs = new_obs
            self._last_episode_starts = dones
            finished = ended.count
            self._count(copies, finished)
            if finished:
                self._forget(dones)
                over = np.flatnonzero(dones)
                self._update_info_buffer([infos[s] for s in over], dones[over])
            callback.update_locals(locals())
            continue_training = callback.on_step()
            if log_interval is not None and self._episode_num % log_interval < finished:
                self.dump_logs()
        if continue_training:
            callback.on_rollout_end()
        return RolloutReturn(
            self._rollout_steps * copies, self._rollout_episodes, continue_training
        )

    def _count(self, steps: int, episodes: int) -> None:
        """World steps and episodes that have just passed, in all that counts them."""
        self.num_timesteps += steps
        self._episode_num += episodes
        self._rollout_steps += 1
        self._rollout_episodes += episodes
        self._update_current_progress_remaining(self.num_timesteps, self._total_timesteps)
        self._set_exploration()
        self._update_target(steps, episodes)

    def _act(self, learning_starts: int) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
        """Actions of all slots, and the recurrent states before them; the memory moves on.

        They are uniformly random in the first ``learning_starts`` steps.
        """
        policy, hidden, temperature = self.policy, self.memory[0], self.policy.temperature
        policy.epsilon = self.exploration_rate
        if self.num_timesteps < learning_starts:
            policy.epsilon, policy.temperature = 1.0, None
        try:
            actions, self.memory = policy.predict(self._last_obs, self.memory)  # type: ignore
        finally:
            policy.epsilon, policy.temperature = self.exploration_rate, temperature
        return actions, hidden

    def _forget(self, dones: NDArray[np.bool_]) -> None:
        """Episodes that begin have no memory and no previous action."""
        hidden, previous = self.memory
        hidden[dones], previous[dones] = 0.0, self.policy.num_actions

    def _set_exploration(self) -> None:
        self.exploration_rate = self.exploration_schedule(self.num_timesteps)
        self.policy.epsilon = self.exploration_rate

    # -- learn from the memory --------------------------------------------------------------------

    def _train_as_due(self) -> None:
        """Make the updates that a rollout asks for, once it is whole."""
        assert self.replay_buffer is not None and isinstance(self.train_freq, TrainFreq)
        steps, episodes = self._rollout_steps, self._rollout_episodes
        if should_collect_more_steps(self.train_freq, steps, episodes):
            return
        self._rollout_steps = self._rollout_episodes = 0
        if self.train_freq.unit is TrainFrequencyUnit.EPISODE:
            self._updates_due += self.updates_per_episode * episodes
        elif self.gradient_steps == AS_MANY_AS_STEPS:
            self._updates_due += steps * self.layout.num_copies
        else:
            self._updates_due += self.gradient_steps
        if self.num_timesteps < self.learning_starts or self.replay_buffer.num_sequences == 0:
            self._updates_due = 0.0
            return
        updates, self._updates_due = int(self._updates_due), self._updates_due % 1.0
        if updates:
            self.train(updates, self.batch_size)

    def train(self, gradient_steps: int, batch_size: int = 32) -> None:
        """``gradient_steps`` updates on sequences from the replay memory."""
        assert self.replay_buffer is not None
        policy, phase, terms = self.policy, self.phase("online"), self.recipe.online
        self._update_learning_rate(policy.optimizer)
        progress = 1.0 - self._current_progress_remaining
        totals: dict[str, torch.Tensor] = {}
        for _ in range(gradient_steps):
            batch = self.replay_buffer.sample(batch_size, progress)
            minibatch = minibatch_values(
                batch,
                phase,
                policy.q_net,
                policy.q_net_target,
                policy.distribution,
                needs_target=any(term.needs_target for term in terms),
            )
            result = update(
                minibatch, terms, policy.optimizer, prioritized=self.replay_buffer.prioritized
            )
            if result.priorities is not None:
                self.replay_buffer.update_priorities(batch.indices, result.priorities)
            for name, loss in result.losses.items():
                totals[name] = totals[name] + loss if name in totals else loss
            if minibatch.treatment_logits is not None:
                self._treatment_counts += treatment_counts(
                    minibatch.treatment_logits, minibatch.batch.condition, minibatch.valid
                )
        self._n_updates += gradient_steps
        for name, total in totals.items():
            before, updates = self._losses.get(name, (torch.zeros_like(total), 0))
            self._losses[name] = (before + total, updates + gradient_steps)

    def _update_target(self, steps: int, episodes: int) -> None:
        passed = steps if self.target_update.unit is TrainFrequencyUnit.STEP else episodes
        self._target_count += passed
        if self._target_count >= self.target_update.frequency:
            self._target_count %= self.target_update.frequency
            polyak_update(
                self.policy.q_net.parameters(), self.policy.q_net_target.parameters(), self.tau
            )

    # -- log --------------------------------------------------------------------------------------

    def _start_averages(self) -> None:
        self._losses: dict[str, tuple[torch.Tensor, int]] = {}
        shape = (self.layout.num_individuals, 2, 2)
        self._treatment_counts = torch.zeros(shape, dtype=torch.int64, device=self.device)

    def _record_losses(self) -> None:
        """Means over the updates since the last log, for each individual."""
        self.logger.record("train/n_updates", self._n_updates, exclude="tensorboard")
        means = {name: summed / updates for name, (summed, updates) in self._losses.items()}
        if self._treatment_counts.any():
            means["treatment_balanced_accuracy"] = mean_recall(self._treatment_counts)
        for name, mean in means.items():
            for individual, value in zip(self.layout.individuals, mean.tolist()):
                self.logger.record(f"train/{name}/{individual}", value)
        self._start_averages()

    def dump_logs(self) -> None:
        """Write the log: SB3's own figures, epsilon, fill of the memory, world steps per second."""
        assert self.ep_info_buffer is not None and self.replay_buffer is not None
        self._record_losses()
        elapsed = max((time.time_ns() - self.start_time) / 1e9, sys.float_info.epsilon)
        speed = (self.num_timesteps - self._num_timesteps_at_start) / elapsed
        if self.ep_info_buffer:
            for key, name in (("r", "ep_rew_mean"), ("l", "ep_len_mean")):
                mean = safe_mean([info[key] for info in self.ep_info_buffer])
                self.logger.record(f"rollout/{name}", mean)
        if self.ep_success_buffer:
            self.logger.record("rollout/success_rate", safe_mean(self.ep_success_buffer))
        self.logger.record("rollout/exploration_rate", self.exploration_rate)
        self.logger.record("rollout/buffer_episodes", self.replay_buffer.num_episodes)
        self.logger.record("rollout/buffer_steps", self.replay_buffer.num_steps)
        self.logger.record("time/episodes", self._episode_num, exclude="tensorboard")
        self.logger.record("time/fps", int(speed))
        self.logger.record("time/time_elapsed", int(elapsed), exclude="tensorboard")
        self.logger.record("time/total_timesteps", self.num_timesteps, exclude="tensorboard")
        self.logger.dump(step=self.num_timesteps)
