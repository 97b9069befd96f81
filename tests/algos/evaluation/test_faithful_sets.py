"""``benchmarks/faithful.py``: sets are dealt as they say, and every bar can be met and missed."""

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import typer

from animarl_algos.evaluation.rollouts import Rollouts
from animarl_algos.evaluation.statistics import Interval
from animarl_algos.evaluation.verdict import Verdict
from animarl_algos.evaluation.verdict_rows import ALIKE
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.episode import UNFINISHED
from animarl_envs.demos.packaged import load_packaged
from animarl_envs.demos.splits import cross_validated
from benchmarks import faithful, order
from benchmarks.faithful import SETS, DataSet, bar_rows, with_others

CROSSED = [one for one in SETS if one.importing is None and one.folds > 1]
NAMED = {one.name: one for one in SETS}
TEST_TABLE = Path(__file__).parents[3] / "docs" / "results" / "test" / "faithful.csv"


@pytest.mark.realdata
@pytest.mark.parametrize("one", CROSSED, ids=[one.name for one in CROSSED])
def test_every_episode_is_tested_once(one: DataSet, tmp_path: Path) -> None:
    demos = one.load(tmp_path)
    tested = [np.flatnonzero(fold.split == "test") for fold in cross_validated(demos, one.folds)]
    assert len(tested) == one.folds
    assert np.sort(np.concatenate(tested)).tolist() == list(range(len(demos)))


def test_a_set_that_is_cut_stops_anywhere(tmp_path: Path) -> None:
    whole, cut = load_packaged("agent"), NAMED["agent-cut"].load(tmp_path)
    assert set(cut.outcome.tolist()) == {UNFINISHED}
    kept = cut.lengths / whole.lengths
    assert kept.min() >= 0.25 and kept.max() <= 1.0 and 0.5 < kept.mean() < 0.75
    for one, other in zip(cut, whole, strict=True):
        np.testing.assert_array_equal(one.positions, other.positions[: len(one.positions)])


def found(floor: float = 0.6, among: float = 0.5, auc: float = 0.65) -> Verdict:
    """A verdict of one row."""
    row = dict.fromkeys(
        ("recorded", "value", "low", "high", "tolerance"),
        math.nan,
    ) | {"measure": "auc", "label": "Told apart", "simulated": auc, "judgement": ALIKE}  # fmt: skip
    words = {"unit": "", "covers": "", "reason": "", "verdict": ALIKE, "colour": "green"}
    return Verdict(
        table=pd.DataFrame([row | words]), learner="soft-bc", recordings=5,
        starts=5, rollouts=250, importance={},
        areas={"auc": {"among": Interval(among, 0.4, 0.6), "floor": Interval(floor, floor, floor)}},
    )  # fmt: skip


@pytest.mark.parametrize(
    ("floor", "auc", "met"),
    [
        (0.60, 0.69, "yes"), (0.60, 0.71, "no"), (0.45, 0.54, "yes"), (0.45, 0.56, "no"),
        (math.nan, 0.5, "cannot be said"),
    ],
)  # fmt: skip
def test_an_area_is_at_most_so_much_above_the_floor(floor: float, auc: float, met: str) -> None:
    row, _ = bar_rows(NAMED["courtship"], found(floor, auc=auc))
    assert row["met?"] == met


@pytest.mark.parametrize("name", ["termites", "fly-groups", "courtship"])
@pytest.mark.parametrize(
    ("floor", "among", "met"),
    [
        (0.75, 0.5, "yes"), (0.76, 0.5, "no"), (0.78, 0.74, "yes"), (0.80, 0.74, "no"),
        (0.70, math.nan, "yes"), (0.76, math.nan, "cannot be said"),
        (math.nan, 0.5, "cannot be said"),
    ],
)  # fmt: skip
def test_a_floor_is_low_or_near_that_of_recordings(
    name: str, floor: float, among: float, met: str
) -> None:
    above, own = bar_rows(NAMED[name], found(floor, among))
    assert above["met?"] == ("cannot be said" if math.isnan(floor) else "yes")  # as before
    assert "the floor" in own["label"] and own["met?"] == met
    assert own["simulated"] == pytest.approx(floor, nan_ok=True)
    assert own["recorded"] == pytest.approx(among, nan_ok=True)
    assert own["bar"] == "at most 0.75, or within 0.05 of recordings"


@pytest.mark.parametrize(
    ("seconds", "met"), [(239.9, "yes"), (240.1, "no"), (math.nan, "cannot be said")]
)
def test_only_sets_of_500_episodes_are_timed(seconds: float, met: str) -> None:
    timed = {
        name: row["met?"]
        for name, one in NAMED.items()
        for row in bar_rows(one, found(), seconds)
        if row["bar"] == "at most 240 s of processor time"
    }
    assert timed == dict.fromkeys(["agent", "agents-indiv", "agents-share"], met)
    assert len(load_packaged("agent")) == 500


def test_the_time_of_a_cell_that_found_networks_is_not_of_all(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def trained(demos: Demonstrations, folder: Path, *asked: Any) -> tuple[Any, ...]:
        folder.mkdir(parents=True, exist_ok=True)
        there = demos.select(split="val")
        same = Rollouts.from_demonstrations(there)
        return same, same, np.split(there.positions, there.offsets[1:-1])

    monkeypatch.setattr(faithful, "trained", trained)
    monkeypatch.setattr(faithful, "verdict", lambda *given, **named: found())
    asked = (NAMED["fly"], tmp_path, "soft-bc", 0, "val", 10)
    cells = [faithful.judged(*asked) for _ in range(2)]
    assert [cell.whole for cell in cells] == [True, False]
    cells[0].save(tmp_path / "cell")
    recorded, rollouts = (tmp_path / "cell" / f"{name}.npz" for name in ("recorded", "rollouts"))
    assert Demonstrations.load(recorded).fingerprint() == cells[0].recorded.fingerprint()
    assert Rollouts.load(rollouts).lengths.tolist() == cells[0].recorded.lengths.tolist()
    assert json.loads((tmp_path / "cell" / "cell.json").read_text())["whole"]


@pytest.mark.parametrize(
    ("done", "met"),
    [
        ({"seconds": 100.0, "whole": True}, "yes"),
        ({"seconds": 300.0, "whole": True}, "no"),
        ({"seconds": 10.0, "whole": False}, "cannot be said"),
        ({"seconds": 10.0}, "cannot be said"),  # of an older cell
    ],
)
@pytest.mark.parametrize("synthetic", [True, False])
def test_kept_cells_are_tabled_in_the_words_of_their_set(
    done: dict[str, Any],
    met: str,
    synthetic: bool,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    demos = load_packaged("agent")
    demos = replace(demos, provenance={**demos.provenance, "synthetic": synthetic})
    monkeypatch.setattr(DataSet, "load", lambda one, folder: demos)
    cell = tmp_path / "cells" / "agent-soft-bc-0-val-250"
    found().save(cell)
    (cell / "cell.json").write_text(json.dumps({"commit": "abc", **done}))
    faithful.main(only=["agent"], out=tmp_path)
    said = capsys.readouterr().out
    assert ("Demonstrated" in said) == synthetic and ("Recorded" in said) != synthetic
    last = pd.read_csv(tmp_path / "faithful.csv").iloc[-1]
    assert (last["met?"], last["seconds"]) == (met, done["seconds"])
    assert f"| {met} |" in (tmp_path / "faithful.md").read_text().splitlines()[-1]


def test_rows_of_older_tables_stay_beside_new_ones() -> None:
    older = pd.read_csv(TEST_TABLE)
    rows = bar_rows(NAMED["courtship"], found())
    head = {"set": "courtship", "seed": 0, "seconds": 1.0, "group": NAMED["courtship"].group}
    anew = pd.DataFrame([head | row for row in rows])
    table = with_others(anew, TEST_TABLE)
    own = (table["set"] == "courtship") & (table["seed"] == 0)
    before = (older["set"] == "courtship") & (older["seed"] == 0)
    assert table[own]["label"].tolist() == [row["label"] for row in rows]
    assert table[~own]["label"].tolist() == older[~before]["label"].tolist()
    groups = table["group"].nunique()  # of each a heading and names, and empty lines
    assert faithful.markdown(table).count("\n") == len(table) + 5 * groups - 2


def test_order_in_time_of_kept_cells_can_be_tabled() -> None:
    recorded = Rollouts.from_demonstrations(load_packaged("silkmoth").select(split="test"))
    values = order.measured(recorded, [1.0], np.zeros(1))
    assert set(values) == {"turns at 1 s", "windings a minute", "sd of speed", "sd of turning"}
    assert 0 < values["windings a minute"] < 10 and abs(values["turns at 1 s"]) < 1


def test_a_lockbox_has_its_own_seed_and_group_and_is_asked_on_its_test_split(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    demos = load_packaged("fly")
    file = tmp_path / "mine.npz"
    demos.save(file)
    asked: list[tuple[Any, ...]] = []

    class Kept:
        def save(self, folder: Path) -> None:
            found().save(folder)
            done = {"seconds": 1.0, "commit": "abc"}
            (folder / "cell.json").write_text(json.dumps(done))

    def judged(one: DataSet, out: Path, *rest: Any) -> Kept:
        asked.append(rest)
        return Kept()

    monkeypatch.setattr(faithful, "judged", judged)
    faithful.main(unseen=[file], out=tmp_path / "out")
    ((_, seed, split, *_),) = asked
    assert split == "test" and seed == faithful.own_seed(Demonstrations.load(file))
    assert seed != faithful.own_seed(load_packaged("newt"))
    assert "## Sets: unseen" in (tmp_path / "out" / "faithful.md").read_text()
    row = pd.read_csv(tmp_path / "out" / "faithful.csv").iloc[-1]
    assert (row["set"], row["group"], row["seed"]) == ("mine", "unseen", seed)

    with pytest.raises(typer.BadParameter, match="stands alone"):
        faithful.main(unseen=[file], seed=[3], out=tmp_path / "out")
    replace(demos, split=np.where(demos.split == "val", "train", demos.split)).save(file)
    with pytest.raises(typer.BadParameter, match="no episodes in split 'val'"):
        faithful.main(unseen=[file], out=tmp_path / "out")
