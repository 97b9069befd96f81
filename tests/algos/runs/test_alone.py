"""Two processes in one run folder: the second says so, and a dead one holds nothing."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from animarl_algos.runs.alone import alone, holding
from animarl_algos.runs.run_folder import RunFolder
from animarl_envs.errors import InputError

HOLD = """
import sys, time
from pathlib import Path
from animarl_algos.runs.alone import alone
with alone(Path(sys.argv[1])):
    print("held", flush=True)
    time.sleep(600)
"""


def test_a_second_process_is_told_and_a_killed_one_lets_go(tmp_path: Path) -> None:
    command = [sys.executable, "-c", HOLD, str(tmp_path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as first:
        assert first.stdout is not None and first.stdout.readline() == "held\n"
        with pytest.raises(InputError, match="another process is at work"), alone(tmp_path):
            pass
        first.kill()
    with alone(tmp_path):
        pass


def test_stages_of_one_process_may_call_each_other(tmp_path: Path) -> None:
    @holding
    def inner(run: RunFolder) -> int:
        return 1

    @holding
    def outer(run: RunFolder) -> int:
        return inner(run) + 1

    assert outer(RunFolder(tmp_path)) == outer(RunFolder(tmp_path / "nowhere")) == 2
    assert not (tmp_path / "nowhere").exists()
