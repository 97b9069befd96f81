"""The leaderboard as Markdown, CSV, JSON and a page; what it cost stands in files of its own.

The same matrix, version and seeds give the same bytes of ``leaderboard.*``, however many processes
made them and however often they were killed; ``costs.*`` hold what differs from time to time.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from animarl_algos.benchmark.cells import Cell, Scoring
from animarl_algos.benchmark.clones import Clone
from animarl_algos.benchmark.leaderboard_page import leaderboard_page
from animarl_algos.benchmark.measured import Measured, Score, differences, labels
from animarl_algos.benchmark.pieces import code, recorded_error, write_json
from animarl_algos.benchmark.plan import Plan
from animarl_algos.benchmark.ranks import ranked
from animarl_algos.runs.run_files import machine
from animarl_envs.files import write_then_rename

HOW = """\
Test split; rollouts from its starts. In brackets the 95 % interval over demonstrations and seeds,
of the AUC over demonstrations alone. With several seeds the others are of training runs like these,
with one of this network only. **Bold**: no larger than its null, so chance alone gives as much (for
both AUC: recordings among themselves, and at least one half; for realism, energy scores and DTW:
other recordings of the same condition). Outcome, duration, path length and speed are differences to
the recordings; realism is higher the better, and lower is better everywhere else. Ranks go by the
energy score of duration, path length and speed together, as far as paired intervals tell two
methods apart; recordings and tracking know where the recordings go and are not ranked. Parameters
and processor time stand in `costs.md`.
"""


def write_leaderboard(plan: Plan, out: Path, command: str = "") -> Path:
    """Write ``leaderboard.{md,csv,json,html}`` and ``costs.{md,csv}`` of what is finished.

    ``command`` made it, and stands with the machine in ``costs.md``.
    """
    scores: dict[str, list[Score]] = {}
    for scoring in plan.scorings:
        if scoring.finished(out):
            scores.setdefault(scoring.data, []).append(scoring.result(out))
    ranks = {name: ranked(some, plan.matrix.resamples) for name, some in scores.items()}
    rows = [
        _row(one, str(ranks[name].get(one.method, "")))
        for name, some in scores.items()
        for one in some
    ]
    missing = [
        (s.name.removesuffix("/score"), why) for s in plan.scorings if (why := _lacks(s, out))
    ]
    content = {
        "format": "animarl-leaderboard",
        "matrix": plan.resolved(),
        "code": code(),
        "rows": rows,
        "missing": [{"row": row, "why": why} for row, why in missing],
    }
    write_json(out / "leaderboard.json", content)
    _write_csv(out / "leaderboard.csv", _long(rows))
    synthetic = {world.data: world.demos.synthetic for world in plan.worlds}
    starts = {name: _starts(some, plan.matrix.folds.get(name)) for name, some in scores.items()}
    text = "".join(
        _markdown(name, some, ranks[name], synthetic[name], starts[name])
        for name, some in scores.items()
    )
    if missing:
        listed = "\n".join(f"- {row}: {why}" for row, why in missing)
        text += f"\n## Not there\n\n{listed}\n"
    with write_then_rename(out / "leaderboard.md") as part:
        part.write_text(f"# Leaderboard\n\n{HOW}{text}", encoding="utf-8")
    page = leaderboard_page(scores, ranks, synthetic, starts, code(), missing)
    with write_then_rename(out / "leaderboard.html") as part:
        part.write_text(page, encoding="utf-8")
    _write_costs(plan, out, command)
    return out / "leaderboard.md"


def measure_rows(scored: Score) -> Iterator[tuple[str, str, str, str]]:
    """Label, value with interval, null and remark of every measure, as texts."""
    for one in scored.measures:
        unit = f" ({one.unit})" if one.unit else ""
        yield labels()[one.measure] + unit, shown(one), _number(one.null), one.reason


def shown(one: Measured) -> str:
    """A value with its interval."""
    if not math.isfinite(one.value):
        return "–"
    ends = f" [{_number(one.low)}, {_number(one.high)}]" if math.isfinite(one.low) else ""
    return _number(one.value) + ends


def _row(one: Score, rank: str) -> dict[str, Any]:
    row = {k: v for k, v in one.to_json().items() if k != "energies"}
    for measure, found in zip(row["measures"], one.measures):
        measure["inside"] = found.inside
    return row | {"rank": rank}


def _long(rows: Sequence[Mapping[str, Any]]) -> Iterator[dict[str, Any]]:
    for row in rows:
        head = {
            k: row[k] for k in ("data", "method", "kind", "rank", "starts", "rollouts", "covers")
        }
        seeds = " ".join(map(str, row["seeds"]))
        for measure in row["measures"]:
            yield head | {"seeds": seeds} | measure


def _starts(scores: Sequence[Score], folds: int | None) -> str:
    """From where rollouts began, in words."""
    text = f"{max(one.starts for one in scores)} test starts"
    return text if folds is None else f"{text}, cross-validated in {folds} folds"


def _markdown(
    name: str, scores: Sequence[Score], ranks: Mapping[str, Any], synthetic: bool, starts: str
) -> str:
    """A section: its methods in the order of their energy score."""

    def place(one: Score) -> tuple[bool, float]:
        value = one.of("energy").value
        return one.method not in ranks, value if math.isfinite(value) else math.inf

    ordered = sorted(scores, key=place)
    most = max(ordered, key=lambda one: one.rollouts)
    kind = "synthetic demonstrations, recorded from no animal" if synthetic else "recordings"
    text = f"\n## {name}\n\n{starts}, of {kind}; "
    text += "beside each method seeds × rollouts.\n"
    for number, keys in enumerate(_parts()):
        heads = [_heading(most.of(key)) for key in keys]
        first = ["rank", "method"] if number == 0 else ["method"]
        lines = [[*first, *heads], ["---"] * (len(first) + len(keys))]
        for one in ordered:
            label = f"{one.method} ({len(one.seeds)} × {one.rollouts // len(one.seeds)})"
            own = [str(ranks.get(one.method, "–")), label] if number == 0 else [one.method]
            lines.append([*own, *(_marked(one.of(key)) for key in keys)])
        text += "\n" + "\n".join(f"| {' | '.join(line)} |" for line in lines) + "\n"
    return text


def _parts() -> tuple[tuple[str, ...], ...]:
    """The columns of each table: what a simulator is judged by, its differences, its closeness."""
    names, of_metrics = list(labels()), tuple(metric.key for metric in differences())
    first = names.index("outcomes")
    return (
        tuple(names[:first]),
        ("outcomes", *of_metrics),
        tuple(names[first + 1 + len(of_metrics) :]),
    )


def _heading(one: Measured) -> str:
    return labels()[one.measure] + (f" ({one.unit})" if one.unit else "")


def _marked(one: Measured) -> str:
    null = f"; null {_number(one.null)}" if math.isfinite(one.null) else ""
    text = shown(one)
    return (f"**{text}**" if one.inside else text) + null


def _number(value: float) -> str:
    return f"{value:.3g}" if math.isfinite(value) else ""


def _lacks(scoring: Scoring, out: Path) -> str:
    """Why a row is not there; empty if it is."""
    if scoring.finished(out):
        return ""
    errors = [f"{cell.name}: {why}" for cell in scoring.cells if (why := recorded_error(cell, out))]
    return "; ".join(errors) or recorded_error(scoring, out) or "not finished"


def _write_costs(plan: Plan, out: Path, command: str) -> None:
    """Processor time and parameters of every finished cell, on which machine, by which command.

    What several cells began with stands once, under its own name, as it was done once.
    """
    done: list[Cell | Clone] = [*plan.cells, *plan.clones]
    rows: list[dict[str, Any]] = [
        {"data": one.data, "method": one.method, "seed": one.seed, "fold": one.fold} | cost
        for one in done
        if (cost := one.cost(out))
    ]
    _write_csv(out / "costs.csv", rows)
    lines = ["| row | seeds | processor time of a seed (s) | parameters |", "|---|---|---|---|"]
    groups: dict[str, list[dict[str, Any]]] = {}
    for row in rows:
        beside = " beside its clone" if row["clone"] else ""
        groups.setdefault(f"{row['data']}/{row['method']}{beside}", []).append(row)
    for name, some in groups.items():
        seeds = len({row["seed"] for row in some})
        seconds = sum(row["processor_seconds"] for row in some) / seeds
        parameters = some[0]["parameters"]
        told = "–" if parameters is None else f"{parameters:,}"
        lines.append(f"| {name} | {seeds} | {seconds:.1f} | {told} |")
    with write_then_rename(out / "costs.md") as part:
        made = [f"- {name}: {value}" for name, value in machine().items()]
        if command:
            made.insert(0, f"- command: `{command}`")
        total = sum(row["processor_seconds"] for row in rows)
        made.append(f"- all cells and clones: {total:.0f} s of processor time")
        text = "\n".join(["# What it cost", "", *made, "", *lines])
        part.write_text(f"{text}\n", encoding="utf-8")


def _write_csv(path: Path, rows: Iterable[Mapping[str, Any]]) -> None:
    listed = list(rows)
    with write_then_rename(path) as part, part.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(listed[0]) if listed else ["data"])
        writer.writeheader()
        writer.writerows(listed)
