"""A figure of the shifts, and the words to paste."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from animarl_algos.evaluation.tables import write_tables
from animarl_algos.whatif.answer import WhatIf
from animarl_algos.whatif.extrapolation import RED, YELLOW, Caution
from animarl_envs.files import all_files_or_none

if TYPE_CHECKING:
    import pandas as pd

WHAT_IT_IS = (
    "The same behaviour in another world: nobody learns, and nobody adapts. A thrust is not a "
    "speed: a change of speed is met by a thrust that was found by simulation. Baseline and "
    "scenario start from the same recordings and meet the same random numbers. The interval (95 %) "
    "speaks of {covers}, not of the training recordings{null}. A shift that is smaller than the "
    "gap between the unchanged simulation and the recordings is no finding."
)
FORMATS = ("svg", "pdf", "png")


def save_answers(found: WhatIf, folder: str | Path) -> None:
    """Write ``whatif.csv``, ``whatif.parquet``, figures and ``README.md``, all or nothing."""
    with all_files_or_none(folder) as part:
        write_tables({"whatif": found.table}, part)
        save_figure(found, part)
        (part / "README.md").write_text(words(found), encoding="utf-8")


def save_figure(found: WhatIf, folder: Path) -> None:
    """Write ``shifts.svg``, ``.pdf`` and ``.png``: one panel per quantity, one row per scenario.

    Hollow points are behind a warning, hatched bands say how far the unchanged simulation is from
    the recordings.
    """
    import matplotlib

    with matplotlib.rc_context({"svg.hashsalt": "animarl", "svg.fonttype": "none"}):
        figure = _figure(found.table)
        for kind in FORMATS:
            metadata: dict[str, Any] = {"Date": None} if kind == "svg" else {}
            if kind == "pdf":
                metadata = {"CreationDate": None}
            figure.savefig(folder / f"shifts.{kind}", dpi=200, metadata=metadata)


def _figure(table: pd.DataFrame) -> Any:
    from matplotlib.figure import Figure

    quantities = list(dict.fromkeys(table["quantity"]))
    scenarios = list(dict.fromkeys(table["scenario"]))
    columns = min(3, len(quantities))
    rows = -(-len(quantities) // columns)
    figure = Figure(
        figsize=(3.2 * columns + 1.5, rows * (0.8 + 0.28 * len(scenarios))), layout="constrained"
    )
    axes = figure.subplots(rows, columns, squeeze=False, sharey=True)
    for axis, quantity in zip(axes.flat, quantities):
        chosen = table[table["quantity"] == quantity].set_index("scenario").loc[scenarios]
        gap = abs(float(chosen["gap"].iloc[0]))
        axis.axvspan(-gap, gap, facecolor="none", edgecolor="0.75", hatch="///", linewidth=0)
        axis.axvline(0.0, color="0.4", linewidth=0.8)
        for place, (_, row) in enumerate(chosen.iterrows()):
            trusted = row["warning"] == Caution.NONE
            axis.plot([row["low"], row["high"]], [place, place], color="0.2", linewidth=1.2)
            axis.plot(
                row["shift"], place, "o", color="C0", markersize=5,
                markerfacecolor="C0" if trusted else "white",
            )  # fmt: skip
        axis.set_yticks(range(len(scenarios)), scenarios)
        axis.set_title(quantity, fontsize=9)
        axis.set_xlabel(f"shift [{chosen['unit'].iloc[0]}]", fontsize=8)
        axis.tick_params(labelsize=8)
    axes[0, 0].invert_yaxis()
    for axis in axes.flat[len(quantities) :]:
        axis.set_axis_off()
    return figure


def words(found: WhatIf) -> str:
    """Return what was found as Markdown to paste."""
    table = found.table
    null = ""
    if table["p"].notna().any():
        null = ", of which p does: how often networks of permuted conditions shift as far"
    lines = ["# What if", "", WHAT_IT_IS.format(covers=table["covers"].iloc[0], null=null), ""]
    for answer in found.answers:
        lines += [f"## {answer.scenario.name}", ""]
        if answer.thrusts:
            took = ", ".join(f"{name} x{factor:.3g}" for name, factor in answer.thrusts.items())
            lines += [f"Thrusts that the speeds took: {took}.", ""]
        if answer.reason:
            lines += [f"**Warning ({answer.warning})**: {answer.reason}.", ""]
        lines += ["| quantity | recorded | baseline | changed | shift |", "|---|---|---|---|---|"]
        lines += [_row(row) for _, row in answer.table.iterrows()]
        lines += ["", *_sentences(answer.table), ""]
    lines += [
        f"Warnings: *some* above {YELLOW:.0%} and *red* above {RED:.0%} more steps than usual with "
        "an input beyond the central 99.8 % of the training inputs.",
        "",
    ]
    return "\n".join(lines)


def _row(row: pd.Series) -> str:
    numbers = [f"{row[key]:.3g}" for key in ("recorded", "baseline", "changed")]
    shift = f"{row['shift']:+.3g} [{row['low']:.3g}, {row['high']:.3g}] {row['unit']}"
    p = f", p = {row['p']:.3g}" if row["p"] == row["p"] else ""
    return f"| {row['quantity']} | {' | '.join(numbers)} | {shift}{p} |"


def _sentences(table: pd.DataFrame) -> list[str]:
    """One sentence for each finding; one where there is none."""
    found = table[table["finding"]]
    if len(found) == 0:
        red = (table["warning"] == Caution.RED).any()
        return ["This answer is a guess." if red else "No shift is clear of chance and of the gap."]
    return [
        f"- {row['quantity']} {'rises' if row['shift'] > 0 else 'falls'} by "
        f"{abs(row['shift']):.3g} {row['unit']} [{row['low']:.3g}, {row['high']:.3g}]."
        for _, row in found.iterrows()
    ]
