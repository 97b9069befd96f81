"""Acting rule and number of thrusts are chosen by what rollouts do, and saved for all that act."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from refusals import refuses

from animarl_algos.evaluation import acting_choice
from animarl_algos.evaluation.acting_choice import (
    APART,
    COOLER,
    MARGIN,
    MOST_ROUNDS,
    MOST_STARTS,
    ROLLOUTS,
    ActingChoice,
    candidate_rules,
    choice_episodes,
    choose_acting,
    errors_above,
    further_rules,
)
from animarl_algos.evaluation.collect import Policy, RandomPolicy
from animarl_algos.evaluation.metrics import INTERACTIVE, KINEMATIC, ORDER, PLACE
from animarl_algos.evaluation.prepared import Prepared
from animarl_algos.evaluation.realism import ENDING, Likelihood
from animarl_algos.evaluation.rollouts import Rollouts
from animarl_algos.evaluation.thrust_choice import choose_thrusts, tracking_floor
from animarl_algos.networks.acting_rule import Acting
from animarl_algos.runs import pipeline
from animarl_algos.runs.run import Run
from animarl_algos.runs.run_settings import CHOSEN, RunSettings
from animarl_envs.arena import Arena
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.packaged import load_packaged
from animarl_envs.errors import InputError
from animarl_envs.fitting.custom_species import arena_of
from animarl_envs.fitting.joint import joint_locomotion
from animarl_envs.fitting.tracking import track
from animarl_envs.fitting.transitions import demonstrated_actions
from animarl_envs.locomotion import Locomotion
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

    def policy_for(rule: Acting, seed: int) -> Policy:
        return Repeats(demos, scenario.species.locomotion) if rule == good else RandomPolicy(seed)

    rules = [Acting(), Acting.boltzmann(1.0), good]
    found = choose_acting(policy_for, partial(make_world, scenario), demos, rules, seed=0)
    assert found.acting == good and found.repeats and found.short < -MARGIN
    by_rule = {each.acting: each for each in found.candidates}
    assert by_rule[str(good)].behind == 0 and by_rule["greedy"].behind > MARGIN
    assert by_rule[str(Acting.boltzmann(1.0))].rounds == 1  # far behind after one round
    for kind in (KINEMATIC, ORDER, INTERACTIVE, PLACE, ENDING):
        assert by_rule[str(good)].kinds[kind] > by_rule["greedy"].kinds[kind]
    assert Acting.from_json(json.loads(json.dumps(found.to_json()))["acting"]) == good


def test_the_choice_does_not_depend_on_the_number_of_processes() -> None:
    demos = choice_episodes(load_packaged("agent"), seed=0).select(episodes=np.arange(6))
    world = partial(make_world, make_scenario("agent", demos=demos, split=None))
    rules = [Acting.boltzmann(1.0), Acting.boltzmann(0.5)]

    def policy_for(rule: Acting, seed: int) -> Policy:
        return RandomPolicy(seed + (rule == rules[0]))

    one, two = (
        choose_acting(policy_for, world, demos, rules, seed=0, processes=number).to_json()
        for number in (1, 2)
    )
    assert one == two


def test_an_error_of_another_process_is_raised_here() -> None:
    def work(rule: Acting) -> Any:
        raise InputError(f"no {rule}")

    rules = [Acting(), Acting.boltzmann(1.0)]
    refuses("no greedy", list, acting_choice.on_cores(work, rules, 2))


def test_a_start_counts_with_its_recording() -> None:
    difference = np.array([1.0, 1.0, 1.0, 1.0, 0.0, np.nan])
    alone = errors_above(difference, np.arange(6).astype(str))
    assert alone == pytest.approx(0.8 / np.sqrt(0.2 / 5))
    assert errors_above(difference, np.array(list("aaaabc"))) == pytest.approx(1.0)
    assert errors_above(difference, np.array(["a"] * 6)) == 0.0


def test_no_test_episode_is_chosen_by() -> None:
    demos = load_packaged("agent")
    chosen = choice_episodes(demos, seed=0)
    assert set(chosen.split) == {"val"} and len(chosen.split) == MOST_STARTS
    few = choice_episodes(load_packaged("fly"), seed=0)
    assert set(few.split) == {"train", "val"} and len(few.split) == MOST_STARTS
    with pytest.raises(InputError, match="no training or validation episode"):
        choice_episodes(demos.select(split="test"), seed=0)


def test_candidates_are_as_meant_then_cooler_shares_of_the_fitted_temperatures_then_greedy() -> (
    None
):
    rules = candidate_rules([2.0, 1.0])
    assert rules[0].temperature == (1.0, 1.0)
    assert rules[1].temperature == (2.0, 1.0)
    assert rules[-1] == Acting() and len(rules) == 2 + len(COOLER)
    further = further_rules([2.0, 1.0])  # how hard and which way are cooled apart
    assert {rule.temperature for rule in further} == {(2.0, 1.0)}
    assert [(rule.thrust, rule.direction) for rule in further] == list(APART)
    assert all(rule.two_stage for rule in further)


Rule = tuple[float, float]
"""How good the rollouts of a rule are, and how much a round moves all of them, up or down."""


def chosen_among(
    goodness: list[Rule], further: list[Rule], monkeypatch: pytest.MonkeyPatch
) -> tuple[ActingChoice, list[Acting]]:
    """The choice where the likelihood of each rule is known; other recordings have 0."""
    demos = choice_episodes(load_packaged("agent"), seed=0)
    rules = [Acting.boltzmann(1.0 + n) for n in range(len(goodness) + len(further))]
    known, starts, seeds = dict(zip(rules, goodness + further)), demos.num_episodes, list[int]()

    class Known:
        """Stands in for the likelihood: its matrix is the likelihood of each recording."""

        @classmethod
        def of(cls, prepared: Prepared, own: Any = ()) -> Known:
            return cls()

        def of_others(self, repetitions: int, rng: np.random.Generator) -> np.ndarray:
            return np.zeros(starts)

        def components(self, rolled: tuple[Acting, int]) -> np.ndarray:
            rule, seed = rolled
            if seed not in seeds:
                seeds.append(seed)
            mean, swing = known[rule]
            return mean + swing * (-1) ** (len(seeds) + 1) + np.sin(np.arange(starts) * (1 + mean))

        def total(self, matrix: np.ndarray) -> np.ndarray:
            return matrix

        def by_kind(self, matrix: np.ndarray) -> dict[str, float]:
            return {}

    monkeypatch.setattr(acting_choice, "Likelihood", Known)
    monkeypatch.setattr(acting_choice, "collect_rollouts", lambda world, rolled, **_: rolled)
    policy_for: Any = lambda rule, seed: (rule, seed)  # noqa: E731
    place = len(goodness)
    found = choose_acting(policy_for, lambda n: None, demos, rules[:place], rules[place:], seed=0)  # type: ignore[arg-type,return-value]
    return found, rules


@pytest.mark.parametrize(
    ("goodness", "number"),
    [
        ([(0.0, 0.0), (0.05, 0.0), (-5.0, 0.0)], 0),
        ([(0.0, 0.0), (4.0, 0.0), (-5.0, 0.0)], 1),
        ([(0.0, 0.0), (4.0, 0.0), (4.2, 0.0)], 2),
    ],
    ids=["nearly as good", "clearly better", "the best of the others"],
)
def test_the_first_rule_is_chosen_unless_another_is_better_by_two_standard_errors(
    goodness: list[Rule], number: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    choice, rules = chosen_among(goodness, [], monkeypatch)
    assert choice.acting == rules[number] and len(choice.candidates) == len(rules)
    assert choice.repeats


def test_rounds_go_on_until_the_chosen_rule_repeats(monkeypatch: pytest.MonkeyPatch) -> None:
    steady, _ = chosen_among([(0.0, 0.0), (4.0, 0.0)], [], monkeypatch)
    assert steady.repeats and steady.candidates[1].rounds == 2
    swinging, _ = chosen_among([(0.0, 0.0), (0.3, 4.0)], [], monkeypatch)
    assert not swinging.repeats and swinging.candidates[0].rounds == MOST_ROUNDS


@pytest.mark.parametrize("level", [0.5, -9.0], ids=["near", "short"])
def test_further_rules_are_chosen_among_where_others_are_nearer(
    level: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    far, _ = chosen_among([(-9.0, 0.0)], [(-8.0, 0.0)], monkeypatch)
    assert far.short > MARGIN  # which is said
    choice, rules = chosen_among([(level, 0.0)], [(0.2, 0.0)], monkeypatch)
    assert len(choice.candidates) == (1 if level > 0 else 2)
    assert choice.acting == rules[0 if level > 0 else 1]
    assert choice.short <= MARGIN


@pytest.mark.slow
def test_the_choice_is_saved_with_the_policy_and_used_by_all_that_act(tmp_path: Path) -> None:
    few = {"offline_epochs": 2, "offline_kwargs": {"updates_per_epoch": 5}}
    settings = RunSettings(
        file="packaged", species="fly", algo="soft-bc", steps=1, copies=1, overrides=few,
        baselines=False, thrusts="1",
    )  # fmt: skip
    run = pipeline.open_run(settings, tmp_path / "fly", "test", load_packaged("fly"))
    pipeline.learn(run, "soft-bc", progress_bar=False)
    chosen = run.acting("soft-bc")
    assert (run.path / "policies" / "soft-bc.acting.json").exists()
    again = pipeline.learn(run, "soft-bc", progress_bar=False)
    assert again.policy.acting == chosen
    other = pipeline.learn(Run(run.path, "boltzmann:0.3"), "soft-bc", progress_bar=False)
    assert other.policy.acting == Acting.boltzmann(0.3)


def test_a_rule_that_was_never_chosen_or_is_damaged_is_refused(tmp_path: Path) -> None:
    run = Run(tmp_path, CHOSEN)
    refuses("no acting rule was chosen yet", run.acting, "soft-bc")
    file = run.acting_file("soft-bc")
    file.parent.mkdir()
    file.write_text("{")
    refuses("it is damaged", run.acting, "soft-bc")


def test_too_few_to_say_get_as_many_as_recorded_animals_ask_for() -> None:
    """Three recordings of newts do not say whether one thrust will do; three exact chases do."""
    newts = load_packaged("newt").select(split="train").select(episodes=np.arange(3))
    floor = tracking_floor(newts, joint_locomotion(newts))
    assert floor.estimate <= 2 / 3 and floor.high - floor.low > 1 / 3
    assert choose_thrusts(newts)[0] == 3
    assert "too few to tell" in choose_thrusts(newts)[1]
    agents = load_packaged("agent")
    long = np.flatnonzero((agents.split == "train") & (agents.lengths > 60))[:3]
    assert choose_thrusts(agents.select(episodes=long))[0] == 1


def test_the_floor_is_tracked_within_the_walls_of_the_world() -> None:
    """Flies that are too sluggish to turn in time: through the edge, unless it is a wall."""
    packaged = load_packaged("fly").select(split="train")
    demos = replace(packaged, arena=replace(packaged.arena, rebound=False))
    sluggish = (Locomotion(0.003, 0.05),) * demos.num_individuals
    walled = arena_of(demos)

    def farthest(arena: Arena) -> float:  # from the centre of the dish [arena unit]
        return float(np.linalg.norm(track(demos, sluggish, arena).positions, axis=2).max())

    assert walled.rebound and not demos.arena.rebound
    assert farthest(demos.arena) > 1.02
    assert farthest(walled) <= 1.0
    floor = tracking_floor(demos, sluggish)
    assert floor == tracking_floor(demos, sluggish, arena=walled)
    assert floor != tracking_floor(demos, sluggish, arena=demos.arena)


def test_recordings_are_less_likely_if_all_stand_still_or_die_at_once() -> None:
    demos = load_packaged("agent").select(split="val")
    realism = Likelihood.of(Prepared(demos))
    recorded = Rollouts.from_demonstrations(demos)
    first = np.repeat(recorded.offsets[:-1], recorded.lengths)
    still = replace(recorded, positions=recorded.positions[first])
    index = np.concatenate([[start, start + 1] for start in recorded.offsets[:-1]])
    dead = replace(recorded, positions=recorded.positions[index], lengths=np.full(len(recorded), 2))
    itself, still_, dead_ = (realism.total(realism.components(r)) for r in (recorded, still, dead))
    others = realism.total(realism.of_others(8, np.random.default_rng(0)))
    for worse in (still_, dead_, others):
        assert errors_above(itself - worse, demos.recording) > MARGIN
