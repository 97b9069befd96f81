"""The leaderboard as Markdown, CSV and JSON; what it cost stands in files of its own.

The same matrix, version and seeds give the same bytes of ``leaderboard.*``, however many processes
made them and however often they were killed; ``costs.*`` hold what differs from time to time.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from animarl_algos.benchmark.matrix import Plan
from animarl_algos.benchmark.pieces import Cell, Clone, Scoring, code, write_json
from animarl_algos.benchmark.scores import ENERGY, Score, differences, labels, ranked
from animarl_algos.evaluation.statistics import Interval
from animarl_algos.evaluation.verdict_rows import OUTCOMES
from animarl_algos.report.words import NOTHING, number, with_interval
from animarl_algos.runs.run_files import machine
from animarl_envs.drawing import markdown_table
from animarl_envs.files import write_then_rename

HOW = """\
Test split; rollouts from its starts. In brackets the 95 % interval over demonstrations and seeds,
of the AUC over demonstrations alone. With several seeds the others are of training runs like these,
with one of this network only. **Bold**: the verdict finds no difference in it; of realism, energy
score and DTW, as good as those of other recordings of the same condition. Outcome, duration, path
length and speed are differences to the recordings; realism is higher the better, and lower is
better everywhere else. Ranks go by the energy score of duration, path length and speed together, as
far as paired intervals tell two methods apart; recordings and tracking know where the recordings go
and are not ranked. Parameters and processor time stand in `costs.md`.
"""


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
        written = {
            one.method: dict(zip(one.measures.index, measure_rows(one))) for one in self.scores
        }
        known = {key: cells[0] for rows in written.values() for key, cells in rows.items()}
        names = [key for key in labels() if key in known]
        compared = {OUTCOMES, *(metric.key for metric in differences())}

        def cell(one: Score, key: str) -> str:
            if key not in written[one.method]:
                return NOTHING
            _, value, null, _ = written[one.method][key]
            marked = f"**{value}**" if one.of(key).inside else value
            return marked if null == NOTHING else f"{marked}; null {null}"

        first = next(i for i, key in enumerate(names) if key in compared)
        last = first + len(compared.intersection(names))
        for keys in (names[:first], names[first:last], names[last:]):
            lines = []
            for one in sorted(self.scores, key=place):
                each = f"{one.method} ({len(one.seeds)} × {one.rollouts // len(one.seeds)})"
                cells = (cell(one, key) for key in keys)
                lines.append([self.ranks.get(one.method, NOTHING), each, *cells])
            head = ["rank", "method", *(known[key] for key in keys)]
            text += f"\n{markdown_table(head, lines)}\n"
        return text


def write_leaderboard(plan: Plan, out: Path, command: str = "") -> Path:
    """Write ``leaderboard.{md,csv,json}`` and ``costs.{md,csv}`` of what is finished.

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
    _write_costs(plan, out, command)
    return out / "leaderboard.md"


def measure_rows(scored: Score) -> Iterator[tuple[str, str, str, str]]:
    """Yield label, value with interval, null and remark of every measure, as texts."""
    for key, one in scored.measures.iterrows():
        value = with_interval(Interval(one.value, one.low, one.high))
        name = labels()[str(key)] + (f" ({one.unit})" if one.unit else "")
        yield name, value, number(one.null), one.reason


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
    lines = []
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
        head = ("row", "seeds", "processor time of a seed (s)", "parameters")
        table = markdown_table(head, lines)
        part.write_text(f"# What it cost\n\n{said}\n\n{table}\n", encoding="utf-8")


def _write_csv(path: Path, rows: Iterable[dict[str, Any]]) -> None:
    with write_then_rename(path) as part:
        table = pd.DataFrame(rows, dtype=object)
        table.to_csv(part, index=False, lineterminator="\r\n")
