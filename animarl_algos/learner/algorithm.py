"""Recurrent double Q-learning on sequences, as an extension of stable-baselines3.

:class:`SequenceQLearning` turns an SB3 off-policy algorithm (DQN, or QRDQN of sb3-contrib) into a
learner with a memory: K individuals, each with its own network, acting in the slots of a VecEnv and
learning from whole episodes or pieces of them. It joins parts that know no learner:
:mod:`.pretraining` (the offline phase) and :mod:`.updates` (when to learn, and how). What the loss
is made of is the recipe's business (:mod:`animarl_algos.losses.terms`); how values are represented
is the value distribution's.
"""

from typing import Any, Self

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.noise import ActionNoise
from stable_baselines3.common.type_aliases import MaybeCallback, RolloutReturn, TrainFreq
from stable_baselines3.common.utils import configure_logger, polyak_update
from stable_baselines3.common.vec_env import VecEnv

from animarl_algos.data.dataset import OfflineDataset, check_demonstrations
from animarl_algos.data.vec_env import (
    check_environment_supports,
    declared,
    declared_feedback,
    feedback_of,
)
from animarl_algos.learner.base import BaseLearner
from animarl_algos.learner.callbacks import with_progress_bar
from animarl_algos.learner.pretraining import (
    DemonstratedValues,
    OfflineProgress,
    Pretraining,
    demonstrated_values,
    fit_boltzmann_temperature,
)
from animarl_algos.learner.updates import minibatch_values, update
from animarl_algos.losses.terms import Recipe
from animarl_algos.losses.values import mean_recall, treatment_counts
from animarl_algos.networks.acting_rule import Acting, Kind
from animarl_algos.networks.policies import State, zero_value_stream
from animarl_algos.replay.sequence_buffer import SequenceReplayBuffer
from animarl_envs.errors import InputError

STEP_VARIABLES = ("actions", "new_obs", "rewards", "dones", "infos")
"""Variables of a step, one entry for each slot, that callbacks of stable-baselines3 read."""
FARTHEST = 1000.0
"""Inputs standardised by random steps are clipped at so many sd: learnt behaviour goes farther."""


class SequenceQLearning(BaseLearner):
    """Sequence Q-learning for K independent individuals; see the recipes for what is minimised.

    Steps are steps of the world: one step of all slots of a copy counts once.
    """

    @property
    def offline_recipe(self) -> Recipe:
        """The recipe whose offline terms are minimised; see ``offline_loss``."""
        return self.recipe.cloning() if self.offline_loss == "cloning" else self.recipe

    def demonstration_data(self) -> Any:
        """Return the demonstrations that were given, or else the environment's own."""
        if self.demonstrations is not None:
            return self.demonstrations
        own = getattr(self.env, "offline_data", None)
        single = declared(self.env, "scenario") if own is None else None
        if single is not None and single.all_splits is not None:
            self.demonstrations = self._as_data(single.all_splits)
            return self.demonstrations
        if own is None or getattr(self.env, "demos", own) is None:
            raise InputError(
                f"recipe {self.recipe.name} learns from demonstrations and neither it nor its "
                "environment was given demonstrations: pass demonstrations="
            )
        return own() if callable(own) else own

    def check_learnable(self) -> None:
        """Check the environment and the demonstrations as :meth:`learn` does before it begins."""
        assert self.env is not None
        check_environment_supports(self.recipe, self.env, self.layout, self.alpha)
        if self.offline_epochs > 0 and not self.offline_progress.done:
            data = self.demonstration_data()
            check_demonstrations(data, self.offline_recipe, self.q_net, self.env)

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
        name = type(self).__name__ if tb_log_name is None else tb_log_name
        total_timesteps, callback = self._setup_learn(
            total_timesteps, callback, reset_num_timesteps, name, progress_bar
        )
        try:
            if self.offline_epochs:
                self.pretrain(progress_bar=progress_bar)
            if self.recipe.online:
                callback.on_training_start(locals(), globals())
                self._learn_online(total_timesteps, callback, log_interval)
                callback.on_training_end()
            self.at_boundary()  # where an interruption of the last stretch is raised
        finally:
            for hook in self.boundary_hooks:
                hook.release()
        return self

    def pretrain(self, *, progress_bar: bool = False) -> OfflineProgress:
        """Run the offline phase, or what is left of it; return its learning curves.

        One that is over stays as it is, also if ``offline_epochs`` is raised. With ``exploration``
        ``"boltzmann"`` the temperatures are fitted to its outcome, for all steps that follow.

        Raises InputError if there are no ``offline_epochs``, or the demonstrations do not suit.
        """
        if not self.offline_epochs:
            raise InputError("there is nothing to pretrain: give offline_epochs")
        if self.offline_progress.done:
            return self.offline_progress
        if not hasattr(self, "_logger"):
            self._logger = configure_logger(self.verbose, self.tensorboard_log, "offline")
        data, policy = self.demonstration_data(), self.policy
        check_demonstrations(data, self.offline_recipe, self.q_net, self.env)
        self.offline_phase().run(data, self.logger, self.at_boundary, progress_bar=progress_bar)
        if self.offline_loss == "cloning":
            zero_value_stream(policy.q_net)
            zero_value_stream(policy.q_net_target)
        policy.reset_optimizer(self.lr_schedule(1.0))
        if self.exploration == "boltzmann":
            policy.acting = Acting.boltzmann(self.fit_temperature(data.val))
        return self.offline_progress

    def offline_phase(self) -> Pretraining:
        """Return the offline phase, as far as it has come."""
        return Pretraining(
            self.policy,
            self.offline_recipe,
            self.phase("offline"),
            self.offline_settings,
            epochs=self.offline_epochs,
            learning_rate=self.offline_learning_rate,
            batch_size=self.offline_batch_size,
            patience=self.offline_patience,
            seed=self.root_seed,
            progress=self.offline_progress,
        )

    def at_boundary(self) -> None:
        """Between updates: let the hooks (checkpoints) look at a state that is whole."""
        for hook in self.boundary_hooks:
            hook.at_boundary()

    def _setup_learn(  # type: ignore[override]
        self, total_timesteps: int, *args: Any
    ) -> tuple[int, BaseCallback]:
        callback, reset_num_timesteps, *rest = args
        if self.env is None:
            raise InputError(
                "there is no environment to learn in: give env=, or call set_env first"
            )
        self.check_learnable()
        if reset_num_timesteps or self._last_obs is None:
            self.memory = self.policy.initial_state(self.n_envs)
            self._require_buffer().drop_running()
            self.schedule.restart_rollout()
        total_timesteps, callback = super()._setup_learn(
            total_timesteps, callback, reset_num_timesteps, *rest
        )
        self._last_obs = np.array(self._last_obs)
        self.feedback_names = declared_feedback(self.env)
        self.treatments_told: Any = 0  # apart, since the last log
        self._set_exploration()
        return total_timesteps, callback

    def _init_callback(self, callback: MaybeCallback, progress_bar: bool = False) -> BaseCallback:
        shown = progress_bar and bool(self.recipe.online)
        return super()._init_callback(with_progress_bar(callback) if shown else callback)

    def _learn_online(
        self, total_timesteps: int, callback: BaseCallback, log_interval: int | None
    ) -> None:
        """Alternate rollouts and updates until ``total_timesteps`` world steps are done."""
        assert self.env is not None and isinstance(self.train_freq, TrainFreq)
        while self.num_timesteps < total_timesteps:
            self.at_boundary()
            rollout = self.collect_rollouts(
                self.env,
                callback=callback,
                train_freq=self.train_freq,
                replay_buffer=self._require_buffer(),
                learning_starts=self.learning_starts,
                log_interval=log_interval,
            )
            if not rollout.continue_training:
                break
            self._train_if_due()

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
        copies, schedule, continue_training = self.layout.num_copies, self.schedule, True
        callback.on_rollout_start()
        while (
            continue_training
            and self.num_timesteps < self._total_timesteps
            and schedule.needs_more_steps(train_freq)
        ):
            self._set_exploration()  # whatever a callback left there
            # Callbacks of stable-baselines3 read these by name.
            actions, (hidden, _) = self._choose_actions(learning_starts)
            new_obs, rewards, dones, infos = env.step(actions)
            new_obs = np.array(new_obs)  # an environment may overwrite its own
            feedback = {"executed": actions} | feedback_of(env, self.feedback_names, infos)
            self._store_step(replay_buffer, new_obs, rewards, dones, infos, feedback)
            previous = feedback["executed"].astype(np.int64)
            # Episodes that begin have no memory and no previous action.
            hidden[dones], previous[dones] = 0.0, self.policy.num_actions
            self.memory = hidden, previous
            self._last_obs, self._last_episode_starts = new_obs, dones
            finished = int(dones.sum()) // self.layout.num_individuals
            self._count(copies, finished)
            if finished:
                over = np.flatnonzero(dones)
                self._update_info_buffer([infos[s] for s in over], dones[over])
            continue_training = self._call_back(callback, locals())
            if log_interval is not None and self._episode_num % log_interval < finished:
                self.dump_logs()
        if continue_training:
            callback.on_rollout_end()
        return RolloutReturn(schedule.steps * copies, schedule.episodes, continue_training)

    def _call_back(self, callback: BaseCallback, variables: dict[str, Any]) -> bool:
        """Call ``callback`` once for each world step, as in one environment; False to stop.

        So ``CheckpointCallback(100)`` saves after 100 world steps, however many copies make them.
        ``variables`` are the locals of a step of all copies; the callback sees those of one copy.
        """
        done, K, copies = self.num_timesteps, self.layout.num_individuals, self.layout.num_copies
        continue_training = True
        for b in range(copies):
            own = slice(b * K, (b + 1) * K)
            self.num_timesteps = done - copies + b + 1
            callback.update_locals(
                variables | {name: variables[name][own] for name in STEP_VARIABLES}
            )
            continue_training = callback.on_step()
            if not continue_training:
                break
        self.num_timesteps = done
        return continue_training

    def _choose_actions(self, learning_starts: int) -> tuple[NDArray[Any], State]:
        """Return an action per slot and the memory after it: uniform before ``learning_starts``."""
        rule = self.policy.acting
        if self.num_timesteps < learning_starts:
            self.policy.acting = Acting.epsilon_greedy(1.0)
        try:
            return self.policy.predict(self._last_obs, self.memory)  # type: ignore[arg-type]
        finally:
            self.policy.acting = rule

    def _store_step(
        self,
        replay_buffer: SequenceReplayBuffer,
        new_obs: NDArray[Any],
        rewards: NDArray[Any],
        dones: NDArray[np.bool_],
        infos: list[dict[str, Any]],
        feedback: dict[str, NDArray[Any]],
    ) -> None:
        """Store the step from the last observation, with the memory before it."""
        successors = new_obs.copy()  # where a slot is done, ``new_obs`` is the next episode's first
        for s in np.flatnonzero(dones):
            successors[s] = infos[s]["terminal_observation"]
        layout, recipe = self.layout, self.recipe

        def by_copy(values: Any) -> Any:
            """(S, ...) as (copies, K, ...), if there are any."""
            shape = (layout.num_copies, layout.num_individuals, *np.shape(values)[1:])
            return None if values is None else np.reshape(values, shape)

        for name, needed in (
            ("dtw_penalty", recipe.needs_distance),
            ("aligned_action", recipe.needs_alignment),
        ):
            if needed and name not in feedback:
                raise InputError(f"the environment declares {name!r} and gave none with a step")
        done = by_copy(dones)[:, 0]
        if not (by_copy(dones) == done[:, None]).all():
            raise InputError(
                "the individuals of a copy ended at different steps: an episode must end for all "
                "of its slots together"
            )
        timed_out = by_copy([info.get("TimeLimit.truncated", False) for info in infos])
        truncated = done & timed_out[:, 0].astype(bool)
        seen = by_copy(np.asarray(self._last_obs).reshape(len(dones), -1))
        warmup, condition = (by_copy(feedback.get(name)) for name in ("warmup", "condition"))
        if condition is None and layout.condition_flag:
            condition = seen[..., -1]
        replay_buffer.add(
            observations=seen,
            actions=by_copy(feedback["executed"]),
            rewards=by_copy(self._learned_rewards(rewards, feedback)),
            next_observations=by_copy(successors.reshape(len(dones), -1)),
            terminated=done & ~truncated,
            truncated=truncated,
            penalties=by_copy(feedback.get("dtw_penalty")),
            labels=by_copy(feedback.get("aligned_action")),
            warmup=None if warmup is None else warmup[:, 0],
            hidden=by_copy(self.memory[0]),
            condition=None if condition is None else condition[:, 0],
        )

    def _learned_rewards(
        self, rewards: NDArray[Any], feedback: dict[str, NDArray[Any]]
    ) -> NDArray[Any]:
        """Return the rewards of a step, or the task's, if the recipe weighs the distance itself.

        Of the latter what is taken back after the recording's end is gone.
        """
        if not self.recipe.needs_distance or "task_reward" not in feedback:
            return rewards
        lasting = feedback["task_reward"]
        task = lasting - feedback.get("dtw_refund", 0.0)
        shaped = [task - weight * feedback["dtw_penalty"] for weight in (1.0, self.alpha)]
        if not any(np.allclose(rewards, each, atol=1e-4) for each in (lasting, *shaped)):
            raise InputError(
                "the reward of a step is neither the task's nor that less the distance: a wrapper "
                f"changed it, and recipe {self.recipe.name} would not learn from that: leave the "
                "wrapper out, or change the reward within the environment"
            )
        return task

    def _count(self, steps: int, episodes: int) -> None:
        """Count world steps and episodes that have just passed; do what depends on their number."""
        self.num_timesteps += steps
        self._episode_num += episodes
        self.schedule.count_step(episodes)
        self._update_current_progress_remaining(self.num_timesteps, self._total_timesteps)
        self._set_exploration()
        if self.schedule.is_target_due(self.target_update, steps, episodes):
            online, target = self.q_net, self.q_net_target
            polyak_update(online.parameters(), target.parameters(), self.tau)

    def _set_exploration(self) -> None:
        """Set epsilon as it is due after the steps done; a policy that samples has none."""
        steps, share = self.exploration_steps, self.exploration_fraction
        if share is not None:
            steps = round(share * self._total_timesteps)
        passed = min(self.num_timesteps / steps, 1.0) if steps else 1.0
        first, last = self.exploration_initial_eps, self.exploration_final_eps
        self.exploration_rate = first + passed * (last - first)
        if self.policy.acting.kind is not Kind.BOLTZMANN:
            self.policy.acting = Acting.epsilon_greedy(self.exploration_rate)

    def _train_if_due(self) -> None:
        """Make the updates that a rollout asks for, once it is whole."""
        schedule, frequency, buffer = self.schedule, self.train_freq, self._require_buffer()
        assert isinstance(frequency, TrainFreq)
        if schedule.needs_more_steps(frequency):
            return
        updates = schedule.take_updates(
            frequency,
            copies=self.layout.num_copies,
            gradient_steps=self.gradient_steps,
            updates_per_episode=self.updates_per_episode,
        )
        if self.num_timesteps < self.learning_starts or buffer.num_sequences == 0:
            schedule.updates_due = 0.0
        elif updates:
            if self.standardise_inputs:
                self._standardise(buffer)
            self.train(updates, self.batch_size)

    def _standardise(self, buffer: SequenceReplayBuffer) -> None:
        """Standardise the networks' inputs by what the memory holds now, once for all.

        What was standardised before, in the offline phase too, stays, and so do the inputs that a
        network has learned from in an offline phase as they were.
        """
        done = torch.isfinite(self.q_net.input_limit).all()
        if self.offline_progress.done or done:
            return
        mean, sd = (torch.from_numpy(each).to(self.device) for each in buffer.moments())
        for network in (self.q_net, self.q_net_target):
            network.standardise_inputs(mean, sd, limit=FARTHEST)

    def train(self, gradient_steps: int, batch_size: int = 32) -> None:
        """Make ``gradient_steps`` updates on sequences from the replay memory."""
        buffer, policy, terms = self._require_buffer(), self.policy, self.recipe.online
        self._update_learning_rate(policy.optimizer)
        progress = 1.0 - self._current_progress_remaining
        phase, needs_target = self.phase("online"), any(term.needs_target for term in terms)
        for _ in range(gradient_steps):
            batch = buffer.sample(batch_size, progress)
            minibatch = minibatch_values(policy, batch, phase, needs_target=needs_target)
            losses, priorities = update(
                minibatch, terms, policy.optimizer, prioritized=buffer.prioritized
            )
            if priorities is not None:
                buffer.update_priorities(batch.indices, priorities)
            if (logits := minibatch.treatment_logits) is not None:
                counts = treatment_counts(logits, minibatch.batch.condition, minibatch.valid)
                self.treatments_told = self.treatments_told + counts
            for name, loss in losses.items():
                for individual, value in zip(self.layout.individuals, loss.tolist()):
                    self.logger.record_mean(f"train/{name}/{individual}", value)
        self._n_updates += gradient_steps

    def dump_logs(self) -> None:
        """Log SB3's own figures, epsilon and the memory's size beside the mean losses."""
        record, buffer = self.logger.record, self._require_buffer()
        record("train/n_updates", self._n_updates, exclude="tensorboard")
        if isinstance(self.treatments_told, torch.Tensor):
            accuracy = mean_recall(self.treatments_told).tolist()
            for individual, value in zip(self.layout.individuals, accuracy):
                record(f"train/treatment_balanced_accuracy/{individual}", value)
            self.treatments_told = 0
        record("rollout/exploration_rate", self.exploration_rate)
        record("rollout/buffer_episodes", buffer.num_episodes)
        record("rollout/buffer_steps", buffer.num_steps)
        super().dump_logs()

    def demonstrated_values(self, dataset: OfflineDataset) -> DemonstratedValues:
        """Return the action values along demonstrated episodes."""
        phase = self.phase("offline")
        return demonstrated_values(self.policy, phase, dataset, self.offline_batch_size)

    def fit_temperature(self, dataset: OfflineDataset) -> NDArray[np.float64]:
        """Return Boltzmann temperatures ``(K,)`` of maximum likelihood for demonstrated actions.

        To act by them: ``model.policy.acting = Acting.boltzmann(model.fit_temperature(data.val))``.
        """
        shown = self.demonstrated_values(dataset)
        fitted = [fit_boltzmann_temperature(v, a) for v, a in zip(shown.values, shown.actions)]
        return np.array(fitted)
