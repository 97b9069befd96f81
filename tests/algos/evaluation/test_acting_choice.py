"""The acting rule is chosen by what rollouts do, and saved where all that act find it."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from animarl_algos.evaluation import acting_choice
from animarl_algos.evaluation.acting_choice import (
    APART,
    COOLER,
    MARGIN,
    NEAR,
    ROLLOUTS,
    Candidate,
    candidate_rules,
    choice_episodes,
    choose_acting,
    compared,
    further_rules,
)
from animarl_algos.evaluation.collect import Policy, RandomPolicy
from animarl_algos.evaluation.rollouts import Rollouts
from animarl_algos.networks.acting_rule import Acting
from animarl_algos.runs import pipeline
from animarl_algos.runs.run import Run
from animarl_algos.runs.run_settings import RunSettings
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.episode import TIME_OUT, UNFINISHED
from animarl_envs.demos.packaged import load_packaged
from animarl_envs.errors import InputError
from animarl_envs.fitting.transitions import demonstrated_actions
from animarl_envs.scenario import make_scenario
from animarl_envs.worlds import make_world


class Repeats:
    """Takes the demonstrated actions again; so many copies per episode, in their order."""

    def __init__(self, demos: Demonstrations, locomotion: Any) -> None:
        self.actions = demonstrated_actions(demos, locomotion)
        each = ROLLOUTS // demos.num_episodes
        self.first = np.repeat(demos.offsets[:-1], each)
        self.last = np.repeat(demos.offsets[1:] - 2, each)

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None,
        deterministic: bool = False,
    ) -> tuple[Any, Any]:  # fmt: skip
        step = 0 if state is None else state
        return self.actions[np.minimum(self.first + step, self.last)].ravel(), step + 1


def test_the_rule_whose_rollouts_are_like_the_recordings_is_chosen() -> None:
    demos = choice_episodes(load_packaged("agent"), seed=0)
    scenario = make_scenario("agent", demos=demos, split=None)
    good = Acting.boltzmann(0.7)

    def policy_for(rule: Acting) -> Policy:
        return Repeats(demos, scenario.species.locomotion) if rule == good else RandomPolicy(0)

    rules = [Acting(), Acting.boltzmann(1.0), good]
    found = choose_acting(policy_for, partial(make_world, scenario), demos, rules, seed=0)
    assert found.acting == good
    by_rule = {each.acting: each for each in found.candidates}
    assert by_rule[str(good)].mismatch < 0.02 < 0.5 < by_rule["greedy"].mismatch
    assert Acting.from_json(json.loads(json.dumps(found.to_json()))["acting"]) == good


def test_standing_still_and_dying_at_once_are_far_from_the_recordings() -> None:
    recorded = Rollouts.from_demonstrations(load_packaged("agent").select(split="val"))
    assert compared("itself", recorded, recorded).mismatch == 0.0
    first = np.repeat(recorded.offsets[:-1], recorded.lengths)
    still = replace(recorded, positions=recorded.positions[first])
    assert compared("still", still, recorded).mismatch > 1.5
    index = np.concatenate([[start, start + 1] for start in recorded.offsets[:-1]])
    dead = replace(recorded, positions=recorded.positions[index], lengths=np.full(len(recorded), 2))
    assert compared("dead", dead, recorded).mismatch > 1.5


def test_a_recording_that_was_cut_ends_as_a_rollout_that_time_ends() -> None:
    simulated = Rollouts.from_demonstrations(load_packaged("newt"))
    went_on = simulated.outcome == TIME_OUT
    assert 0 < went_on.mean() < 1
    cut = replace(simulated, outcome=np.where(went_on, UNFINISHED, simulated.outcome))
    assert compared("itself", simulated, cut).distances["outcome"] == 0
    touched = replace(simulated, outcome=np.where(went_on, 1, simulated.outcome))
    assert compared("another end", simulated, touched).distances["outcome"] == pytest.approx(
        went_on.mean()
    )


def test_no_test_episode_is_chosen_by() -> None:
    demos = load_packaged("agent")
    chosen = choice_episodes(demos, seed=0)
    assert set(chosen.split) == {"train", "val"} and (chosen.split == "val").sum() == 50
    with pytest.raises(InputError, match="no training or validation episode"):
        choice_episodes(demos.select(split="test"), seed=0)


def test_candidates_are_as_meant_then_cooler_shares_of_the_fitted_temperatures_then_greedy() -> (
    None
):
    rules = candidate_rules([2.0, 1.0])
    assert rules[0].temperature == (1.0, 1.0)
    assert rules[1].temperature == (2.0, 1.0)
    assert rules[-1] == Acting() and len(rules) == 2 + len(COOLER)


@pytest.mark.parametrize(
    ("mismatches", "number"),
    [
        ([0.1 + 0.5 * MARGIN, 0.1, 2.0], 0),
        ([0.1 + 2.0 * MARGIN, 0.1, 2.0], 1),
        ([0.1 + 2.0 * MARGIN, 0.1 + 0.5 * MARGIN, 0.1], 2),
    ],
    ids=["nearly as good", "clearly worse", "the best of the others"],
)
def test_the_first_rule_stays_unless_another_is_better_by_a_margin(
    mismatches: list[float], number: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    demos = choice_episodes(load_packaged("agent"), seed=0).select(episodes=np.arange(5))
    scenario = make_scenario("agent", demos=demos, split=None)
    rules = [Acting.boltzmann(1.0), Acting.boltzmann(0.5), Acting()]
    found = iter(mismatches)
    monkeypatch.setattr(
        acting_choice, "compared", lambda name, *_: Candidate(name, {"outcome": next(found)})
    )
    choice = choose_acting(
        lambda rule: RandomPolicy(0), partial(make_world, scenario), demos, rules, seed=0
    )
    assert choice.acting == rules[number] and len(choice.candidates) == len(rules)


def test_how_hard_and_which_way_are_cooled_apart() -> None:
    rules = further_rules([2.0, 1.0])
    assert {rule.temperature for rule in rules} == {(2.0, 1.0)}
    assert [(rule.thrust, rule.direction) for rule in rules] == list(APART)
    assert all(rule.two_stage for rule in rules)


@pytest.mark.parametrize("near", [True, False])
def test_further_rules_are_tried_where_none_of_the_first_comes_near(near: bool) -> None:
    demos = choice_episodes(load_packaged("agent"), seed=0)
    scenario = make_scenario("agent", demos=demos, split=None)
    first, later = Acting(), Acting.boltzmann(1.0, direction=0.5)
    asked = []

    def policy_for(rule: Acting) -> Policy:
        asked.append(rule)
        good = near == (rule == first)
        return Repeats(demos, scenario.species.locomotion) if good else RandomPolicy(0)

    found = choose_acting(
        policy_for, partial(make_world, scenario), demos, [first], [later], seed=0
    )
    assert asked == ([first] if near else [first, later])
    assert found.acting == asked[-1] and len(found.candidates) == len(asked)
    assert (found.candidates[0].mismatch <= NEAR) == near


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """A clone of few episodes, hardly trained."""
    demos = load_packaged("fly")
    few = {"offline_epochs": 2, "offline_kwargs": {"updates_per_epoch": 5}}
    settings = RunSettings(
        file="packaged", species="fly", algo="soft-bc", steps=1, copies=1, overrides=few,
        baselines=False, thrusts="1",
    )  # fmt: skip
    found = pipeline.open_run(settings, tmp_path_factory.mktemp("run") / "fly", "test", demos)
    pipeline.learn(found, "soft-bc", progress_bar=False)
    return found


def test_the_choice_is_saved_with_the_policy_and_used_by_all_that_act(run: Run) -> None:
    chosen = run.acting("soft-bc")
    assert (run.path / "policies" / "soft-bc.acting.json").exists()
    again = pipeline.learn(run, "soft-bc", progress_bar=False)
    assert again.policy.acting == chosen
    other = Run(run.path, "boltzmann:0.3")
    assert pipeline.learn(other, "soft-bc", progress_bar=False).policy.acting == Acting.boltzmann(
        0.3
    )


def test_a_rule_that_was_never_chosen_or_is_damaged_is_refused(run: Run, tmp_path: Path) -> None:
    import shutil

    copy = tmp_path / "run"
    shutil.copytree(run.path, copy)
    file = copy / "policies" / "soft-bc.acting.json"
    file.write_text("{")
    with pytest.raises(InputError, match="it is damaged"):
        Run(copy).acting("soft-bc")
    file.unlink()
    with pytest.raises(InputError, match="no acting rule was chosen yet"):
        Run(copy).acting("soft-bc")
