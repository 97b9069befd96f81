"""What the player on the page plays: paths of a few starts, packed into little text."""

from __future__ import annotations

import base64
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from animarl_algos.evaluation.rollouts import Rollouts
from animarl_algos.report import style
from animarl_algos.report.examples import examples, factual_rollouts
from animarl_algos.report.inputs import ReportInputs
from animarl_algos.report.path_figures import bar_length, view_of
from animarl_algos.report.style import method_label
from animarl_algos.report.themes import COLOURS
from animarl_algos.report.words import Words
from animarl_envs.arena import Arena
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.episode import PURSUER_OUT, TARGET_OUT

Floats = NDArray[np.float64]

STARTS = 12  # that can be played, over all conditions
BUDGET = 1_500_000  # characters of packed paths; longer ones are thinned in time, evenly
LEVELS = 65_535  # of a packed coordinate, across the box that holds the scene
RECORDED, SIMULATED, FACTUAL, FLIPPED = "recorded", "simulated", "factual", "flipped"
TOLD_OTHER = "told the other condition"


class Track(NamedTuple):
    """One episode: ``(frames, individuals, 2)`` [arena unit], and how it ended."""

    path: Floats
    ending: str


class Scene(NamedTuple):
    """One start: its tracks by kind."""

    title: str
    tracks: dict[str, Track]


@dataclass(frozen=True, eq=False)
class Field:
    """Where scenes are played and by whom: the arena with its walls, and how near is contact."""

    demos: Demonstrations
    arena: Arena
    contact_radius: float | None

    @property
    def words(self) -> Words:
        return Words.of(self.demos)


@dataclass(frozen=True, eq=False)
class Player:
    """What the script of the page plays, as plain data; ``caption`` says what it is."""

    data: dict[str, Any]
    caption: str

    @classmethod
    def of(cls, inputs: ReportInputs) -> Player:
        """Simulated beside demonstrated and, where a cue was flipped, factual beside flipped."""
        scenes, words = list(_scenes(inputs)), inputs.words
        learner = method_label(inputs.learner)
        views = [view("simulated", words.say("recorded"), RECORDED, learner, SIMULATED)]
        if any(FLIPPED in scene.tracks for scene in scenes):
            flipper = method_label(str(_flipper(inputs)))
            views.append(view("flipped", f"{flipper}, factual", FACTUAL, TOLD_OTHER, FLIPPED))
        chosen = "from rollouts near their recording to far from it (DTW distance)"
        field = Field(inputs.demos, inputs.arena, inputs.contact_radius)
        return cls.playing(field, scenes, views, of_starts(field, len(scenes), chosen))

    @classmethod
    def playing(
        cls, field: Field, scenes: Sequence[Scene], views: Sequence[dict[str, Any]], said: str
    ) -> Player:
        """Any scenes; the caption begins with what is ``said`` of them."""
        demos, words = field.demos, field.words
        numbers = sum(t.path.size for s in scenes for t in s.tracks.values())
        stride = -(-numbers * 8 // (3 * BUDGET))  # two bytes a number, four characters for three
        names = {colour.hex: colour.name for colour in COLOURS}
        data = {
            "dt": demos.dt * max(1, stride),
            "unit": words.unit.name,
            "arena": {
                "shape": field.arena.shape,
                "size": field.arena.size,
                "walls": field.arena.rebound,
            },
            "contact": field.contact_radius,
            "individuals": [
                {"name": name, "role": role, "colour": names[look.colour], "mark": look.marker}
                for name, role, look in zip(
                    demos.individuals, demos.roles, style.looks(demos.roles), strict=True
                )
            ],
            "views": list(views),
            "scenes": [_packed(scene, field, max(1, stride)) for scene in scenes],
        }
        return cls(data, _caption(field, said))


def view(key: str, left: str, first: str, right: str, second: str) -> dict[str, Any]:
    """Two panels side by side: a title and a kind of track for each."""
    return {
        "key": key,
        "title": f"{right} beside {left}",
        "panels": [
            {"track": first, "title": left[:1].upper() + left[1:]},
            {"track": second, "title": right[:1].upper() + right[1:]},
        ],
    }


def _scenes(inputs: ReportInputs) -> Iterator[Scene]:
    rollouts, _ = factual_rollouts(inputs)
    conditions = len(np.unique(rollouts.condition))
    per_condition = max(1, STARTS // conditions)
    quantiles = [(k + 0.5) / per_condition for k in range(per_condition)]
    name = _flipper(inputs)
    asked = None if name is None else inputs.rollouts[name]
    demos = Rollouts.from_demonstrations(inputs.demos)
    for condition, chosen in examples(inputs, quantiles):
        for i in chosen:
            start = int(rollouts.demo[i])
            tracks = {
                RECORDED: track(inputs.demos, demos, start),
                SIMULATED: track(inputs.demos, rollouts, i),
            }
            pair = None if asked is None else _flipped_pair(asked, rollouts, i)
            if asked is not None and pair is not None:
                tracks[FACTUAL] = track(inputs.demos, asked, pair[0])
                tracks[FLIPPED] = track(inputs.demos, asked, pair[1])
            yield Scene(f"Start {start}{f', {condition}' if condition else ''}", tracks)


def _flipper(inputs: ReportInputs) -> str | None:
    """The method that was told the other condition: the learner if it was, else the first."""
    for name in dict.fromkeys([inputs.learner, *inputs.rollouts]):
        told = inputs.rollouts[name]
        if ((told.cue >= 0) & (told.cue != told.condition)).any():
            return name
    return None


def _flipped_pair(asked: Rollouts, rollouts: Rollouts, i: int) -> tuple[int, int] | None:
    """Factual and flipped rollout from the start of rollout ``i``: one network, one repetition."""
    here = np.flatnonzero(
        (asked.demo == rollouts.demo[i]) & (asked.condition == rollouts.condition[i])
    )
    factual = here[asked.cue[here] == asked.condition[here]]
    same = factual[
        (asked.seed[factual] == rollouts.seed[i])
        & (asked.repetition[factual] == rollouts.repetition[i])
    ]
    for first in (*same.tolist(), *factual.tolist()):
        other = here[
            (asked.cue[here] == 1 - asked.condition[here]) & (asked.seed[here] == asked.seed[first])
        ]
        nearest = other[
            np.argsort(asked.repetition[other] != asked.repetition[first], kind="stable")
        ]
        if len(nearest):
            return first, int(nearest[0])
    return None


def track(demos: Demonstrations, rollouts: Rollouts, i: int) -> Track:
    """An episode, and its ending in words."""
    goal = "source" if "searcher" in demos.roles else "target"
    outcome = int(rollouts.outcome[i])
    endings = {TARGET_OUT: "target left", PURSUER_OUT: "pursuer left"}
    ending = f"{goal} reached" if outcome > 0 else endings.get(outcome, f"{goal} not reached")
    return Track(rollouts.path(i), ending)


def _packed(scene: Scene, field: Field, stride: int) -> dict[str, Any]:
    """A scene as plain data; paths as 16-bit numbers across the box that holds them, in base64."""
    points = np.concatenate([t.path.reshape(-1, 2) for t in scene.tracks.values()])
    low = points.min(axis=0)
    span = float((points.max(axis=0) - low).max()) or 1.0
    moved = [t.path for kind, t in scene.tracks.items() if kind != RECORDED]
    shown = view_of(
        field.arena,
        np.concatenate([path.reshape(-1, 2) for path in moved]),
        scene.tracks[RECORDED].path,
    )
    unit = field.words.unit
    length = bar_length(shown[2], unit)
    return {
        "title": scene.title,
        "view": [round(v, 6) for v in shown],
        "bar": {"length": length / unit.per_arena_unit, "label": f"{length:g} {unit.name}"},
        "box": [float(low[0]), float(low[1]), span / LEVELS],
        "tracks": {
            kind: {"path": pack(track.path[::stride], low, span), "ending": track.ending}
            for kind, track in scene.tracks.items()
        },
    }


def pack(path: Floats, low: Floats, span: float) -> str:
    """``(frames, individuals, 2)`` as unsigned 16-bit little-endian numbers in base64."""
    levels = np.round((path - low) / span * LEVELS).astype("<u2")
    return base64.b64encode(levels.tobytes()).decode()


def of_starts(field: Field, count: int, chosen: str) -> str:
    """How many starts are shown, and how they were ``chosen``."""
    return field.words.say(f"{count} test starts, all different, {chosen}.")


def _caption(field: Field, said: str) -> str:
    walls = {"open": "The field is open."}.get(
        field.arena.shape,
        "The outline is a wall." if field.arena.rebound
        else "The dashed outline is the edge of the field; there is no wall.",
    )  # fmt: skip
    contact = (
        "" if field.contact_radius is None
        else " The dotted ring shows how near is contact; it is drawn thick while there is any."
    )  # fmt: skip
    return f"{said} {walls}{contact}"
