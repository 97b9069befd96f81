"""The command line before any command: quick to start, complete in its lists, quiet in files."""

from __future__ import annotations

import ast
import io
import subprocess
import sys
from types import SimpleNamespace
from typing import Any

import pytest
import typer
from stable_baselines3.common.callbacks import CallbackList

from animarl_algos.cli.lazy import COMMANDS
from animarl_algos.cli.main import app
from animarl_algos.learner.callbacks import ProgressBar, with_progress_bar
from animarl_envs.compiling import FirstCompilation

HEAVY = {"torch", "stable_baselines3", "sb3_contrib", "numba", "scipy", "pandas", "matplotlib"}
ANIMARL = "from animarl_algos.cli.main import main; main()"


def test_start_of_the_help_imports_nothing_heavy() -> None:
    program = (
        "import sys\ntry:\n    from animarl_algos.cli.main import main; main()\n"
        "finally:\n    print(sorted(m for m in sys.modules if '.' not in m), file=sys.stderr)"
    )
    done = subprocess.run(
        [sys.executable, "-c", program, "--help"], capture_output=True, text=True, check=True
    )
    assert not HEAVY & set(ast.literal_eval(done.stderr))
    for name, place in COMMANDS.items():
        assert name in done.stdout and place.summary()[:20] in done.stdout


@pytest.mark.parametrize("name", [name for name in COMMANDS if name != "benchmark"])
def test_start_of_the_help_of_a_command_imports_no_learners(name: str) -> None:
    program = (
        "import sys\ntry:\n    from animarl_algos.cli.main import main; main()\n"
        "finally:\n    print(sorted(m for m in sys.modules if '.' not in m), file=sys.stderr)"
    )
    done = subprocess.run(
        [sys.executable, "-c", program, name, "--help"], capture_output=True, text=True, check=True
    )
    learning = {"torch", "stable_baselines3", "sb3_contrib", "sklearn", "matplotlib"}
    assert not learning & set(ast.literal_eval(done.stderr))


@pytest.mark.parametrize("name", COMMANDS)
def test_start_of_a_command_is_as_listed(name: str) -> None:
    root: Any = typer.main.get_command(app)
    context = root.make_context("animarl", [name, "--help"])
    listed = root.get_command(context, name)
    found, command, rest = root.resolve_command(context, [name, "--help"])
    assert (found, rest) == (name, ["--help"])
    assert command.help.partition("\n")[0] == listed.help


def test_start_of_an_unknown_command_is_refused() -> None:
    done = subprocess.run(
        [sys.executable, "-c", ANIMARL, "trian"], capture_output=True, text=True, check=False
    )
    assert done.returncode == 2 and "train" in done.stderr


def test_start_of_a_report_without_a_run_names_the_folder(tmp_path: Any) -> None:
    done = subprocess.run(
        [sys.executable, "-c", ANIMARL, "report", str(tmp_path / "nowhere")],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 2
    assert "nowhere: it is not a run folder" in done.stderr and "make one with" in done.stderr


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
