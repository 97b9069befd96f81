"""The page of a counterfactual: shifts with their truth, errors, every episode, paths."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

from animarl_algos.evaluation import effects as effects_of
from animarl_algos.evaluation.comparison import interval
from animarl_algos.evaluation.metrics import PATH_LENGTH, Episodes
from animarl_algos.evaluation.rollouts import RECORDED, Rollouts
from animarl_algos.report import figures, style
from animarl_algos.report.figures import Dots
from animarl_algos.report.inputs import CounterfactualInputs, PageInputs
from animarl_algos.report.page import (
    Block,
    Gallery,
    Page,
    Section,
    Sentences,
    Table,
    Text,
    tabulate,
)
from animarl_algos.report.path_figures import path_panels
from animarl_algos.report.player import changed_starts, first_from, shift_player
from animarl_algos.report.provenance import provenance, to_paste
from animarl_algos.report.style import Image, method_label, to_image
from animarl_algos.report.words import ARROW, MINUS, NOTHING, pick, scaled, with_interval

if TYPE_CHECKING:
    import pandas as pd

SHIFTS = {
    "Predicted": effects_of.PREDICTED,
    "True": effects_of.TRUE,
    f"Predicted\n{MINUS} true": effects_of.MISSED,
    "Untrained": effects_of.UNTRAINED_SHIFT,
    "Flag\nzeroed": effects_of.BLIND,
}
NULLS = (effects_of.UNTRAINED_SHIFT, effects_of.BLIND)
QUANTILES = (0.1, 0.5, 0.9)  # of the predicted change, for the examples
COUNTED = {"all": "All episodes", "captures": "Captures only, starts that both reach"}


def counterfactual_page(inputs: CounterfactualInputs) -> Page:
    """Return the page: what is claimed and the player, then shifts, errors, episodes and paths."""
    names = list(map(method_label, inputs.asked))
    said = [Sentences(list(findings(inputs))), Sentences(list(cautions(inputs)))]
    seeds = [
        (method_label(name), f"seeds {', '.join(map(str, some))}")
        for name, some in inputs.seeds.items()
    ]
    demos, table = inputs.demos, inputs.effects.table
    return Page(
        title=f"Counterfactual: {', '.join(names)}",
        kind="What if the condition had been the other one?",
        synthetic=demos.synthetic,
        facts=[
            ("Species", demos.species),
            ("Evaluated on", f"{demos.num_episodes} demonstrations"),
            *seeds,
        ],
        player=shift_player(inputs),
        sections=[
            Section("findings", "In short", [block for block in said if block.sentences]),
            Section("shifts", "Shifts and their truth", list(_shifts(inputs))),
            Section("errors", "Error to the demonstrations", [error_table(inputs, table)]),
            Section("episodes", "Every episode", list(_episodes(inputs))),
            Section("paths", "Factual beside flipped", list(_paths(inputs))),
            Section("provenance", "How this was made", list(provenance(inputs, "page"))),
            Section("paste", "To paste", list(_paste(inputs))),
        ],
        methods=names,
    )


def findings(inputs: CounterfactualInputs) -> Iterator[str]:
    """Yield a sentence for every planned flip: a claim where there is one, or why there is none."""
    for _, row in inputs.effects.claims.iterrows():
        of, told, method = int(row["condition"]), int(row["told"]), str(row["method"])
        if (of, told) != inputs.species.planned_flip:
            continue
        about = f"{method_label(method)}, {inputs.flip(of, told)}"
        shift, true, missed = (
            inputs.value(method, quantity, of)
            for quantity in (effects_of.PREDICTED, effects_of.TRUE, effects_of.MISSED)
        )
        if not row["worded"]:
            yield (
                f"{about}: no effect of the cue is claimed, because "
                f"{row['reason']} (predicted shift {with_interval(shift)} {inputs.unit})."
            )
            continue
        longer = shift.estimate > 0
        truth = (
            f"; the true shift is {with_interval(true)}, predicted minus true "
            f"{with_interval(missed)}"
            if np.isfinite(true.estimate)
            else ""
        )
        yield (
            f"{about}: told the other condition, paths get {'longer' if longer else 'shorter'} by "
            f"{with_interval(scaled(shift, 1 if longer else -1))} {inputs.unit}{truth}."
        )


def cautions(inputs: CounterfactualInputs) -> Iterator[str]:
    """Yield what limits the page's conclusions."""
    if min(len(seeds) for seeds in inputs.seeds.values()) == 1:
        yield (
            "One training seed: intervals speak of starts, for this network only, and nothing is "
            "claimed of its method."
        )
    if inputs.species.condition_is_sensed:
        yield (
            "The true shift is the same policy in the world of the other condition. Blocked senses "
            "reveal the condition by themselves, so being blind to it costs sensory information."
        )
    elif inputs.teams is None:
        yield (
            "No truth is known for these demonstrations: the true shift is missing in all tables."
        )


def _shifts(inputs: CounterfactualInputs) -> Iterator[Block]:
    truth = (
        "its own search in the world of the other condition"
        if inputs.species.condition_is_sensed
        else "what teams trained under the other condition do from the same starts"
    )
    yield Text(
        "A policy is told the other condition; the world, the starts and all random numbers stay "
        f"as they are. The truth is {truth}. Beside it stand two shifts in which nothing of the "
        "condition was learned: of untrained networks, and of the trained ones with the flag "
        "zeroed, asked twice with random numbers of their own."
    )
    yield Gallery(
        list(_shift_images(inputs)),
        f"Shift of the mean path length ({inputs.unit}) with 95 % interval, all episodes; grey: "
        "where nothing of the condition was learned.",
    )

    yield shift_table(inputs, inputs.effects.table)


def shift_table(inputs: PageInputs, table: pd.DataFrame) -> Table:
    """Return predicted shifts beside their truth and their nulls, as far as they are known."""
    predicted = table[(table["quantity"] == effects_of.PREDICTED) & table["value"].notna()]
    known = set(table.loc[table["value"].notna(), "quantity"])

    def shift(quantity: str) -> Any:
        keys = ("method", "condition", "counting")
        return lambda row: inputs.words.told(
            pick(table, quantity=quantity, **{key: row[key] for key in keys}), "value", PATH_LENGTH
        )

    return tabulate(
        "Shifts",
        {
            "Method": lambda row: method_label(row["method"]),
            "Variant": lambda row: str(row["variant"]),
            "Flip": lambda row: inputs.flip(int(row["condition"]), 1 - int(row["condition"])),
            **{title: shift(one) for title, one in SHIFTS.items() if one in known},
        },
        counted(predicted),
        f"Mean path length ({inputs.words.unit_of(PATH_LENGTH)}) with the flipped cue minus that "
        "with the true one, [95 % interval]; bold: the flip that was planned in advance. Among "
        "captures only starts in which both answers reached the target count, so that they are "
        "paired.",
        left=3,
        strong=lambda row: bool(row["planned"]),
    )


def counted(table: pd.DataFrame) -> Iterator[tuple[str, list[Any]]]:
    """Yield the rows of all episodes and of captures, with a title."""
    for counting, title in COUNTED.items():
        yield title, [row for _, row in table[table["counting"] == counting].iterrows()]


def _shift_images(inputs: CounterfactualInputs) -> Iterator[Image]:
    """Predicted and true shifts over the nulls, a panel per flip; the line is no shift."""
    for of in (0, 1):
        shifts, colours = {}, {}
        for name in inputs.asked:
            for quantity in SHIFTS.values():
                value = inputs.value(name, quantity, of)
                if quantity == effects_of.MISSED or not np.isfinite(value.estimate):
                    continue
                label = f"{method_label(name)}: {quantity}"
                shifts[label] = value
                colour = style.method_colour(RECORDED if quantity == effects_of.TRUE else name)
                colours[label] = style.MUTED.hex if quantity in NULLS else colour
        if shifts:
            flip = inputs.flip(of, 1 - of)
            figure = figures.interval_rows(
                shifts, f"Shift of path length ({inputs.unit})", title=flip, reference=0.0,
                colours=colours,
            )  # fmt: skip
            yield to_image(figure, f"Predicted and true shifts of the path length, {flip}")


def error_table(inputs: PageInputs, table: pd.DataFrame) -> Table:
    """Return errors to the demonstrations, and the differences of the methods' errors."""

    def accuracy(row: Any) -> str:
        found = pick(table, method=row["method"], quantity=effects_of.ACCURACY)
        return NOTHING if found is None else with_interval(interval(found, "value"))

    words = inputs.words
    shown = table[table["quantity"].isin([effects_of.ERROR, effects_of.ERROR_DIFFERENCE])]
    return tabulate(
        "Signed errors",
        {
            "Method": lambda row: method_label(str(row["method"])).replace(" - ", f" {MINUS} "),
            "Variant": lambda row: str(row["variant"]),
            "Condition": lambda row: inputs.condition(int(row["condition"])),
            f"Simulated {MINUS} {inputs.recorded}\n({words.unit_of(PATH_LENGTH)})": (
                lambda row: words.told(row, "value", PATH_LENGTH)
            ),
            "Treatment\naccuracy": accuracy,
        },
        counted(shown[shown["value"].notna()]),
        "Mean path length of the rollouts minus that of the demonstrations they started from, in "
        "the same condition [95 % interval], and the difference of the methods' errors. Treatment "
        "accuracy: balanced, on held-out demonstrations; 0.5 is what a memory blind to the "
        "condition gives.",
        left=3,
    )


def _episodes(inputs: CounterfactualInputs) -> Iterator[Block]:
    figure = figures.episode_dots(list(_dots(inputs)), f"Path length ({inputs.unit})")
    yield Gallery(
        [to_image(figure, "Path length of every episode by method, condition and cue")],
        "Every episode is a dot (mean over those who move towards the target), bars are means: "
        f"{inputs.recorded}, simulated in either condition, and hollow: told the other condition "
        f"(1: {inputs.condition(0)}, 2: {inputs.condition(1)}).",
    )


def _dots(inputs: CounterfactualInputs) -> Iterator[Dots]:
    """A column for each condition of everybody, told the truth and then the other condition."""
    demos, asked, factor = inputs.demos, inputs.asked, inputs.words.factor(PATH_LENGTH)
    recorded = Rollouts.from_demonstrations(demos)
    shown: list[tuple[str, str, Any, bool]] = [
        (inputs.recorded, RECORDED, (recorded, recorded), False),
        *((method_label(n), n, (a.trained.factual,) * 2, False) for n, a in asked.items()),
        *((method_label(n), n, (a.trained.flipped,) * 2, True) for n, a in asked.items()),
    ]
    if inputs.teams is not None:
        shown.append(("team", RECORDED, inputs.teams[::-1], True))
    for label, method, by_condition, flipped in shown:
        for c, rollouts in enumerate(by_condition):
            lengths = factor * PATH_LENGTH.measure(Episodes(rollouts, demos))
            own = demos.condition[rollouts.demo] == c
            told = f"{ARROW}{2 - c}" if flipped else ""
            yield Dots(f"{label} {c + 1}{told}", method, lengths[own], flipped)


def _paths(inputs: CounterfactualInputs) -> Iterator[Block]:
    of, told = inputs.planned
    truth, other = inputs.condition(of), inputs.condition(told)
    images = []
    for start in changed_starts(inputs, of, QUANTILES):
        recorded = inputs.demos.episode(start).positions
        paths = [(inputs.recorded, recorded)]
        for cue, key in ((truth, "factual"), (other, "flipped")):
            for name, one in inputs.asked.items():
                rollouts = getattr(one.trained, key)
                said = cue if key == "factual" else f"told {cue}"
                path = rollouts.path(first_from(rollouts, start))
                paths.append((f"{method_label(name)}\n{said}", path))
        if inputs.teams is not None:
            team = inputs.teams[told]
            paths.append((f"team\n{other}", team.path(first_from(team, start))))
        figure = path_panels(paths, recorded, inputs.stage, f"start {start}")
        images.append(to_image(figure, f"Paths from start {start}, told {truth} and {other}"))
    yield Gallery(
        images,
        f"From one start each: {inputs.recorded}, simulated told the truth ({truth}), and told the "
        f"other condition ({other}), first seed, first rollout. Starts chosen by rank: the 10th, "
        "50th and 90th percentile of how much the path of "
        f"{method_label(next(iter(inputs.asked)))} changes. Open circles mark starts, filled ones "
        "ends.",
    )


def _paste(inputs: CounterfactualInputs) -> Iterator[Block]:
    trained = "; ".join(
        f"{method_label(name)}, {len(seeds)} training seed{'s' if len(seeds) != 1 else ''}"
        for name, seeds in inputs.seeds.items()
    )
    truth = (
        ""
        if inputs.teams is None
        else ", beside what the teams of the other condition do from the same starts"
    )
    sentence = (
        f"Trained policies ({trained}) were rolled out from "
        f"{inputs.demos.num_episodes} test starts, told the condition of the start and, with the "
        "same random numbers, the other one. Shifts are the differences of means over starts, with "
        "95 % intervals over starts and, from two training seeds on, over seeds by Student's t"
        f"{truth}, and beside the shifts of untrained networks and of networks that cannot see the "
        "condition."
    )
    return to_paste(inputs, "", [sentence])
