"""Realism score, exchange test and sequence judge, on simulated animals of known statistics."""

from dataclasses import replace

import numpy as np
import pytest

from animarl_algos.evaluation.classifier import classify, sequence_windows, window_steps
from animarl_algos.evaluation.prepared import Prepared, resting_step
from animarl_algos.evaluation.realism import CEILING, OTHERS, OWN, WEIGHTS, realism
from animarl_algos.evaluation.rollouts import Rollouts
from animarl_algos.evaluation.verdict import compare
from animarl_algos.evaluation.verdict_rows import DIFFERS
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.episode import UNFINISHED
from benchmarks import verdict_power
from benchmarks.known_worlds import ARENA, FAULTS, WORLDS, KnownWorld, with_fault

PAIR, CHASE = WORLDS["free pair"], WORLDS["chase"]
EACH = 8
UNSEEN = ("8 % too fast",)  # by the rows of fifty recordings


def recorded_and_simulated(
    world: KnownWorld, count: int, seed: int
) -> tuple[Demonstrations, Rollouts]:
    rng = np.random.default_rng(seed)
    recorded = world.recordings(count, rng)
    return recorded, world.rollouts(recorded, EACH, rng)


def score_of(recorded: Demonstrations, rollouts: Rollouts) -> float:
    found = realism(Prepared(recorded), rollouts, np.random.default_rng(0))
    return float(found["value"].iloc[-1])


def standing_still(rollouts: Rollouts) -> Rollouts:
    first = np.repeat(rollouts.positions[rollouts.offsets[:-1]], rollouts.lengths, axis=0)
    return replace(rollouts, positions=first)


def dying_early(rollouts: Rollouts) -> Rollouts:
    kept = np.minimum(rollouts.lengths, 8)
    paths = [rollouts.path(i)[:n] for i, n in enumerate(kept.tolist())]
    return replace(rollouts, positions=np.concatenate(paths), lengths=kept)


@pytest.mark.slow
@pytest.mark.parametrize("world", [PAIR, CHASE], ids=["pair", "chase"])
def test_realism_ranks_the_true_simulator_above_every_broken_one(world: KnownWorld) -> None:
    recorded, perfect = recorded_and_simulated(world, 30, seed=1)
    true = score_of(recorded, perfect)
    rng = np.random.default_rng(2)
    broken = {name: with_fault(perfect, fault, rng) for name, fault in FAULTS.items()}
    broken |= {"still": standing_still(perfect), "dies": dying_early(perfect)}
    # A likelihood of 8 rollouts sees none of these; the rows of the verdict see all but the first.
    better = {name for name, one in broken.items() if score_of(recorded, one) >= true}
    assert better <= {"8 % too fast", "order lost beyond 2 s", "too much alike"}


def test_who_stands_still_has_the_least_likely_turns() -> None:
    """It has no turns at all, which is no reason to call all turns equally likely."""
    recorded, perfect = recorded_and_simulated(PAIR, 20, seed=5)
    true, still = (
        realism(Prepared(recorded), one, np.random.default_rng(0)).set_index("component")
        for one in (perfect, standing_still(perfect))
    )
    assert still.loc["turning", "value"] < 0.01 < 0.1 < true.loc["turning", "value"]


def test_realism_stands_between_its_references() -> None:
    recorded, perfect = recorded_and_simulated(CHASE, 20, seed=3)
    found = realism(Prepared(recorded), perfect, np.random.default_rng(0))
    total = found.iloc[-1]
    assert total["kind"] == "total"
    assert total[OTHERS] < total["value"] < total[CEILING] <= 1.0
    assert total["low"] < total["value"] < total["high"]
    kinds = found[found["component"].eq("") & found["kind"].ne("total")]
    assert dict(zip(kinds["kind"], kinds["weight"])) == pytest.approx(
        {kind: weight for kind, weight in WEIGHTS.items() if kind != OWN}
    )


def test_realism_of_one_recording_and_of_recordings_that_merely_end() -> None:
    recorded, perfect = recorded_and_simulated(PAIR, 1, seed=4)
    found = realism(Prepared(recorded), perfect, np.random.default_rng(0))
    assert OTHERS not in found and np.isnan(found["low"].iloc[-1])
    cut = Prepared(replace(recorded, outcome=np.full(1, UNFINISHED)))
    rows = realism(cut, perfect, np.random.default_rng(0)).set_index("component")
    assert "outcome" not in rows.index  # nothing is known of how it would have ended
    assert rows.loc["duration", "value"] == pytest.approx((EACH + 0.1) / (EACH + 0.2))
    ended = realism(cut, dying_early(perfect), np.random.default_rng(0)).set_index("component")
    assert ended.loc["duration", "value"] == pytest.approx(0.1 / (EACH + 0.2))


def differing(recorded: Demonstrations, rollouts: Rollouts, seed: int) -> list[str]:
    found = compare(recorded, rollouts, seed)[0]
    return [row.measure for row in found.rows() if row.judgement == DIFFERS]


def test_a_perfect_simulator_differs_in_nothing() -> None:
    alarms = [bool(differing(*recorded_and_simulated(PAIR, 10, seed), seed)) for seed in range(20)]
    assert np.mean(alarms) <= 0.15  # 3 % expected


@pytest.mark.parametrize("fault", [name for name in PAIR.faults if name not in UNSEEN])
def test_a_fault_differs_at_fifty_starts(fault: str) -> None:
    rng = np.random.default_rng(5)
    recorded = PAIR.recordings(50, rng)
    assert differing(recorded, PAIR.faulty_rollouts(recorded, EACH, fault, rng), 7)


def test_a_simulated_animal_of_a_dish_stays_within_it_whatever_its_fault() -> None:
    world, rng = WORLDS["shoal"], np.random.default_rng(0)
    recorded = world.recordings(3, rng)
    made = {name: world.faulty_rollouts(recorded, 2, name, rng) for name in world.faults}
    reach = {name: np.linalg.norm(one.positions, axis=-1).max() for name, one in made.items()}
    start = np.linalg.norm(recorded.positions[recorded.offsets[:-1]], axis=-1).max()
    assert max(reach.values()) <= 1 and reach["never at walls"] <= max(start, 0.8) + 1e-9
    assert float(np.linalg.norm(recorded.positions, axis=-1).max()) > 0.99


def test_the_sequence_judge_is_blind_to_a_perfect_simulator_and_sees_order() -> None:
    recorded, perfect = recorded_and_simulated(PAIR, 30, seed=9)
    truth = Rollouts.from_demonstrations(recorded)
    rest = resting_step(truth)

    steps, starts = window_steps(truth), np.arange(len(truth))
    own = sequence_windows(truth, ARENA, rest, steps, starts)

    def auc(rollouts: Rollouts) -> float:
        simulated = sequence_windows(rollouts, ARENA, rest, steps, starts)
        return classify(own, simulated, np.random.default_rng(0)).auc.low

    assert auc(perfect) <= 0.5
    for fault in ("path reversed", "bursts reversed", "independent speeds"):
        wrong = with_fault(perfect, FAULTS[fault], np.random.default_rng(1))
        assert auc(wrong) > 0.6, fault


def test_the_benchmark_of_false_alarms_and_power_runs(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    asked = ["verdict_power.py", "--quick", "--starts", "10", "--faults", "bursts reversed"]
    monkeypatch.setattr("sys.argv", [*asked, "--worlds", "free pair", "chase"])
    verdict_power.main()
    printed = [line.split(" | ") for line in capsys.readouterr().out.splitlines()]
    alarms = {row[0]: row[3] for row in printed if row[0] in ("| free pair", "| chase")}
    assert alarms == {"| free pair": "0 %", "| chase": "0 %"}
    found = next(row for row in printed if row[0] == "| bursts reversed")
    assert found[1:] == ["100 %, 0 %", "100 %, 0 % |"]
