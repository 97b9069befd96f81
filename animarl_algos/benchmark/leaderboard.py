"""The leaderboard as Markdown, CSV, JSON and a page; what it cost stands in files of its own.

The same matrix, version and seeds give the same bytes of ``leaderboard.*``, however many processes
made them and however often they were killed; ``costs.*`` hold what differs from time to time.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from animarl_algos.benchmark.matrix import Plan
from animarl_algos.benchmark.pieces import Cell, Clone, Scoring, code, write_json
from animarl_algos.benchmark.scores import (
    ENERGY,
    REALISM,
    Score,
    differences,
    labels,
    ranked,
)
from animarl_algos.evaluation.classifier import AUC, SEQUENCE
from animarl_algos.evaluation.statistics import Interval
from animarl_algos.report.figures import interval_rows
from animarl_algos.report.page import (
    Block,
    Gallery,
    Page,
    Pairs,
    Section,
    Sentences,
    tabulate,
    write_page,
)
from animarl_algos.report.provenance import flattened
from animarl_algos.report.style import Image, to_image
from animarl_algos.report.words import NOTHING
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
CAPTION = (
    "Dots with 95 % intervals over demonstrations and seeds, of the AUC over demonstrations alone. "
    "Grey bars, of differences to the recordings: what chance alone gives in 95 % of cases. "
    "Dashed: no difference; for the AUC what recordings reach among themselves, for energy scores "
    "and DTW what other recordings of the same condition come to."
)


class Board:
    """The methods of one set of demonstrations, in the order of their energy score."""

    def __init__(self, plan: Plan, name: str, scores: Sequence[Score]) -> None:
        self.name, self.scores = name, scores
        self.ranks = ranked(scores, plan.matrix.resamples)
        self.synthetic = next(w.demos.synthetic for w in plan.worlds if w.data == name)
        folds = plan.matrix.folds.get(name)
        self.starts = f"{max(one.starts for one in scores)} test starts"
        self.starts += "" if folds is None else f", cross-validated in {folds} folds"

    def rows(self) -> Iterator[dict[str, Any]]:
        """Yield what the files hold of each method."""
        for one in self.scores:
            head = {
                "data": self.name, "kind": one.kind, "method": one.method, "seeds": one.seeds,
                "starts": one.starts, "rollouts": one.rollouts, "covers": one.covers,
                "words": one.words, "rank": self.ranks.get(one.method, ""),
            }  # fmt: skip
            table = one.measures.reset_index().astype(object)
            yield head | {"measures": table.where(table.notna(), None).to_dict("records")}

    def headings(self) -> dict[str, str]:
        """Return the measures that these animals have, with their units, by key."""
        units = max(self.scores, key=lambda one: one.rollouts).measures["unit"]
        return {k: name + _bracketed(units[k]) for k, name in labels().items() if k in units.index}

    def markdown(self) -> str:
        """Return a section: what a simulator is judged by, its differences, its closeness."""

        def place(one: Score) -> tuple[bool, float]:
            value = one.of(ENERGY).value
            return one.method not in self.ranks, value if math.isfinite(value) else math.inf

        kind = "synthetic demonstrations, recorded from no animal" if self.synthetic else ""
        text = (
            f"\n## {self.name}\n\n{self.starts}, of {kind or 'recordings'}; beside each method "
            "seeds × rollouts.\n"
        )
        headings = self.headings()
        names, compared = list(headings), {"outcomes", *(metric.key for metric in differences())}
        first = next(i for i, key in enumerate(names) if key in compared)
        last = first + len(compared.intersection(names))
        for keys in (names[:first], names[first:last], names[last:]):
            lines = [["method", *(headings[key] for key in keys)], ["---"] * (1 + len(keys))]
            for one in sorted(self.scores, key=place):
                lines.append([one.method, *(_marked(one.of(key)) for key in keys)])
                if keys[0] == names[0]:
                    each = f" ({len(one.seeds)} × {one.rollouts // len(one.seeds)})"
                    lines[-1][:1] = [self.ranks.get(one.method, NOTHING), one.method + each]
            if keys[0] == names[0]:
                lines[0].insert(0, "rank")
                lines[1].append("---")
            text += f"\n{_markdown_table(lines)}\n"
        return text

    def blocks(self) -> Iterator[Block]:
        """Yield plots of the main measures and a table of all."""
        there, own = self.headings(), [metric.key for metric in differences()]
        drawn = [REALISM, AUC, SEQUENCE, ENERGY, *own, "dtw_per_step", "dtw_first_second"]
        pictures = (self._picture(key, key in own) for key in drawn if key in there)
        yield Gallery([one for one in pictures if one], CAPTION)

        def value(key: str) -> Any:
            return lambda one: _number(one.of(key).value) or NOTHING

        yield tabulate(
            "All measures",
            {
                "Method": lambda one: one.method,
                "Rank": lambda one: self.ranks.get(one.method, NOTHING),
                **{h.replace(" (", "\n("): value(key) for key, h in there.items()},
            },
            [("", self.scores)],
            "Estimates; intervals and nulls of every one are in leaderboard.csv. Endings to path "
            "length are distances and differences to the recordings.",
        )

    def _picture(self, key: str, is_difference: bool) -> Image | None:
        """One measure of all methods that have it."""
        rows = {one.method: one.of(key) for one in self.scores}
        found = {name: row for name, row in rows.items() if math.isfinite(row.value)}
        if not found:
            return None
        label, unit = labels()[key], next(iter(found.values())).unit
        nulls = [row.null for row in found.values() if math.isfinite(row.null)]
        reference = sum(nulls) / len(nulls) if nulls else math.nan
        figure = interval_rows(
            {name: Interval(row.value, row.low, row.high) for name, row in found.items()},
            unit or label,
            title=label,
            reference=0.0 if is_difference else reference,
            bands={name: Interval(0.0, -row.null, row.null) for name, row in found.items()}
            if is_difference
            else None,
        )
        return to_image(figure, f"{label} of every method, with intervals")


def write_leaderboard(plan: Plan, out: Path, command: str = "") -> Path:
    """Write ``leaderboard.{md,csv,json,html}`` and ``costs.{md,csv}`` of what is finished.

    ``command`` made it, and stands with the machine in ``costs.md``.
    """
    scores: dict[str, list[Score]] = {}
    missing = {}
    for scoring in plan.scorings:
        if scoring.finished(out):
            scores.setdefault(scoring.data, []).append(scoring.result(out))
        else:
            missing[scoring.name.removesuffix("/score")] = _reason(scoring, out)
    boards = [Board(plan, name, some) for name, some in scores.items()]
    rows = [row for board in boards for row in board.rows()]
    content = {
        "format": "animarl-leaderboard",
        "matrix": plan.resolved(),
        "code": code(),
        "rows": rows,
        "missing": [{"row": row, "why": why} for row, why in missing.items()],
    }
    write_json(out / "leaderboard.json", content)
    head = ("data", "method", "kind", "rank", "starts", "rollouts", "covers")
    _write_csv(
        out / "leaderboard.csv",
        (
            {key: row[key] for key in head} | {"seeds": " ".join(map(str, row["seeds"]))} | measure
            for row in rows
            for measure in row["measures"]
        ),
    )
    text = "".join(board.markdown() for board in boards)
    if missing:
        listed = "\n".join(f"- {row}: {why}" for row, why in missing.items())
        text += f"\n## Not there\n\n{listed}\n"
    with write_then_rename(out / "leaderboard.md") as part:
        part.write_text(f"# Leaderboard\n\n{HOW}{text}", encoding="utf-8")
    write_page(_page(boards, missing), out / "leaderboard.html")
    _write_costs(plan, out, command)
    return out / "leaderboard.md"


def _page(boards: Sequence[Board], missing: dict[str, str]) -> Page:
    """The page; the same scores give the same bytes."""
    listed = tabulate(
        "Rows that are not there",
        {"Row": lambda one: one[0], "Why": lambda one: one[1]},
        [("", missing.items())],
        "",
    )
    plain = HOW.replace("**Bold**", "Bold, in leaderboard.md").replace("`", "").strip()
    reading = re.split(r"(?<=[.])\s", plain)
    return Page(
        title="Leaderboard",
        kind="Every method, every set of demonstrations, every seed",
        synthetic=bool(boards) and all(board.synthetic for board in boards),
        facts=[
            (board.name, board.starts + (", synthetic" if board.synthetic else ""))
            for board in boards
        ],
        sections=[
            Section("reading", "How to read it", [Sentences(reading)]),
            *(Section(board.name, board.name, list(board.blocks())) for board in boards),
            Section("missing", "Not there", [listed] if missing else []),
            Section("versions", "Versions", [Pairs("Versions", flattened(code()))]),
        ],
    )


def measure_rows(scored: Score) -> Iterator[tuple[str, str, str, str]]:
    """Yield label, value with interval, null and remark of every measure, as texts."""
    for key, one in scored.measures.iterrows():
        name = labels()[str(key)] + _bracketed(one.unit)
        yield name, _shown(one), _number(one.null), one.reason


def _shown(one: Any) -> str:
    """A value with its interval."""
    ends = f" [{_number(one.low)}, {_number(one.high)}]" if math.isfinite(one.low) else ""
    return f"{_number(one.value)}{ends}" if math.isfinite(one.value) else NOTHING


def _marked(one: Any) -> str:
    null = f"; null {_number(one.null)}" if math.isfinite(one.null) else ""
    return (f"**{_shown(one)}**" if one.inside else _shown(one)) + null


def _number(value: float) -> str:
    return f"{value:.3g}" if math.isfinite(value) else ""


def _bracketed(unit: str) -> str:
    return f" ({unit})" if unit else ""


def _reason(scoring: Scoring, out: Path) -> str:
    """Why a row is not there."""
    errors = [f"{cell.name}: {why}" for cell in scoring.cells if (why := cell.error(out))]
    return "; ".join(errors) or scoring.error(out) or "not finished"


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
    groups: dict[str, list[dict[str, Any]]] = {}
    for row in rows:
        beside = " beside its clone" if row["clone"] else ""
        groups.setdefault(f"{row['data']}/{row['method']}{beside}", []).append(row)
    lines = [["row", "seeds", "processor time of a seed (s)", "parameters"], ["---"] * 4]
    for name, some in groups.items():
        seeds = len({row["seed"] for row in some})
        seconds = sum(row["processor_seconds"] for row in some) / seeds
        parameters = some[0]["parameters"]
        told = NOTHING if parameters is None else f"{parameters:,}"
        lines.append([name, str(seeds), f"{seconds:.1f}", told])
    total = sum(row["processor_seconds"] for row in rows)
    made = {"command": f"`{command}`"} if command else {}
    made |= machine() | {"all cells and clones": f"{total:.0f} s of processor time"}
    said = "\n".join(f"- {name}: {value}" for name, value in made.items())
    with write_then_rename(out / "costs.md") as part:
        table = _markdown_table(lines)
        part.write_text(f"# What it cost\n\n{said}\n\n{table}\n", encoding="utf-8")


def _markdown_table(lines: Iterable[Sequence[str]]) -> str:
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _write_csv(path: Path, rows: Iterable[dict[str, Any]]) -> None:
    with write_then_rename(path) as part:
        table = pd.DataFrame(rows, dtype=object)
        table.to_csv(part, index=False, lineterminator="\r\n")
