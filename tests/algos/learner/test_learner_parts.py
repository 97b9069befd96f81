"""The parts of a learner, each by itself."""

import os
import signal
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import toys
from pair_learners import SETTINGS, Interrupt, make_pair_learner, weights
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.type_aliases import TrainFreq, TrainFrequencyUnit

from animarl_algos.learner.algorithm import SequenceQLearning
from animarl_algos.learner.callbacks import CheckpointCallback
from animarl_algos.learner.checkpoint import latest_checkpoint, load_checkpoint
from animarl_algos.learner.collecting import boltzmann_nll, fit_boltzmann_temperature
from animarl_algos.learner.pretraining import Pretraining, demonstrated_rank
from animarl_algos.learner.updates import AS_MANY_AS_STEPS, Updater, UpdateSchedule
from animarl_algos.recipes.registry import DQN

EPISODES = TrainFreq(2, TrainFrequencyUnit.EPISODE)
STEPS = TrainFreq(3, TrainFrequencyUnit.STEP)

# -- how often ------------------------------------------------------------------------------------


def test_a_rollout_in_episodes_lasts_until_enough_have_finished() -> None:
    schedule = UpdateSchedule()
    for finished, still in ((0, True), (1, True), (0, True), (1, False)):
        schedule.count_step(finished)
        assert schedule.needs_more_steps(EPISODES) is still
    assert (schedule.steps, schedule.episodes) == (4, 2)


def test_fractions_of_updates_are_kept_until_they_are_whole() -> None:
    schedule, made = UpdateSchedule(), []
    for _ in range(6):
        schedule.count_step(2)
        schedule.schedule_updates(EPISODES, copies=4, gradient_steps=1, updates_per_episode=0.375)
        made.append(schedule.take_due_updates())
    assert made == [0, 1, 1, 1, 0, 1]  # of 0.75, 1.5, 2.25, 3, 3.75 and 4.5 in all
    assert schedule.updates_due == 0.5 and schedule.steps == 0


@pytest.mark.parametrize(("asked", "updates"), [(5, 5), (AS_MANY_AS_STEPS, 12)])
def test_updates_per_steps(asked: int, updates: int) -> None:
    schedule = UpdateSchedule()
    for _ in range(3):
        assert schedule.needs_more_steps(STEPS)
        schedule.count_step(0)
    assert not schedule.needs_more_steps(STEPS)
    schedule.schedule_updates(STEPS, copies=4, gradient_steps=asked, updates_per_episode=9.0)
    assert schedule.take_due_updates() == updates


def test_the_target_is_due_in_its_own_unit_and_the_rest_is_carried() -> None:
    by_steps, by_episodes = UpdateSchedule(), UpdateSchedule()
    due = [
        (by_steps.is_target_due(STEPS, 2, 1), by_episodes.is_target_due(EPISODES, 2, 1))
        for _ in range(6)
    ]
    assert [a for a, _ in due] == [False, True, True, False, True, True]
    assert [b for _, b in due] == [False, True] * 3


# -- acting ---------------------------------------------------------------------------------------


def test_each_step_is_taken_with_the_epsilon_that_is_due_before_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Not with that of the step before: the schedule says how many steps are done."""
    model = DQN(
        "MlpPolicy", toys.Pair(2), **SETTINGS | {"exploration_steps": 100}, learning_starts=0
    )
    used, choose = [], model.policy.choose

    def watched(q_values: Any, deterministic: bool) -> Any:
        used.append((model.num_timesteps, model.policy.acting.epsilon))
        return choose(q_values, deterministic)

    monkeypatch.setattr(model.policy, "choose", watched)
    model.learn(60)
    model.learn(60, reset_num_timesteps=False)
    steps, epsilons = zip(*used)
    assert steps == tuple(range(0, 120, 2))
    assert epsilons == pytest.approx([max(0.3, 0.5 - 0.2 * step / 100) for step in steps])


# -- updating -------------------------------------------------------------------------------------


def test_losses_are_averaged_over_the_updates_since_the_last_look() -> None:
    model = make_pair_learner("dqdil", updates_per_episode=0.0).learn(200)
    updater, phase = Updater(model.policy, model.recipe.online), model.phase("online")
    assert updater.means() == {}
    before, summed = weights(model), []
    for updates in (1, 3):
        updater.run(model.replay_buffer, updates, 4, phase, 0.5)  # type: ignore[arg-type]
        summed.append({name: total.clone() for name, total in updater.totals.items()})
    assert not torch.equal(before, weights(model))
    means = updater.means()
    for name, total in summed[1].items():
        assert means[name] == pytest.approx((total / 4).tolist())
        assert (total > summed[0][name]).all()
    assert updater.means() == {}


def test_updates_before_learning_starts_are_forfeited() -> None:
    model = DQN("GruPolicy", toys.Pair(2), **SETTINGS, learning_starts=10_000).learn(100)
    model.schedule.count_step(3)
    model._train_if_due()
    assert model.schedule == UpdateSchedule(since_target=model.schedule.since_target)
    assert model._n_updates == 0


# -- ranks and temperatures -----------------------------------------------------------------------


def test_ties_rank_as_chance_does() -> None:
    values = np.array([[1.0, 1.0, 1.0], [3.0, 2.0, 1.0], [0.0, 5.0, 5.0]])
    np.testing.assert_array_equal(demonstrated_rank(values, np.array([0, 2, 1])), [2.0, 3.0, 1.5])


def test_the_temperature_is_recovered() -> None:
    rng = np.random.default_rng(0)
    values = rng.normal(size=(20_000, 5))
    gumbel = rng.gumbel(size=values.shape)
    actions = (values / 0.3 + gumbel).argmax(1)  # samples of softmax(values / 0.3)
    fitted = fit_boltzmann_temperature(values, actions)
    assert fitted == pytest.approx(0.3, rel=0.03)
    assert boltzmann_nll(values, actions, fitted) <= boltzmann_nll(values, actions, 0.3)


def test_a_few_actions_that_are_all_the_same_make_no_greedy_animal() -> None:
    """Those of a validation animal at rest: the likelihood alone is highest at temperature 0."""
    values = np.array([4.0, 0.0, 0.0]) + np.random.default_rng(0).normal(0, 0.1, size=(25, 3))
    actions = np.zeros(25, dtype=int)
    fitted = fit_boltzmann_temperature(values, actions)
    assert 0.5 < fitted < 1.0
    assert boltzmann_nll(values, actions, 0.01) < boltzmann_nll(values, actions, fitted)


# -- a learner that is stopped, by a callback or by Ctrl-C, has lost nothing ----------------------


WHOLE_RUN = 240


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
        WHOLE_RUN - model.num_timesteps,
        callback=[CheckpointCallback(folder, every=10_000), StopAt(step)],
        reset_num_timesteps=False,
    )


@pytest.mark.parametrize("train_freq", [(1, "episode"), (3, "episode"), (7, "step")])
def test_a_callback_may_stop_at_any_step(train_freq: tuple[int, str], tmp_path: Path) -> None:
    """Continuing, and resuming from the checkpoint, equal a straight run."""
    straight = make_pair_learner("dqn", train_freq=train_freq).learn(WHOLE_RUN)
    stopped = make_pair_learner("dqn", train_freq=train_freq)
    for step in (41, 58, 60, 62, 95, 130, WHOLE_RUN):
        learn_until(stopped, step, tmp_path)
        np.testing.assert_array_equal(stopped._last_obs, present_observation(stopped))
        if step == 95:
            resumed = make_pair_learner("dqn", train_freq=train_freq, seed=99)
            load_checkpoint(resumed, tmp_path)
    resumed.learn(WHOLE_RUN - resumed.num_timesteps, reset_num_timesteps=False)
    for model in (stopped, resumed):
        assert torch.equal(weights(straight), weights(model))
        assert model._n_updates == straight._n_updates > 0
        assert model._episode_num == straight._episode_num


def test_ctrl_c_in_the_last_rollout_is_raised(tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt):
        make_pair_learner("dqn").learn(100, callback=Interrupt(tmp_path, 100))
    assert latest_checkpoint(tmp_path) is not None


def test_a_callback_that_was_interrupted_serves_again(tmp_path: Path) -> None:
    """As in a notebook, where the cell that learns is run once more."""
    callback, model = Interrupt(tmp_path, 100), make_pair_learner("dqn")
    with pytest.raises(KeyboardInterrupt):
        model.learn(WHOLE_RUN, callback=callback)
    model.learn(WHOLE_RUN - model.num_timesteps, callback=callback, reset_num_timesteps=False)
    assert torch.equal(weights(make_pair_learner("dqn").learn(WHOLE_RUN)), weights(model))


def test_ctrl_c_in_the_last_epoch_is_raised(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    train_epoch = Pretraining.train_epoch

    def last_is_interrupted(phase: Pretraining, data: Any) -> Any:
        if phase.progress.epoch == 1:
            os.kill(os.getpid(), signal.SIGINT)
        return train_epoch(phase, data)

    monkeypatch.setattr(Pretraining, "train_epoch", last_is_interrupted)
    with pytest.raises(KeyboardInterrupt):
        make_pair_learner("bc").learn(100, callback=CheckpointCallback(tmp_path, every=10_000))
    resumed = make_pair_learner("bc")
    load_checkpoint(resumed, tmp_path)
    assert resumed.offline_progress.done
