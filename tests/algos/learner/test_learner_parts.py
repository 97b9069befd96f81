"""The parts of a learner, each by itself."""

from __future__ import annotations

from typing import Any

import pytest
import torch
import toys
from pair_learners import SETTINGS, make_pair_learner, weights
from stable_baselines3.common.type_aliases import TrainFreq, TrainFrequencyUnit

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
