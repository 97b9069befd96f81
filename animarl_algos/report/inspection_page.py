"""The page of one episode: its recording beside the rollouts, and what the learner values in it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from animarl_algos.evaluation.decisions import Decisions
from animarl_algos.evaluation.metrics import METRICS
from animarl_algos.evaluation.rollouts import NO_CUE, RECORDED, Rollouts
from animarl_algos.report import cue_figures, interpretation
from animarl_algos.report.blocks import (
    Block,
    Command,
    Gallery,
    Group,
    Pairs,
    Row,
    Section,
    Sentences,
    Table,
    Text,
)
from animarl_algos.report.glossary import glossary
from animarl_algos.report.page import Page, render_page
from animarl_algos.report.provenance import (
    code_and_machine,
    flattened,
    licence,
    made_with,
    origin,
    words_to_paste,
)
from animarl_algos.report.scenes import RECORDED as BY_RECORDING
from animarl_algos.report.scenes import Field, Player, Scene, track, view
from animarl_algos.report.sentences import NOTHING, listed, number
from animarl_algos.report.style import method_label, to_image
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.episode import TIME_OUT
from animarl_envs.demos.summary import ending_in_words
from animarl_envs.species import Species

if TYPE_CHECKING:
    import pandas as pd

MOST_PATHS = 4  # of one method in a row
MOST_ROWS = 12  # of one method in the table


@dataclass(frozen=True, eq=False, kw_only=True)
class InspectionInputs:
    """Everything that the page shows; ``rollouts`` are those from the start of the episode."""

    learner: str
    episode: int
    demos: Demonstrations
    species: Species
    recording: Rollouts
    rollouts: Mapping[str, Rollouts]
    decisions: Decisions
    metrics: pd.DataFrame
    world: Mapping[str, str]
    environment: Mapping[str, Any]
    machine: Mapping[str, str]
    wall_time: Mapping[str, float]
    versions: Mapping[str, str]
    command: str

    @property
    def recorded(self) -> str:
        """What the demonstration is called: recorded only if it was."""
        return "demonstrated" if self.demos.synthetic else "recorded"


def inspection_page(inputs: InspectionInputs) -> tuple[list[Section], str]:
    """The sections, whose figures may be written on their own, and the page made of them."""
    sections = [
        Section("paths", "Paths from this start", list(_paths(inputs))),
        Section("episodes", "What became of it", list(_episodes(inputs))),
        Section("decisions", "Decisions along the demonstration", list(_decisions(inputs))),
        Section("provenance", "How this was made", list(_provenance(inputs))),
        Section("paste", "To paste", list(words_to_paste(_methods(inputs), inputs.versions))),
    ]
    found = Section("findings", "In short", [Sentences(list(_findings(inputs)))])
    page = Page(
        title=f"{inputs.species.title}: test episode {inputs.episode}",
        kind="One episode",
        synthetic=inputs.demos.synthetic,
        facts=[
            ("Episode", str(inputs.demos.recording[inputs.episode])),
            ("Method", method_label(inputs.learner)),
            ("Condition", _condition(inputs, int(inputs.recording.condition[0]))),
        ],
        player=_player(inputs),
        sections=[found, *sections],
        glossary=glossary(
            map(method_label, inputs.rollouts), "\n".join(t for s in sections for t in s.texts)
        ),
    )
    return sections, render_page(page)


def _player(inputs: InspectionInputs) -> Player:
    """The recording beside the first rollouts of every method, one scene for each repetition."""
    field = Field(inputs.demos, inputs.species.arena, inputs.species.contact_radius)
    recorded = track(inputs.demos, inputs.recording, 0)
    views = [
        view(name, inputs.recorded, BY_RECORDING, method_label(name), name)
        for name in dict.fromkeys([inputs.learner, *inputs.rollouts])
    ]
    count = min(MOST_PATHS, *(len(rollouts) for rollouts in inputs.rollouts.values()))
    scenes = [
        Scene(
            f"Rollout {k}",
            {BY_RECORDING: recorded}
            | {name: track(inputs.demos, r, k) for name, r in inputs.rollouts.items()},
        )
        for k in range(count)
    ]
    said = f"The {inputs.recorded} episode beside the first rollouts of each method from its start."
    return Player.playing(field, scenes, views, said)


def _findings(inputs: InspectionInputs) -> Iterator[str]:
    duration = float((inputs.recording.lengths[0] - 1) * inputs.recording.dt)
    ending = _ending(inputs, int(inputs.recording.outcome[0]))
    yield f"{inputs.recorded.capitalize()}: {ending} after {duration:.1f} s."
    own = inputs.rollouts[inputs.learner]
    told = own.select((own.cue == NO_CUE) | (own.cue == own.condition))
    seconds = np.sort((told.lengths - 1) * told.dt)
    reached = int(told.captured.sum())
    yield (
        f"{method_label(inputs.learner)}: {inputs.species.goal} reached in {reached} of "
        f"{len(told)} rollouts from the same start, which last {seconds[0]:.1f} to "
        f"{seconds[-1]:.1f} s."
    )
    decisions = inputs.decisions
    known = decisions.actions >= 0
    first = decisions.q.argmax(axis=1) == decisions.actions
    yield (
        f"Along the demonstration the action of highest value of {decisions.individual} is the "
        f"{inputs.recorded} one in {int(first[known].sum())} of {int(known.sum())} steps."
    )


def _paths(inputs: InspectionInputs) -> Iterator[Block]:
    images = []
    recorded = (inputs.recorded, inputs.recording.path(0))
    for name, rollouts in inputs.rollouts.items():
        chosen = rollouts.select(np.arange(min(MOST_PATHS, len(rollouts))))
        paths: list[tuple[str, Any]] = [recorded]
        for i in range(len(chosen)):
            told = _told(inputs, int(chosen.cue[i]), int(chosen.condition[i]))
            paths.append((f"rollout {chosen.repetition[i]}{told}", chosen.path(i)))
        figure = cue_figures.path_row(
            paths,
            inputs.demos.arena,
            inputs.demos.roles,
            inputs.demos.individuals,
            method_label(name),
        )
        images.append(to_image(figure, f"Paths of {method_label(name)} beside the demonstration"))
    yield Gallery(
        images,
        "The demonstration and the first rollouts of every method from its start. Open circles "
        "mark starts, filled ones ends; the target is dark.",
    )


def _episodes(inputs: InspectionInputs) -> Iterator[Block]:
    shown = [metric for metric in METRICS if metric.heading and not metric.share]
    groups = []
    for name, rows in inputs.metrics.groupby("method", sort=False):
        lines = [
            Row(
                [
                    str(int(row["repetition"])) if name != RECORDED else NOTHING,
                    _told(inputs, int(row["cue"]), int(row["condition"])).strip(", ") or NOTHING,
                    _ending(inputs, int(row["outcome"])),
                    *(number(float(row[metric.key])) for metric in shown),
                ]
            )
            for _, row in rows.head(MOST_ROWS).iterrows()
        ]
        title = inputs.recorded if name == RECORDED else method_label(str(name))
        groups.append(Group(title, lines))
    yield Table(
        "Episodes",
        ["Rollout", "Told", "Ended", *(f"{m.label}\n({m.unit})" for m in shown)],
        groups,
        f"The demonstration and at most {MOST_ROWS} rollouts of each method from its start.",
        left=3,
    )


def _decisions(inputs: InspectionInputs) -> Iterator[Block]:
    decisions, dt = inputs.decisions, inputs.demos.dt
    who = decisions.individual
    along = interpretation.values_along_path(decisions.q, decisions.actions, dt, title=who)
    images = [to_image(along, f"Action values of {who} along the demonstration")]
    if decisions.map_q.size:
        figure = interpretation.value_map(
            decisions.x, decisions.y, decisions.map_q, decisions.focus, inputs.demos.arena,
            others=decisions.others, targets=interpretation.other_targets(inputs.demos, who),
            title=f"{who} at {number(decisions.moment * dt)} s",
        )  # fmt: skip
        images.append(to_image(figure, f"Best action value of {who} over the arena"))
    yield Text(
        f"What {method_label(inputs.learner)} values for {who} while everybody moves as "
        f"{inputs.recorded}; dots are the actions found in the demonstration, angles are taken "
        "from the direction to its focus. Over the arena: the value of the best action, were it "
        "put there at rest."
    )
    yield Gallery(images, "Values along the demonstration, and over the arena at half of its time.")


def _provenance(inputs: InspectionInputs) -> Iterator[Block]:
    yield Text("To repeat this page:")
    yield Command(inputs.command)
    yield Pairs("World", [*inputs.world.items(), *flattened(inputs.environment)])
    yield Pairs("Demonstrations", origin(inputs.demos))
    yield code_and_machine(inputs.machine, inputs.wall_time)
    yield Pairs("Versions", list(inputs.versions.items()))


def _methods(inputs: InspectionInputs) -> str:
    """What was done, in the past tense, with the numbers of this episode."""
    names = listed([method_label(name) for name in inputs.rollouts])
    rollouts = sum(map(len, inputs.rollouts.values()))
    return (
        f"{made_with(inputs.demos, inputs.versions, inputs.machine)}; licence of the data: "
        f"{licence(inputs.demos)}). From the first frame of one {inputs.recorded} test episode "
        f"(number {inputs.episode}, {inputs.demos.recording[inputs.episode]}), {rollouts} "
        f"rollouts of {names} were simulated. Along the "
        f"{inputs.recorded} path, {method_label(inputs.learner)} was asked at every time step "
        f"for the values of all actions of {inputs.decisions.individual}. One episode was chosen "
        "to be shown; nothing was inferred from it."
    )


def _condition(inputs: InspectionInputs, condition: int) -> str:
    return inputs.species.conditions[condition] if inputs.species.conditions else NOTHING


def _told(inputs: InspectionInputs, cue: int, condition: int) -> str:
    """What a rollout was told, where that is not its own condition."""
    return "" if cue in (NO_CUE, condition) else f", told {_condition(inputs, cue)}"


def _ending(inputs: InspectionInputs, outcome: int) -> str:
    if outcome == TIME_OUT:
        return "time limit"
    demos = inputs.demos
    return ending_in_words(outcome, demos.individuals, demos.roles) or "unfinished"
