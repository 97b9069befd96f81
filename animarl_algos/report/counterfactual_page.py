"""The page of a counterfactual: what is claimed, and shifts beside their truth."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

from animarl_algos.evaluation import effects as effects_of
from animarl_algos.evaluation.metrics import PATH_LENGTH
from animarl_algos.evaluation.rollouts import RECORDED
from animarl_algos.report import figures, style
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
from animarl_algos.report.player import shift_player
from animarl_algos.report.provenance import provenance
from animarl_algos.report.style import Image, method_label, to_image
from animarl_algos.report.words import MINUS, pick, scaled, with_interval

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
COUNTED = {"all": "All episodes", "captures": "Captures only, starts that both reach"}


def counterfactual_page(inputs: CounterfactualInputs) -> Page:
    """Return the page: what is claimed and the player, then shifts and how it was made."""
    names = list(map(method_label, inputs.asked))
    said = [Sentences(list(findings(inputs))), Sentences(list(cautions(inputs)))]
    seeds = [
        (method_label(name), f"seeds {', '.join(map(str, some))}")
        for name, some in inputs.seeds.items()
    ]
    demos = inputs.demos
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
            Section("provenance", "How this was made", list(provenance(inputs, "page"))),
        ],
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
