"""What commands show and write of demonstrations."""

from __future__ import annotations

from pathlib import Path

from rich.box import SIMPLE_HEAD
from rich.table import Table
from rich.text import Text

from animarl_algos.cli.describing import Row, demonstrations_at_a_glance
from animarl_algos.cli.screen import PlainConsole
from animarl_envs.checks import printable
from animarl_envs.demos import Demonstrations
from animarl_envs.importing.import_recipe import ImportRecipe


def report(demos: Demonstrations, out: Path | None, plan: ImportRecipe | None) -> None:
    """Show the demonstrations; write them, and the recipe that made them, if ``out`` is given."""
    show(demos)
    if out is None:
        return
    demos.save(out)
    console = wide_console()
    console.print(f"Wrote {out}", highlight=False, soft_wrap=True)
    if plan is not None:
        recipe_file = plan.save(out.with_suffix(".recipe.yaml"))
        console.print(f"Wrote {recipe_file}, which repeats it", highlight=False, soft_wrap=True)


def show(demos: Demonstrations) -> None:
    """Print what demonstrations hold."""
    show_rows(demos.name, demonstrations_at_a_glance(demos))


def show_rows(title: str, rows: list[Row]) -> None:
    """Print a table of names and words."""
    table = Table(
        title=Text(printable(title)), show_header=False, box=SIMPLE_HEAD, title_justify="left"
    )
    table.add_column(no_wrap=True)
    table.add_column(overflow="fold")
    for name, words in rows:
        table.add_row(name, Text(printable(str(words))))
    wide_console().print(table, highlight=False)


def wide_console() -> PlainConsole:
    return PlainConsole(least_width=100)
