"""The leaderboard as Markdown and CSV; what it cost stands in files of its own.

The same matrix, version and seeds give the same bytes of ``leaderboard.*``, however many processes
made them and however often they were killed; ``costs.*`` hold what differs from time to time.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from animarl_algos.benchmark.matrix import Plan
from animarl_algos.benchmark.scores import ENERGY, Score, differences, labels, ranked
from animarl_algos.evaluation.statistics import interval
from animarl_algos.report.words import NOTHING, number, with_interval
from animarl_algos.runs.run_files import machine
from animarl_envs.drawing import markdown_table
from animarl_envs.files import write_then_rename

COSTS = ("row", "seed", "processor_seconds", "parameters")
HEAD = ("data", "method", "kind", "starts", "rollouts", "covers", "words")
HOW = """\
Test split; rollouts from its starts. In brackets the 95 % interval over recordings; of differences
to the recordings (endings, duration, path length, speed) it holds for all rows of a verdict
together. Of realism, energy score and DTW it is over recordings and seeds. With several seeds these
are of training runs like these, with one of this network only. **Bold**: alike; of realism, energy
score and DTW, as good as those of other recordings of the same condition. Realism is higher the
better, and lower is better everywhere else. Ranks go by the energy score of duration, path length
and speed together, as far as paired intervals tell two methods apart; recordings and tracking know
where the recordings go and are not ranked. Parameters and processor time stand in `costs.md`.
"""


def write_leaderboard(plan: Plan, out: Path, command: str = "") -> Path:
    """Write ``leaderboard.{md,csv}`` and ``costs.{md,csv}`` of what is finished.

    ``command`` made it, and stands with the machine in ``costs.md``.
    """
    boards: dict[str, list[Score]] = {}
    missing = []
    for scoring in plan.scorings:
        if scoring.finished(out):
            boards.setdefault(scoring.data, []).append(scoring.result(out))
        else:
            worlds = [world for world in plan.worlds if world.data == scoring.data]
            tried = [*worlds, *scoring.cells, scoring]
            errors = [f"{piece.name}: {why}" for piece in tried if (why := piece.error(out))]
            why = "; ".join(errors) or "not finished"
            missing.append(f"- {scoring.name.removesuffix('/score')}: {why}\n")
    text = ""
    rows: list[dict[str, Any]] = []
    for name, scores in boards.items():
        ranks = ranked(scores, plan.matrix.resamples)
        text += _section(plan, name, scores, ranks)
        for one in scores:
            head = {key: getattr(one, key) for key in HEAD} | {"rank": ranks.get(one.method, "")}
            head["seeds"] = " ".join(map(str, one.seeds))
            rows += [head | row for row in one.measures]
    _write_csv(out / "leaderboard.csv", rows)
    text += f"\n## Not there\n\n{''.join(missing)}" if missing else ""
    with write_then_rename(out / "leaderboard.md") as part:
        part.write_text(f"# Leaderboard\n\n{HOW}{text}", encoding="utf-8")
    _write_costs(plan, out, command)
    return out / "leaderboard.md"


def _section(plan: Plan, name: str, scores: Sequence[Score], ranks: Mapping[str, str]) -> str:
    """Return the tables of one set: main measures, differences, closeness."""
    folds = plan.matrix.folds.get(name)
    synthetic = next(w.demos.synthetic for w in plan.worlds if w.data == name)
    kind = "synthetic demonstrations, recorded from no animal" if synthetic else "recordings"
    text = (
        f"\n## {name}\n\n{max(one.starts for one in scores)} test starts"
        f"{'' if folds is None else f', cross-validated in {folds} folds'}, of {kind}; beside each "
        "method seeds × rollouts.\n"
    )

    def place(one: Score) -> tuple[bool, float]:
        value = one.by_measure[ENERGY]["value"]
        return one.method not in ranks, value if math.isfinite(value) else math.inf

    def cell(one: Score, key: str) -> str:
        row = one.by_measure.get(key)
        if row is None:
            return NOTHING
        value = with_interval(interval(row))
        marked = f"**{value}**" if row["inside"] else value
        return f"{marked}; null {number(row['null'])}" if math.isfinite(row["null"]) else marked

    named = {key: title for one in scores for key, title in titles(one).items()}
    keys = [key for key in labels() if key in named]
    compared = [k for k in keys if k in {metric.key for metric in differences()}]
    first = keys.index(compared[0])
    for some in (keys[:first], compared, keys[first + len(compared) :]):
        lines = [
            [
                ranks.get(one.method, NOTHING),
                f"{one.method} ({len(one.seeds)} × {one.rollouts // len(one.seeds)})",
                *(cell(one, key) for key in some),
            ]
            for one in sorted(scores, key=place)
        ]
        text += f"\n{markdown_table(['rank', 'method', *map(named.__getitem__, some)], lines)}\n"
    return text


def titles(scored: Score) -> dict[str, str]:
    """Return the name of every measure with its unit."""
    names, units = labels(), {row["measure"]: row["unit"] for row in scored.measures}
    return {key: names[key] + (f" ({unit})" if unit else "") for key, unit in units.items()}


def _write_costs(plan: Plan, out: Path, command: str) -> None:
    """Processor time and parameters of every finished cell, on which machine, by which command."""
    rows: list[dict[str, Any]] = [
        {"data": one.data, "method": one.method, "seed": one.seed, "fold": one.fold} | cost
        for one in plan.cells
        if (cost := one.cost(out))
    ]
    _write_csv(out / "costs.csv", rows)
    lines = []
    for row in rows:
        row["row"] = f"{row['data']}/{row['method']}"
    for name, some in pd.DataFrame(rows, columns=COSTS).groupby("row", sort=False):
        seeds, parameters = some["seed"].nunique(), some["parameters"].iloc[0]
        size = NOTHING if pd.isna(parameters) else f"{int(parameters):,}"
        seconds = some["processor_seconds"].sum() / seeds
        lines.append([str(name), str(seeds), f"{seconds:.1f}", size])
    total = sum(row["processor_seconds"] for row in rows)
    made = {"command": f"`{command}`"} if command else {}
    made |= machine() | {"all cells": f"{total:.0f} s of processor time"}
    versions_list = "\n".join(f"- {name}: {value}" for name, value in made.items())
    with write_then_rename(out / "costs.md") as part:
        head = ("row", "seeds", "processor time of a seed (s)", "parameters")
        table = markdown_table(head, lines)
        part.write_text(f"# What it cost\n\n{versions_list}\n\n{table}\n", encoding="utf-8")


def _write_csv(path: Path, rows: Iterable[dict[str, Any]]) -> None:
    with write_then_rename(path) as part:
        table = pd.DataFrame(rows, dtype=object)
        table.to_csv(part, index=False, lineterminator="\r\n")
