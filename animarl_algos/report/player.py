"""What the player on a page plays: paths of a few starts, packed into little text."""

import base64
import math
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from animarl_algos.evaluation.metrics import DTW
from animarl_algos.evaluation.rollouts import Rollouts
from animarl_algos.report import style
from animarl_algos.report.figures import Stage, view_of
from animarl_algos.report.inputs import PageInputs, ReportInputs
from animarl_algos.report.page import Player
from animarl_algos.report.style import method_label
from animarl_algos.report.words import capitalised
from animarl_envs.array_types import Floats, Ints
from animarl_envs.demos.summary import outcome_name
from animarl_envs.drawing.render import round_length

STARTS = 12  # that can be played, over all conditions
BUDGET = 1_500_000  # characters of packed paths; longer ones are thinned in time, evenly
LEVELS = 65_535  # of a packed coordinate, across the box that holds the scene
RECORDED, SIMULATED = "recorded", "simulated"


Scene = tuple[str, dict[str, tuple[Rollouts, int]]]
"""One start: its title and, by kind of track, an episode as rollouts and which of them."""


def run_player(inputs: ReportInputs) -> Player:
    """Play simulated beside demonstrated."""
    rollouts, _ = factual_rollouts(inputs)
    demos, scenes = Rollouts.from_demonstrations(inputs.demos), []
    each = max(1, STARTS // len(np.unique(rollouts.condition)))
    for condition, chosen in examples(inputs, middles(each)):
        for i in chosen:
            start = int(rollouts.demo[i])
            title = f"Start {start}{f', {condition}' if condition else ''}"
            scenes.append((title, {RECORDED: (demos, start), SIMULATED: (rollouts, i)}))
    learner = method_label(inputs.learner)
    views = [view("simulated", inputs.recorded, RECORDED, learner, SIMULATED)]
    order = "from rollouts near their recording to far from it (DTW distance)."
    several = "s, all different," if len(scenes) > 1 else ""
    return play(inputs, scenes, views, f"{len(scenes)} test start{several} {order}")


def play(
    inputs: PageInputs, scenes: Sequence[Scene], views: Sequence[dict[str, Any]], introduction: str
) -> Player:
    """Return a player of any scenes; the caption begins with the ``introduction``."""
    demos, stage = inputs.demos, inputs.stage
    numbers = sum(made.path(i).size for _, tracks in scenes for made, i in tracks.values())
    stride = max(1, -(-numbers * 8 // (3 * BUDGET)))  # two bytes a number, four characters for 3
    data = {
        "dt": demos.dt * stride,
        "unit": inputs.words.unit.name,
        **_world(stage),
        "views": list(views),
        "scenes": [_packed(*scene, stage, stride) for scene in scenes],
    }
    walls = "The dashed outline is the edge of the field; there is no wall."
    if stage.arena.shape == "open":
        walls = "The field is open."
    elif stage.arena.rebound:
        walls = "The outline is a wall."
    near = "The dotted ring shows how near is contact; it is drawn thick while there is any."
    around = walls if stage.contact_radius is None else f"{walls} {near}"
    return Player(data, f"{inputs.words.adapt(introduction)} {around}")


def view(
    key: str, left: str, first: str, right: str, second: str, changed: Stage | None = None
) -> dict[str, Any]:
    """Return two panels side by side: a title and a kind of track for each.

    ``changed`` is where the second one moves and who they are, if that differs.
    """
    return {
        "key": key,
        "title": f"{right} beside {left}",
        "panels": [
            {"track": first, "title": capitalised(left)},
            {"track": second, "title": capitalised(right)}
            | ({} if changed is None else {"world": _world(changed)}),
        ],
    }


def _world(stage: Stage) -> dict[str, Any]:
    """Return what is drawn besides the paths, as plain data."""
    arena, names = stage.arena, {colour.hex: colour.name for colour in style.COLOURS}
    return {
        "arena": {
            "shape": arena.shape,
            "size": arena.size,
            "walls": arena.rebound,
            "obstacles": arena.pillars,
            "corners": arena.corners.tolist(),
            "landmarks": [place for place in arena.landmarks if math.isfinite(place[1])],
        },
        "contact": stage.contact_radius,
        "individuals": [
            {"name": name, "role": role, "colour": names[look.colour], "mark": look.marker}
            for name, role, look in zip(
                stage.names, stage.roles, style.looks(stage.roles), strict=True
            )
        ],
    }


def _packed(
    title: str, tracks: dict[str, tuple[Rollouts, int]], stage: Stage, stride: int
) -> dict[str, Any]:
    """Return a scene as plain data; paths are 16-bit numbers across their box, in base64."""
    paths = {kind: made.path(i) for kind, (made, i) in tracks.items()}
    points = np.concatenate([path.reshape(-1, 2) for path in paths.values()])
    low = points.min(axis=0)
    span = float((points.max(axis=0) - low).max()) or 1.0
    moved = [path for kind, path in paths.items() if kind != RECORDED]
    view_box = view_of(stage.arena, paths[RECORDED], *moved)
    unit = stage.words.unit
    length, label = round_length(view_box[2] * unit.per_arena_unit / 2, unit.name)

    def pack(path: Floats) -> str:
        levels = np.round((path[::stride] - low) / span * LEVELS).astype("<u2")
        return base64.b64encode(levels.tobytes()).decode()

    return {
        "title": title,
        "view": [round(v, 6) for v in view_box],
        "bar": {"length": length / unit.per_arena_unit, "label": label},
        "box": [float(low[0]), float(low[1]), span / LEVELS],
        "tracks": {
            kind: {"path": pack(paths[kind]), "ending": outcome_name(int(made.outcome[i]), made)}
            for kind, (made, i) in tracks.items()
        },
    }


def at_ranks(values: ArrayLike, starts: ArrayLike, quantiles: Sequence[float]) -> Ints:
    """Return indices of the values nearest in rank to the quantiles, no two from one start.

    There are fewer than asked for where there are fewer starts.
    """
    starts = np.asarray(starts)
    order = np.argsort(np.asarray(values), kind="stable")
    chosen: dict[int, int] = {}  # rank by start
    for quantile in quantiles:
        off = np.abs(np.arange(len(order)) - quantile * (len(order) - 1))
        nearest = np.argsort(off, kind="stable").tolist()
        rank = next((r for r in nearest if int(starts[order[r]]) not in chosen), None)
        if rank is not None:
            chosen[int(starts[order[rank]])] = rank
    return np.asarray(order[sorted(chosen.values())], dtype=np.int64)


def middles(count: int) -> list[float]:
    """Return so many quantiles, evenly."""
    return [(k + 0.5) / count for k in range(count)]


def factual_rollouts(inputs: ReportInputs) -> tuple[Rollouts, Floats]:
    """Return the rollouts of the learner that the tables compare, and their DTW distances."""
    rows = inputs.evaluation.metrics  # in the order of the rollouts
    distances = rows.loc[(rows["method"] == inputs.learner) & rows["factual"], DTW.key]
    return inputs.rollouts[inputs.learner].factual(inputs.demos), distances.to_numpy(np.float64)


def examples(inputs: ReportInputs, quantiles: Sequence[float]) -> Iterator[tuple[str, list[int]]]:
    """Yield for each condition its name and factual rollouts at quantiles of the DTW distance.

    The name is empty where there is one condition only.
    """
    rollouts, dtw = factual_rollouts(inputs)
    present = np.unique(rollouts.condition).tolist()
    for condition in present:
        among = np.flatnonzero(rollouts.condition == condition)
        ranked = at_ranks(dtw[among], rollouts.demo[among], quantiles)
        yield inputs.condition(condition) if len(present) > 1 else "", among[ranked].tolist()
