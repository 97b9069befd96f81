"""Measures of the user's own, and recorded conditions beside each other."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from moving_pairs import recorded_pairs, simulated_pairs
from refusals import refuses

from animarl_algos.evaluation.conditions import compare_conditions
from animarl_algos.evaluation.metrics import METRICS
from animarl_algos.evaluation.own_measures import measured_recordings, register_measures
from animarl_algos.evaluation.prepared import Prepared
from animarl_algos.evaluation.realism import OWN, Likelihood
from animarl_algos.evaluation.rollouts import Rollouts
from animarl_algos.evaluation.verdict import compare
from animarl_algos.evaluation.verdict_rows import DIFFERS, Questions, Row
from animarl_algos.report.verdict_section import conditions_as_table
from animarl_algos.whatif.quantities import quantities_of
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.summary import unit_of

CODE = """
import numpy as np

def first_x(positions, dt, roles):
    return positions[:, 0, 0]

first_x.unit = "mm"

def per_animal(positions, dt, roles):
    return np.ptp(positions, axis=0).sum(axis=-1)

def no_value(positions, dt, roles):
    return np.nan

def fails(positions, dt, roles):
    return positions[10_000]

def odd(positions, dt, roles):
    return 1.0

odd.tolerance = "wide"
"""


@pytest.fixture
def file(tmp_path: Path) -> Iterator[Path]:
    known, path = list(METRICS), tmp_path / "my_index.py"
    path.write_text(CODE)
    yield path
    METRICS[:] = known


def rows_of(demos: Demonstrations, rollouts: Rollouts) -> dict[str, Row]:
    return {row.measure: row for row in compare(demos, rollouts, 0)[0].rows()}


def test_own_measure_stands_in_the_verdict_and_in_what_if(file: Path) -> None:
    demos = recorded_pairs()
    scales = {name: {"unit": 50.0} for name in demos.recording.tolist()}
    demos = replace(demos, provenance={**demos.provenance, "unit": "mm", "scales": scales})
    [metric] = register_measures([f"{file}:first_x"])
    register_measures([f"{file}:first_x"])  # once more: it replaces the other
    assert [one.key for one in METRICS].count("first_x") == 1
    rollouts = simulated_pairs(demos, "true")
    row = rows_of(demos, rollouts)["first_x"]
    lengths = demos.lengths
    expected = [50 * demos.path(i)[:, 0, 0].mean() for i in range(len(demos))]
    assert row.recorded == pytest.approx(np.mean(expected)) and row.unit == "mm"
    assert row.tolerance == pytest.approx(0.25 * np.std(expected, ddof=1))
    moved = replace(rollouts, positions=rollouts.positions + 0.9)
    assert rows_of(demos, moved)["first_x"].judgement == DIFFERS
    assert "First x: mean" in measured_recordings([metric], demos)[0]
    quantity = next(one for one in quantities_of(rollouts, unit_of(demos)) if one.name == "first x")
    assert quantity.unit == "mm" and len(quantity.values(rollouts)) == len(rollouts) != len(lengths)


def test_own_measure_takes_part_in_the_choice_of_acting(file: Path) -> None:
    demos = recorded_pairs()
    own = register_measures([f"{file}:first_x"], chooses=True)
    assert own[0].chooses and not register_measures([f"{file}:per_animal"])[0].chooses
    likelihood = Likelihood.of(Prepared(demos), own=own)
    rollouts = simulated_pairs(demos, "true")
    moved = replace(rollouts, positions=rollouts.positions + 0.9)
    found = [likelihood.components(side) for side in (rollouts, moved)]
    likely, unlikely = (likelihood.by_kind(each)[OWN] for each in found)
    assert likely > unlikely + 0.3
    without = Likelihood.of(Prepared(demos))
    assert np.array_equal(without.components(moved), found[1][likelihood.kinds != OWN])


def test_own_measure_of_each_animal_or_of_none(file: Path) -> None:
    demos = recorded_pairs()
    register_measures([f"{file}:per_animal", f"{file}:no_value"])
    rows = rows_of(demos, simulated_pairs(demos, "still"))
    assert rows["per_animal"].recorded > 0 == rows["per_animal"].simulated
    assert "too few for an interval" in rows["no_value"].verdict


def test_own_measure_that_cannot_be_taken_is_refused(file: Path) -> None:
    for name, said in (
        ("first_x", "FILE.py:FUNCTION"), (f"{file}x:first_x", "FILE.py:FUNCTION"),
        ("nowhere.py:first_x", "no file nowhere.py"), (f"{file}:gone", "no function gone"),
        (f"{file}:odd", "tolerance is 'wide'"),
    ):  # fmt: skip
        refuses(said, register_measures, [name])
    broken = file.with_name("broken.py")
    broken.write_text("import nothing_of_this_name")
    refuses("cannot be run", register_measures, [f"{broken}:f"])
    register_measures([f"{file}:fails"])
    demos = recorded_pairs()
    rollouts = simulated_pairs(demos, "true")
    refuses("fails on episode 0 of 30", compare, demos, rollouts, 0)


def of_two(factor: float) -> Demonstrations:
    """Recordings of two conditions; in the second everybody goes less far."""
    demos = recorded_pairs()
    second = np.arange(len(demos)) % 2 == 1
    first = np.repeat(demos.positions[demos.offsets[:-1]], demos.lengths, axis=0)
    frame = np.repeat(second, demos.lengths)[:, None, None]
    moved = np.where(frame, first + factor * (demos.positions - first), demos.positions)
    return replace(
        demos, positions=moved, condition=second.astype(np.int8),
        provenance={**demos.provenance, "conditions": ["sham", "lesion"]},
    )  # fmt: skip


def test_conditions_that_are_alike_do_not_differ_and_others_do() -> None:
    same, other = (compare_conditions(of_two(factor)) for factor in (1.0, 0.5))
    assert same.names == ("sham", "lesion") and same.recordings == (15, 15)
    assert not any(row.judgement == DIFFERS for row in same.rows)
    speed = next(row for row in other.rows if row.measure == "mean_speed")
    assert speed.judgement == DIFFERS and speed.verdict.startswith("mean speed lower: ")
    assert speed.simulated == pytest.approx(0.5 * speed.recorded, rel=0.15)
    assert conditions_as_table(other).columns[2:4] == ["sham", "lesion"]
    assert "15 of sham and 15 of lesion" in other.headline
    first = compare_conditions(of_two(1.0), questions=Questions(primary=("speed",)))
    narrow = next(row for row in first.rows if row.measure == "mean_speed")
    wide = next(row for row in same.rows if row.measure == "mean_speed")
    assert narrow.high - narrow.low < wide.high - wide.low


def test_conditions_that_are_not_there_are_refused() -> None:
    refuses("two different conditions are needed", compare_conditions, recorded_pairs())
    refuses("it has sham, lesion", compare_conditions, of_two(1.0), ["sham", "drug"])
