"""Demonstrations and recipes in words, with units: what the command line says about them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.table import Table
from rich.text import Text

from animarl_algos.cli.screen import PlainConsole
from animarl_envs.checks import printable
from animarl_envs.demos import Demonstrations
from animarl_envs.demos.splits import FEWEST_RECORDINGS
from animarl_envs.demos.summary import TRACKING, episode_table, summarise
from animarl_envs.demos.units import unit_of
from animarl_envs.importing.cleaning import LIKELY
from animarl_envs.importing.import_recipe import ImportRecipe

Row = tuple[str, str]
_SPLITS = {
    "auto": f"recording (by episode with fewer than {FEWEST_RECORDINGS})",
    "group": "groups of recordings",
}


def demonstrations_at_a_glance(demos: Demonstrations) -> list[Row]:
    """What a set of demonstrations holds, line by line."""
    found = summarise(demos)
    shortest, median, longest = (
        found["duration"][key] for key in ("shortest", "median", "longest")
    )
    rows = [
        ("species", demos.species),
        ("individuals", ", ".join(f"{n} ({r})" for n, r in found["individuals"].items())),
        ("kind", "SYNTHETIC, not recorded animals" if demos.synthetic else "recorded animals"),
        ("source", found["source"]),
        ("licence", found["licence"]),
        ("episodes", f"{demos.num_episodes} from {counted(found['recordings'], 'recording')}"),
        ("splits", ", ".join(f"{count} {name}" for name, count in found["splits"].items())),
        ("time step", f"{demos.dt:.4g} s ({1 / demos.dt:.4g} Hz), {found['frames']} frames"),
        ("duration", f"{shortest:.3g} to {longest:.4g} s, median {median:.3g} s"),
        ("in total", f"{found['total_duration']:.1f} s ({found['total_duration'] / 60:.1f} min)"),
        ("arena", _arena(demos)),
    ]
    if "command" in demos.provenance:
        rows.insert(4, ("made by", str(demos.provenance["command"])))
    keypoints = demos.provenance.get("keypoints", [])
    if len(keypoints) > 1:
        used = {one.get("keypoint") for one in demos.provenance.get("cleaning", {}).values()}
        rows.append(("keypoints", f"{', '.join(keypoints)}; used: {', '.join(map(str, used))}"))
    unit = unit_of(demos)
    scale = unit.per_arena_unit
    for name in demos.individuals:
        speed = found[f"speed of {name}"]
        rows.append(
            (
                f"speed of {name}",
                f"median {scale * speed['median']:.3g}, 99th percentile "
                f"{scale * speed['99 %']:.3g} {unit.name}/s, "
                f"at rest {speed['resting']:.0%} of the time",
            )
        )
    if "target" in demos.roles or "searcher" in demos.roles:
        targets = demos.roles.count("target")
        to = "source" if not targets else "target" if targets == 1 else "nearest target"
        table = episode_table(demos)
        first = float(np.median([row["first_distance"] for row in table]))
        least = float(np.median([row["least_distance"] for row in table]))
        rows.append(
            (
                f"distance to the {to}",
                f"first {scale * first:.3g}, least {scale * least:.3g} {unit.name} (medians)",
            )
        )
    for condition in np.unique(demos.condition):
        outcomes = found[f"outcomes, condition {condition}"]
        rows.append(
            (
                f"outcomes, condition {condition}",
                ", ".join(f"{name}: {count}" for name, count in outcomes.items()),
            )
        )
    if demos.signals:
        rows.append(("signals", ", ".join(found["signals"])))
    tracking = [f"{found[f'frames: {key}']} {key}" for key in TRACKING if f"frames: {key}" in found]
    if tracking:
        rows.append(("frames flagged", ", ".join(tracking)))
    return [*rows, ("fingerprint", found["fingerprint"])]


def understood(recipe: ImportRecipe, source: str, files: Sequence[Path]) -> list[Row]:
    """What an import is going to do, line by line."""
    clean, scale, cut, split = recipe.cleaning, recipe.scaling, recipe.cutting, recipe.splitting
    cleaning = [f"keypoint {clean.keypoint}"]
    if clean.heading is not None:
        cleaning.append(f"heading from {clean.heading[0]} to {clean.heading[1]}")
    if clean.min_confidence is None:
        cleaning.append(f"likelihoods below {LIKELY:g} not used")
    elif clean.min_confidence:
        cleaning.append(f"confidence of at least {clean.min_confidence:g}")
    cleaning.append(
        f"gaps of up to {clean.max_gap:g} s filled" if clean.max_gap else "gaps not filled"
    )
    cleaning.append("jumps taken out" if clean.drop_jumps else "jumps flagged")
    cutoff = clean.smoothing_cutoff
    cleaning.append(f"smoothed at {cutoff:g} Hz" if cutoff else "not smoothed")
    if scale.shape == "open":
        units = scale.units_per_arena_unit
        size = "half the extent of all recordings" if units is None else f"{units:g} file units"
        scaling = f"open field, {size} to an arena unit"
    else:
        unit = "units of the file" if scale.px_per_cm is None else "cm"
        extent = "each recording's own extent" if scale.each else "the extent of all recordings"
        size = extent if scale.width is None else f"{scale.width:g} {unit} wide"
        scaling = f"{scale.shape}, {size}"
        if scale.centre is not None:
            scaling += f" around ({scale.centre[0]:g}, {scale.centre[1]:g})"
    if scale.px_per_cm is not None:
        scaling += f", {scale.px_per_cm:g} of the file's units to 1 cm"
    if cut.mode == "approach":
        cutting = (
            f"from farther than {cut.farther_than:g} to closer than {cut.closer_than:g} arena units"
        )
    elif cut.mode == "events":
        cutting = f"by the table {cut.events}"
    else:
        cutting = "whole stretches without gaps"
        if cut.piece is None:
            cutting += ", a lone recording in pieces"
        elif cut.piece < math.inf:
            cutting += f" in pieces of {cut.piece:g} s"
    rate = "the file's" if recipe.frame_rate is None else f"{recipe.frame_rate:g} Hz"
    decisions = "every frame" if recipe.decision_rate is None else f"{recipe.decision_rate:g} Hz"
    return [
        ("read as", f"{source}, {counted(len(files), 'file')}"),
        ("frame rate", f"{rate}; decisions at {decisions}"),
        ("target", _target(recipe)),
        ("cleaning", ", ".join(cleaning)),
        ("scaling", scaling),
        ("episodes", cutting),
        ("splits", f"by {_SPLITS.get(split.by, split.by)}, seed {split.seed}"),
    ]


def _target(recipe: ImportRecipe) -> str:
    if recipe.searcher:
        return "the source at the origin"
    if recipe.pursuer is not None:
        return f"all but {recipe.pursuer}, who pursues them"
    if recipe.target is None:
        return "none named"
    return "who is approached" if recipe.target == "auto" else recipe.target


def _arena(demos: Demonstrations) -> str:
    arena = demos.arena
    words = {"square": "square, half side 1", "disc": "disc, radius 1", "open": "open field"}
    said = words[arena.shape]
    if math.isfinite(arena.boundary):
        said += f", boundary {arena.boundary:g}"
    scales: Mapping[str, Any] = demos.provenance.get("scales", {})
    units = sorted(float(scale["unit"]) for scale in scales.values())
    if units:
        low, high = f"{units[0]:.4g}", f"{units[-1]:.4g}"
        span = low if low == high else f"{low} to {high}"
        said += f"; an arena unit is {span} {demos.provenance.get('unit', 'units of the file')}"
    return said


def counted(number: int, noun: str) -> str:
    """So many of them, with a plural's s."""
    return f"{number} {noun}{'s' * (number != 1)}"


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
