"""What a run remembers of the code, the machine and the time it took."""

from __future__ import annotations

import subprocess
from dataclasses import dataclass
from pathlib import Path

import pytest

from animarl_algos.report.provenance import duration, flattened
from animarl_algos.runs.machine import commit, machine, timed, wall_times


def git(folder: Path, *arguments: str) -> str:
    who = ["-c", "user.name=a", "-c", "user.email=a@b", "-c", "commit.gpgsign=false"]
    done = subprocess.run(
        ["git", "-C", str(folder), *who, *arguments], capture_output=True, text=True, check=True
    )
    return done.stdout.strip()


def test_the_commit_is_that_of_the_code_and_changes_are_told(tmp_path: Path) -> None:
    assert "no checkout" in commit(tmp_path)
    git(tmp_path, "init", "-q")
    assert "git did not tell" in commit(tmp_path)  # nothing was ever committed
    (tmp_path / "code.py").write_text("1\n")
    git(tmp_path, "add", "code.py")
    git(tmp_path, "commit", "-q", "-m", "Begin")
    head = git(tmp_path, "rev-parse", "HEAD")
    assert commit(tmp_path) == head
    (tmp_path / "code.py").write_text("2\n")
    assert commit(tmp_path) == f"{head} with changes"


def test_the_machine_is_told_in_texts() -> None:
    told = machine()
    assert set(told) == {"commit", "system", "processor", "accelerator"}
    assert all(text and "None" not in text for text in told.values())
    assert "logical cores" in told["processor"]


@dataclass
class Run:
    path: Path


def test_times_of_a_stage_add_up(tmp_path: Path) -> None:
    assert wall_times(tmp_path) == {}
    with timed(tmp_path, "training"):
        pass
    once = wall_times(tmp_path)["training"]
    with timed(tmp_path, "training"):
        pass
    assert wall_times(tmp_path)["training"] >= once >= 0.0


def test_what_fails_is_not_timed(tmp_path: Path) -> None:
    with pytest.raises(ZeroDivisionError), timed(tmp_path, "training"):
        _ = 1 / 0
    assert wall_times(tmp_path) == {}


def test_times_and_settings_are_told_in_words() -> None:
    assert [duration(s) for s in (3.21, 90.0, 600.0, 9000.0)] == [
        "3.2 s", "90.0 s", "10.0 min", "2.5 h",
    ]  # fmt: skip
    settings = {"a": None, "b": {"c": True, "d": []}, "e": [1, None], "f": {}, "g": ""}
    assert flattened(settings) == [
        ("a", "not set"), ("b.c", "yes"), ("b.d", "not set"), ("e", "1, not set"),
        ("f", "not set"), ("g", "not set"),
    ]  # fmt: skip
