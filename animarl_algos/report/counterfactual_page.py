"""The page of a counterfactual: what is claimed, and shifts beside their truth."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from animarl_algos.evaluation import effects as effects_of
from animarl_algos.evaluation.comparison import COUNTING
from animarl_algos.evaluation.effects import FACTUAL, FLIPPED, TEAM, Effects
from animarl_algos.evaluation.metrics import PATH_LENGTH
from animarl_algos.evaluation.rollouts import RECORDED, Rollouts
from animarl_algos.evaluation.statistics import Interval
from animarl_algos.report import figures, page, player, style
from animarl_algos.report.inputs import PageInputs, provenance
from animarl_algos.report.style import Image, method_label, to_image
from animarl_algos.report.words import MINUS, capitalised, pick, scaled, with_interval
from animarl_envs.species import Species

SHIFTS = {
    "Predicted": effects_of.PREDICTED,
    "True": effects_of.TRUE,
    f"Predicted\n{MINUS} true": effects_of.MISSED,
    "Untrained": effects_of.UNTRAINED_SHIFT,
    "Flag\nzeroed": effects_of.BLIND,
}
NULLS = (effects_of.UNTRAINED_SHIFT, effects_of.BLIND)
TOLD_OTHER = "told the other condition"


@dataclass(frozen=True, eq=False, kw_only=True)
class CounterfactualInputs(PageInputs):
    """Everything that the page of a counterfactual shows.

    ``answers`` are rollouts by method and answer, measured in the table of ``episodes``, ``teams``
    as which methods the teams of condition 0 and of condition 1 are there, ``seeds`` the training
    seeds by method.
    """

    species: Species
    answers: Mapping[tuple[str, str], Rollouts]
    teams: Sequence[str]
    episodes: pd.DataFrame
    effects: Effects
    seeds: Mapping[str, tuple[int, ...]]

    @property
    def unit(self) -> str:
        return self.words.unit_of(PATH_LENGTH)

    def value(self, method: str, quantity: str, of: int, counting: str = "all") -> Interval:
        """Return a quantity from starts of condition ``of``; undefined if there is none."""
        row = pick(
            self.effects.table, method=method, quantity=quantity, condition=of, counting=counting
        )
        return self.words.interval(row, PATH_LENGTH)


def counterfactual_page(inputs: CounterfactualInputs) -> page.Page:
    """Return the page: what is claimed and the player, then shifts and how it was made."""
    names = list(map(method_label, inputs.seeds))
    said = [page.Text([*some], "sentences") for some in (findings(inputs), cautions(inputs))]
    seeds = [
        (method_label(name), f"seeds {', '.join(map(str, some))}")
        for name, some in inputs.seeds.items()
    ]
    demos = inputs.demos
    return page.Page(
        title=f"Counterfactual: {', '.join(names)}",
        kind="What if the condition had been the other one?",
        synthetic=demos.synthetic,
        facts=[
            ("Species", demos.species),
            ("Evaluated on", f"{demos.num_episodes} demonstrations"),
            *seeds,
        ],
        player=_player(inputs),
        sections=[
            page.Section("findings", "In short", [block for block in said if block.text]),
            page.Section("shifts", "Shifts and their truth", list(_shifts(inputs))),
            page.Section("provenance", "How this was made", list(provenance(inputs, "page"))),
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
    elif not inputs.teams:
        yield (
            "No truth is known for these demonstrations: the true shift is missing in all tables."
        )


def _shifts(inputs: CounterfactualInputs) -> Iterator[page.Block]:
    truth = (
        "its own search in the world of the other condition"
        if inputs.species.condition_is_sensed
        else "what teams trained under the other condition do from the same starts"
    )
    yield page.Text(
        "A policy is told the other condition; the world, the starts and all random numbers stay "
        f"as they are. The truth is {truth}. Beside it stand two shifts in which nothing of the "
        "condition was learned: of untrained networks, and of the trained ones with the flag "
        "zeroed, asked twice with random numbers of their own."
    )
    yield page.Gallery(
        list(_shift_images(inputs)),
        f"Shift of the mean path length ({inputs.unit}) with 95 % interval, all episodes; grey: "
        "where nothing of the condition was learned.",
    )
    yield _shift_table(inputs)


def _shift_table(inputs: CounterfactualInputs) -> page.Table:
    """Predicted shifts beside their truth and their nulls, as far as they are known."""
    known = inputs.effects.table.dropna(subset="value")
    predicted = known[known["quantity"] == effects_of.PREDICTED]

    def shift(quantity: str) -> Any:
        return lambda row: with_interval(
            inputs.value(row["method"], quantity, row["condition"], row["counting"])
        )

    return page.tabulate(
        "Shifts",
        {
            "Method": lambda row: method_label(row["method"]),
            "Variant": lambda row: str(row["variant"]),
            "Flip": lambda row: inputs.flip(row["condition"], row["told"]),
            **{title: shift(one) for title, one in SHIFTS.items() if one in set(known["quantity"])},
        },
        [
            (
                capitalised(title),
                [row for _, row in predicted.query(f"counting == '{rule}'").iterrows()],
            )
            for rule, title in COUNTING.items()
        ],
        f"Mean path length ({inputs.unit}) with the flipped cue minus that "
        "with the true one, [95 % interval]; bold: the flip that was planned in advance. Among "
        "captures only starts in which both answers reached the target count, so that they are "
        "paired.",
        left=3,
        strong=lambda row: bool(row["planned"]),
    )


def _shift_images(inputs: CounterfactualInputs) -> Iterator[Image]:
    """Predicted and true shifts over the nulls, a panel per flip; the line is no shift."""
    for of in (0, 1):
        shifts, colours = {}, {}
        for name in inputs.seeds:
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


def _player(inputs: CounterfactualInputs) -> page.Player:
    """Play the first method: factual beside flipped, flipped beside the truth and the recording."""
    name = method_label(next(iter(inputs.seeds)))
    factual = f"{name}, factual"
    views = [player.view("flipped", factual, FACTUAL, TOLD_OTHER, FLIPPED)]
    if inputs.teams:
        team = "team of the other condition"
        views.append(player.view("truth", team, TEAM, f"{name}, {TOLD_OTHER}", FLIPPED))
    views.append(player.view("simulated", inputs.recorded, RECORDED, factual, FACTUAL))
    scenes = list(_scenes(inputs))
    said = f"from paths that get shorter to paths that get longer when {name} is {TOLD_OTHER}."
    said = f"{len(scenes)} test starts, all different, {said}"
    return player.play(inputs, scenes, views, said)


def _scenes(inputs: CounterfactualInputs) -> Iterator[player.Scene]:
    """Starts by how much longer paths get when the first method is told the other condition."""
    table, demos, first = inputs.episodes, inputs.demos, next(iter(inputs.seeds))
    lengths = table[table["method"] == first].pivot_table(PATH_LENGTH.key, "demo", "answer")
    longer = (lengths[FLIPPED] - lengths[FACTUAL]).to_numpy()
    shown = {RECORDED: Rollouts.from_demonstrations(demos)}
    shown |= {answer: inputs.answers[first, answer] for answer in (FACTUAL, FLIPPED)}
    present = np.unique(demos.condition).tolist()
    for condition in present:
        if inputs.teams:
            shown[TEAM] = inputs.answers[inputs.teams[1 - condition], TEAM]
        starts = np.flatnonzero(demos.condition == condition)
        quantiles = player.middles(max(1, player.STARTS // len(present)))
        for start in starts[player.at_ranks(longer[starts], starts, quantiles)].tolist():
            tracks = {k: (some, int(np.argmax(some.demo == start))) for k, some in shown.items()}
            yield f"Start {start}, {inputs.condition(condition)}", tracks
