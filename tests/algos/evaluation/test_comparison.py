"""Tables of methods compared: known answers, pairs, their gate, and what is undefined."""

import numpy as np
import pandas as pd
import pytest
from numpy.typing import NDArray

from animarl_algos.evaluation.comparison import comparison_table, pair_table


def metrics_rows(
    method: str, seed: int, value: NDArray[np.float64], captured: NDArray[np.bool_], **more: object
) -> pd.DataFrame:
    """One row per demonstration with every metric equal to ``value``."""
    count = len(value)
    names = ("path_length", "duration", "dtw", "dtw_per_step")
    columns: dict[str, object] = {"method": method, "seed": seed, "demo": np.arange(count)}
    columns |= {
        "repetition": 0, "condition": 0, "cue": -1, "outcome": 0, "captured": captured,
        "factual": True,
    }  # fmt: skip
    columns |= {"reached": captured.astype(float), **dict.fromkeys(names, value), **more}
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
            *(metrics_rows("DQDIL", seed, recorded + 1.0, caught) for seed in (0, 1)),
        ]
    )
    table = comparison_table(metrics, np.arange(20), rng, resamples=400)
    everything = row(table, method="DQDIL", measure="duration", counting="all")
    assert everything["rollouts"] == 40 and everything["seeds"] == 2
    pairs = pair_table(metrics, np.arange(20), rng, resamples=400)
    duration = {"first": "DQDIL", "measure": "duration", "counting": "all"}
    to_recorded = row(pairs, second="recorded", **duration)
    assert to_recorded[["low", "value", "high"]].tolist() == pytest.approx([1.0] * 3)
    to_bc = row(pairs, second="BC", **duration)
    assert to_bc[["low", "value", "high"]].tolist() == pytest.approx([-1.0] * 3)
    assert "recorded" not in set(pairs["first"])
    energy = row(table, method="DQDIL", measure="energy of duration", counting="all")
    assert np.isnan(energy["value"])  # one rollout a start shows no spread
    captures = row(table, method="DQDIL", measure="duration", counting="captures")
    assert captures["rollouts"] == 16 and captures["demos"] == 8
    assert captures["value"] == pytest.approx(recorded[:8].mean() + 1.0)
    assert row(table, method="BC", measure="reached")["value"] == pytest.approx(0.6)
    # Recordings are not compared with themselves, and DTW only from method to method.
    of = {name: set(rows["measure"]) for name, rows in table.groupby("method")}
    assert of["recorded"] == {"reached", "path_length", "duration"}
    assert "energy of duration" in of["BC"] and "energy of dtw" not in of["BC"]
    assert "dtw" not in set(pairs.loc[pairs["second"] == "recorded", "measure"])


def test_flipped_cues_and_changed_worlds_do_not_enter_the_comparison() -> None:
    rng = np.random.default_rng(1)
    values, caught = rng.normal(size=10), np.ones(10, dtype=bool)
    metrics = pd.concat(
        [
            metrics_rows("recorded", -1, values, caught),
            metrics_rows("DQCIL", 0, values, caught, cue=0),
            metrics_rows("DQCIL", 0, values + 100.0, caught, cue=1, factual=False),
        ]
    )
    table = comparison_table(metrics, np.arange(10), rng, resamples=50)
    found = row(table, method="DQCIL", measure="duration", counting="all")
    assert found["value"] == pytest.approx(values.mean())


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


def gates(metrics: pd.DataFrame) -> pd.DataFrame:
    """Pairs that were planned, by the metrics that planned pairs have a gate by."""
    table = pair_table(metrics, np.arange(20), np.random.default_rng(0), resamples=300)
    return table[table["gate"] != ""]


@pytest.mark.parametrize(
    ("methods", "seeds"), [(METHODS, 1), (METHODS, 2), ({"DQDIL": 9.0, "DQDIL-PT": 1.0}, 3)]
)
def test_a_gate_of_few_seeds_decides_nothing(methods: dict[str, float], seeds: int) -> None:
    """Two methods of three seeds have 20 arrangements: the smallest p is 2 in 20."""
    table = gates(runs(methods, dict.fromkeys(methods, seeds), repetitions=2))
    assert set(table["gate"]) == {"cannot be decided with so few seeds"}
    assert set(table["measure"]) == {"energy of path_length", "energy of duration", "dtw"}
    assert set(table["counting"]) == {"all"}


def test_planned_pairs_alone_have_a_gate_whatever_the_case_of_their_names() -> None:
    metrics = runs(METHODS | {"BC": 1.0}, dict.fromkeys([*METHODS, "BC"], 4), repetitions=2)
    found = gates(metrics.replace("DQAAS", "dqaas"))
    pairs = set(zip(found["first"], found["second"]))
    assert pairs == {("DQDIL", "dqaas"), ("DQDIL-PT", "dqaas"), ("DQDIL-PT", "DQDIL")}
    assert set(found["gate"]) == {"not passed"} and (found["gate_p"] > 0.05).all()
    assert gates(metrics[metrics["method"].isin(["recorded", "DQDIL", "BC"])]).empty


def test_unequal_seeds_and_missing_starts_pass_the_gate_all_the_same() -> None:
    gaps = {"DQAAS": 4.0, "DQDIL": 1.0, "DQDIL-PT": 1.0}
    metrics = runs(gaps, {"DQAAS": 4, "DQDIL": 3, "DQDIL-PT": 5}, repetitions=2)
    lacking = (metrics["method"] == "DQDIL") & (metrics["demo"] < 3)
    table = gates(metrics[~lacking])
    table = table[table["measure"] != "dtw"]  # here as far on either side as the others
    assert set(table["gate"]) == {"passed"} and (table["gate_p"] <= 0.05).all()
    clear = row(table, measure="energy of duration", first="DQDIL", second="DQAAS")
    assert clear["demos"] == 17 and clear["high"] < 0


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
    pairs = pair_table(metrics, np.arange(20), rng, resamples=200)
    where = {"first": "DQDIL", "second": "BC", "measure": "duration"}
    captures = row(pairs, counting="captures", **where)
    assert captures["demos"] == 4 and captures["pairing"] == "paired, shared starts only"
    assert abs(captures["value"]) < 0.5
    everything = row(pairs, counting="all", **where)
    assert everything["demos"] == 20 and everything["pairing"] == "paired, same starts"
    to_recorded = row(pairs, counting="captures", **where | {"second": "recorded"})
    assert to_recorded["value"] == pytest.approx(0.0, abs=0.2) and to_recorded["demos"] == 12


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
    table = comparison_table(metrics, np.arange(6), rng, resamples=100)
    where = {"method": "BC", "counting": "captures"}
    one, energy = (row(table, measure=f"{of}duration", **where) for of in ("", "energy of "))
    assert np.isnan([one["low"], energy["value"]]).all() and one["covers"] == "this network only"
    assert one["reason"].startswith("one demonstration")
    assert energy["reason"] == "fewer than two rollouts a start"
    assert set(table.loc[table["method"] == "DQDIL", "covers"]) == {"training runs like these"}
    pairs = pair_table(metrics, np.arange(6), rng, resamples=100)
    assert set(pairs.loc[pairs["second"] == "DQDIL", "covers"]) == {"these networks only"}
    apart = row(pairs, first="BC", second="DQDIL", measure="duration", counting="captures")
    assert np.isnan(apart["value"]) and "no shared start" in apart["reason"]
