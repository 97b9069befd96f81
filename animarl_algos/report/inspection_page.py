"""The page of one episode: its recording beside the rollouts, and what the learner values in it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from animarl_algos.evaluation.metrics import METRICS
from animarl_algos.evaluation.rollouts import NO_CUE, RECORDED
from animarl_algos.report.inputs import InspectionInputs
from animarl_algos.report.page import Block, Gallery, Page, Section, Sentences, tabulate
from animarl_algos.report.path_figures import values_along_path
from animarl_algos.report.player import episode_player
from animarl_algos.report.provenance import provenance
from animarl_algos.report.style import method_label, to_image
from animarl_algos.report.words import NOTHING, capitalised, number
from animarl_envs.demos.episode import TIME_OUT
from animarl_envs.demos.summary import ending_in_words

MOST_ROWS = 12  # of one method in the table


def inspection_page(inputs: InspectionInputs) -> Page:
    """Return the page: what was found and the player, then episodes and decisions."""
    return Page(
        title=f"{inputs.species.title}: test episode {inputs.episode}",
        kind="One episode",
        synthetic=inputs.demos.synthetic,
        facts=[
            ("Episode", str(inputs.demos.recording[inputs.episode])),
            ("Method", method_label(inputs.learner)),
            ("Condition", _condition(inputs, int(inputs.recording.condition[0]))),
        ],
        player=episode_player(inputs),
        sections=[
            Section("findings", "In short", [Sentences(list(_findings(inputs)))]),
            Section("episodes", "What became of it", list(_episodes(inputs))),
            Section("decisions", "Decisions along the demonstration", list(_decisions(inputs))),
            Section("provenance", "How this was made", list(provenance(inputs, "page"))),
        ],
    )


def _findings(inputs: InspectionInputs) -> Iterator[str]:
    recording, own = inputs.recording, inputs.rollouts[inputs.learner]
    duration = float((recording.lengths[0] - 1) * recording.dt)
    ending = _ending(inputs, int(recording.outcome[0]))
    yield f"{capitalised(inputs.recorded)}: {ending} after {duration:.1f} s."
    told = own.select((own.cue == NO_CUE) | (own.cue == own.condition))
    seconds = np.sort((told.lengths - 1) * told.dt)
    yield (
        f"{method_label(inputs.learner)}: {inputs.species.goal} reached in "
        f"{int(told.captured.sum())} of {len(told)} rollouts from the same start, which last "
        f"{seconds[0]:.1f} to {seconds[-1]:.1f} s."
    )
    decisions = inputs.decisions
    known = decisions.actions >= 0
    first = decisions.q.argmax(axis=1) == decisions.actions
    yield (
        f"Along the demonstration the action of highest value of {decisions.individual} is the "
        f"{inputs.recorded} one in {int(first[known].sum())} of {int(known.sum())} steps."
    )


def _episodes(inputs: InspectionInputs) -> Iterator[Block]:
    shown = [metric for metric in METRICS if metric.heading and not metric.share]

    def measured(key: str) -> Callable[[Any], str]:
        return lambda row: number(float(row[key]))

    yield tabulate(
        "Episodes",
        {
            "Rollout": lambda row: (
                NOTHING if row["method"] == RECORDED else str(int(row["repetition"]))
            ),
            "Told": lambda row: (
                _told(inputs, int(row["cue"]), int(row["condition"])).removeprefix("told ")
                or NOTHING
            ),
            "Ended": lambda row: _ending(inputs, int(row["outcome"])),
            **{f"{one.label}\n({one.unit})": measured(one.key) for one in shown},
        },
        [
            (
                inputs.recorded if name == RECORDED else method_label(str(name)),
                (row for _, row in rows.head(MOST_ROWS).iterrows()),
            )
            for name, rows in inputs.metrics.groupby("method", sort=False)
        ],
        f"The demonstration and at most {MOST_ROWS} rollouts of each method from its start.",
        left=3,
    )


def _decisions(inputs: InspectionInputs) -> Iterator[Block]:
    who = inputs.decisions.individual
    figure = values_along_path(inputs.decisions, inputs.demos.dt)
    yield Gallery(
        [to_image(figure, f"Action values of {who} along the demonstration")],
        f"What {method_label(inputs.learner)} values for {who} while everybody moves as "
        f"{inputs.recorded}. Above, the mean of Q over actions and the best action's; below, the "
        "advantage of each direction of acceleration, angles taken from the direction to its "
        "focus; dots: the actions found in the demonstration.",
    )


def _condition(inputs: InspectionInputs, number: int) -> str:
    return inputs.condition(number) if inputs.species.conditions else NOTHING


def _told(inputs: InspectionInputs, cue: int, condition: int) -> str:
    """What a rollout was told, where that is not its own condition."""
    return "" if cue in (NO_CUE, condition) else f"told {_condition(inputs, cue)}"


def _ending(inputs: InspectionInputs, outcome: int) -> str:
    if outcome == TIME_OUT:
        return "time limit"
    demos = inputs.demos
    return ending_in_words(outcome, demos.individuals, demos.roles) or "unfinished"
