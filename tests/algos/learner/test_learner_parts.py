"""The parts of a learner, each by itself."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch
import toys
from pair_learners import SETTINGS, make_pair_learner, weights
from stable_baselines3.common.type_aliases import TrainFreq, TrainFrequencyUnit

from animarl_algos.learner.collecting import boltzmann_nll, fit_boltzmann_temperature
from animarl_algos.learner.pretraining import demonstrated_rank
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
