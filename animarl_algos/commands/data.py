"""``animarl import`` and ``animarl data``: anyone's tracks in, demonstrations out."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
import yaml
from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from animarl_envs.demos import Demonstrations
from animarl_envs.demos.following import follow
from animarl_envs.demos.minari_io import export_minari
from animarl_envs.demos.packaged import load_packaged, packaged_names
from animarl_envs.demos.readers import available_readers, default_recipe, find_reader, read
from animarl_envs.demos.recipe import Recipe
from animarl_envs.demos.splits import Splitting, deal
from animarl_envs.demos.summary import episode_table, plot_summary, summarise
from animarl_envs.errors import InputError
from animarl_envs.files import write_then_rename

app = typer.Typer(help="Look at, check, split, convert and plot demonstrations.")
DemosArgument = Annotated[
    str, typer.Argument(help="A demonstrations file, or agent, fly, newt, silkmoth (packaged).")
]
OutOption = Annotated[Path, typer.Option("--out", help="Where to write.")]


def import_command(
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
    target: Annotated[
        str | None, typer.Option(help="Name of the pursued individual, or auto: who is approached.")
    ] = None,
    keypoint: Annotated[str | None, typer.Option(help="Body part, or centroid.")] = None,
    min_confidence: Annotated[float | None, typer.Option(help="Below it: not tracked.")] = None,
    max_gap: Annotated[float | None, typer.Option(help="Fill gaps up to so many seconds.")] = None,
    smoothing: Annotated[
        float | None, typer.Option(help="Low-pass cutoff in Hz (Butterworth, zero phase).")
    ] = None,
    arena: Annotated[str | None, typer.Option(help="square, disc or open.")] = None,
    arena_width: Annotated[
        float | None, typer.Option(help="Side or diameter in the file's unit; default: extent.")
    ] = None,
    units: Annotated[
        float | None, typer.Option(help="Open arena: the file's units per arena unit.")
    ] = None,
    cut: Annotated[str | None, typer.Option(help="whole, approach or events.")] = None,
    farther_than: Annotated[float | None, typer.Option(help="An approach starts here.")] = None,
    closer_than: Annotated[float | None, typer.Option(help="An approach ends here.")] = None,
    contact: Annotated[float | None, typer.Option(help="whole: ends within this.")] = None,
    piece: Annotated[float | None, typer.Option(help="whole: cut into pieces, s.")] = None,
    longest: Annotated[float | None, typer.Option(help="Leave longer episodes out, s.")] = None,
    keep_last: Annotated[float | None, typer.Option(help="Keep the last seconds.")] = None,
    shortest: Annotated[float | None, typer.Option(help="Leave shorter ones out, s.")] = None,
    events: Annotated[Path | None, typer.Option(help="Table: recording, start, end [s].")] = None,
    species: Annotated[str | None, typer.Option(help="Species they belong to.")] = None,
    condition: Annotated[int | None, typer.Option(help="0 or 1, of all episodes.")] = None,
    licence: Annotated[str | None, typer.Option(help="Of the recordings.")] = None,
    split_by: Annotated[str | None, typer.Option(help="auto, recording or episode.")] = None,
    split_seed: Annotated[int | None, typer.Option(help="Of the splits.")] = None,
    option: Annotated[
        list[str] | None, typer.Option(help="Of the reader: name=value, value as YAML.")
    ] = None,
) -> None:
    """Turn tracker files into demonstrations; the recipe is saved beside them.

    Examples:

      animarl import clip.slp --source sleap --fps 25 --target female --dry-run

      animarl import pairs.csv --fps 30 --target auto --decision-rate 10 --out demos.npz

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
        finished = read(files[0], reader.name, **_options(option))
        _report(finished, out, None)
        return
    given: dict[str, Any] = {
        "frame_rate": fps, "decision_rate": decision_rate, "target": target, "species": species,
        "condition": condition, "licence": licence, "options": _options(option) or None,
        "cleaning": {
            "keypoint": keypoint, "min_confidence": min_confidence, "max_gap": max_gap,
            "smoothing_cutoff": smoothing,
        },
        "scaling": {"shape": arena, "width": arena_width, "units_per_arena_unit": units},
        "cutting": {
            "mode": cut or ("approach" if farther_than else "events" if events else None),
            "farther_than": farther_than, "closer_than": closer_than,
            "contact": contact, "piece": piece,
            "longest": longest, "keep_last": keep_last, "shortest": shortest,
            "events": str(events) if events else None,
        },
        "splitting": {"by": split_by, "seed": split_seed},
    }  # fmt: skip
    if individuals is not None:
        pairs = [entry.strip().partition("=") for entry in individuals.split(",")]
        given["individuals"] = [name for name, _, _ in pairs]
        given["rename"] = {name: new for name, _, new in pairs if new} or None
    base = Recipe.load(recipe) if recipe is not None else default_recipe(reader)
    plan = Recipe.from_dict(_merged(base.to_dict(), given), "the options given")
    with Progress(transient=True, console=Console(stderr=True)) as bar:
        task = bar.add_task(f"Reading {len(files)} file(s)", total=1.0)
        demos = follow(plan, files, lambda share: bar.update(task, completed=share))
    if dry_run:
        _report(demos, None, plan)
        Console().print("Dry run: nothing was written.")
    else:
        _report(demos, out, plan)


@app.command("sources")
def sources_command() -> None:
    """List the readers and their options."""
    table = Table("source", "reads", "options (--option name=value)")
    for reader in available_readers():
        table.add_row(reader.name, reader.description, ", ".join(reader.options))
    _console().print(table)


@app.command("show")
def show_command(file: DemosArgument) -> None:
    """Say what a file holds: individuals, episodes, durations, speeds, outcomes, provenance."""
    _show(load(file))


@app.command("check")
def check_command(
    file: DemosArgument,
    out: Annotated[Path | None, typer.Option(help="Table per episode (.csv).")] = None,
) -> None:
    """Validate a file, name suspicious episodes, and write the table per episode."""
    demos = load(file)
    rows = episode_table(demos)
    console = _console()
    for warning in suspicions(demos, rows):
        console.print(f"check: {warning}", highlight=False, soft_wrap=True)
    if out is not None:
        with write_then_rename(out) as part, part.open("w", newline="") as target:
            writer = csv.DictWriter(target, fieldnames=list(rows[0]))
            writer.writeheader()
            writer.writerows(rows)
    console.print(f"{file}: {len(rows)} episodes, all valid.", highlight=False, soft_wrap=True)


@app.command("split")
def split_command(
    file: DemosArgument,
    out: OutOption,
    by: Annotated[str, typer.Option(help="recording, episode or group.")] = "recording",
    pattern: Annotated[str | None, typer.Option(help="group: regular expression.")] = None,
    fractions: Annotated[str, typer.Option(help="Of train, val, test.")] = "0.8,0.1,0.1",
    seed: Annotated[int, typer.Option(help="Of the dealing.")] = 0,
) -> None:
    """Deal episodes to train, val and test again; recordings are not torn apart by default."""
    try:
        shares = tuple(float(share) for share in fractions.split(","))
    except ValueError:
        raise InputError(
            f"fractions are {fractions!r}: give three numbers, as 0.8,0.1,0.1"
        ) from None
    settings = Splitting(by=by, pattern=pattern, fractions=shares, seed=seed)  # type: ignore[arg-type]
    demos = load(file)
    _report(deal(demos, settings), out, None)


@app.command("convert")
def convert_command(
    file: DemosArgument,
    out: OutOption,
    source: Annotated[str | None, typer.Option(help="Reader of the file.")] = None,
) -> None:
    """Convert to .npz, .csv (long table), or a Minari dataset (a folder, no suffix)."""
    demos = load(file, source)
    if out.suffix == ".npz":
        demos.save(out)
    elif out.suffix == ".csv":
        write_long_table(demos, out)
    elif out.suffix == "":
        export_minari(demos, out)
    else:
        raise InputError(f"{out}: the suffix says the format: .npz, .csv, or none for Minari")
    _console().print(f"Wrote {out}", highlight=False, soft_wrap=True)


@app.command("plot")
def plot_command(file: DemosArgument, out: OutOption) -> None:
    """Draw tracks, durations, path lengths, speeds and distances (.png, .svg, .pdf)."""
    if out.suffix not in {".png", ".svg", ".pdf"}:
        raise InputError(f"{out}: a figure ends in .png, .svg or .pdf: rename it")
    plot_summary(load(file), out)
    _console().print(f"Wrote {out}", highlight=False, soft_wrap=True)


def load(file: str, source: str | None = None) -> Demonstrations:
    """A packaged set by name, or a file."""
    if file in packaged_names() and not Path(file).exists():
        return load_packaged(file)
    return read(file, source)


def suspicions(demos: Demonstrations, rows: list[dict[str, Any]]) -> list[str]:
    """What a careful eye would look at again, in sentences."""
    found = []
    for name in demos.individuals:
        top = np.array([row[f"top_speed_{name}"] for row in rows])
        usual = float(np.median(top))
        for row in rows:
            if row[f"top_speed_{name}"] > 5 * usual > 0:
                found.append(
                    f"episode {row['episode']} ({row['recording']}): {name} reaches "
                    f"{row[f'top_speed_{name}']:.3g}, five times the usual {usual:.3g}: a jump?"
                )
            if row[f"path_length_{name}"] == 0:
                found.append(f"episode {row['episode']} ({row['recording']}): {name} never moves")
    for split, count in summarise(demos)["splits"].items():
        if count == 0:
            found.append(f"split {split} is empty: deal again with 'animarl data split'")
    torn = [
        name
        for name in np.unique(demos.recording)
        if len(np.unique(demos.split[demos.recording == name])) > 1
    ]
    if torn:
        found.append(f"{len(torn)} recordings lie in several splits, {torn[0]} first")
    return found


def write_long_table(demos: Demonstrations, out: Path) -> None:
    """A row per frame and individual, as the long-table reader takes it."""
    with write_then_rename(out) as part, part.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["recording", "frame", "id", "x", "y"])
        for one in demos:
            name = f"{one.recording}/{one.index}"
            for frame, bodies in enumerate(one.positions.tolist()):
                for who, (x, y) in zip(demos.individuals, bodies, strict=True):
                    writer.writerow([name, frame, who, x, y])


def _report(demos: Demonstrations, out: Path | None, plan: Recipe | None) -> None:
    _show(demos)
    if out is None:
        return
    demos.save(out)
    console = _console()
    console.print(f"Wrote {out}", highlight=False, soft_wrap=True)
    if plan is not None:
        recipe_file = plan.save(out.with_suffix(".recipe.yaml"))
        console.print(f"Wrote {recipe_file}, which repeats it", highlight=False, soft_wrap=True)


def _show(demos: Demonstrations) -> None:
    table = Table(title=demos.name, show_header=False)
    for key, value in summarise(demos).items():
        table.add_row(key.replace("_", " "), _words(value))
    _console().print(table)


def _words(value: Any) -> str:
    if isinstance(value, dict):
        return ", ".join(f"{name} {_words(entry)}" for name, entry in value.items())
    if isinstance(value, float):
        return f"{value:.4g}"
    return ", ".join(value) if isinstance(value, list) else str(value)


def _options(given: list[str] | None) -> dict[str, Any]:
    found = {}
    for entry in given or []:
        name, equals, value = entry.partition("=")
        if not equals:
            raise InputError(f"option {entry!r} has no '=': write name=value")
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


def _console() -> Console:
    console = Console()
    console.width = max(console.width, 100)
    return console
