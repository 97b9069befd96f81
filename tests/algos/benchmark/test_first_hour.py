"""The first hour: the table of a lab, two commands without options, a simulator to be believed."""

from __future__ import annotations

from pathlib import Path

import pytest
from typer.testing import CliRunner

from animarl_algos.cli.main import app
from animarl_algos.evaluation.verdict import Verdict

TABLE = Path(__file__).parents[3] / "examples" / "data" / "lab_table.csv"


@pytest.mark.slow
def test_a_table_of_a_lab_becomes_a_simulator_within_a_quarter(tmp_path: Path) -> None:
    demos, run = tmp_path / "lab.npz", tmp_path / "lab"
    for words in (("import", TABLE, "--out", demos), ("run", demos, "--out", run)):
        ran = CliRunner().invoke(app, [str(word) for word in words], catch_exceptions=False)
        assert ran.exit_code == 0, ran.output
    assert (run / "report.html").exists()
    found = Verdict.load(run / "evaluation")
    for measure in ("median_speed", "duration", "reached"):
        row = found.row(measure)
        assert row["simulated"] == pytest.approx(row["recorded"], rel=0.25)
