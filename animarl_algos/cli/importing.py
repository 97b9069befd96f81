"""``animarl import``: anyone's tracks in, demonstrations out."""

import inspect
import json
from collections.abc import Mapping
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, get_args, get_origin, get_type_hints

import numpy as np
import typer
from rich.console import Console
from rich.progress import Progress

from animarl_algos.cli.describing import (
    describe_recipe,
    report,
    report_import,
    show_rows,
    wide_console,
)
from animarl_algos.cli.shared import CONTEXT, option, parse_settings, with_options
from animarl_envs.demos.splits import Splitting
from animarl_envs.errors import InputError, require
from animarl_envs.importing.cleaning import Cleaning, Scaling
from animarl_envs.importing.cutting import Cutting
from animarl_envs.importing.import_recipe import ImportRecipe
from animarl_envs.importing.readers import (
    Reader,
    default_recipe,
    files_in,
    find_reader,
    follow,
    load_readers,
    read,
)
from animarl_envs.importing.sessions import AUTO

NOBODY = "none"  # is the target
OF_FINISHED = {
    "files",
    "readers",
    "source",
    "out",
    "dry_run",
    "condition",
    "option",
}  # what they go with
FILES: list[inspect.Parameter] = [
    CONTEXT,
    option("files", list[Path], ..., typer.Argument(help="Files of one kind, or their folder.")),
    option(
        "source",
        str | None,
        None,
        "Reader; see 'animarl data sources'. Default: by a look.",
    ),
    option(
        "readers",
        Path | None,
        None,
        "A .py file of readers of your own; it is run.",
    ),
    option("out", Path | None, None, "Demonstrations to write (.npz)."),
    option("recipe", Path | None, None, "Repeat this saved recipe (.yaml)."),
    option("dry_run", bool, False, "Only say what is understood."),
]


def _recipe_options() -> dict[str, tuple[str, str, inspect.Parameter]]:
    """Return, by name, the options that set an entry of the recipe: part, entry, option."""
    options = {}
    for model in (ImportRecipe, Cleaning, Scaling, Cutting, Splitting):
        part, hints = "" if model is ImportRecipe else model.__name__.lower(), get_type_hints(model)
        for each in fields(model):
            if not (name := each.metadata.get("option")):
                continue
            kinds = {hints[each.name], *get_args(hints[each.name])}
            kind: Any = next((one for one in (float, bool, int) if one in kinds), str)
            kind = list[str] if get_origin(hints[each.name]) in (Mapping, tuple) else kind
            flags = ["/".join(f"--{one.replace('_', '-')}" for one in name.split("/"))]
            info = typer.Option(*flags if kind is bool else [], help=each.metadata["help"])
            name = name.partition("/")[0]
            options[name] = (part, each.name, option(name, kind | None, None, info))
    return options


RECIPE = _recipe_options()


@with_options([*FILES, *(parameter for _, _, parameter in RECIPE.values())])
def import_command(context: typer.Context, files: list[Path], **given: Any) -> None:
    """Turn tracker files into demonstrations; the recipe is saved beside them.

    Examples:

      animarl import clip.slp --source sleap --fps 25 --target female --dry-run

      animarl import pairs.csv --fps 30 --target auto --decision-rate 10 --out demos.npz

      animarl import flock.csv --fps 25 --pursuer dog --out flock.npz

      animarl import *.csv --fps 30 --metadata sessions.csv --px-per-cm 14.2 --out demos.npz

      animarl import more.csv --recipe demos.recipe.yaml --out more.npz
    """
    out, dry_run = given["out"], given["dry_run"]
    require(out is None or out.suffix == ".npz", f"{out}: demonstrations end in .npz: rename it")
    if given["readers"] is not None:
        load_readers(given["readers"])
    files = files_in(files)
    reader = find_reader(files[0], given["source"])
    require(out or dry_run, "nothing would be written: name --out, or ask for a --dry-run")
    if reader.finished:
        for more in files[1:]:
            raise InputError(f"{more}: files of source {reader.name} are imported one by one")
        _refuse_beside_finished(files[0], context)
        finished = read(files[0], reader.name, **parse_settings(given["option"], "--option"))
        if (condition := given["condition"]) is not None:
            finished = replace(finished, condition=np.full(len(finished), condition, dtype=np.int8))
        report(finished, None if dry_run else out)
        return
    plan = _plan(given, reader)
    with Progress(transient=True, console=Console(stderr=True)) as bar:
        task = bar.add_task(f"Reading {len(files)} file(s)", total=1.0)

        def advance(share: float) -> None:
            doing = "Cleaning and cutting" if share >= 1 else f"Reading {len(files)} file(s)"
            bar.update(task, completed=share, description=doing)

        demos = follow(plan, files, advance)
    if dry_run:
        show_rows("What is understood", describe_recipe(plan, reader.name, files))
    report_import(demos, None if dry_run else out, plan)
    if dry_run:
        wide_console().print("Dry run: nothing was written.")


def _refuse_beside_finished(file: Path, context: typer.Context) -> None:
    """Refuse options that say how episodes are made, of a file that holds them made."""
    idle = [
        (own.secondary_opts if context.params[own.name] is False else own.opts)[0]
        for own in context.command.params
        if own.name not in OF_FINISHED and context.params.get(own.name or "") not in (None, [], ())
    ]
    if idle:
        raise InputError(
            f"{file}: it holds finished demonstrations: leave out what has no effect on them "
            f"({', '.join(idle)}), or import the tracks anew"
        )


def _plan(given: dict[str, Any], reader: Reader) -> ImportRecipe:
    """Return the saved recipe or the reader's, with the given options over it."""
    recipe, target = given["recipe"], given["target"]
    base = ImportRecipe.load(recipe) if recipe is not None else default_recipe(reader)
    unsaid = recipe is None and target is None and given["pursuer"] is None
    if unsaid and base.target is None and not base.searcher:
        given["target"] = AUTO
    record = json.loads(json.dumps(base.to_dict()))
    for name in ("option", "landmark"):
        given[name] = parse_settings(given[name], f"--{name}") or None
    given["cut"] = given["cut"] or (
        "approach" if given["farther_than"] else "events" if given["events"] else None
    )
    given["split_by"] = given["split_by"] or ("group" if given["split_pattern"] else None)
    for name in ("centre", "heading", "individuals"):
        if given[name] is not None:
            given[name] = [part.strip() for part in given[name].split(",")]
    if (centre := given["centre"]) is not None:
        try:
            x, y = map(float, centre)
        except ValueError:
            text = ",".join(centre)
            raise InputError(f"centre is {text!r}: give x and y, as 512,384") from None
        given["centre"] = [x, y]
    if given["individuals"] is not None:
        pairs = [entry.partition("=") for entry in given["individuals"]]
        given["individuals"] = [name for name, _, _ in pairs]
        record["rename"] = {name: new for name, _, new in pairs if new} or record["rename"]
    for name, (part, key, _) in RECIPE.items():
        if (value := given[name]) is not None:
            table = record[part] if part else record
            table[key] = table[key] | value if key == "options" else value
    if target == NOBODY:
        record["target"] = None
    return ImportRecipe.from_dict(record, "the options given")
