"""Two processes in one run folder: the second says so, and a dead one holds nothing."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from animarl_algos.runs.run import Run
from animarl_algos.runs.run_lock import locked, run_lock
from animarl_envs.errors import InputError

HOLD = """
import sys, time
from pathlib import Path
from animarl_algos.runs.run_lock import run_lock
with run_lock(Path(sys.argv[1])):
    print("held", flush=True)
    time.sleep(600)
"""


def test_a_second_process_is_told_and_a_killed_one_lets_go(tmp_path: Path) -> None:
    command = [sys.executable, "-c", HOLD, str(tmp_path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as first:
        assert first.stdout is not None and first.stdout.readline() == "held\n"
        with pytest.raises(InputError, match="another process is at work"), run_lock(tmp_path):
            pass
        first.kill()
    with run_lock(tmp_path):
        pass


def test_stages_of_one_process_may_call_each_other(tmp_path: Path) -> None:
    @locked
    def inner(run: Run) -> int:
        return 1

    @locked
    def outer(run: Run) -> int:
        return inner(run) + 1

    assert outer(Run(tmp_path)) == outer(Run(tmp_path / "nowhere")) == 2
    assert not (tmp_path / "nowhere").exists()
