"""``animarl import``: anyone's tracks in, demonstrations out."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
import yaml
from rich.console import Console
from rich.progress import Progress

from animarl_algos.cli.describing import understood
from animarl_algos.cli.hints import found_by_itself, hints
from animarl_algos.cli.showing import report, show_rows, wide_console
from animarl_envs.errors import InputError
from animarl_envs.importing.import_recipe import ImportRecipe
from animarl_envs.importing.readers import default_recipe, find_reader, follow, read
from animarl_envs.importing.roles import AUTO

SIGNS = {",", "."}  # a decimal sign, which is no value of YAML
NOBODY = "none"  # is the target
OF_FINISHED = {"files", "source", "out", "dry_run", "condition", "option"}  # what they go with


def import_command(
    context: typer.Context,
    files: Annotated[list[Path], typer.Argument(help="One file or more of the same kind.")],
    source: Annotated[
        str | None, typer.Option(help="Reader; see 'animarl data sources'. Default: by a look.")
    ] = None,
    out: Annotated[Path | None, typer.Option(help="Demonstrations to write (.npz).")] = None,
    recipe: Annotated[Path | None, typer.Option(help="Repeat this saved recipe (.yaml).")] = None,
    dry_run: Annotated[bool, typer.Option(help="Only say what is understood.")] = False,
    fps: Annotated[float | None, typer.Option(help="Frames a second of the recording.")] = None,
    decision_rate: Annotated[
        float | None, typer.Option(help="Samples a second of the demonstrations.")
    ] = None,
    individuals: Annotated[
        str | None, typer.Option(help="Which, in order: a,b,c; rename by a=male,b=female.")
    ] = None,
    merge_individuals: Annotated[
        bool | None, typer.Option("--merge-individuals", help="One file per animal: put together.")
    ] = None,
    target: Annotated[
        str | None,
        typer.Option(help="The pursued individual; auto (default): who is approached; none."),
    ] = None,
    pursuer: Annotated[
        str | None, typer.Option(help="The only pursuer: all others are its targets.")
    ] = None,
    metadata: Annotated[
        Path | None,
        typer.Option(
            help="Table of recordings: recording, and condition, split, target, px_per_cm, or a "
            "row for each individual and role."
        ),
    ] = None,
    name_pattern: Annotated[
        str | None,
        typer.Option(
            help=r"The same by groups in names of recordings: (?P\<condition>sham|drug) or "
            r"(?P\<split>train|test)."
        ),
    ] = None,
    keypoint: Annotated[str | None, typer.Option(help="Body part, or centroid.")] = None,
    heading: Annotated[
        str | None, typer.Option(help="Bodies point from one keypoint to another: thorax,head.")
    ] = None,
    drop_jumps: Annotated[
        bool | None,
        typer.Option("--drop-jumps/--keep-jumps", help="Make gaps of jumps, or only flag them."),
    ] = None,
    min_confidence: Annotated[
        float | None,
        typer.Option(help="Below it: not tracked. Default: 0.6 of likelihoods; 0: all are used."),
    ] = None,
    max_gap: Annotated[float | None, typer.Option(help="Fill gaps up to so many seconds.")] = None,
    smoothing: Annotated[
        float | None, typer.Option(help="Low-pass cutoff in Hz (Butterworth, zero phase); 0: none.")
    ] = None,
    arena: Annotated[str | None, typer.Option(help="square, disc or open.")] = None,
    arena_width: Annotated[
        float | None, typer.Option(help="Side or diameter in the file's unit; default: extent.")
    ] = None,
    centre: Annotated[
        str | None, typer.Option(help="Of the arena, x,y in the file's unit; default: of extent.")
    ] = None,
    px_per_cm: Annotated[
        float | None, typer.Option(help="The file's units to 1 cm; all lengths then are in cm.")
    ] = None,
    scale_each: Annotated[
        bool | None,
        typer.Option("--scale-each", help="Each recording by its own extent, not all by one."),
    ] = None,
    boundary: Annotated[
        float | None, typer.Option(help="Beyond it an individual is out, in arena units.")
    ] = None,
    units: Annotated[
        float | None,
        typer.Option(help="Open arena: the file's units per arena unit; default: extent."),
    ] = None,
    cut: Annotated[str | None, typer.Option(help="whole, approach or events.")] = None,
    farther_than: Annotated[
        float | None, typer.Option(help="An approach starts here, in arena units.")
    ] = None,
    closer_than: Annotated[
        float | None, typer.Option(help="An approach ends here, in arena units.")
    ] = None,
    start: Annotated[
        str | None,
        typer.Option(
            help="An approach starts at the separation, or at the approach: the last time."
        ),
    ] = None,
    contact: Annotated[
        float | None, typer.Option(help="whole, events: ends within this, in arena units; 0: none.")
    ] = None,
    piece: Annotated[float | None, typer.Option(help="whole: cut into pieces, s.")] = None,
    longest: Annotated[float | None, typer.Option(help="Leave longer episodes out, s.")] = None,
    keep_last: Annotated[float | None, typer.Option(help="Keep the last seconds.")] = None,
    shortest: Annotated[float | None, typer.Option(help="Leave shorter ones out, s.")] = None,
    events: Annotated[Path | None, typer.Option(help="Table: recording, start, end [s].")] = None,
    species: Annotated[str | None, typer.Option(help="Species they belong to.")] = None,
    condition: Annotated[int | None, typer.Option(help="0 or 1, of all episodes.")] = None,
    licence: Annotated[str | None, typer.Option(help="Of the recordings.")] = None,
    synthetic: Annotated[
        bool | None, typer.Option("--synthetic", help="No animal was recorded: say so everywhere.")
    ] = None,
    split_by: Annotated[str | None, typer.Option(help="auto, recording, episode or group.")] = None,
    split_pattern: Annotated[
        str | None, typer.Option(help="group: regular expression with a (group).")
    ] = None,
    split_seed: Annotated[int | None, typer.Option(help="Of the splits.")] = None,
    option: Annotated[
        list[str] | None, typer.Option(help="Of the reader: name=value, value as YAML.")
    ] = None,
) -> None:
    """Turn tracker files into demonstrations; the recipe is saved beside them.

    Examples:

      animarl import clip.slp --source sleap --fps 25 --target female --dry-run

      animarl import pairs.csv --fps 30 --target auto --decision-rate 10 --out demos.npz

      animarl import flock.csv --fps 25 --pursuer dog --out flock.npz

      animarl import *.csv --fps 30 --metadata sessions.csv --px-per-cm 14.2 --out demos.npz

      animarl import more.csv --recipe demos.recipe.yaml --out more.npz
    """
    if out is not None and out.suffix != ".npz":
        raise InputError(f"{out}: demonstrations end in .npz: rename it")
    if out is None and not dry_run:
        raise InputError("nothing would be written: name --out, or ask for a --dry-run")
    reader = find_reader(files[0], source)
    if reader.read_demonstrations is not None:
        if len(files) > 1:
            raise InputError(f"{files[1]}: files of source {reader.name} are imported one by one")
        _refuse_beside_finished(files[0], context)
        finished = read(files[0], reader.name, **_options(option))
        if condition is not None:
            finished = replace(finished, condition=np.full(len(finished), condition, dtype=np.int8))
        report(finished, None if dry_run else out, None)
        return
    given: dict[str, Any] = {
        "frame_rate": fps, "decision_rate": decision_rate, "target": target, "pursuer": pursuer,
        "species": species, "merge_individuals": merge_individuals,
        "metadata": str(metadata) if metadata else None, "name_pattern": name_pattern,
        "condition": condition, "licence": licence, "synthetic": synthetic,
        "options": _options(option) or None,
        "cleaning": {
            "keypoint": keypoint, "heading": _heading(heading), "min_confidence": min_confidence,
            "max_gap": max_gap, "smoothing_cutoff": smoothing, "drop_jumps": drop_jumps,
        },
        "scaling": {"shape": arena, "width": arena_width, "units_per_arena_unit": units,
            "boundary": boundary, "centre": _centre(centre), "px_per_cm": px_per_cm,
            "each": scale_each,
        },
        "cutting": {
            "mode": cut or ("approach" if farther_than else "events" if events else None),
            "farther_than": farther_than, "closer_than": closer_than,
            "start": start, "contact": contact, "piece": piece,
            "longest": longest, "keep_last": keep_last, "shortest": shortest,
            "events": str(events) if events else None,
        },
        "splitting": {
            "by": split_by or ("group" if split_pattern else None), "pattern": split_pattern,
            "seed": split_seed,
        },
    }  # fmt: skip
    if individuals is not None:
        pairs = [entry.strip().partition("=") for entry in individuals.split(",")]
        given["individuals"] = [name for name, _, _ in pairs]
        given["rename"] = {name: new for name, _, new in pairs if new} or None
    base = ImportRecipe.load(recipe) if recipe is not None else default_recipe(reader)
    unsaid = target is None and pursuer is None
    if recipe is None and unsaid and base.target is None and not base.searcher:
        given["target"] = AUTO
    record = _merged(base.to_dict(), given)
    if target == NOBODY:
        record["target"] = None
    plan = ImportRecipe.from_dict(record, "the options given")
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


def _heading(given: str | None) -> list[str] | None:
    return None if given is None else [part.strip() for part in given.split(",")]


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


def _merged(base: dict[str, Any], given: dict[str, Any]) -> dict[str, Any]:
    """``base`` with every entry of ``given`` that is not None, nested ones included."""
    merged = json.loads(json.dumps(base))
    for key, value in given.items():
        if isinstance(value, dict) and isinstance(merged.get(key), dict) and key != "rename":
            merged[key] = _merged(merged[key], value)
        elif value is not None:
            merged[key] = value
    return dict(merged)
