"""Metrics of episodes and the tables made of them: known answers on paths drawn by hand."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from numpy.typing import NDArray

from animarl_algos.evaluation.comparison import comparison_table, pair_table
from animarl_algos.evaluation.contrasts import contrast_table
from animarl_algos.evaluation.counterfactual import counterfactual_table, has_flips
from animarl_algos.evaluation.metrics import (
    dtw_alignments,
    dtw_distances,
    measure,
    measure_recordings,
    path_lengths,
)
from animarl_algos.evaluation.rollouts import Rollouts
from animarl_envs.arena import Arena
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.errors import InputError


def line(frames: int, step: tuple[float, float], start: tuple[float, float]) -> NDArray[np.float64]:
    return np.asarray(start) + np.arange(frames)[:, None] * np.asarray(step)


def chase(frames: int, speed: float) -> NDArray[np.float64]:
    """Two pursuers, of step ``speed`` and twice that, and a target at rest."""
    return np.stack(
        [
            line(frames, (speed, 0.0), (-0.5, 0.0)),
            line(frames, (0.0, 2 * speed), (0.0, -0.5)),
            line(frames, (0.0, 0.0), (0.3, 0.3)),
        ],
        axis=1,
    )


@pytest.fixture
def demos() -> Demonstrations:
    paths = [chase(11, 0.02), chase(6, 0.01), chase(21, 0.03)]
    return Demonstrations(
        species="agent",
        individuals=("predator_0", "predator_1", "prey"),
        roles=("pursuer", "pursuer", "target"),
        dt=0.1,
        arena=Arena(),
        positions=np.concatenate(paths),
        lengths=np.array([len(p) for p in paths]),
        initial_velocity=np.zeros((3, 3, 2)),
        condition=np.array([0, 1, 1]),
        outcome=np.array([1, 0, 2]),
        split=np.array(["test"] * 3),
        recording=np.array(["a", "b", "c"]),
        provenance={"source": "drawn by hand", "licence": "MIT", "synthetic": True},
    )


def rollouts(demos: Demonstrations, demo: list[int], paths: list[NDArray[np.float64]]) -> Rollouts:
    count = len(demo)
    return Rollouts(
        method="BC",
        individuals=demos.individuals,
        roles=demos.roles,
        dt=demos.dt,
        positions=np.concatenate(paths),
        lengths=np.array([len(p) for p in paths]),
        outcome=np.array([1, 0, -1, 2][:count]),
        condition=demos.condition[demo],
        cue=np.full(count, -1),
        demo=np.array(demo),
        seed=np.zeros(count),
        repetition=np.arange(count),
    )


def test_path_length_is_that_of_each_episode_alone(demos: Demonstrations) -> None:
    made = rollouts(demos, [0, 1], [chase(4, 0.1), chase(3, 0.2)])
    assert path_lengths(made) == pytest.approx(np.array([[0.3, 0.6, 0.0], [0.4, 0.8, 0.0]]))


def test_measures_of_the_recordings(demos: Demonstrations) -> None:
    table = measure_recordings(demos)
    assert table["method"].unique().tolist() == ["recorded"]
    assert table["return"].tolist() == [1.0, 0.0, 1.0]
    assert table["duration"].to_numpy() == pytest.approx([1.0, 0.5, 2.0])
    assert table["path_length"].to_numpy() == pytest.approx([0.3, 0.075, 0.9])  # pursuers only
    assert (table["dtw"] == 0.0).all() and (table["dtw_per_step"] == 0.0).all()


def test_return_counts_captures_by_a_pursuer_only(demos: Demonstrations) -> None:
    """Contact counts; a target that leaves, a pursuer that leaves and a time-out do not."""
    table = measure(rollouts(demos, [0, 0, 0, 0], [chase(3, 0.1)] * 4), demos)
    assert table["return"].tolist() == [1.0, 0.0, 0.0, 1.0]
    assert table["captured"].tolist() == [True, False, False, True]


def test_dtw_known_answers(demos: Demonstrations) -> None:
    shifted = demos.episode(0).positions + [0.0, 0.25]
    slower = np.repeat(demos.episode(0).positions, 2, axis=0)  # the same path at half the speed
    made = rollouts(demos, [0, 0, 0], [demos.episode(0).positions, slower, shifted])
    distances = dtw_distances(made, demos)
    assert distances[0] == pytest.approx(0.0) and distances[1] == pytest.approx(0.0)
    assert distances[2, [0, 2]] == pytest.approx(11 * 0.25)  # crosswise to the path, or at rest
    table = measure(made, demos)
    assert table["dtw"][2] == pytest.approx(distances[2, :2].mean())
    # The second pursuer moves along the shift: its path is aligned in 17 pairs, not 11.
    pairs = dtw_alignments(made, demos)[1]
    assert pairs[2].tolist() == [11, 17, 11]
    per_step = (distances[2, 0] / 11 + distances[2, 1] / 17) / 2
    assert table["dtw_per_step"][2] == pytest.approx(per_step)


def test_dtw_equals_a_textbook_recursion(demos: Demonstrations) -> None:
    rng = np.random.default_rng(0)
    path = rng.uniform(-1, 1, (9, 3, 2))
    made = rollouts(demos, [2], [path])
    for k in range(3):
        x, y = path[:, k], demos.episode(2).positions[:, k]
        cost = np.linalg.norm(x[:, None] - y[None], axis=-1)
        total = np.full((len(x) + 1, len(y) + 1), np.inf)
        total[0, 0] = 0.0
        for t in range(len(x)):
            for j in range(len(y)):
                before = min(total[t, j], total[t, j + 1], total[t + 1, j])
                total[t + 1, j + 1] = cost[t, j] + before
        assert dtw_distances(made, demos)[0, k] == pytest.approx(total[-1, -1], abs=1e-9)


def test_a_lone_searcher_is_measured_itself() -> None:
    path = line(5, (0.1, 0.0), (0.0, 0.0))[:, None]
    demos = Demonstrations(
        species="silkmoth",
        individuals=("moth",),
        roles=("searcher",),
        dt=0.5,
        arena=Arena("open", size=1.0),
        positions=path,
        lengths=np.array([5]),
        initial_velocity=np.zeros((1, 1, 2)),
        condition=np.array([1]),
        outcome=np.array([1]),
        split=np.array(["test"]),
        recording=np.array(["a"]),
        provenance={"source": "drawn by hand", "licence": "MIT", "synthetic": True},
    )
    table = measure_recordings(demos)
    assert table["path_length"][0] == pytest.approx(0.4)
    assert table["duration"][0] == 2.0 and table["return"][0] == 1.0


def test_foreign_rollouts_are_refused(demos: Demonstrations) -> None:
    made = rollouts(demos, [2], [chase(3, 0.1)])
    with pytest.raises(InputError, match="were not made from"):
        measure(made, demos.select(episodes=[0, 1]))


# -- tables ------------------------------------------------------------


def metrics_rows(
    method: str, seed: int, value: NDArray[np.float64], captured: NDArray[np.bool_], **more: object
) -> pd.DataFrame:
    """One row per demonstration with every metric equal to ``value``."""
    count = len(value)
    names = ("path_length", "duration", "dtw", "dtw_per_step")
    columns: dict[str, object] = {"method": method, "seed": seed, "demo": np.arange(count)}
    columns |= {"repetition": 0, "condition": 0, "cue": -1, "outcome": 0, "captured": captured}
    columns |= {"return": captured.astype(float), **dict.fromkeys(names, value), **more}
    return pd.DataFrame(columns)


def row(table: pd.DataFrame, **where: object) -> pd.Series:
    chosen = table
    for key, value in where.items():
        chosen = chosen[chosen[key] == value]
    assert len(chosen) == 1
    return chosen.iloc[0]


def test_comparison_counts_what_it_says() -> None:
    rng = np.random.default_rng(0)
    recorded = rng.normal(5.0, 1.0, 20)
    caught = np.arange(20) < 8
    metrics = pd.concat(
        [
            metrics_rows("recorded", -1, recorded, caught),
            metrics_rows("BC", 0, recorded + 2.0, ~caught),
            metrics_rows("DQDIL", 0, recorded + 1.0, caught),
            metrics_rows("DQDIL", 1, recorded + 1.0, caught),
        ]
    )
    table = comparison_table(metrics, 20, rng, resamples=400, distance_resamples=200)
    everything = row(table, method="DQDIL", metric="duration", counting="all")
    assert everything["rollouts"] == 40 and everything["seeds"] == 2
    assert everything["to_recorded"] == pytest.approx(1.0)
    assert (everything["to_recorded_low"], everything["to_recorded_high"]) == pytest.approx((1, 1))
    pairs = pair_table(metrics, 20, rng, resamples=400)
    to_bc = row(pairs, first="DQDIL", second="BC", metric="duration", counting="all")
    assert to_bc["difference"] == pytest.approx(-1.0)
    assert everything["wasserstein"] == pytest.approx(1.0)
    assert everything["kde"] > everything["kde_null"]
    captures = row(table, method="DQDIL", metric="duration", counting="captures")
    assert captures["rollouts"] == 16 and captures["demos"] == 8
    assert captures["mean"] == pytest.approx(recorded[:8].mean() + 1.0)
    assert row(table, method="BC", metric="return")["mean"] == pytest.approx(0.6)
    # Recordings are not compared with themselves, and DTW only from method to method.
    assert np.isnan(row(table, method="recorded", metric="duration", counting="all")["kde"])
    dtw = row(table, method="BC", metric="dtw", counting="all")
    assert np.isnan(dtw["to_recorded"]) and np.isnan(dtw["kde"])
    assert len(table[(table["method"] == "recorded") & (table["metric"] == "dtw")]) == 0


def test_pairs_are_differences_on_the_same_demonstrations() -> None:
    rng = np.random.default_rng(0)
    recorded = rng.normal(5.0, 1.0, 20)
    caught = np.ones(20, dtype=bool)
    metrics = pd.concat(
        [
            metrics_rows("recorded", -1, recorded, caught),
            metrics_rows("BC", 0, recorded + 2.0, caught),
            metrics_rows("DQDIL", 0, recorded + 1.0, caught),
        ]
    )
    table = pair_table(metrics, 20, rng, resamples=200)
    assert "recorded" not in set(table["first"]) | set(table["second"])
    for first, second, difference in [("BC", "DQDIL", 1.0), ("DQDIL", "BC", -1.0)]:
        pair = row(table, first=first, second=second, metric="duration", counting="all")
        ends = (pair["difference_low"], pair["difference"], pair["difference_high"])
        assert ends == pytest.approx((difference,) * 3)
    within = row(
        comparison_table(metrics, 20, rng, resamples=200, distance_resamples=50),
        method="BC", metric="duration", counting="all",
    )  # fmt: skip
    assert (within["within_low"], within["within_high"]) == pytest.approx((within["mean"],) * 2)
    assert within["mean_high"] - within["mean_low"] > 0.5


def test_flipped_cues_and_changed_worlds_do_not_enter_the_comparison() -> None:
    rng = np.random.default_rng(1)
    values, caught = rng.normal(size=10), np.ones(10, dtype=bool)
    metrics = pd.concat(
        [
            metrics_rows("recorded", -1, values, caught),
            metrics_rows("DQCIL", 0, values, caught, cue=0),
            metrics_rows("DQCIL", 0, values + 100.0, caught, cue=1),
            metrics_rows("DQCIL", 0, values + 200.0, caught, condition=1, cue=1),
        ]
    )
    table = comparison_table(metrics, 10, rng, resamples=50, distance_resamples=50)
    assert row(table, method="DQCIL", metric="duration", counting="all")["mean"] == pytest.approx(
        values.mean()
    )


def test_contrasts_compare_gaps_and_stand_behind_a_gate() -> None:
    rng = np.random.default_rng(2)
    recorded, caught = rng.normal(5.0, 1.0, 25), np.ones(25, dtype=bool)

    def near(method: str, seed: int, gap: float) -> pd.DataFrame:
        sides = rng.choice([-1.0, 1.0], 25) * (gap + rng.normal(0, 0.05, 25))
        return metrics_rows(method, seed, recorded + sides, caught)

    methods = [("dqaas", 2.0), ("DQDIL", 1.0), ("DQDIL-PT", 1.0)]
    metrics = pd.concat(
        [metrics_rows("recorded", -1, recorded, caught)]
        + [near(name, seed, gap) for name, gap in methods for seed in range(4)]
    )
    table = contrast_table(metrics, 25, rng, resamples=400)
    table = table[table["measure"] != "energy score"]  # of which one rollout a start shows nothing
    assert len(table) == 9
    assert set(table["gate_unit"]) == {
        "which method a training seed belongs to (4 + 4 + 4 seeds, a sample of the 34,650 ways)"
    }
    clear = row(table, metric="duration", first="DQDIL", second="dqaas")
    assert clear["gate_passed"] and clear["difference_high"] < -0.8
    none = row(table, metric="duration", first="DQDIL-PT", second="DQDIL")
    assert none["difference_low"] < 0.0 < none["difference_high"]
    alone = metrics[metrics["method"].isin(["recorded", "DQDIL"])]
    assert contrast_table(alone, 25, rng).empty


def runs(
    gaps: dict[str, float], seeds: dict[str, int], *, repetitions: int = 1, spread: float = 0.3
) -> pd.DataFrame:
    """Recordings and methods as far from them as ``gaps`` says, whose seeds differ."""
    rng = np.random.default_rng(5)
    recorded, caught = rng.normal(5.0, 1.0, 20), np.ones(20, dtype=bool)
    parts = [metrics_rows("recorded", -1, recorded, caught)]
    for method, gap in gaps.items():
        for seed in range(seeds[method]):
            own = gap + rng.normal(0.0, spread)
            for _ in range(repetitions):
                away = rng.choice([-1.0, 1.0], 20) * (own + rng.normal(0, 0.2, 20))
                parts.append(metrics_rows(method, seed, recorded + away, caught))
    return pd.concat(parts)


METHODS = {"DQAAS": 1.0, "DQDIL": 1.0, "DQDIL-PT": 1.0}


@pytest.mark.parametrize(
    ("methods", "seeds"),
    [(METHODS, 1), (METHODS, 2), ({"DQDIL": 9.0, "DQDIL-PT": 1.0}, 3)],
)
def test_a_gate_of_few_seeds_decides_nothing(methods: dict[str, float], seeds: int) -> None:
    """Two methods of three seeds have 20 arrangements: the smallest p is 2 in 20."""
    rng = np.random.default_rng(0)
    metrics = runs(methods, dict.fromkeys(methods, seeds))
    table = contrast_table(metrics, 20, rng, resamples=200)
    table = table[table["measure"] != "energy score"]
    assert set(table["gate"]) == {"cannot be decided with so few seeds"}
    assert not table["gate_passed"].any() and table["difference_low"].isna().all()
    assert table["reason"].str.contains("cannot be decided with so few seeds").all()


def test_unequal_seeds_and_missing_starts_pass_the_gate_all_the_same() -> None:
    rng = np.random.default_rng(0)
    gaps = {"DQAAS": 4.0, "DQDIL": 1.0, "DQDIL-PT": 1.0}
    metrics = runs(gaps, {"DQAAS": 4, "DQDIL": 3, "DQDIL-PT": 5}, repetitions=2)
    lacking = (metrics["method"] == "DQDIL") & (metrics["demo"] < 3)
    table = contrast_table(metrics[~lacking], 20, rng, resamples=300)
    assert (table["demos"] == 17).all()
    for by in ("energy score", "absolute gap"):
        clear = row(table, metric="duration", measure=by, first="DQDIL", second="DQAAS")
        assert clear["gate"] == "passed" and clear["difference_high"] < 0
        assert "4 + 3 + 5 seeds" in row(
            table, metric="duration", measure=by, first="DQDIL-PT", second="DQDIL"
        )["gate_unit"].replace("3 + 4 + 5", "4 + 3 + 5")


def test_contrasts_behind_a_gate_that_was_not_passed_have_no_interval() -> None:
    metrics = runs(METHODS, dict.fromkeys(METHODS, 4), repetitions=2)
    table = contrast_table(metrics, 20, np.random.default_rng(0), resamples=300)
    shut = table[table["gate"] == "not passed"]
    assert len(shut) > 0
    assert shut["difference_low"].isna().all()
    assert (shut["reason"] == "difference: the gate: not passed").all()


def test_differences_of_captures_are_of_shared_starts() -> None:
    """Who is captured only from far starts is not slower for that."""
    rng = np.random.default_rng(0)
    recorded = np.arange(20.0)
    early, late = np.arange(20) < 12, np.arange(20) >= 8
    metrics = pd.concat(
        [
            metrics_rows("recorded", -1, recorded, np.ones(20, dtype=bool)),
            metrics_rows("BC", 0, recorded + rng.normal(0, 0.1, 20), early),
            metrics_rows("DQDIL", 0, recorded + rng.normal(0, 0.1, 20), late),
        ]
    )
    pairs = pair_table(metrics, 20, rng, resamples=200)
    where = {"first": "DQDIL", "second": "BC", "metric": "duration"}
    captures = row(pairs, counting="captures", **where)
    assert captures["demos"] == 4 and captures["pairing"] == "paired, shared starts only"
    assert abs(captures["difference"]) < 0.5
    everything = row(pairs, counting="all", **where)
    assert everything["demos"] == 20 and everything["pairing"] == "paired, same starts"
    table = comparison_table(metrics, 20, rng, resamples=200, distance_resamples=50)
    mean = row(table, method="DQDIL", metric="duration", counting="captures")
    assert mean["mean"] > 13 and mean["to_recorded"] == pytest.approx(0.0, abs=0.2)
    assert mean["to_recorded_demos"] == 12


def test_what_is_undefined_has_its_reason_and_one_network_is_called_so() -> None:
    rng = np.random.default_rng(0)
    recorded, once = rng.normal(5.0, 1.0, 6), np.arange(6) == 2
    metrics = pd.concat(
        [
            metrics_rows("recorded", -1, recorded, np.ones(6, dtype=bool)),
            metrics_rows("BC", 0, recorded, once),
            metrics_rows("DQDIL", 0, recorded, ~once),
            metrics_rows("DQDIL", 1, recorded, ~once),
        ]
    )
    table = comparison_table(metrics, 6, rng, resamples=100, distance_resamples=50)
    one = row(table, method="BC", metric="duration", counting="captures")
    assert np.isnan([one["mean_low"], one["to_recorded_low"], one["energy"]]).all()
    assert "mean: one demonstration" in one["reason"]
    assert "energy: fewer than two rollouts a start" in one["reason"]
    assert one["covers"] == "this network only"
    assert set(table.loc[table["method"] == "DQDIL", "covers"]) == {"training runs like these"}
    pairs = pair_table(metrics, 6, rng, resamples=100)
    assert set(pairs["covers"]) == {"these networks only"}
    apart = row(pairs, first="BC", second="DQDIL", metric="duration", counting="captures")
    assert np.isnan(apart["difference"]) and "no shared start" in apart["reason"]


def test_duration_and_outcome_stand_beside_dtw() -> None:
    rng = np.random.default_rng(0)
    recorded, caught = rng.normal(5.0, 1.0, 10), np.arange(10) < 4
    metrics = pd.concat(
        [
            metrics_rows("recorded", -1, recorded, caught),
            metrics_rows("BC", 0, np.full(10, 1.0), caught),
        ]
    )
    table = comparison_table(metrics, 10, rng, resamples=100, distance_resamples=50)
    dtw = row(table, method="BC", metric="dtw", counting="all")
    assert dtw["duration"] == pytest.approx(1.0) and dtw["reached"] == pytest.approx(0.4)
    floor = row(table, method="BC", metric="duration", counting="all")["kde_floor"]
    assert floor == pytest.approx(0.01 * np.ptp([*recorded, 1.0]))
    assert np.isnan(row(table, method="recorded", metric="duration", counting="all")["kde_floor"])


# -- counterfactual ------------------------------------------------------------


@pytest.fixture
def flips() -> tuple[pd.DataFrame, NDArray[np.int64]]:
    """Condition 1 adds 2 to the recordings; the policy adds 1.5 when it is told so."""
    rng = np.random.default_rng(3)
    condition = np.repeat([0, 1], 15)
    caught = np.ones(30, dtype=bool)
    base = rng.normal(5.0, 1.0, 30)
    parts = [metrics_rows("recorded", -1, base + 2.0 * condition, caught, condition=condition)]
    for seed in range(3):
        for told in (condition, 1 - condition):
            value = base + seed + 1.5 * told
            parts.append(metrics_rows("DQCIL", seed, value, caught, condition=condition, cue=told))
        changed = metrics_rows(
            "DQCIL", seed, base + seed + 3.0 * (1 - condition), caught,
            condition=1 - condition, cue=1 - condition,
        )  # fmt: skip
        parts.append(changed)
    return pd.concat(parts), condition


def test_counterfactual_known_answers(flips: tuple[pd.DataFrame, NDArray[np.int64]]) -> None:
    metrics, condition = flips
    assert has_flips(metrics)
    table = counterfactual_table(
        metrics, condition, np.random.default_rng(0), planned=(0, 1), resamples=400
    )
    table = table[table["counting"] == "all"]
    shifts = table[table["quantity"] == "cue shift"].set_index("condition")
    # The same networks on the same starts: what the seed and the start add cancels.
    assert shifts.loc[0, ["value", "value_low", "value_high"]].tolist() == pytest.approx([1.5] * 3)
    assert shifts.loc[1, ["value", "value_low", "value_high"]].tolist() == pytest.approx([-1.5] * 3)
    assert shifts["planned"].to_dict() == {0: True, 1: False}
    world = row(table, quantity="world shift", condition=0)
    assert world["value"] == pytest.approx(3.0)
    # Seeds 0, 1, 2 add one on average.
    assert row(table, quantity="absolute error", condition=0)["value"] == pytest.approx(1.0)
    assert row(table, quantity="absolute error", condition=1)["value"] == pytest.approx(0.5)
    gap = row(table, quantity="condition 0 - condition 1", method="recorded")
    assert gap["value_low"] < gap["value"] < gap["value_high"] < 0.0


def test_counterfactual_counts_captures_apart(
    flips: tuple[pd.DataFrame, NDArray[np.int64]],
) -> None:
    metrics, condition = flips
    metrics = metrics.assign(captured=metrics["demo"] % 2 == 0)
    table = counterfactual_table(metrics, condition, np.random.default_rng(0), resamples=100)
    recorded = metrics[(metrics["method"] == "recorded") & (metrics["condition"] == 0)]
    for counting, chosen in (("all", recorded), ("captures", recorded[recorded["captured"]])):
        mean = row(table, method="recorded", quantity="mean", condition=0, counting=counting)
        assert mean["value"] == pytest.approx(chosen["path_length"].mean())


def test_no_flips_without_another_cue(demos: Demonstrations) -> None:
    assert not has_flips(measure_recordings(demos))
