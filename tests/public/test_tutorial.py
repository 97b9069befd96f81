"""docs/tutorial.md: its commands and its program run, one after the other, as they stand there."""

import shlex
import sys
from pathlib import Path

import pytest
from pages import blocks, run_programs

from animarl_algos.cli.main import main

PAGE = "docs/tutorial.md"


def commands() -> list[list[str]]:
    return [shlex.split(line) for block in blocks(PAGE, "") for line in block.splitlines()]


def test_every_command_is_shown() -> None:
    names = [words[1] for words in commands()]
    assert names == ["data", "run", "run", "run", "run", "evaluate", "counterfactual", "inspect"]
    assert all(words[0] == "animarl" for words in commands())


@pytest.mark.slow
def test_the_tutorial_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for words in commands():
        monkeypatch.setattr(sys, "argv", words)
        with pytest.raises(SystemExit) as ended:
            main()
        assert ended.value.code in (0, None), words
        if "--out" in words:
            assert (Path(words[words.index("--out") + 1]) / "report.html").exists()
    assert len(run_programs(PAGE)["table"]) > 0
