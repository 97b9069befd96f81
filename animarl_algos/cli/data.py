"""``animarl data``: look at demonstrations, check, split, convert and plot them."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import typer
from rich.table import Table

from animarl_algos.cli.describing import hints, report, show, wide_console
from animarl_algos.cli.evaluate import MEASURE, PRIMARY, TOLERANCE
from animarl_algos.cli.main import SETTINGS
from animarl_algos.cli.shared import (
    SOURCE,
    load,
    refuse_overwriting,
    with_help,
    write_csv,
    write_tracks,
)
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.episode import SPLITS
from animarl_envs.demos.joining import join
from animarl_envs.demos.splits import Splitting, deal
from animarl_envs.demos.summary import RECORDED_SCALE, episode_table, unit_of
from animarl_envs.drawing.summary_figure import plot_summary
from animarl_envs.errors import InputError, require
from animarl_envs.importing.minari_io import export_minari, export_packaged
from animarl_envs.importing.readers import available_readers
from animarl_envs.importing.sessions import conditions_of
from animarl_envs.importing.sets import named_set, published_sets

app = typer.Typer(
    epilog="For example: animarl data show agent. COMMAND --help gives more.",
    no_args_is_help=True,
    **SETTINGS,
)
FILE = "A demonstrations file, or a packaged or published set, such as agent or termites."
OUT = typer.Option(help="Where to write.")
MOST_WARNINGS = 20


@app.callback()
def data_commands() -> None:
    """Get, look at, check, split, merge, convert and plot demonstrations."""


@app.command("sources")
def sources_command() -> None:
    """List the readers and their options.

    Example:

      animarl data sources
    """
    table = Table("source", "reads", "options (--option name=value)")
    for reader in available_readers():
        table.add_row(reader.name, reader.description, ", ".join(reader.options))
    wide_console().print(table)


@app.command("get")
@with_help(
    name=typer.Argument(help="Name of a published set; without it all are listed."),
    folder="Take its files from this folder, not from the network; default: $ANIMARL_DATA.",
)
def get_command(name: str | None = None, folder: Path | None = None) -> None:
    """Fetch published recordings and import them; then they are known by their name.

    Examples:

      animarl data get

      animarl data get termites_alone
    """
    console = wide_console()
    if name is None:
        table = Table("set", "recordings", "MB", "licence", "from", "here")
        for one in published_sets().values():
            where = "the network" if one.address else f"--folder ({one.origin})"
            here = "yes" if one.imported.exists() else "no"
            table.add_row(one.name, one.title, f"{one.bytes / 1e6:.1f}", one.licence, where, here)
        console.print(table)
        return
    one = named_set(name)
    show(one.build(folder))
    console.print(f"Cite: {one.citation}; {one.origin}; licence: {one.licence}")
    console.print(f"Next: animarl run {name} --out runs/{name}")


@app.command("show")
@with_help(file=FILE, measure=MEASURE)
def show_command(file: str, measure: list[str] | None = None) -> None:
    """Show a file: individuals, episodes, durations, speeds, outcomes, provenance.

    Examples:

      animarl data show demos.npz

      animarl data show agent

      animarl data show demos.npz --measure my_index.py:axis_index
    """
    from animarl_algos.evaluation.own_measures import measured_recordings, register_measures

    own = register_measures(measure)
    demos = load(file)
    show(demos)
    for line in measured_recordings(own, demos):
        wide_console().print(line)


@app.command("compare")
@with_help(
    file=FILE,
    conditions="Two conditions, such as control,drug; by default the first two of the file.",
    tolerance=TOLERANCE,
    primary=PRIMARY,
    measure=MEASURE,
    seed="Of the exchanges of recordings between the conditions.",
)
def compare_command(
    file: str,
    conditions: str | None = None,
    tolerance: list[str] | None = None,
    primary: list[str] | None = None,
    measure: list[str] | None = None,
    seed: int = 0,
) -> None:
    """Compare recordings of two conditions, as a verdict compares simulated with recorded ones.

    Each row is the second condition minus the first. The unit is the recording.

    Example:

      animarl data compare both.npz --conditions sham,lesion --primary speed
    """
    from animarl_algos.evaluation.conditions import compare_conditions
    from animarl_algos.evaluation.own_measures import register_measures
    from animarl_algos.evaluation.verdict_rows import Questions
    from animarl_algos.report.verdict_section import conditions_as_table, terminal_table

    register_measures(measure)
    names = None if conditions is None else conditions.split(",")
    questions = Questions.parse(tolerance or (), primary or ())
    compared = compare_conditions(load(file), names, questions, seed=seed)
    console = wide_console()
    console.print(terminal_table(conditions_as_table(compared), compared.headline, wrapped=True))


@app.command("check")
@with_help(file=FILE, out="Table of episodes to write (.csv).")
def check_command(file: str, out: Path | None = None) -> None:
    """Validate a file, list suspicious episodes, and write a table of episodes.

    Example:

      animarl data check demos.npz --out episodes.csv
    """
    if out is not None:
        require(out.suffix == ".csv", f"{out}: a table of episodes ends in .csv: rename it")
        refuse_overwriting(out, file)
    demos = load(file)
    rows = episode_table(demos)
    console = wide_console()
    warnings = suspicions(demos, rows)
    for warning in warnings[:MOST_WARNINGS]:
        console.print(f"check: {warning}")
    if len(warnings) > MOST_WARNINGS:
        console.print(f"check: and {len(warnings) - MOST_WARNINGS} more of this kind")
    if out is not None:
        write_csv(out, rows)
        console.print(f"Wrote {out}")
    console.print(f"{file}: {len(rows)} episodes, all valid.")


@app.command("split")
@with_help(
    file=FILE,
    out=OUT,
    by="recording, episode or group.",
    pattern="group: regular expression.",
    fractions="Shares of train, val, test.",
    seed="Seed of the new splits.",
)
def split_command(
    file: str,
    out: Path,
    by: str = "recording",
    pattern: str | None = None,
    fractions: str = "0.8,0.1,0.1",
    seed: int = 0,
) -> None:
    """Assign episodes to train, val and test again; by default recordings stay together.

    Examples:

      animarl data split demos.npz --seed 1 --out dealt.npz

      animarl data split demos.npz --by episode --fractions 0.6,0.2,0.2 --out dealt.npz
    """
    try:
        shares = tuple(float(share) for share in fractions.split(","))
    except ValueError:
        raise InputError(
            f"fractions are {fractions!r}: give three numbers, as 0.8,0.1,0.1"
        ) from None
    settings = Splitting(by=by, pattern=pattern, fractions=shares, seed=seed)  # type: ignore[arg-type]
    demos = load(file)
    report(deal(demos, settings), out)


@app.command("merge")
@with_help(
    files="Two files of demonstrations or more.",
    out=typer.Option(help="Demonstrations to write (.npz)."),
    conditions="Condition of each file: 0,1 or two words (control,drug); default: as they are.",
)
def merge_command(files: list[Path], out: Path, conditions: str | None = None) -> None:
    """Join files of demonstrations of the same animals in the same arena.

    Splits stay as they are; 'animarl data split' deals again.

    Examples:

      animarl data merge monday.npz tuesday.npz --out week.npz

      animarl data merge sham.npz lesion.npz --conditions sham,lesion --out both.npz
    """
    require(out.suffix == ".npz", f"{out}: demonstrations end in .npz: rename it")
    refuse_overwriting(out, *files)
    report(merged(files, conditions), out)


@app.command("convert")
@with_help(file=FILE, out=OUT, source="Reader of the file.")
def convert_command(file: str, out: Path, source: str | None = None) -> None:
    """Convert to .npz, .csv or .parquet (long table), .nc (movement), .nwb, or Minari (no suffix).

    Examples:

      animarl data convert demos.npz --out demos.csv

      animarl data convert demos.npz --out demos.nc

      animarl data convert demos.npz --out courtship-v0
    """
    refuse_overwriting(out, file)
    demos = load(file, source, takes=(SOURCE,))
    if out.suffix == ".npz":
        demos.save(out)
    elif out.suffix == "":
        export_minari(demos, out)
    else:
        heads = [{"recording": f"{name}/{i}"} for i, name in enumerate(demos.recording.tolist())]
        unit = RECORDED_SCALE if out.suffix == ".csv" else unit_of(demos)
        write_tracks(out, demos, heads, unit)
    wide_console().print(f"Wrote {out}")


@app.command("minari")
@with_help(out=typer.Option(help="Folder for all sets, new or without them."))
def minari_command(out: Path) -> None:
    """Write all packaged sets as Minari datasets, animarl/newt/demonstrations-v0 and the like.

    Example:

      animarl data minari --out minari
    """
    for name in export_packaged(out):
        wide_console().print(f"Wrote {out / name}")
    wide_console().print(f"Minari finds them with MINARI_DATASETS_PATH={out.resolve()}")


@app.command("plot")
@with_help(file=FILE, out=OUT)
def plot_command(file: str, out: Path) -> None:
    """Draw tracks, durations, path lengths, speeds and distances (.png, .svg, .pdf).

    Example:

      animarl data plot demos.npz --out demos.png
    """
    figure = out.suffix in {".png", ".svg", ".pdf"}
    require(figure, f"{out}: a figure ends in .png, .svg or .pdf: rename it")
    plot_summary(load(file), out)
    wide_console().print(f"Wrote {out}")


def merged(files: Sequence[Path], conditions: str | None = None) -> Demonstrations:
    """Join the demonstrations of two files or more, in their order.

    ``conditions`` are those of each file, such as ``0,1`` or ``control,drug``; by default those of
    their episodes. Raises InputError if the sets do not fit together, or conditions are not one for
    each file.
    """
    several = f"{files[0]}: there is nothing to merge it with: give two files or more"
    require(len(files) > 1, several)
    parts = [load(str(file)) for file in files]
    place = " and ".join(map(str, files))
    if conditions is None:
        return join(parts, place)
    words = [word.strip() for word in conditions.split(",")]
    require(
        len(words) == len(files) and all(words),
        f"conditions are {conditions!r} for {len(files)} files: give one for each, as "
        f"{','.join(str(i % 2) for i in range(len(files)))}",
    )
    names = conditions_of(words, "--conditions")
    labelled = [
        replace(part, condition=np.full(len(part), names.index(word), dtype=np.int8))
        for part, word in zip(parts, words, strict=True)
    ]
    joined = join(labelled, place)
    if len(names) < 2:
        return joined
    return replace(joined, provenance={**joined.provenance, "conditions": list(names)})


def suspicions(demos: Demonstrations, rows: list[dict[str, Any]]) -> list[str]:
    """Return sentences about episodes and splits that should be looked at again."""
    sentences = []
    for name in demos.individuals:
        top = np.array([row[f"top_speed_{name}"] for row in rows])
        usual = float(np.median(top))
        for row in rows:
            if row[f"top_speed_{name}"] > 5 * usual > 0:
                sentences.append(
                    f"episode {row['episode']} ({row['recording']}): {name} reaches "
                    f"{row[f'top_speed_{name}']:.3g}, five times the usual {usual:.3g}: a jump?"
                )
            if row[f"path_length_{name}"] == 0:
                sentences.append(
                    f"episode {row['episode']} ({row['recording']}): {name} never moves"
                )
    sentences += [
        f"split {split} is empty: deal again with 'animarl data split'"
        for split in SPLITS
        if not (demos.split == split).any()
    ]
    torn = [
        name
        for name in np.unique(demos.recording)
        if len(np.unique(demos.split[demos.recording == name])) > 1
    ]
    if torn:
        sentences.append(
            f"{len(torn)} of {len(np.unique(demos.recording))} recordings lie in several splits, "
            f"{torn[0]} first"
        )
    return hints(demos) + sentences
