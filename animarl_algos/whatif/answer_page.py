"""The folder of an answer: tables, words to paste, and a page with figures and a player."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from animarl_algos.evaluation.comparison import write_tables
from animarl_algos.evaluation.prepared import censored
from animarl_algos.evaluation.rollouts import Rollouts
from animarl_algos.evaluation.statistics import Interval
from animarl_algos.report import figures, page, player, style
from animarl_algos.report.inputs import PageInputs, provenance, to_paste
from animarl_algos.report.style import Image, to_image
from animarl_algos.report.words import MINUS, Words, capitalised, number, scaled, with_interval
from animarl_algos.whatif.answer import Answer, WhatIf
from animarl_algos.whatif.changes import Amount
from animarl_algos.whatif.extrapolation import RED, YELLOW, Caution
from animarl_algos.whatif.quantities import quantities_of
from animarl_algos.whatif.shifts import NO_INTERVAL
from animarl_envs.demos.summary import stand_in_note, unit_of
from animarl_envs.drawing import markdown_table
from animarl_envs.files import all_files_or_none

if TYPE_CHECKING:
    import pandas as pd

WHAT_IT_IS = (
    "The same behaviour in another world: nobody learns, and nobody adapts. A thrust is not a "
    "speed: a change of speed is met by a thrust that was found by simulation. Baseline and "
    "scenario start from the same recordings and meet the same random numbers. The interval (95 %) "
    "speaks of {covers} and of the chance of {rollouts}, not of the choice of the training "
    "recordings{null}. The error behind ± is of this chance alone: the mean of other rollouts "
    "from the same starts lies so near in 95 of 100 cases. A shift that is smaller than the gap "
    "between the unchanged simulation and the recordings is no finding."
)
FAMILY = (
    "The intervals of a quantity hold together over all {} answers, so that one of twenty such "
    "questions has a shift outside by chance, not one of twenty answers."
)
CUT = (
    "Some recordings were cut: there the gap looks at the simulation as far as its recording "
    "goes, and all else at whole episodes."
)
GUESS = "This answer is a guess."
WARNINGS = (
    f"A warning is some above {YELLOW:.0%} and red above {RED:.0%} more steps than in the "
    "unchanged world in which an individual perceives what lies beyond the central 99.8 % of its "
    "training inputs. No warning is no guarantee. The calibrated interval also covers how far such "
    "answers were wrong in worlds with a known truth: it grows with the difference between habit "
    "and knowledge of a changed body and with that to a second simulator with other inputs. The "
    "calibrated shift by a condition is corrected by what the simulator misses of it in the "
    "recordings that were learned from. Where both simulators disagree beyond their intervals and "
    "their gaps, it cannot be told from these recordings."
)
SIGNS = {Caution.NONE: ("green", "="), Caution.SOME: ("amber", "~"), Caution.RED: ("red", "?")}
SMALLEST_SHIFT = 1e-9  # on an axis; a smaller one is of rounding errors
MOST_PLAYED = 6  # scenarios in the player
MOST_NAMED = 12  # measures that a terminal names
RECORDED, UNCHANGED = "recorded", "unchanged"


def save_answers(
    result: WhatIf, folder: str | Path, *, command: str = "", versions: Mapping[str, str] = {}
) -> None:
    """Write tables, ``README.md``, ``report.html`` and figures, all or nothing.

    Parameters
    ----------
    command, versions
        What repeats the answer, and of which packages, for the page.
    """
    with all_files_or_none(folder) as part:
        write_tables({"whatif": result.table}, part)
        (part / "README.md").write_text(words(result), encoding="utf-8")
        answer_page(result, command, versions).write(part)


# -- words ----------------------------------------------------------------------------------------


def what_it_is(result: WhatIf) -> str:
    """Return what kind of answer it is, and what its interval covers."""
    table = result.table
    null = ""
    if table["p"].notna().any():
        null = ", of which p does: how often networks of permuted conditions shift as far"
    text = WHAT_IT_IS.format(
        covers=table["covers"].iloc[0], null=null, rollouts=rollouts_note(result)
    )
    truth = "" if result.truth is None else result.truth.description
    family = FAMILY.format(len(result.answers)) if len(result.answers) > 1 else ""
    notes = [text, family, truth, cut_note(result), stand_in_note(result.demos)]
    return " ".join(filter(None, notes))


def rollouts_note(result: WhatIf) -> str:
    """Return how many rollouts each mean is of."""
    seeds = f" by each of {result.runs} training runs" * (result.runs > 1)
    each = f"{result.repetitions} from each of {len(result.demos)} starts{seeds}"
    return f"{len(result.baseline)} rollouts ({each})"


def measures_note(result: WhatIf) -> str:
    """Return how to ask for the measures that were not asked; empty if there are none."""
    names = [key.removeprefix("mean_") for key in result.other_measures]
    if not names:
        return ""
    listed = ", ".join([*names[:MOST_NAMED], *["..."] * (len(names) > MOST_NAMED)])
    return f"--measure NAME adds a measure of the verdict: {listed} (all: --measure all)"


def cut_note(result: WhatIf) -> str:
    """Return how the gap treats recordings that were cut; empty if none was."""
    cut = result.baseline.lengths.sum() > censored(result.baseline, result.demos).lengths.sum()
    return CUT if cut else ""


def words(result: WhatIf) -> str:
    """Return what was found as Markdown to paste."""
    vocabulary = Words.of(result.demos)
    lines = ["# What if", "", what_it_is(result), ""]
    for answer in result.answers:
        table = answer_table(answer, recorded=vocabulary.adapt(RECORDED))
        lines += [f"## {answer.scenario.name}", ""]
        lines += [f"{sentence}\n" for sentence in asides(answer)]
        columns = [column.replace("\n", " ") for column in table.columns]
        lines.append(markdown_table(columns, (row.cells for row in table.groups[0].rows)))
        lines += ["", *(f"- {sentence}" for sentence in findings(answer)), ""]
    return "\n".join([*lines, *(f"{why}.\n" for why in result.unmet.values()), WARNINGS, ""])


def asides(answer: Answer) -> Iterator[str]:
    """Yield sentences with the thrusts of wanted speeds, and with the warning."""
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
    if (table["judged"] == NO_INTERVAL).all():
        return [f"{capitalised(NO_INTERVAL)}, so no shift can be distinguished from chance."]
    sentences = []
    for _, row in table[table["finding"]].iterrows():
        size, *ends = (abs(_factor(row) * row[key]) for key in ("shift", "low", "high"))
        unit = "percentage points" if row["unit"] == "share" else row["unit"]
        truth = f"; the true shift is {_with_interval(row, 'true')} {unit}" if "true" in row else ""
        sentences.append(
            f"{capitalised(row['quantity'])} {row['judged']} by {size:.3g} {unit} "
            f"[{', '.join(f'{end:.3g}' for end in sorted(ends))}]{truth}."
        )
    return sentences or ["No shift is clear of chance and of the gap."]


# -- the page -------------------------------------------------------------------------------------


def answer_page(result: WhatIf, command: str = "", versions: Mapping[str, str] = {}) -> page.Page:
    """Return the page: findings and warnings, the player, shifts, figures, words to paste."""
    inputs = PageInputs(
        demos=result.demos, species=result.species, command=command, versions=versions
    )
    shifts = answer_table(
        *result.answers,
        recorded=inputs.recorded,
        caption="Means over starts. Grey: no finding, because the shift is not clear of zero, "
        "smaller than the gap, or as large with permuted conditions (p). Hatched: behind a red "
        "warning.",
    )
    names = [answer.scenario.name for answer in result.answers]
    sentences = [f"{a.scenario.name}: {' '.join(findings(a))}" for a in result.answers]
    more = f" and {len(names) - 1} more" if len(names) > 1 else ""
    return page.Page(
        title=f"{names[0]}{more}",
        kind="What if?",
        synthetic=result.demos.synthetic,
        facts=[
            ("Animals", inputs.animals),
            ("Starts", f"{len(result.demos)} test episodes"),
            ("Rollouts", rollouts_note(result)),
            ("Policies act by", "habit" if result.reading == "habit" else "knowing their bodies"),
        ],
        lead=_lead(result),
        player=_player(result, inputs),
        sections=[
            page.Section("short", "In short", list(_in_short(result))),
            page.Section("shifts", "Shifts", [shifts]),
            page.Section("figures", "Figures", [_figures(result)]),
            page.Section("provenance", "How this was made", list(provenance(inputs, "page"))),
            page.Section(
                "paste", "To paste", list(to_paste(inputs, [what_it_is(result), *sentences]))
            ),
        ],
    )


def _lead(result: WhatIf) -> page.Lead:
    warnings = [answer.warning for answer in result.answers]
    worst = next(one for one in (Caution.RED, Caution.SOME, Caution.NONE) if one in warnings)
    first, *others = result.answers
    headline, *sentences = findings(first)
    if others:
        clear = sum(bool(answer.table["finding"].any()) for answer in result.answers)
        headline, sentences = (
            f"{clear} of {len(result.answers)} changes shift something beyond chance and beyond "
            "the gap to the recordings.",
            [],
        )
    cautions = [f"{a.scenario.name}: {a.reason}." for a in result.answers if a.reason]
    judgement = "the same behaviour in another world"
    return page.Lead(judgement, *SIGNS[worst], headline, [*sentences, what_it_is(result)], cautions)


def _in_short(result: WhatIf) -> Iterator[page.Block]:
    sentences = [
        f"{a.scenario.name}: {' '.join([*findings(a), *asides(a)])}" for a in result.answers
    ]
    yield page.Text([*sentences, *(f"{why}." for why in result.unmet.values())], "sentences")
    yield page.Text(WARNINGS)


def answer_table(
    *answers: Answer, recorded: str = RECORDED, caption: str = "", gap: bool = True
) -> page.Table:
    """Return a table of one row per quantity of each answer; rows without a finding are faint.

    Without ``gap`` recordings are left out: a terminal has no room for what stands above.
    """
    means = _means(recorded)
    if not gap:
        means = {name: means[name] for name in ("Quantity", capitalised(UNCHANGED))}
    return page.tabulate(
        "Shifts",
        {
            **means,
            "Changed": lambda row: _with_error(row, "changed"),
            "Shift [95 % interval]": lambda row: with_interval(
                scaled(Interval(row["shift"], row["low"], row["high"]), _factor(row))
            ),
            "Calibrated": lambda row: _with_interval(row, "calibrated"),
            **_columns_beside(answers),
            "Shift is": lambda row: (
                row["judged"] + (f" (p = {number(row['p'], 2)})" if row["p"] == row["p"] else "")
            ),
        },
        [(answer.scenario.name, answer.table) for answer in answers],
        caption,
        faint=lambda row: not row["finding"],
        hatched=lambda row: row["warning"] == Caution.RED,
    )


def unchanged_table(table: pd.DataFrame, recorded: str = RECORDED) -> page.Table:
    """Return how far the unchanged simulation is from the recordings."""
    return page.tabulate("Unchanged", _means(recorded), [("", table)], "")


def _means(recorded: str) -> dict[str, Callable[[pd.Series], str]]:
    """Return the columns of a quantity without any change."""

    def format_mean(key: str) -> Callable[[pd.Series], str]:
        return lambda row: number(_factor(row) * row[key])

    return {
        "Quantity": _quantity,
        capitalised(recorded): format_mean("recorded"),
        capitalised(UNCHANGED): lambda row: _with_error(row, "baseline"),
        f"Gap: {UNCHANGED}\n{MINUS} {recorded}": format_mean("gap"),
    }


def _quantity(row: pd.Series) -> str:
    """Return the name of a quantity with its unit, if it has one."""
    unit = "%" if _factor(row) > 1 else row["unit"]
    return f"{row['quantity']} ({unit})" if unit else str(row["quantity"])


def _with_error(row: pd.Series, key: str) -> str:
    """Return a mean with its error by the chance of rollouts, where that is known."""
    error = _factor(row) * row[f"{key}_error"]
    mean = number(_factor(row) * row[key])
    return f"{mean} ± {number(error, 2)}" if np.isfinite(error) else mean


def _columns_beside(answers: Sequence[Answer]) -> dict[str, Callable[[pd.Series], str]]:
    """Return the columns of a second simulator, of recordings learned from, and of the truth."""

    def of_second(row: pd.Series) -> str:
        if "second_shift" not in row:
            return ""
        return _with_interval(row.rename({"second_shift": "second"}), "second")

    def of_recordings(row: pd.Series) -> str:
        if "trained_shift" not in row:
            return ""
        shift, margin = row["trained_shift"], row["trained_margin"]
        interval = Interval(shift, shift - margin, shift + margin)
        return with_interval(scaled(interval, _factor(row)))

    known = {name for answer in answers for name in answer.table}
    columns: dict[str, Callable[[pd.Series], str]] = {}
    if "second_shift" in known:
        columns["By other inputs"] = of_second
    if "trained_shift" in known:
        columns["Learned from"] = of_recordings
    if "true" in known:
        columns["True shift"] = lambda row: _with_interval(row, "true")
        columns[f"Shift\n{MINUS} true"] = lambda row: _with_interval(row, "miss")
    return columns


def _with_interval(row: pd.Series, key: str) -> str:
    value = Interval(row[key], row[f"{key}_low"], row[f"{key}_high"])
    return with_interval(scaled(value, _factor(row)))


def _factor(row: pd.Series) -> float:
    return 100.0 if row["unit"] == "share" else 1.0


# -- figures --------------------------------------------------------------------------------------


def _figures(result: WhatIf) -> page.Gallery:
    shifts = result.table.dropna(subset="quantity")
    images = list(_shift_images(shifts))
    caption = (
        "Shift of every quantity with its 95 % interval. The band is the gap between the unchanged "
        "simulation and the recordings. Grey: no finding. Hollow: behind a warning."
    )
    if result.truth is not None:
        caption += " Beside each shift stands the true one."
    doses = _doses(result)
    if doses is not None:
        images += _dose_images(shifts, *doses)
        caption += " Dose and response: changed means over the amount of the change, with the "
        caption += "interval of their shift; dashed: recorded."
    return page.Gallery(images, caption)


def _shift_images(table: pd.DataFrame) -> Iterator[Image]:
    """Yield one panel per quantity, one row per scenario."""
    for quantity, rows in table.groupby("quantity", sort=False):
        names, columns = rows["scenario"].tolist(), ["shift", "low", "high", "gap"]
        shifts = dict(zip(names, map(Interval, rows["shift"], rows["low"], rows["high"])))
        tints = np.where(rows["finding"], style.BLUE.hex, style.MUTED.hex)
        colours = dict(zip(names, tints.tolist()))
        if "true" in rows:
            ends = ["true", "true_low", "true_high"]
            columns += ends
            true = [f"{name}: true" for name in names]
            shifts |= dict(zip(true, map(Interval, *(rows[key] for key in ends))))
            colours |= dict.fromkeys(true, style.TARGET.hex)
        size = float(np.nanmax(np.abs(rows[columns].to_numpy())))
        figure = figures.interval_rows(
            shifts,
            f"Shift ({rows['unit'].iloc[0]})",
            title=str(quantity),
            reference=0.0,
            limits=None if size > SMALLEST_SHIFT else (-1.0, 1.0),
            band=abs(float(rows["gap"].iloc[0])),
            colours=colours,
            hollow=rows.loc[rows["warning"] != Caution.NONE, "scenario"].tolist(),
        )
        yield to_image(figure, f"Shift of {quantity} by change")


def _doses(result: WhatIf) -> tuple[str, list[float]] | None:
    """Return what a sweep changes and its doses; None unless one change has 3 doses or more."""
    doses: list[float] = []
    subjects = set()
    for answer in result.answers:
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


def _dose_images(table: pd.DataFrame, name: str, doses: list[float]) -> Iterator[Image]:
    """Yield one panel per quantity: its mean over the amount of the change."""
    for quantity, rows in table.groupby("quantity", sort=False):
        rows = rows.assign(dose=doses).sort_values("dose")
        texts = {"title": str(quantity), "xlabel": name, "ylabel": rows["unit"].iloc[0]}
        with figures.one_panel(2.8, 2.1, "", **texts) as (figure, panel):
            panel.plot(rows["dose"], rows["changed"], color=style.LINE.hex, zorder=1)
            panel.axhline(
                rows["recorded"].iloc[0], color=style.TARGET.hex, linewidth=0.9, linestyle="--"
            )
            ends = rows["baseline"] + rows["low"], rows["baseline"] + rows["high"]
            panel.vlines(rows["dose"], *ends, color=style.BLUE.hex, linewidth=1.4)
            face = np.where(rows["warning"] == Caution.NONE, style.BLUE.hex, style.PAGE.hex)
            panel.scatter(
                rows["dose"], rows["changed"], 25, c=face, edgecolors=style.BLUE.hex, zorder=3
            )
        yield to_image(figure, f"Dose and response: {quantity} by {name}")


# -- the player -----------------------------------------------------------------------------------


def _player(result: WhatIf, inputs: PageInputs) -> page.Player:
    """Play the unchanged world beside each change, and beside the recordings."""
    played = result.answers[:MOST_PLAYED]
    paired = result.truth is not None and result.truth.paired
    true = {k: one.true for k, one in enumerate(played) if paired and one.true is not None}
    views = []
    for k, answer in enumerate(played):
        guess = " (a guess)" if answer.warning == Caution.RED else ""
        changed = inputs.stage.of(answer.species)
        title, key = f"{answer.scenario.name}{guess}", f"change-{k}"
        views.append(player.view(key, UNCHANGED, UNCHANGED, title, key, changed))
        if k in true:
            team = f"{answer.scenario.name}: the team that made the recordings"
            views.append(player.view(f"true-{k}", team, f"true-{k}", title, key, changed))
    views.append(player.view(UNCHANGED, inputs.recorded, RECORDED, UNCHANGED, UNCHANGED))
    recorded = Rollouts.from_demonstrations(result.demos)
    quantity = next(quantities_of(result.species, unit_of(result.demos)))
    first = played[0].rollouts
    shift = quantity.values(first) - quantity.values(result.baseline)
    of_first = np.flatnonzero(result.baseline.repetition == 0)[: len(result.demos)]
    chosen = of_first[
        player.at_ranks(
            shift[of_first], result.baseline.demo[of_first], player.middles(player.STARTS)
        )
    ].tolist()
    scenes = []
    for i in chosen:
        start = int(result.baseline.demo[i])
        tracks = {RECORDED: (recorded, start), UNCHANGED: (result.baseline, i)}
        tracks |= {f"change-{k}": (answer.rollouts, i) for k, answer in enumerate(played)}
        tracks |= {
            f"true-{k}": (made, int(np.argmax(made.demo == start))) for k, made in true.items()
        }
        scenes.append((f"Start {start}", tracks))
    caption = f"{len(scenes)} test starts, in both worlds with the same random numbers."
    return player.play(inputs, scenes, views, caption)
