"""A counterfactual beside its truth: planted shifts are found, and of nothing learned no claim."""

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from animarl_algos.evaluation import Rollouts, collect_rollouts, cue_effects
from animarl_algos.evaluation import effects as of
from animarl_algos.evaluation.collect import Cue
from animarl_algos.evaluation.effects import FEWEST_SEEDS, measured_answers, objection_to_claim
from animarl_algos.evaluation.prepared import path_lengths
from animarl_algos.evaluation.statistics import Cells
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.packaged import load_packaged
from animarl_envs.scenario import make_scenario
from animarl_envs.worlds import make_world

AWAY, COAST = 6, 12  # from the focus; no acceleration
STEPS = 12
SMALL = 2000  # resamples


class Thrusting:
    """Predators accelerate for so many steps when told 1, one step fewer when told 0.

    With the damping d and the thrust u of all, a path that ends after T steps is then longer by
    what one more thrust at step s leads to: u dt^2 (1 - (1 - d)^(T - s)) / d.
    """

    def __init__(self, start: int, noise: float = 0.0, seed: int = 0) -> None:
        self.start, self.noise, self.step = start, noise, 0
        self.rng = np.random.default_rng(seed)

    def seed(self, seed: int) -> None:
        self.rng = np.random.default_rng(seed)

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None,
        deterministic: bool = False,
    ) -> tuple[np.ndarray, Any]:  # fmt: skip
        step = 0 if state is None else state
        told = observation[:, -1]
        thrusting = (step < self.start) | ((step == self.start) & (told == 1))
        # Now and then one that was told nothing else idles, on the same draws for both cues.
        idle = (step < self.start) & (self.rng.random(len(told)) < self.noise)
        return np.where(thrusting & ~idle, AWAY, COAST), step + 1


@cache
def starts() -> Demonstrations:
    """Ten packaged test starts of each condition."""
    test = load_packaged("agent").select(split="test")
    chosen = [np.flatnonzero(test.condition == c)[:10] for c in (0, 1)]
    return test.select(episodes=np.concatenate(chosen).tolist())


def world_of(copies: int) -> Any:
    scenario = make_scenario(
        "agent", demos=starts(), split=None, time_limit=STEPS, contact_radius=1e-6,
        arena={"boundary": 50.0},
    )  # fmt: skip
    return make_world(scenario, copies)


def answers(policy: Any, seed: int, reseed: Any = None) -> dict[str, Rollouts]:
    cues: dict[str, Cue] = {of.FACTUAL: "actual", of.FLIPPED: "flipped"}
    return {
        answer: collect_rollouts(
            world_of, policy, method="m", seed=seed, repetitions=2, cue=cue, resolution=None,
            reseed=reseed,
        )
        for answer, cue in cues.items()
    }  # fmt: skip


def joined(seeds: list[dict[str, Rollouts]]) -> dict[str, Rollouts]:
    return {answer: Rollouts.concatenate([one[answer] for one in seeds]) for answer in seeds[0]}


def effects(methods: dict[str, dict[str, Rollouts]], *teams: Rollouts, **options: Any) -> Any:
    told = {(name, answer): r for name, own in methods.items() for answer, r in own.items()}
    told |= {(team.method, of.TEAM): team for team in teams}
    return cue_effects(
        measured_answers(starts(), told), dict.fromkeys(methods, True),
        teams=[team.method for team in teams], **{"resamples": SMALL, **options},
    )  # fmt: skip


def planted(start: int) -> float:
    """How much longer a path is for one more step of thrust after ``start`` of them [arena unit].

    Everybody is at rest at first; predators flee from the prey along one line, which does not move
    here, so that a path is as long as it is straight.
    """
    d, u, dt = 0.25, 3.0, 0.1

    def travelled(steps: int) -> float:
        speed, total = 0.0, 0.0
        for step in range(STEPS):
            speed = (1 - d) * speed + u * dt * (step < steps)
            total += speed * dt
        return total

    return travelled(start + 1) - travelled(start)


class PreyRests(Thrusting):
    """The same, but the prey never accelerates."""

    def predict(self, *arguments: Any, **more: Any) -> tuple[np.ndarray, Any]:
        actions, state = super().predict(*arguments, **more)
        actions[2::3] = COAST
        return actions, state


@cache
def planted_effects() -> Any:
    """Three seeds that thrust after 3, 4 or 5 steps; the truth is a team that does so after 4."""
    trained = joined([answers(PreyRests(3 + seed, 0.2, seed), seed) for seed in range(3)])
    team = PreyRests(4)
    teams = (
        collect_rollouts(
            world_of, team, method=f"team {c}", seed=0, repetitions=1, cue=c, resolution=None
        )
        for c in (0, 1)
    )
    return effects({"DQCIL": trained}, *teams, planned=(0, 1))


def value(found: Any, quantity: str, c: int) -> Any:
    table = found.table
    (row,) = [
        row for _, row in table.iterrows()
        if row["quantity"] == quantity and row["condition"] == c and row["counting"] == "all"
        and row["method"] == "DQCIL"
    ]  # fmt: skip
    return row


def test_a_planted_truth_is_recovered_within_its_interval() -> None:
    assert (starts().initial_velocity == 0).all()
    for c, sign in ((0, 1.0), (1, -1.0)):
        truth = sign * planted(4)
        true = value(planted_effects(), of.TRUE, c)
        assert true["value"] == pytest.approx(truth, abs=1e-9)
        predicted = value(planted_effects(), of.PREDICTED, c)
        assert predicted["low"] <= truth <= predicted["high"]
        missed = value(planted_effects(), of.MISSED, c)
        assert missed["low"] <= 0.0 <= missed["high"]
        assert missed["value"] == pytest.approx(predicted["value"] - true["value"])


def test_both_cues_meet_the_same_random_numbers() -> None:
    """With them the shift is the planted one in every rollout; without, idling blurs it."""
    policy = PreyRests(4, 0.3)
    common = answers(policy, 0, policy.seed)
    lengths = [path_lengths(r)[:, :2] for r in common.values()]
    sign = np.where(starts().condition[common[of.FACTUAL].demo] == 0, 1.0, -1.0)
    shift = (lengths[1] - lengths[0]) * sign[:, None]
    assert np.abs(shift - planted(4)).max() < 1e-9
    apart = answers(policy, 0)
    lengths = [path_lengths(r)[:, :2] for r in apart.values()]
    assert np.ptp((lengths[1] - lengths[0]) * sign[:, None]) > 0.1


def test_an_effect_that_all_seeds_share_is_claimed() -> None:
    rng = np.random.default_rng(1)
    shift = Cells(2.0 + 0.1 * rng.normal(size=(4, 12)), np.ones((4, 12)))
    null = Cells(0.1 * rng.normal(size=(4, 12)), np.ones((4, 12)))
    assert not objection_to_claim(shift, null, rng, SMALL)
    assert "untrained" in objection_to_claim(shift, Cells.absent("not asked"), rng, SMALL)
    alike = replace(null, sums=null.sums + 2.0)
    assert "not told apart" in objection_to_claim(shift, alike, rng, SMALL)
    few = Cells(shift.sums[: FEWEST_SEEDS - 1], shift.counts[: FEWEST_SEEDS - 1])
    assert objection_to_claim(few, null, rng, SMALL).startswith("2 training seeds")
    torn = Cells(np.repeat([[3.0], [-2.0], [4.0]], 12, axis=1), np.ones((3, 12)))
    assert "do not agree" in objection_to_claim(torn, null, rng, SMALL)
    of_starts = np.linspace(-5.0, 6.0, 12) + 0.01 * rng.normal(size=(4, 12))
    uneven = Cells(of_starts, np.ones((4, 12)))
    assert objection_to_claim(uneven, null, rng, SMALL) == "the interval includes zero"


def test_with_one_seed_no_claim_and_the_table_says_so() -> None:
    one = answers(PreyRests(4, 0.2), 0)
    found = effects({"DQCIL": one}, planned=(0, 1), resamples=200)
    assert not found.claims["worded"].any()
    few, other = found.claims["reason"]
    assert few == "1 training seed: give at least 3" and other == f"{few}; {of.NOT_PLANNED}"
    rows = found.table[found.table["quantity"] == of.PREDICTED]
    assert (rows["covers"] == "this network only").all()
    missing = found.table[found.table["value"].isna()]
    assert len(missing) and (missing["reason"] != "").all()
    assert set(missing.loc[missing["quantity"] == of.TRUE, "reason"]) == {of.NO_TRUTH}


def test_who_acts_without_chance_has_no_shift_by_chance() -> None:
    """Zero with an interval of no width would look like a null that was measured."""
    certain, chancy = answers(PreyRests(4), 0), answers(PreyRests(4, 0.2), 0)
    others = answers(PreyRests(4, 0.2, 1), 0)
    for first, second, known in ((certain, certain, False), (chancy, others, True)):
        blind = {of.ZEROED + of.FACTUAL: first[of.FACTUAL],
                 of.ZEROED + of.FLIPPED: second[of.FACTUAL]}  # fmt: skip
        row = value(effects({"DQCIL": certain | blind}, resamples=200), of.BLIND, 0)
        assert np.isfinite(row["value"]) == known
        assert row["reason"] == (
            "" if known else "it acts without chance: asked twice, it does the same"
        )


def test_errors_of_the_two_learners_are_paired() -> None:
    first, second = (joined([answers(PreyRests(k + s), s) for s in range(2)]) for k in (3, 4))
    table = effects({"DQCIL-PT": first, "DQDIL-PT": second}).table
    rows = table[table["quantity"] == of.ERROR_DIFFERENCE]
    assert set(rows["method"]) == {"DQCIL-PT - DQDIL-PT"}
    errors = table[(table["quantity"] == of.ERROR) & (table["counting"] == "all")]
    for c in (0, 1):
        mine = errors[errors["condition"] == c].set_index("method")["value"]
        row = rows[(rows["condition"] == c) & (rows["counting"] == "all")].iloc[0]
        assert row["value"] == pytest.approx(mine["DQCIL-PT"] - mine["DQDIL-PT"])
        assert row["low"] <= row["value"] <= row["high"]
