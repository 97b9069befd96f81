"""Benchmarks that import each other run as their pages say, from any folder."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

FOLDER = Path(__file__).resolve().parents[2] / "benchmarks"


@pytest.mark.parametrize("name", ["stated_coverage", "verdict_power", "whatif_truth"])
def test_a_benchmark_starts_as_a_script(name: str, tmp_path: Path) -> None:
    clean = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
    said = subprocess.run(
        [sys.executable, FOLDER / f"{name}.py", "--help"],
        capture_output=True, text=True, cwd=tmp_path, env=clean,
    )  # fmt: skip
    assert said.returncode == 0, said.stderr
    assert "--quick" in said.stdout or "--only" in said.stdout
