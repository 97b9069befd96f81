"""The player on the page of a counterfactual: the same start, told the other condition."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from animarl_algos.evaluation.metrics import PATH_LENGTH, Episodes
from animarl_algos.evaluation.rollouts import Rollouts
from animarl_algos.report.counterfactual_inputs import CounterfactualInputs
from animarl_algos.report.examples import at_ranks
from animarl_algos.report.scenes import (
    FACTUAL,
    FLIPPED,
    RECORDED,
    STARTS,
    TOLD_OTHER,
    Field,
    Player,
    Scene,
    of_starts,
    track,
    view,
)
from animarl_algos.report.style import method_label

TEAM = "team"


def shift_player(inputs: CounterfactualInputs) -> Player:
    """The first method: factual beside flipped, flipped beside the truth, and the recording."""
    name = method_label(next(iter(inputs.asked)))
    factual = f"{name}, factual"
    views = [view("flipped", factual, FACTUAL, TOLD_OTHER, FLIPPED)]
    if inputs.teams is not None:
        team = "team of the other condition"
        views.append(view("truth", team, TEAM, f"{name}, {TOLD_OTHER}", FLIPPED))
    views.append(view("simulated", inputs.recorded, RECORDED, factual, FACTUAL))
    species = inputs.species
    chosen = f"from paths that get shorter to paths that get longer when {name} is {TOLD_OTHER}"
    field = Field(inputs.demos, species.arena, species.contact_radius)
    scenes = list(_scenes(inputs))
    return Player.playing(field, scenes, views, of_starts(field, len(scenes), chosen))


def _scenes(inputs: CounterfactualInputs) -> Iterator[Scene]:
    trained = next(iter(inputs.asked.values())).trained
    recorded = Rollouts.from_demonstrations(inputs.demos)
    change = start_change(inputs, trained.factual, trained.flipped)
    present = np.unique(inputs.demos.condition).tolist()
    count = max(1, STARTS // len(present))
    for condition in present:
        starts = np.flatnonzero(inputs.demos.condition == condition)
        ranked = at_ranks(change[starts], starts, [(k + 0.5) / count for k in range(count)])
        for start in starts[ranked].tolist():
            tracks = {
                RECORDED: track(inputs.demos, recorded, start),
                FACTUAL: track(inputs.demos, trained.factual, first_from(trained.factual, start)),
                FLIPPED: track(inputs.demos, trained.flipped, first_from(trained.flipped, start)),
            }
            if inputs.teams is not None:
                team = inputs.teams[1 - condition]
                tracks[TEAM] = track(inputs.demos, team, first_from(team, start))
            yield Scene(f"Start {start}, {inputs.conditions[condition]}", tracks)


def start_change(
    inputs: CounterfactualInputs, factual: Rollouts, flipped: Rollouts
) -> NDArray[np.float64]:
    """``(starts,)``: how much longer paths get from each start, mean over seeds and rollouts."""
    means = []
    for rollouts in (factual, flipped):
        lengths = PATH_LENGTH.measure(Episodes(rollouts, inputs.demos))
        number = inputs.demos.num_episodes
        sums = np.bincount(rollouts.demo, weights=lengths, minlength=number)
        means.append(sums / np.bincount(rollouts.demo, minlength=number))
    return means[1] - means[0]


def first_from(rollouts: Rollouts, start: int) -> int:
    """The first rollout from a start: of the first seed, the first repetition."""
    return int(np.flatnonzero(rollouts.demo == start)[0])
