"""The truth beside an answer: planted shifts, teams, recordings of the other condition, a page."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from commands import animarl
from refusals import refuses

from animarl_algos import load_run
from animarl_algos.evaluation import Rollouts
from animarl_algos.evaluation.statistics import Interval
from animarl_algos.runs.run import Run
from animarl_algos.whatif.answer import ask
from animarl_algos.whatif.answer_page import answer_page, words
from animarl_algos.whatif.changes import ChangedWorld
from animarl_algos.whatif.truth import TeamTruth, find_truth, mean_by_start, subtract
from animarl_envs.species.base import Reading


@pytest.fixture(scope="module")
def chase() -> Run:
    return load_run("agent")


class Planted:
    """Recordings that are half as large in the changed world."""

    description = "The true shift was planted."

    def __init__(self, run: Run, paired: bool) -> None:
        test = run.demos.select(split="test")
        self.paired, self.recorded = paired, Rollouts.from_demonstrations(test)

    def check(self, scenario: ChangedWorld) -> None: ...

    def roll_out(self, scenario: ChangedWorld, reading: Reading) -> tuple[Rollouts, Rollouts]:
        return self.recorded, replace(self.recorded, positions=self.recorded.positions / 2)


def test_a_planted_truth_stands_beside_the_shift_and_the_miss_is_their_difference(
    chase: Run,
) -> None:
    rows = {}
    for paired in (True, False):
        found = ask([chase], ["contact=x1.5"], repetitions=2, truth=Planted(chase, paired))
        assert "The true shift was planted." in words(found)
        rows[paired] = row = found.table.set_index("quantity").loc["mean distance"]
        assert row["true"] == pytest.approx(-row["recorded"] / 2)
        assert row["miss"] == pytest.approx(row["shift"] - row["true"])
        assert row["true_low"] < row["true"] < row["true_high"]
        assert row["miss_low"] < row["miss"] < row["miss_high"]
    # Starts of the truth are those of the answer only where it is paired.
    alone, paired_row = rows[False], rows[True]
    assert alone["true_high"] - alone["true_low"] > paired_row["true_high"] - paired_row["true_low"]
    same = found.table.set_index("quantity").loc["duration"]
    assert same["true"] == 0.0 and same["true_low"] < 0.0 < same["true_high"]


def test_independent_intervals_are_subtracted_end_by_end() -> None:
    difference = subtract(Interval(5.0, 2.0, 6.0), Interval(1.0, 0.0, 5.0))
    assert (difference.estimate, difference.low, difference.high) == pytest.approx(
        (4.0, 4.0 - 5.0, 4.0 + np.sqrt(2.0))
    )


def test_teams_act_in_the_changed_world_and_under_the_other_condition(chase: Run) -> None:
    truth = find_truth("teams", chase, 2)
    assert isinstance(truth, TeamTruth)
    texts = ["condition=shared", "prey.thrust=x1.5", "contact=x1"]
    cue, faster, same = ask([chase], texts, repetitions=1, separately=True, truth=truth).answers
    # Teams in the same world with the same random numbers: not one number differs.
    assert (same.table[["true", "true_low", "true_high"]] == 0).all(axis=None)
    assert faster.table.set_index("quantity").loc["duration", "true_low"] > 0
    assert cue.true is not None
    usual = truth.roll_out(ChangedWorld(()), "habit")[0]
    seconds = [
        mean_by_start(made, (made.lengths - 1) * made.dt, len(truth.test))
        for made in (cue.true, usual)
    ]
    own = truth.test.condition == 0
    expected = (seconds[0] - seconds[1])[own].mean()
    row = cue.table.set_index("quantity").loc["duration"]
    assert row["true"] == pytest.approx(expected) and expected != 0
    assert (seconds[0] == seconds[1])[~own].all()  # these were shared already


def test_recordings_of_the_other_condition_are_a_group_of_their_own(chase: Run) -> None:
    truth = find_truth("recordings", chase, 1)
    (answer,) = ask([chase], ["condition=shared"], repetitions=1, truth=truth).answers
    test = chase.demos.select(split="test")
    seconds = (test.lengths - 1) * test.dt
    row = answer.table.set_index("quantity").loc["duration"]
    groups = [seconds[test.condition == number].mean() for number in (0, 1)]
    assert row["true"] == pytest.approx(groups[1] - groups[0])
    page = answer_page(ask([chase], ["condition=shared"], repetitions=1, truth=truth))
    assert page.player is not None and len(page.player.data["views"]) == 2  # nothing is paired


@pytest.mark.parametrize(
    ("source", "changes", "message"),
    [
        ("recordings", ["arena=x2"], "no recordings show arena=x2"),
        ("recordings", ["condition=shared", "arena=x2"], "ask for condition=NAME alone"),
        ("teams", ["prey.speed=+20%"], "change these, or leave --truth out"),
        ("teams", ["remove=predator_0"], "change these, or leave --truth out"),
    ],
)
def test_a_change_without_a_truth_is_refused(
    chase: Run, source: str, changes: list[str], message: str
) -> None:
    refuses(message, ask, [chase], changes, truth=find_truth(source, chase, 1))


def test_a_truth_that_is_not_known_is_refused(chase: Run, tmp_path: Path) -> None:
    refuses("not known which teams made these recordings", find_truth, "teams", load_run("fly"), 1)
    refuses("by which agents it was made", find_truth, str(tmp_path), chase, 1)


def test_the_command_shows_the_truth_twice_the_same(tmp_path: Path) -> None:
    arguments = ("whatif", "agent", "--change", "condition=shared", "--truth", "teams")
    for out in ("first", "second"):
        text = animarl(*arguments, "--repetitions", "1", "--out", tmp_path / out)
        assert "True shift" in text
    table = pd.read_csv(tmp_path / "first" / "whatif.csv")
    assert (table["true_low"] <= table["true"]).all() and table["miss"].notna().all()
    page = (tmp_path / "first" / "report.html").read_bytes()
    assert b"the team that made the recordings" in page
    again = (tmp_path / "second" / "report.html").read_bytes()
    assert page.replace(b"second", b"first") == again.replace(b"second", b"first")
