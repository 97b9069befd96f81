"""The parts of a learner, each by itself."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
import toys
from pair_learners import SETTINGS, make_pair_learner, weights
from stable_baselines3.common.type_aliases import TrainFreq, TrainFrequencyUnit

from animarl_algos.learner.collecting import Collector
from animarl_algos.learner.online import train_as_due
from animarl_algos.learner.pace import AS_MANY_AS_STEPS, Pace
from animarl_algos.learner.saving import pace_from, pace_numbers
from animarl_algos.learner.updating import Updater
from animarl_algos.networks.acting_rule import Acting
from animarl_algos.recipes.registry import DQN

EPISODES = TrainFreq(2, TrainFrequencyUnit.EPISODE)
STEPS = TrainFreq(3, TrainFrequencyUnit.STEP)

# -- how often ------------------------------------------------------------------------------------


def test_a_rollout_in_episodes_lasts_until_enough_have_finished() -> None:
    pace = Pace()
    for finished, still in ((0, True), (1, True), (0, True), (1, False)):
        pace.passed(finished)
        assert pace.collecting(EPISODES) is still
    assert (pace.steps, pace.episodes) == (4, 2)


def test_fractions_of_updates_are_kept_until_they_are_whole() -> None:
    pace, made = Pace(), []
    for _ in range(6):
        pace.passed(2)
        pace.earn(EPISODES, copies=4, gradient_steps=1, updates_per_episode=0.375)
        made.append(pace.spend())
    assert made == [0, 1, 1, 1, 0, 1]  # of 0.75, 1.5, 2.25, 3, 3.75 and 4.5 in all
    assert pace.updates_due == 0.5 and pace.steps == 0


@pytest.mark.parametrize(("asked", "updates"), [(5, 5), (AS_MANY_AS_STEPS, 12)])
def test_updates_per_steps(asked: int, updates: int) -> None:
    pace = Pace()
    for _ in range(3):
        assert pace.collecting(STEPS)
        pace.passed(0)
    assert not pace.collecting(STEPS)
    pace.earn(STEPS, copies=4, gradient_steps=asked, updates_per_episode=9.0)
    assert pace.spend() == updates


def test_the_target_is_due_in_its_own_unit_and_the_rest_is_carried() -> None:
    by_steps, by_episodes = Pace(), Pace()
    due = [
        (by_steps.target_due(STEPS, 2, 1), by_episodes.target_due(EPISODES, 2, 1)) for _ in range(6)
    ]
    assert [a for a, _ in due] == [False, True, True, False, True, True]
    assert [b for _, b in due] == [False, True] * 3


def test_the_pace_is_found_again_under_the_names_of_files() -> None:
    pace = Pace(steps=3, episodes=1, updates_due=0.25, since_target=7)
    numbers = pace_numbers(pace) | {"other": 1}
    assert numbers["_updates_due"] == 0.25 and numbers["_target_count"] == 7
    assert pace_from(numbers) == pace and numbers == {"other": 1}
    assert pace_from({}) == Pace()


# -- acting ---------------------------------------------------------------------------------------


class ListRecorder:
    """Keeps what it is given, and says that every copy ended."""

    count = 2

    def __init__(self) -> None:
        self.given: list[Any] = []

    def record(self, *given: Any) -> ListRecorder:
        self.given.append(given)
        return self

    def executed(self, actions: Any) -> Any:
        return actions


def test_a_step_is_recorded_with_the_state_before_it_and_forgotten_where_it_ended() -> None:
    model = DQN("GruPolicy", toys.Pair(2), **SETTINGS)
    env, recorder = model.env, ListRecorder()
    assert env is not None
    memory = model.policy.initial_state(4)
    memory[0][:] = 0.5
    collector = Collector(model.policy, recorder)  # type: ignore[arg-type]
    first = np.array(env.reset())
    dones = np.zeros(4, dtype=bool)
    while not dones.any():
        step = collector.step(env, None, first, memory, epsilon=0.0, at_random=False)  # type: ignore[arg-type]
        dones = step.dones
        assert (step.memory[0][dones] == 0).all() and (step.memory[0][~dones] != 0).any(
            axis=-1
        ).all()
        assert (step.memory[1] == np.where(dones, 3, step.actions)).all()
    given = recorder.given[-1]
    assert given[1] is first and (given[2] == 0.5).all() and (given[3] == step.actions).all()
    assert (memory[0] == 0.5).all()


def test_acting_at_random_uses_every_action_and_leaves_the_rule_in_force() -> None:
    model = DQN("MlpPolicy", toys.Pair(2), **SETTINGS)
    assert model.env is not None
    collector = Collector(model.policy, ListRecorder())  # type: ignore[arg-type]
    model.policy.temperature = 1e-6
    observation, chosen = np.array(model.env.reset()), set()
    for _ in range(40):
        step = collector.step(
            model.env,
            None,
            observation,
            model.policy.initial_state(4),
            epsilon=0.1,
            at_random=True,  # type: ignore[arg-type]
        )
        chosen |= set(step.actions.tolist())
    assert chosen == {0, 1, 2}
    assert model.policy.acting == replace(Acting.boltzmann(1e-6), epsilon=0.1)


# -- updating -------------------------------------------------------------------------------------


def test_losses_are_averaged_over_the_updates_since_the_last_look() -> None:
    model = make_pair_learner("dqdil", updates_per_episode=0.0).learn(200)
    updater, phase = Updater(model.policy, model.recipe.online), model.phase("online")
    assert updater.means() == {}
    before, summed = weights(model), []
    for updates in (1, 3):
        updater.run(model.replay_buffer, updates, 4, phase, 0.5)  # type: ignore[arg-type]
        summed.append({name: total.clone() for name, (total, _) in updater.losses.items()})
    assert not torch.equal(before, weights(model))
    means = updater.means()
    for name, total in summed[1].items():
        assert means[name] == pytest.approx((total / 4).tolist())
        assert (total > summed[0][name]).all()
    assert updater.means() == {}


def test_updates_before_learning_starts_are_forfeited() -> None:
    model = DQN("GruPolicy", toys.Pair(2), **SETTINGS, learning_starts=10_000).learn(100)
    model.pace.passed(3)
    train_as_due(model)
    assert model.pace == Pace(since_target=model.pace.since_target)
    assert model._n_updates == 0
