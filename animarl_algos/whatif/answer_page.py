"""The folder of an answer: tables, words to paste, and a page with figures and a player."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from animarl_algos.evaluation.comparison import write_tables
from animarl_algos.evaluation.rollouts import Rollouts
from animarl_algos.evaluation.statistics import Interval
from animarl_algos.report import page, player, style
from animarl_algos.report.inputs import PageInputs, provenance, to_paste
from animarl_algos.report.style import figure_style, to_image
from animarl_algos.report.words import MINUS, capitalised, number, scaled, with_interval
from animarl_algos.whatif.answer import Answer, WhatIf
from animarl_algos.whatif.changes import Amount
from animarl_algos.whatif.extrapolation import RED, YELLOW, Caution
from animarl_envs.files import all_files_or_none

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

WHAT_IT_IS = (
    "The same behaviour in another world: nobody learns, and nobody adapts. A thrust is not a "
    "speed: a change of speed is met by a thrust that was found by simulation. Baseline and "
    "scenario start from the same recordings and meet the same random numbers. The interval (95 %) "
    "speaks of {covers}, not of the choice of the training recordings{null}. A shift that is "
    "smaller than the gap between the unchanged simulation and the recordings is no finding."
)
GUESS = "This answer is a guess."
WARNINGS = (
    f"A warning is some above {YELLOW:.0%} and red above {RED:.0%} more steps than in the "
    "unchanged world in which an individual perceives what lies beyond the central 99.8 % of its "
    "training inputs. No warning is no guarantee."
)
SIGNS = {Caution.NONE: ("green", "="), Caution.SOME: ("amber", "~"), Caution.RED: ("red", "?")}
MOST_PLAYED = 6  # scenarios in the player
RECORDED, UNCHANGED = "recorded", "unchanged"


def save_answers(
    found: WhatIf, folder: str | Path, *, command: str = "", versions: Mapping[str, str] = {}
) -> None:
    """Write tables, ``README.md``, ``report.html`` and figures, all or nothing.

    Parameters
    ----------
    command, versions
        What repeats the answer, and of which packages, for the page.
    """
    with all_files_or_none(folder) as part:
        write_tables({"whatif": found.table}, part)
        (part / "README.md").write_text(words(found), encoding="utf-8")
        answer_page(found, command, versions).write(part)


# -- words ----------------------------------------------------------------------------------------


def what_it_is(found: WhatIf) -> str:
    """Return what an answer is, and what its interval covers."""
    table = found.table
    null = ""
    if table["p"].notna().any():
        null = ", of which p does: how often networks of permuted conditions shift as far"
    return WHAT_IT_IS.format(covers=table["covers"].iloc[0], null=null)


def words(found: WhatIf) -> str:
    """Return what was found as Markdown to paste."""
    lines = ["# What if", "", what_it_is(found), ""]
    for answer in found.answers:
        lines += [f"## {answer.scenario.name}", ""]
        lines += [f"{sentence}\n" for sentence in asides(answer)]
        lines += ["| quantity | recorded | baseline | changed | shift |", "|---|---|---|---|---|"]
        for _, row in answer.table.iterrows():
            numbers = [f"{row[key]:.3g}" for key in ("recorded", "baseline", "changed")]
            shift = f"{row['shift']:+.3g} [{row['low']:.3g}, {row['high']:.3g}] {row['unit']}"
            p = f", p = {row['p']:.3g}" if row["p"] == row["p"] else ""
            lines.append(f"| {row['quantity']} | {' | '.join(numbers)} | {shift}{p} |")
        lines += ["", *(f"- {sentence}" for sentence in findings(answer)), ""]
    return "\n".join([*lines, WARNINGS, ""])


def asides(answer: Answer) -> Iterator[str]:
    """Yield in sentences what thrusts a wanted speed took, and the warning."""
    if answer.thrusts:
        took = ", ".join(f"{name} x{factor:.3g}" for name, factor in answer.thrusts.items())
        yield f"Thrusts that the speeds took: {took}."
    if answer.reason:
        yield f"Warning ({answer.warning}): {answer.reason}."


def findings(answer: Answer) -> list[str]:
    """Return a sentence for each finding; one where there is none."""
    table = answer.table
    if answer.warning == Caution.RED:
        return [GUESS]
    return [
        f"{capitalised(row['quantity'])} {row['judged']} by "
        f"{abs(row['shift']):.3g} {row['unit']} "
        f"[{', '.join(f'{abs(end):.3g}' for end in sorted((row['low'], row['high']), key=abs))}]."
        for _, row in table[table["finding"]].iterrows()
    ] or ["No shift is clear of chance and of the gap."]


# -- the page -------------------------------------------------------------------------------------


def answer_page(found: WhatIf, command: str = "", versions: Mapping[str, str] = {}) -> page.Page:
    """Return the page: findings and warnings, the player, shifts, figures, words to paste."""
    inputs = PageInputs(
        demos=found.demos, species=found.species, command=command, versions=versions
    )
    names = [answer.scenario.name for answer in found.answers]
    said = [f"{a.scenario.name}: {' '.join(findings(a))}" for a in found.answers]
    more = f" and {len(names) - 1} more" if len(names) > 1 else ""
    rollouts = f"{found.repetitions} from each start" + f" and of {found.runs} training seeds" * (
        found.runs > 1
    )
    return page.Page(
        title=f"{names[0]}{more}",
        kind="What if?",
        synthetic=found.demos.synthetic,
        facts=[
            ("Species", found.species.name),
            ("Starts", f"{len(found.demos)} test episodes"),
            ("Rollouts", rollouts),
            ("Policies act by", "habit" if found.reading == "habit" else "knowing their bodies"),
        ],
        lead=_lead(found),
        player=_player(found, inputs),
        sections=[
            page.Section("short", "In short", list(_in_short(found))),
            page.Section("shifts", "Shifts", [_shift_table(found, inputs)]),
            page.Section("figures", "Figures", [_figures(found)]),
            page.Section("provenance", "How this was made", list(provenance(inputs, "page"))),
            page.Section("paste", "To paste", list(to_paste(inputs, [what_it_is(found), *said]))),
        ],
    )


def _lead(found: WhatIf) -> page.Lead:
    warnings = [answer.warning for answer in found.answers]
    worst = next(one for one in (Caution.RED, Caution.SOME, Caution.NONE) if one in warnings)
    first, *others = found.answers
    headline, *said = findings(first)
    if others:
        clear = sum(bool(answer.table["finding"].any()) for answer in found.answers)
        headline, said = (
            f"{clear} of {len(found.answers)} changes shift something beyond chance and beyond the "
            "gap to the recordings.",
            [],
        )
    cautions = [f"{a.scenario.name}: {a.reason}." for a in found.answers if a.reason]
    judgement = "the same behaviour in another world"
    return page.Lead(judgement, *SIGNS[worst], headline, [*said, what_it_is(found)], cautions)


def _in_short(found: WhatIf) -> Iterator[page.Block]:
    said = [f"{a.scenario.name}: {' '.join([*findings(a), *asides(a)])}" for a in found.answers]
    yield page.Text(said, "sentences")
    yield page.Text(WARNINGS)


def _shift_table(found: WhatIf, inputs: PageInputs) -> page.Table:
    columns = ["Quantity", inputs.recorded, UNCHANGED, "changed", "Shift [95 % interval]"]
    columns += [f"Gap: {UNCHANGED}\n{MINUS} {inputs.recorded}", "Shift is"]
    return page.Table(
        "Shifts",
        list(map(capitalised, columns)),
        [
            page.Group(answer.scenario.name, [_row(row) for _, row in answer.table.iterrows()])
            for answer in found.answers
        ],
        "Means over starts. Grey: no finding, because the shift is not clear of zero, smaller than "
        "the gap, or as large with permuted conditions (p). Hatched: behind a red warning.",
    )


def _row(row: pd.Series) -> page.Row:
    percent = row["unit"] == "share"
    cells = [f"{row['quantity']} ({'%' if percent else row['unit']})"]
    factor = 100.0 if percent else 1.0
    cells += [number(factor * row[key]) for key in ("recorded", "baseline", "changed")]
    shift = scaled(Interval(row["shift"], row["low"], row["high"]), factor)
    p = f" (p = {number(row['p'], 2)})" if row["p"] == row["p"] else ""
    cells += [with_interval(shift), number(factor * row["gap"]), row["judged"] + p]
    red = row["warning"] == Caution.RED
    return page.Row(cells, faint=not row["finding"], hatched=red)


# -- figures --------------------------------------------------------------------------------------


def _figures(found: WhatIf) -> page.Gallery:
    images = [to_image(_shift_figure(found.table), "Shift of every quantity by change")]
    caption = (
        "Shift of every quantity with its 95 % interval. Grey: within the gap between the "
        "unchanged simulation and the recordings. Hollow: behind a warning; hatched: a red one."
    )
    doses = _doses(found)
    if doses is not None:
        images.append(to_image(_dose_figure(found, *doses), f"Dose and response: {doses[0]}"))
        caption += " Dose and response: changed means over the amount of the change, with the "
        caption += "interval of their shift; dashed: recorded."
    return page.Gallery(images, caption)


def _grid(count: int, width: float, height: float, **options: Any) -> tuple[Figure, Any]:
    columns = min(3, count)
    rows = -(-count // columns)
    figure, axes = style.new_figure(width * columns + 1.2, height * rows, rows, columns)
    axes = np.atleast_1d(axes).ravel()
    for axis in axes[count:]:
        axis.set_axis_off()
    return figure, axes


def _shift_figure(table: pd.DataFrame) -> Figure:
    """One panel per quantity, one row per scenario."""
    quantities = list(dict.fromkeys(table["quantity"]))
    scenarios = list(dict.fromkeys(table["scenario"]))
    with figure_style():
        figure, axes = _grid(len(quantities), 2.6, 0.9 + 0.24 * len(scenarios))
        for k, (axis, quantity) in enumerate(zip(axes, quantities)):
            chosen = table[table["quantity"] == quantity].set_index("scenario")
            gap = abs(float(chosen["gap"].iloc[0]))
            axis.axvspan(-gap, gap, facecolor=style.LINE.hex, linewidth=0, zorder=0)
            axis.axvline(0.0, color=style.MUTED.hex, linewidth=0.7)
            for place, scenario in enumerate(scenarios):
                if scenario not in chosen.index:  # of somebody who is removed in it
                    continue
                row = chosen.loc[scenario]
                if row["warning"] == Caution.RED:
                    axis.axhspan(
                        place - 0.4, place + 0.4, facecolor="none", edgecolor=style.STONE.hex,
                        hatch="////", linewidth=0, zorder=0.5,
                    )  # fmt: skip
                colour = style.BLUE.hex if row["finding"] else style.MUTED.hex
                axis.plot([row["low"], row["high"]], [place] * 2, color=colour, linewidth=1.6)
                axis.plot(row["shift"], place, "o", **_dot(row, colour))
            axis.set_yticks(range(len(scenarios)), scenarios if k % 3 == 0 else [])
            axis.set_ylim(len(scenarios) - 0.5, -0.5)
            axis.set_title(quantity)
            axis.set_xlabel(f"shift ({chosen['unit'].iloc[0]})")
    return figure


def _dot(row: pd.Series, colour: str) -> dict[str, Any]:
    trusted = row["warning"] == Caution.NONE
    face = colour if trusted else style.PAGE.hex
    return {"color": colour, "markersize": 5, "markerfacecolor": face}


def _doses(found: WhatIf) -> tuple[str, list[float]] | None:
    """What a sweep changes, and by how much; nothing if one change is not asked at 3 doses."""
    doses: list[float] = []
    subjects = set()
    for answer in found.answers:
        if len(answer.scenario.changes) != 1:
            return None
        (change,) = answer.scenario.changes
        if not isinstance(change.amount, Amount):
            return None
        subjects.add((change.text.partition("=")[0], change.amount.is_factor, change.amount.unit))
        doses.append(change.amount.value)
    if len(subjects) != 1 or len(set(doses)) < 3:
        return None
    ((name, is_factor, unit),) = subjects
    return f"{name} ({'factor' if is_factor else unit or 'value'})", doses


def _dose_figure(found: WhatIf, name: str, doses: list[float]) -> Figure:
    """One panel per quantity: its mean over the amount of the change."""
    table = found.table
    quantities = list(dict.fromkeys(table["quantity"]))
    with figure_style():
        figure, axes = _grid(len(quantities), 2.6, 1.9)
        for axis, quantity in zip(axes, quantities):
            rows = table[table["quantity"] == quantity]
            order = np.argsort(doses)
            axis.plot(np.array(doses)[order], rows["changed"].to_numpy()[order],
                      color=style.LINE.hex, zorder=1)  # fmt: skip
            axis.axhline(rows["recorded"].iloc[0], color=style.TARGET.hex, linewidth=0.9,
                         linestyle="--")  # fmt: skip
            for dose, (_, row) in zip(doses, rows.iterrows(), strict=True):
                ends = [row["baseline"] + row["low"], row["baseline"] + row["high"]]
                axis.plot([dose] * 2, ends, color=style.BLUE.hex, linewidth=1.4)
                axis.plot(dose, row["changed"], "o", **_dot(row, style.BLUE.hex))
            axis.set_title(quantity)
            axis.set_ylabel(rows["unit"].iloc[0])
            axis.set_xlabel(name)
    return figure


# -- the player -----------------------------------------------------------------------------------


def _player(found: WhatIf, inputs: PageInputs) -> page.Player:
    """Play the unchanged world beside each change, and beside the recordings."""
    played = found.answers[:MOST_PLAYED]
    views = []
    for k, answer in enumerate(played):
        guess = " (a guess)" if answer.warning == Caution.RED else ""
        changed = inputs.stage.of(answer.species)
        views.append(
            player.view(f"change-{k}", UNCHANGED, UNCHANGED, f"{answer.scenario.name}{guess}",
                 f"change-{k}", changed)
        )  # fmt: skip
    views.append(player.view(UNCHANGED, inputs.recorded, RECORDED, UNCHANGED, UNCHANGED))
    recorded = Rollouts.from_demonstrations(found.demos)
    quantity = next(found.quantities())
    first = played[0].rollouts
    shift = quantity.values(first) - quantity.values(found.baseline)
    of_first = np.flatnonzero(found.baseline.repetition == 0)[: len(found.demos)]
    chosen = of_first[
        player.at_ranks(
            shift[of_first], found.baseline.demo[of_first], player.middles(player.STARTS)
        )
    ].tolist()
    scenes = []
    for i in chosen:
        start = int(found.baseline.demo[i])
        tracks = {RECORDED: (recorded, start), UNCHANGED: (found.baseline, i)}
        tracks |= {f"change-{k}": (answer.rollouts, i) for k, answer in enumerate(played)}
        scenes.append((f"Start {start}", tracks))
    said = f"{len(scenes)} test starts, in both worlds with the same random numbers."
    return player.play(inputs, scenes, views, said)
