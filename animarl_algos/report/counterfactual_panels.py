"""The figures of a counterfactual's page: which data goes into which panel."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from animarl_algos.evaluation import effects as effects_of
from animarl_algos.evaluation.metrics import PATH_LENGTH, Episodes
from animarl_algos.evaluation.rollouts import RECORDED, Rollouts
from animarl_algos.report import cue_figures
from animarl_algos.report.counterfactual_inputs import ARROW, CounterfactualInputs
from animarl_algos.report.counterfactual_player import first_from, start_change
from animarl_algos.report.cue_figures import Dots, ShiftRow
from animarl_algos.report.style import Image, method_label, to_image

SHOWN = (
    effects_of.PREDICTED, effects_of.TRUE, effects_of.MISSED, effects_of.UNTRAINED_SHIFT,
    effects_of.BLIND,
)  # fmt: skip
QUANTILES = (0.1, 0.5, 0.9)  # of the predicted change, for the examples


def shift_panels(inputs: CounterfactualInputs) -> Iterator[Image]:
    """Predicted and true shifts over the nulls, a panel per flip."""
    for of in (0, 1):
        rows = []
        for name in inputs.asked:
            for quantity in SHOWN:
                if quantity == effects_of.MISSED:
                    continue
                value = inputs.value(name, quantity, of)
                if np.isfinite(value.estimate):
                    null = quantity in (effects_of.UNTRAINED_SHIFT, effects_of.BLIND)
                    method = RECORDED if quantity == effects_of.TRUE else name
                    label = f"{method_label(name)}: {quantity}"
                    rows.append(ShiftRow(label, value, method, null))
        if rows:
            flip = inputs.flip(of, 1 - of)
            figure = cue_figures.shift_rows(rows, f"Shift of path length ({inputs.unit})", flip)
            yield to_image(figure, f"Predicted and true shifts of the path length, {flip}")


def episode_panel(inputs: CounterfactualInputs) -> Image:
    """Every episode as a dot."""
    figure = cue_figures.episode_dots(list(_dots(inputs)), f"Path length ({inputs.unit})")
    return to_image(figure, "Path length of every episode by method, condition and cue")


def _dots(inputs: CounterfactualInputs) -> Iterator[Dots]:
    demos = inputs.demos
    recorded = Rollouts.from_demonstrations(demos)
    for c in (0, 1):
        yield Dots(f"{inputs.recorded} {c + 1}", RECORDED, _lengths(inputs, recorded, c))
    for name, one in inputs.asked.items():
        for c in (0, 1):
            values = _lengths(inputs, one.trained.factual, c)
            yield Dots(f"{method_label(name)} {c + 1}", name, values)
    for name, one in inputs.asked.items():
        for c in (0, 1):
            values = _lengths(inputs, one.trained.flipped, c)
            label = f"{method_label(name)} {c + 1}{ARROW}{2 - c}"
            yield Dots(label, name, values, flipped=True)
    for c in (0, 1) if inputs.teams is not None else ():
        assert inputs.teams is not None
        values = _lengths(inputs, inputs.teams[1 - c], c)
        yield Dots(f"team {c + 1}{ARROW}{2 - c}", RECORDED, values, flipped=True)


def path_panels(inputs: CounterfactualInputs) -> Iterator[Image]:
    """Paths of the planned flip, from starts chosen by how much the first method's changes."""
    of, told = inputs.planned
    starts = np.flatnonzero(inputs.demos.condition == of)
    first = next(iter(inputs.asked.values())).trained
    change = start_change(inputs, first.factual, first.flipped)[starts]
    order = starts[np.argsort(change, kind="stable")]
    ranks = np.unique(np.round(np.array(QUANTILES) * (len(order) - 1)).astype(int))
    for start in order[ranks].tolist():
        title = f"test demonstration {start}"
        paths = list(_paths_from(inputs, start, of, told))
        figure = cue_figures.path_row(
            paths, inputs.demos.arena, inputs.demos.roles, inputs.demos.individuals, title
        )
        yield to_image(figure, f"Factual and flipped paths from {title}")


def _paths_from(
    inputs: CounterfactualInputs, start: int, of: int, told: int
) -> Iterator[tuple[str, Any]]:
    """What is above each path, and the path: recorded, factual, flipped, the team's."""
    truth, other = inputs.conditions[of], inputs.conditions[told]
    yield f"{inputs.recorded}\n{truth}", inputs.demos.episode(start).positions
    for name, one in inputs.asked.items():
        yield f"{method_label(name)}\n{truth}", _first_path(one.trained.factual, start)
    for name, one in inputs.asked.items():
        yield f"{method_label(name)}\ntold {other}", _first_path(one.trained.flipped, start)
    if inputs.teams is not None:
        yield f"team\n{other}", _first_path(inputs.teams[told], start)


def _lengths(inputs: CounterfactualInputs, rollouts: Rollouts, condition: int) -> Any:
    lengths = PATH_LENGTH.measure(Episodes(rollouts, inputs.demos))
    return lengths[inputs.demos.condition[rollouts.demo] == condition]


def _first_path(rollouts: Rollouts, start: int) -> Any:
    return rollouts.path(first_from(rollouts, start))
