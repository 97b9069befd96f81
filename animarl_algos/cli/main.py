"""The command line, ``animarl``. Bad input is one sentence and exit code 2, never a traceback.

Modules of commands are imported when these are called: ``--help`` waits for none of them.
"""

import ast
import signal
import sys
import warnings
from importlib import import_module
from importlib.resources import files
from time import perf_counter
from typing import Any, NamedTuple

from animarl_envs.errors import InputError, MissingExtraError, is_of_an_extra, printable
from animarl_envs.files import unreadable_or_unwritable

try:
    import typer
    from typer.core import TyperCommand, TyperGroup
except ModuleNotFoundError:
    print(f"animarl: {MissingExtraError('the command line', 'cli')}", file=sys.stderr)
    sys.exit(2)

SETTINGS: dict[str, Any] = {
    "add_completion": False,
    "rich_markup_mode": "markdown",
    "pretty_exceptions_enable": False,
}
TERMINATED = 128 + signal.SIGTERM  # as a shell gives it
INTERRUPTED = (130, TERMINATED)  # Ctrl-C, which typer gives without a word, and SIGTERM


class Place(NamedTuple):
    """Where a command stands: a module of :mod:`animarl_algos.cli` and a function in it.

    With ``app`` the module has an application of several commands under that name, which the
    function introduces.
    """

    module: str
    function: str
    app: str = ""

    def summary(self) -> str:
        """Return the first line of the function's docstring, read from the source."""
        source = files("animarl_algos.cli") / f"{self.module}.py"
        for node in ast.parse(source.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.FunctionDef) and node.name == self.function:
                return (ast.get_docstring(node) or "").partition("\n")[0]
        raise LookupError(f"{self.module} has no function {self.function}")

    def load(self, name: str) -> Any:
        """Return the command itself."""
        module = import_module(f"animarl_algos.cli.{self.module}")
        if self.app:
            return typer.main.get_command(getattr(module, self.app))
        alone = typer.Typer(**SETTINGS)
        alone.command(name)(getattr(module, self.function))
        return typer.main.get_command(alone)


def compile_command() -> None:
    """Compile the kernels of every species for this machine, so that no first step waits for it.

    `make` does it as it installs a checkout. A wheel of your platform brings kernels for many
    processors; these here are of your own.

    Example:

      animarl compile
    """
    import numpy as np

    from animarl_algos.cli.shared import PlainConsole
    from animarl_algos.data.vec_env import SlotVecEnv
    from animarl_envs.compiling import KernelCache
    from animarl_envs.species import COMPACT, SPECIES
    from animarl_envs.worlds import demonstration_observations

    KernelCache.takes_installed = False
    for name in SPECIES:
        before = perf_counter()
        for observation in (COMPACT, "full"):  # "paper" has the kernels of "full"
            slots = SlotVecEnv(name, 1, observation=observation)
            slots.reset()
            slots.step(np.zeros(slots.num_envs, dtype=np.int64))
        if slots.demos is not None:  # recorded headings ask for a kernel more
            demonstration_observations(slots.scenario.species, slots.demos)
        PlainConsole().print(f"{name}: compiled in {perf_counter() - before:.1f} s")


COMMANDS = {
    "import": Place("importing", "import_command"),
    "data": Place("data", "data_commands", app="app"),
    "fit": Place("fit", "fit_command"),
    "run": Place("run", "run_command"),
    "train": Place("run", "train_command"),
    "evaluate": Place("evaluate", "evaluate_command"),
    "whatif": Place("evaluate", "whatif_command"),
    "page": Place("evaluate", "page_command"),
    "report": Place("run", "report_command"),
    "export": Place("evaluate", "export_command"),
    "watch": Place("watch", "watch_command"),
    "simulate": Place("simulate", "simulate_command"),
    "figure": Place("figure", "figure_command"),
    "open": Place("opening", "open_command"),
    "compile": Place("main", "compile_command"),
    "benchmark": Place("benchmark", "benchmark_command", app="app"),
    "paper": Place("paper", "paper_command"),
}
"""By name, in the order of the help."""


class LazyCommands(TyperGroup):
    """Lists :data:`COMMANDS` with their summaries, and loads the one that is called."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(**settings)
        for name, place in COMMANDS.items():
            self.commands[name] = TyperCommand(name=name, help=place.summary())

    def resolve_command(self, ctx: Any, args: list[str]) -> tuple[Any, Any, list[str]]:
        """Return the command that ``args`` begin with, loaded."""
        name, listed, rest = super().resolve_command(ctx, args)
        return name, None if listed is None else COMMANDS[str(name)].load(str(name)), rest


app = typer.Typer(
    name="animarl",
    cls=LazyCommands,
    epilog="First steps: animarl run packaged --steps 20000 --out runs/first, then "
    "animarl watch AnimaRL/Agent-v0 --model runs/first. COMMAND --help gives examples.",
    no_args_is_help=True,
    **SETTINGS | {"add_completion": True},
)


@app.callback()
def animarl() -> None:
    """Build simulators of animals from their tracks, and ask them what if."""


def say_warning(message: Warning | str, *_: Any, **__: Any) -> None:
    """Print a warning as one line, without the place in the source that Python would add."""
    sentence = printable(" ".join(str(message).split()))
    print(f"Warning: {sentence}", file=sys.stderr)


def main() -> None:
    """Entry point of the ``animarl`` script."""
    before = signal.signal(signal.SIGTERM, lambda *_: sys.exit(TERMINATED))
    try:
        with warnings.catch_warnings():
            warnings.showwarning = say_warning
            app()
    except (InputError, MissingExtraError) as error:
        sys.exit(_refuse(str(error)))
    except ModuleNotFoundError as error:
        if not is_of_an_extra(error):
            raise
        sys.exit(_refuse(str(MissingExtraError("this command", "algos"))))
    except OSError as error:
        sentence = unreadable_or_unwritable(error)
        sys.exit(_refuse(f"{sentence}; finished stages and checkpoints are kept"))
    except SystemExit as ended:
        if ended.code in INTERRUPTED:
            print(
                "\nanimarl: interrupted; given again, the same command takes up a run where its "
                "last checkpoint or finished stage left it",
                file=sys.stderr,
            )
        raise
    finally:
        signal.signal(signal.SIGTERM, before)


def _refuse(sentence: str) -> int:
    print(f"animarl: {printable(sentence)}", file=sys.stderr)
    return 2


if __name__ == "__main__":
    main()
