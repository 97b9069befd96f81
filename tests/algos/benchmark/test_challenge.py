"""The challenge: sets are frozen, starts are given, entries are checked, the page has the table."""

import csv
import re
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from commands import animarl
from refusals import refuses

from animarl_algos.benchmark import challenge
from animarl_algos.evaluation.collect import RandomPolicy, collect_rollouts
from animarl_algos.evaluation.rollouts import Rollouts
from animarl_envs.demos.packaged import packaged_names
from animarl_envs.scenario import make_scenario
from animarl_envs.worlds import make_world

ROOT = Path(__file__).resolve().parents[3]
TABLE = ROOT / "docs" / "results" / "challenge" / "table.csv"


@pytest.fixture
def entry(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Random actions from the packaged fly's test starts, twice: 32 times would take long."""
    monkeypatch.setattr(challenge, "ROLLOUTS", 2)
    made = collect_rollouts(
        partial(make_world, make_scenario("fly", split="test", time_limit=20)),
        RandomPolicy(0),
        method="mine",
        seed=0,
        repetitions=challenge.ROLLOUTS,
    )
    return made.save(tmp_path / "mine.npz")


def test_challenge_sets_are_frozen() -> None:
    """Packaged demonstrations have the fingerprints that entries are scored against."""
    for name in packaged_names():
        assert challenge.load_set(name).split is not None
    refuses("is no set of the challenge", challenge.load_set, "cat")


def test_challenge_gives_the_starts(tmp_path: Path) -> None:
    out = tmp_path / "starts.csv"
    animarl("benchmark", "starts", "newt", "--out", out)
    test = challenge.load_set("newt").select(split="test")
    with out.open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == len(test) * 3
    given = np.array([[float(row[key]) for key in ("x", "y", "vx", "vy")] for row in rows])
    first = test.positions[test.offsets[:-1]].reshape(-1, 2)
    np.testing.assert_array_equal(given[:, :2], first)
    np.testing.assert_array_equal(given[:, 2:], test.initial_velocity.reshape(-1, 2))


def test_challenge_entries_make_a_row(entry: Path, tmp_path: Path) -> None:
    scored = challenge.score_entry(entry, "fly", resamples=20)
    row = challenge.row_of(scored, "fly", entry)
    table = tmp_path / "table.csv"
    challenge.add_row(row | {"realism": "0.900"}, table)
    challenge.add_row(row, table)
    assert challenge.read_table(table) == [row]
    assert row["entry"] == "mine" and 0.0 < float(row["realism"]) < 0.6


def test_challenge_refuses_other_numbers_of_rollouts(entry: Path, tmp_path: Path) -> None:
    made = Rollouts.load(entry)
    fewer = made.select(np.arange(1, len(made))).save(tmp_path / "fewer.npz")
    refuses("1 rollouts are from test episode 0", challenge.score_entry, fewer, "fly")
    refuses("its fingerprint is", challenge.load_set, "fly", packaged_file("newt"))


def packaged_file(name: str) -> Path:
    return ROOT / "animarl_envs" / "demos" / "data" / f"{name}.npz"


def test_challenge_rows_are_well_formed_and_on_the_page() -> None:
    rows = challenge.read_table(TABLE)
    page = (ROOT / "docs" / "challenge.md").read_text()
    assert len({(row["set"], row["entry"]) for row in rows}) == len(rows) > 0
    for row in rows:
        assert tuple(row) == challenge.COLUMNS and row["set"] in challenge.frozen_sets()
        assert 0.0 <= float(row["realism"]) <= 1.0
        assert re.fullmatch("[0-9a-f]{64}", row["sha256"])
        assert f"| {row['set']} | {row['entry']} | {row['realism']}" in page
    for name in {row["set"] for row in rows}:  # references are in their order
        score = {row["entry"]: float(row["realism"]) for row in rows if row["set"] == name}
        assert score.get("ceiling", 1.0) >= max(score.values())
        assert score.get("floor", 0.0) <= min(score.values())
