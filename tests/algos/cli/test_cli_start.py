"""The command line before any command: quick to start, complete in its lists, quiet in files."""

from __future__ import annotations

import ast
import io
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import typer
from stable_baselines3.common.callbacks import CallbackList

from animarl_algos.cli.main import COMMANDS, app
from animarl_algos.learner.callbacks import ProgressBar, with_progress_bar
from animarl_envs.compiling import FirstCompilation

LEARNING = {"torch", "stable_baselines3", "sb3_contrib", "sklearn", "matplotlib"}
HEAVY = {"numba", "scipy", "pandas"}
ANIMARL = "from animarl_algos.cli.main import main; main()"


@pytest.mark.parametrize("name", ["", *(name for name in COMMANDS if name != "benchmark")])
def test_start_of_a_help_imports_no_learners(name: str) -> None:
    program = (
        f"import sys\ntry:\n    {ANIMARL}\n"
        "finally:\n    print(sorted(m for m in sys.modules if '.' not in m), file=sys.stderr)"
    )
    asked = [sys.executable, "-c", program, *name.split(), "--help"]
    done = subprocess.run(asked, capture_output=True, text=True, check=True)
    loaded = set(ast.literal_eval(done.stderr))
    assert not loaded & (LEARNING if name else LEARNING | HEAVY)
    assert f"animarl {name}" in done.stdout
    for command, place in COMMANDS.items():
        assert name or (command in done.stdout and place.summary()[:20] in done.stdout)


@pytest.mark.parametrize("name", COMMANDS)
def test_start_of_a_command_is_as_listed(name: str) -> None:
    root: Any = typer.main.get_command(app)
    context = root.make_context("animarl", [name, "--help"])
    listed = root.get_command(context, name)
    found, command, rest = root.resolve_command(context, [name, "--help"])
    assert (found, rest) == (name, ["--help"])
    assert command.help.partition("\n")[0] == listed.help


@pytest.mark.parametrize(
    ("words", "said"), [("trian", "train"), ("report nowhere", "nowhere: it is not a run folder")]
)
def test_start_that_is_refused(words: str, said: str, tmp_path: Path) -> None:
    asked = [sys.executable, "-c", ANIMARL, *words.split()]
    done = subprocess.run(asked, capture_output=True, text=True, check=False, cwd=tmp_path)
    assert done.returncode == 2 and said in done.stderr


class Terminal(io.StringIO):
    """A stream that says whether it is a terminal."""

    def __init__(self, there: bool) -> None:
        super().__init__()
        self.there = there

    def isatty(self) -> bool:
        return self.there


@pytest.mark.parametrize("there", [True, False])
def test_progress_is_shown_on_a_terminal_only(there: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stderr", Terminal(there))
    shown = with_progress_bar(CallbackList([]))
    assert any(isinstance(callback, ProgressBar) for callback in shown) == there


@pytest.mark.parametrize("there", [True, False])
def test_a_first_compilation_says_so_once(there: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    stream = Terminal(there)
    monkeypatch.setattr(sys, "stderr", stream)
    listener = FirstCompilation()
    for module in ("scipy.special", "animarl_envs.worlds.base", "animarl_envs.dtw"):
        function = SimpleNamespace(py_func=SimpleNamespace(__module__=module))
        listener.on_start(SimpleNamespace(data={"dispatcher": function}))
    assert stream.getvalue().count("compiling kernels") == there
