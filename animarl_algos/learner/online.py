"""The online loop: act, store, learn. SB3's, with a memory, and counting steps of the world."""

from __future__ import annotations

import sys
import time
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.type_aliases import RolloutReturn, TrainFreq
from stable_baselines3.common.utils import polyak_update, safe_mean
from stable_baselines3.common.vec_env import VecEnv

from animarl_algos.learner.exploration import LinearDecay
from animarl_algos.replay.sequence_buffer import SequenceReplayBuffer

if TYPE_CHECKING:
    from animarl_algos.learner.algorithm import SequenceQLearning

FARTHEST = 1000.0
"""Inputs standardised by random steps are clipped at so many sd: learnt behaviour goes farther."""


def alternate(
    model: SequenceQLearning,
    total_timesteps: int,
    callback: BaseCallback,
    log_interval: int | None,
) -> None:
    """Rollouts and updates in turns, until ``model`` has done ``total_timesteps``."""
    while model.num_timesteps < total_timesteps:
        model.at_boundary()
        rollout = model.collect_rollouts(
            model.env,  # type: ignore[arg-type]
            callback=callback,
            train_freq=model.train_freq,  # type: ignore[arg-type]
            replay_buffer=model.replay_buffer,  # type: ignore[arg-type]
            learning_starts=model.learning_starts,
            log_interval=log_interval,
        )
        if not rollout.continue_training:
            break
        train_as_due(model)


def collect(
    model: SequenceQLearning,
    env: VecEnv,
    callback: BaseCallback,
    train_freq: TrainFreq,
    replay_buffer: SequenceReplayBuffer,
    learning_starts: int,
    log_interval: int | None,
) -> RolloutReturn:
    """Act until ``train_freq`` steps of every copy, or episodes of all copies, are done.

    The end of training and a callback that returns False end it too. What was collected until
    then counts when training is continued, as if it had never been stopped.
    """
    copies, continue_training = model.layout.num_copies, True
    callback.on_rollout_start()
    while (
        continue_training
        and model.num_timesteps < model._total_timesteps
        and model.pace.collecting(train_freq)
    ):
        last_obs: Any = model._last_obs
        step = model.collector.step(
            env,
            replay_buffer,
            last_obs,
            model.memory,
            epsilon=model.exploration_rate,
            at_random=model.num_timesteps < learning_starts,
        )
        # Callbacks of stable-baselines3 read these by name.
        actions, rewards, dones, infos = step.actions, step.rewards, step.dones, step.infos
        new_obs, finished = step.observation, step.finished
        model._last_obs, model._last_episode_starts, model.memory = new_obs, dones, step.memory
        count(model, copies, finished)
        if finished:
            over = np.flatnonzero(dones)
            model._update_info_buffer([infos[s] for s in over], dones[over])
        callback.update_locals(locals() | {"self": model})
        continue_training = callback.on_step()
        if log_interval is not None and model._episode_num % log_interval < finished:
            model.dump_logs()
    if continue_training:
        callback.on_rollout_end()
    return RolloutReturn(model.pace.steps * copies, model.pace.episodes, continue_training)


def count(model: SequenceQLearning, steps: int, episodes: int) -> None:
    """World steps and episodes that have just passed, in all that counts them."""
    model.num_timesteps += steps
    model._episode_num += episodes
    model.pace.passed(episodes)
    model._update_current_progress_remaining(model.num_timesteps, model._total_timesteps)
    set_exploration(model)
    if model.pace.target_due(model.target_update, steps, episodes):
        policy = model.policy
        polyak_update(policy.q_net.parameters(), policy.q_net_target.parameters(), model.tau)


def start_exploration(model: SequenceQLearning, total_timesteps: int) -> None:
    """The schedule of epsilon for a run of ``total_timesteps``, and its present value."""
    steps = model.exploration_steps
    if model.exploration_fraction is not None:
        steps = round(model.exploration_fraction * total_timesteps)
    model.exploration_schedule = LinearDecay(
        model.exploration_initial_eps, model.exploration_final_eps, steps
    )
    set_exploration(model)


def set_exploration(model: SequenceQLearning) -> None:
    """Epsilon as it is due after the steps done."""
    model.exploration_rate = model.exploration_schedule(model.num_timesteps)
    model.policy.epsilon = model.exploration_rate


def train_as_due(model: SequenceQLearning) -> None:
    """Make the updates that a rollout asks for, once it is whole."""
    pace, frequency, buffer = model.pace, model.train_freq, model.replay_buffer
    assert buffer is not None and isinstance(frequency, TrainFreq)
    if pace.collecting(frequency):
        return
    pace.earn(
        frequency,
        copies=model.layout.num_copies,
        gradient_steps=model.gradient_steps,
        updates_per_episode=model.updates_per_episode,
    )
    if model.num_timesteps < model.learning_starts or buffer.num_sequences == 0:
        pace.updates_due = 0.0
        return
    if updates := pace.spend():
        if model.standardise_inputs:
            standardise(model)
        model.train(updates, model.batch_size)


def standardise(model: SequenceQLearning) -> None:
    """Let the networks see inputs in units of what the memory holds now, once for all.

    What was standardised before, in the offline phase too, stays, and so do the inputs that a
    network has learned from in an offline phase as they were.
    """
    assert model.replay_buffer is not None
    policy = model.policy
    if model.offline_progress.done or torch.isfinite(policy.q_net.input_limit).all():
        return
    mean, sd = (torch.from_numpy(each) for each in model.replay_buffer.moments())
    for network in (policy.q_net, policy.q_net_target):
        network.standardise_inputs(mean.to(model.device), sd.to(model.device), limit=FARTHEST)


def write_log(model: SequenceQLearning) -> None:
    """SB3's own figures, losses per individual, epsilon, fill of the memory, steps per second."""
    assert model.ep_info_buffer is not None and model.replay_buffer is not None
    record = model.logger.record
    record("train/n_updates", model._n_updates, exclude="tensorboard")
    for name, means in model.updater.means().items():
        for individual, mean in zip(model.layout.individuals, means):
            record(f"train/{name}/{individual}", mean)
    elapsed = max((time.time_ns() - model.start_time) / 1e9, sys.float_info.epsilon)
    speed = (model.num_timesteps - model._num_timesteps_at_start) / elapsed
    if model.ep_info_buffer:
        for key, name in (("r", "ep_rew_mean"), ("l", "ep_len_mean")):
            record(f"rollout/{name}", safe_mean([info[key] for info in model.ep_info_buffer]))
    if model.ep_success_buffer:
        record("rollout/success_rate", safe_mean(model.ep_success_buffer))
    record("rollout/exploration_rate", model.exploration_rate)
    record("rollout/buffer_episodes", model.replay_buffer.num_episodes)
    record("rollout/buffer_steps", model.replay_buffer.num_steps)
    record("time/episodes", model._episode_num, exclude="tensorboard")
    record("time/fps", int(speed))
    record("time/time_elapsed", int(elapsed), exclude="tensorboard")
    record("time/total_timesteps", model.num_timesteps, exclude="tensorboard")
    model.logger.dump(step=model.num_timesteps)
