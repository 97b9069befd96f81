"""Commands whose modules are imported when they are called: ``--help`` waits for none of them."""

from __future__ import annotations

import ast
from importlib import import_module
from importlib.resources import files
from typing import Any, NamedTuple

import typer
from typer.core import TyperCommand, TyperGroup

SETTINGS: dict[str, Any] = {
    "add_completion": False,
    "rich_markup_mode": "markdown",
    "pretty_exceptions_enable": False,
}


class Place(NamedTuple):
    """Where a command stands: a module of :mod:`animarl_algos.cli` and a function in it.

    With ``app`` the module has an application of several commands under that name, which the
    function introduces.
    """

    module: str
    function: str
    app: str = ""

    def summary(self) -> str:
        """What the function's docstring says first, read off the source."""
        source = files("animarl_algos.cli") / f"{self.module}.py"
        for node in ast.parse(source.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.FunctionDef) and node.name == self.function:
                return (ast.get_docstring(node) or "").partition("\n")[0]
        raise LookupError(f"{self.module} has no function {self.function}")

    def load(self, name: str) -> Any:
        """The command itself."""
        module = import_module(f"animarl_algos.cli.{self.module}")
        if self.app:
            return typer.main.get_command(getattr(module, self.app))
        alone = typer.Typer(**SETTINGS)
        alone.command(name)(getattr(module, self.function))
        return typer.main.get_command(alone)


COMMANDS = {
    "import": Place("importing", "import_command"),
    "data": Place("data", "data_commands", app="app"),
    "fit": Place("fit", "fit_command"),
    "run": Place("run", "run_command"),
    "train": Place("run", "train_command"),
    "evaluate": Place("evaluate", "evaluate_command"),
    "whatif": Place("whatif", "whatif_command"),
    "page": Place("whatif", "page_command"),
    "counterfactual": Place("evaluate", "counterfactual_command"),
    "inspect": Place("evaluate", "inspect_command"),
    "report": Place("run", "report_command"),
    "export": Place("evaluate", "export_command"),
    "watch": Place("watch", "watch_command"),
    "benchmark": Place("benchmark", "benchmark_command", app="app"),
}
"""By name, in the order of the help."""


class LazyCommands(TyperGroup):
    """Lists :data:`COMMANDS` with their summaries, and loads the one that is called."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(**settings)
        for name, place in COMMANDS.items():
            self.commands[name] = TyperCommand(name=name, help=place.summary())

    def resolve_command(self, ctx: Any, args: list[str]) -> tuple[Any, Any, list[str]]:
        """The command that ``args`` begin with, loaded."""
        name, listed, rest = super().resolve_command(ctx, args)
        return name, None if listed is None else COMMANDS[str(name)].load(str(name)), rest
