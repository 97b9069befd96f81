"""Benchmarks that import each other run as their pages say, from any folder."""

from __future__ import annotations

import csv
import os
import subprocess
import sys
from pathlib import Path

import pytest

FOLDER = Path(__file__).resolve().parents[2] / "benchmarks"


@pytest.mark.parametrize("name", ["baselines", "stated_coverage", "verdict_power", "whatif_truth"])
def test_a_benchmark_starts_as_a_script(name: str, tmp_path: Path) -> None:
    clean = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
    said = subprocess.run(
        [sys.executable, FOLDER / f"{name}.py", "--help"],
        capture_output=True, text=True, cwd=tmp_path, env=clean,
    )  # fmt: skip
    assert said.returncode == 0, said.stderr
    assert "--quick" in said.stdout or "--only" in said.stdout


@pytest.mark.slow
def test_a_team_learns_and_is_scored(tmp_path: Path) -> None:
    command = [FOLDER / "baselines.py", "--quick", "--task", "agent", "--out", tmp_path]
    learners = ["--learner", "PPO", "--learner", "DQN"]
    subprocess.run([sys.executable, "-W", "ignore", *command, *learners], check=True, cwd=tmp_path)
    with (tmp_path / "teams.csv").open(newline="") as file:
        rows = {row["policy"]: row for row in csv.DictReader(file)}
    assert list(rows) == ["random", "PPO", "DQN", "demonstrations (synthetic)"]
    assert [row["score"] for row in rows.values()][::3] == ["0.00", "1.00"]
    assert rows["DQN"]["steps"] == "16384" and -1.0 < float(rows["DQN"]["return"]) < 1.0
