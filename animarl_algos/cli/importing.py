"""``animarl import``: anyone's tracks in, demonstrations out."""

from __future__ import annotations

import inspect
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import typer
import yaml
from rich.console import Console
from rich.progress import Progress

from animarl_algos.cli.describing import report, show_rows, understood, wide_console
from animarl_algos.cli.hints import found_by_itself, hints
from animarl_algos.cli.options import CONTEXT, asks_for, option
from animarl_envs.errors import InputError
from animarl_envs.importing.import_recipe import ImportRecipe
from animarl_envs.importing.readers import Reader, default_recipe, find_reader, follow, read
from animarl_envs.importing.roles import AUTO

SIGNS = {",", "."}  # a decimal sign, which is no value of YAML
NOBODY = "none"  # is the target
OF_FINISHED = {"files", "source", "out", "dry_run", "condition", "option"}  # what they go with


FILES: list[inspect.Parameter] = [
    CONTEXT,
    option("files", list[Path], ..., typer.Argument(help="One file or more of the same kind.")),
    option("source", str | None, None, typer.Option(
        help="Reader; see 'animarl data sources'. Default: by a look.",
    )),
    option("out", Path | None, None, typer.Option(help="Demonstrations to write (.npz).")),
    option("recipe", Path | None, None, typer.Option(help="Repeat this saved recipe (.yaml).")),
    option("dry_run", bool, False, typer.Option(help="Only say what is understood.")),
]  # fmt: skip
RECIPE: tuple[tuple[str, str, Any, str], ...] = (
    ("fps", "frame_rate", float, "Frames a second of the recording."),
    ("decision_rate", "decision_rate", float, "Samples a second of the demonstrations."),
    ("individuals", "individuals", str, "Which, in order: a,b,c; rename by a=male,b=female."),
    ("merge_individuals", "merge_individuals", bool, "One file per animal: put together."),
    ("target", "target", str, "The pursued individual; auto (default): who is approached; none."),
    ("pursuer", "pursuer", str, "The only pursuer: all others are its targets."),
    ("metadata", "metadata", Path, "Table of recordings: recording, and condition, split, target, "
     "px_per_cm, or a row for each individual and role."),
    ("name_pattern", "name_pattern", str, r"The same by groups in names of recordings: "
     r"(?P\<condition>sham|drug) or (?P\<split>train|test)."),
    ("keypoint", "cleaning.keypoint", str, "Body part, or centroid."),
    ("heading", "cleaning.heading", str,
     "Bodies point from one keypoint to another: thorax,head."),
    ("drop_jumps", "cleaning.drop_jumps", bool, "Make gaps of jumps, or only flag them."),
    ("min_confidence", "cleaning.min_confidence", float,
     "Below it: not tracked. Default: 0.6 of likelihoods; 0: all are used."),
    ("max_gap", "cleaning.max_gap", float, "Fill gaps up to so many seconds."),
    ("smoothing", "cleaning.smoothing_cutoff", float,
     "Low-pass cutoff in Hz (Butterworth, zero phase); 0: none."),
    ("arena", "scaling.shape", str, "square, disc or open."),
    ("arena_width", "scaling.width", float,
     "Side or diameter in the file's unit; default: extent."),
    ("centre", "scaling.centre", str, "Of the arena, x,y in the file's unit; default: of extent."),
    ("px_per_cm", "scaling.px_per_cm", float,
     "The file's units to 1 cm; all lengths then are in cm."),
    ("scale_each", "scaling.each", bool, "Each recording by its own extent, not all by one."),
    ("boundary", "scaling.boundary", float, "Beyond it an individual is out, in arena units."),
    ("units", "scaling.units_per_arena_unit", float,
     "Open arena: the file's units per arena unit; default: extent."),
    ("cut", "cutting.mode", str, "whole, approach or events."),
    ("farther_than", "cutting.farther_than", float, "An approach starts here, in arena units."),
    ("closer_than", "cutting.closer_than", float, "An approach ends here, in arena units."),
    ("start", "cutting.start", str,
     "An approach starts at the separation, or at the approach: the last time."),
    ("contact", "cutting.contact", float,
     "whole, events: ends within this, in arena units; 0: none."),
    ("piece", "cutting.piece", float, "whole: cut into pieces, s."),
    ("longest", "cutting.longest", float, "Leave longer episodes out, s."),
    ("keep_last", "cutting.keep_last", float, "Keep the last seconds."),
    ("shortest", "cutting.shortest", float, "Leave shorter ones out, s."),
    ("events", "cutting.events", Path, "Table: recording, start, end [s]."),
    ("species", "species", str, "Species they belong to."),
    ("condition", "condition", int, "0 or 1, of all episodes."),
    ("licence", "licence", str, "Of the recordings."),
    ("synthetic", "synthetic", bool, "No animal was recorded: say so everywhere."),
    ("split_by", "splitting.by", str, "auto, recording, episode or group."),
    ("split_pattern", "splitting.pattern", str, "group: regular expression with a (group)."),
    ("split_seed", "splitting.seed", int, "Of the splits."),
    ("option", "options", list[str], "Of the reader: name=value, value as YAML."),
)  # fmt: skip
"""Options that set an entry of the recipe: name, entry, kind, help."""


def _recipe_option(name: str, kind: Any, prose: str) -> inspect.Parameter:
    flag = f"--{name.replace('_', '-')}"
    flags = {"drop_jumps": ["--drop-jumps/--keep-jumps"]}.get(name, [flag] if kind is bool else [])
    return option(name, kind | None, None, typer.Option(*flags, help=prose))


@asks_for([*FILES, *(_recipe_option(name, kind, prose) for name, _, kind, prose in RECIPE)])
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
    if out is not None and out.suffix != ".npz":
        raise InputError(f"{out}: demonstrations end in .npz: rename it")
    if out is None and not dry_run:
        raise InputError("nothing would be written: name --out, or ask for a --dry-run")
    reader = find_reader(files[0], given["source"])
    if reader.read_demonstrations is not None:
        if len(files) > 1:
            raise InputError(f"{files[1]}: files of source {reader.name} are imported one by one")
        _refuse_beside_finished(files[0], context)
        finished = read(files[0], reader.name, **_options(given["option"]))
        if (condition := given["condition"]) is not None:
            finished = replace(finished, condition=np.full(len(finished), condition, dtype=np.int8))
        report(finished, None if dry_run else out, None)
        return
    plan = _plan(given, reader)
    with Progress(transient=True, console=Console(stderr=True)) as bar:
        task = bar.add_task(f"Reading {len(files)} file(s)", total=1.0)

        def told(share: float) -> None:
            doing = "Cleaning and cutting" if share >= 1 else f"Reading {len(files)} file(s)"
            bar.update(task, completed=share, description=doing)

        demos = follow(plan, files, told)
    if dry_run:
        show_rows("What is understood", understood(plan, reader.name, files))
    report(demos, None if dry_run else out, plan)
    console = wide_console()
    for hint in [*found_by_itself(demos), *hints(demos)]:
        console.print(f"hint: {hint}", highlight=False, soft_wrap=True)
    if dry_run:
        console.print("Dry run: nothing was written.")


def _refuse_beside_finished(file: Path, context: typer.Context) -> None:
    """Refuse options that say how episodes are made, of a file that holds them made."""
    idle = [
        (own.secondary_opts if context.params[own.name] is False else own.opts)[0]
        for own in context.command.params
        if own.name not in OF_FINISHED and context.params.get(own.name or "") is not None
    ]
    if idle:
        raise InputError(
            f"{file}: it holds finished demonstrations: leave out what has no effect on them "
            f"({', '.join(idle)}), or import the tracks anew"
        )


def _plan(given: dict[str, Any], reader: Reader) -> ImportRecipe:
    """The recipe: the saved one or the reader's, with what was given over it."""
    recipe, target = given["recipe"], given["target"]
    base = ImportRecipe.load(recipe) if recipe is not None else default_recipe(reader)
    unsaid = recipe is None and target is None and given["pursuer"] is None
    if unsaid and base.target is None and not base.searcher:
        given["target"] = AUTO
    given["option"] = _options(given["option"]) or None
    given["centre"] = _centre(given["centre"])
    given["cut"] = given["cut"] or (
        "approach" if given["farther_than"] else "events" if given["events"] else None
    )
    given["split_by"] = given["split_by"] or ("group" if given["split_pattern"] else None)
    if given["heading"] is not None:
        given["heading"] = [part.strip() for part in given["heading"].split(",")]
    record = json.loads(json.dumps(base.to_dict()))
    if given["individuals"] is not None:
        pairs = [entry.strip().partition("=") for entry in given["individuals"].split(",")]
        given["individuals"] = [name for name, _, _ in pairs]
        record["rename"] = {name: new for name, _, new in pairs if new} or record["rename"]
    for name, entry, _, _ in RECIPE:
        if (value := given[name]) is not None:
            *within, key = entry.split(".")
            table = record[within[0]] if within else record
            value = str(value) if isinstance(value, Path) else value
            table[key] = table[key] | value if key == "options" else value
    if target == NOBODY:
        record["target"] = None
    return ImportRecipe.from_dict(record, "the options given")


def _centre(given: str | None) -> list[float] | None:
    if given is None:
        return None
    try:
        x, y = (float(part) for part in given.split(","))
    except ValueError:
        raise InputError(f"centre is {given!r}: give x and y, as 512,384") from None
    return [x, y]


def _options(given: list[str] | None) -> dict[str, Any]:
    found = {}
    for entry in given or []:
        name, equals, value = entry.partition("=")
        if not equals:
            raise InputError(f"option {entry!r} has no '=': write name=value")
        if value.strip() in SIGNS:
            found[name.strip()] = value.strip()
            continue
        try:
            found[name.strip()] = yaml.safe_load(value)
        except yaml.YAMLError:
            raise InputError(f"option {entry!r} has a value that is no YAML: quote it") from None
    return found
