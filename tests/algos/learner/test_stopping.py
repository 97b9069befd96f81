"""A learner that is stopped, by a callback or by Ctrl-C, has lost nothing."""

from __future__ import annotations

import os
import signal
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import toys
from pair_learners import make_pair_learner, weights
from stable_baselines3.common.callbacks import BaseCallback

from animarl_algos.learner.algorithm import SequenceQLearning
from animarl_algos.learner.callbacks import CheckpointCallback
from animarl_algos.learner.checkpoint import latest_checkpoint, load_checkpoint
from animarl_algos.learner.pretraining import Pretraining

STEPS = 240


class StopAt(BaseCallback):
    """Ends training at a world step, and looks at what it is shown at every one."""

    def __init__(self, step: int) -> None:
        super().__init__()
        self.step = step

    def _on_step(self) -> bool:
        assert {"infos", "dones", "rewards", "actions"} <= set(self.locals)
        np.testing.assert_array_equal(self.locals["new_obs"], present_observation(self.model))
        return self.num_timesteps < self.step


def present_observation(model: Any) -> Any:
    """What the toy that ``model`` learns in shows now."""
    env = model.env
    assert isinstance(env, toys.Toy)
    return env._slots(env.observe())


def learn_until(model: SequenceQLearning, step: int, folder: Path) -> None:
    model.learn(
        STEPS - model.num_timesteps,
        callback=[CheckpointCallback(folder, every=10_000), StopAt(step)],
        reset_num_timesteps=False,
    )


@pytest.mark.parametrize("train_freq", [(1, "episode"), (3, "episode"), (7, "step")])
def test_a_callback_may_stop_at_any_step(train_freq: tuple[int, str], tmp_path: Path) -> None:
    """Continuing, and resuming from the checkpoint, equal a straight run."""
    straight = make_pair_learner("dqn", train_freq=train_freq).learn(STEPS)
    stopped = make_pair_learner("dqn", train_freq=train_freq)
    for step in (41, 58, 60, 62, 95, 130, STEPS):
        learn_until(stopped, step, tmp_path)
        np.testing.assert_array_equal(stopped._last_obs, present_observation(stopped))
        if step == 95:
            resumed = make_pair_learner("dqn", train_freq=train_freq, seed=99)
            load_checkpoint(resumed, tmp_path)
    resumed.learn(STEPS - resumed.num_timesteps, reset_num_timesteps=False)
    for model in (stopped, resumed):
        assert torch.equal(weights(straight), weights(model))
        assert model._n_updates == straight._n_updates > 0
        assert model._episode_num == straight._episode_num


def interrupt() -> None:
    os.kill(os.getpid(), signal.SIGINT)


def test_ctrl_c_in_the_last_rollout_is_raised(tmp_path: Path) -> None:
    class Interrupt(CheckpointCallback):
        def _on_step(self) -> bool:
            if self.model.num_timesteps == 100:
                interrupt()
            return True

    with pytest.raises(KeyboardInterrupt):
        make_pair_learner("dqn").learn(100, callback=Interrupt(tmp_path, every=10_000))
    assert latest_checkpoint(tmp_path) is not None


def test_a_callback_that_was_interrupted_serves_again(tmp_path: Path) -> None:
    """As in a notebook, where the cell that learns is run once more."""

    class InterruptOnce(CheckpointCallback):
        def _on_step(self) -> bool:
            if self.model.num_timesteps == 100:
                interrupt()
            return True

    callback, model = InterruptOnce(tmp_path, every=10_000), make_pair_learner("dqn")
    with pytest.raises(KeyboardInterrupt):
        model.learn(STEPS, callback=callback)
    model.learn(STEPS - model.num_timesteps, callback=callback, reset_num_timesteps=False)
    assert torch.equal(weights(make_pair_learner("dqn").learn(STEPS)), weights(model))


def test_ctrl_c_in_the_last_epoch_is_raised(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    train_epoch = Pretraining.train_epoch

    def last_is_interrupted(phase: Pretraining, data: Any) -> Any:
        if phase.progress.epoch == 1:
            interrupt()
        return train_epoch(phase, data)

    monkeypatch.setattr(Pretraining, "train_epoch", last_is_interrupted)
    with pytest.raises(KeyboardInterrupt):
        make_pair_learner("bc").learn(100, callback=CheckpointCallback(tmp_path, every=10_000))
    resumed = make_pair_learner("bc")
    load_checkpoint(resumed, tmp_path)
    assert resumed.offline_progress.done
