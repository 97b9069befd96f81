"""Figures that open the decision process: values along a path, values over the arena.

They take plain arrays, so any source of Q-values can be shown: a trained network's, or a table.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from animarl_algos.report import style, themes
from animarl_envs.arena import Arena
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.units import RECORDED_SCALE, Unit
from animarl_envs.errors import InputError
from animarl_envs.locomotion import NUM_ACTIONS, NUM_DIRECTIONS, action_directions

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Floats = NDArray[np.float64]

DIRECTIONS = {0: "towards focus", 3: "right", 6: "away", 9: "left"}
DIVERGING = "RdBu_r"
SEQUENTIAL = "cividis"  # readable with every colour vision deficiency, and in grey


def action_labels(num_actions: int) -> dict[int, str]:
    """Actions named on an axis: four directions of each thrust magnitude, and coasting.

    With several magnitudes, the number in front counts them from the largest.
    """
    thrusts = (num_actions - 1) // NUM_DIRECTIONS
    labels = {
        NUM_DIRECTIONS * m + k: name if thrusts == 1 else f"{m + 1}: {name}"
        for m in range(thrusts)
        for k, name in DIRECTIONS.items()
    }
    return labels | {num_actions - 1: "coast"}


def advantage(q: Floats) -> Floats:
    """Q minus its mean over actions, ``(..., actions)``: what the choice of action is worth."""
    return np.asarray(q - q.mean(axis=-1, keepdims=True))


def values_along_path(
    q: Floats, actions: NDArray[np.integer], dt: float, *, title: str = ""
) -> Figure:
    """State value and the advantage of each direction along a recorded or simulated path.

    Parameters
    ----------
    q
        ``(steps, actions)``, action values before each decision.
    actions
        ``(steps,)``, the actions that were taken, drawn as dots; -1 where unknown.
    dt
        One decision step [s].
    """
    _check(q, "(steps, actions)", 2)
    time = np.arange(len(q)) * dt
    with style.figure_style():
        from matplotlib.figure import Figure

        figure = Figure(figsize=(6.6, 3.6), layout="constrained")
        above, below = figure.subplots(2, 1, sharex=True, height_ratios=[1, 2.2])
        above.plot(time, q.mean(axis=1), color=style.RECORDED_COLOUR, label="mean over actions")
        above.plot(
            time, q.max(axis=1), color=style.SIMULATED_COLOUR, linewidth=1.0, label="best action"
        )
        above.set(ylabel="Q", title=title)
        above.legend(loc="best", ncols=2)
        table = advantage(q).T
        reach = float(np.abs(table).max()) or 1.0
        edges = np.append(time, time[-1] + dt) - dt / 2
        mesh = below.pcolormesh(
            edges, np.arange(q.shape[1] + 1) - 0.5, table, cmap=DIVERGING, vmin=-reach,
            vmax=reach, rasterized=True,
        )  # fmt: skip
        known = actions >= 0
        below.plot(
            time[known], actions[known], ".", color=style.RECORDED_COLOUR, markersize=3.5,
            markeredgewidth=0,
        )  # fmt: skip
        labels = action_labels(q.shape[1])
        below.set_yticks(list(labels), list(labels.values()))
        below.invert_yaxis()
        below.set(xlabel="Time (s)", ylabel="Acceleration")
        figure.colorbar(mesh, ax=below, label="Advantage", pad=0.01)
    return figure


def other_targets(demos: Demonstrations, who: str) -> list[bool]:
    """Which of the others are targets, in order."""
    return [
        role == "target"
        for name, role in zip(demos.individuals, demos.roles, strict=True)
        if name != who
    ]


def value_map(
    x: Floats,
    y: Floats,
    q: Floats,
    focus: Floats,
    arena: Arena,
    *,
    others: Floats | None = None,
    targets: Sequence[bool] = (),
    unit: Unit = RECORDED_SCALE,
    title: str = "",
) -> Figure:
    """Best action value at every place of the arena, with the accelerations it calls for.

    Parameters
    ----------
    x, y
        ``(columns,)`` and ``(rows,)``, where the individual is put [arena unit].
    q
        ``(rows, columns, actions)``, its action values there; NaN outside the arena.
    focus
        ``(rows, columns, 2)``, unit vectors towards the focus, arena frame: they turn
        an action into a direction in the arena.
    others
        ``(individuals, 2)``, where the others stand.
    targets
        Which of them are targets, drawn as dark crosses; by default none.
    unit
        Of the axes.
    """
    _check(q, "(rows, columns, actions)", 3)
    if q.shape[:2] != (len(y), len(x)) or focus.shape != (*q.shape[:2], 2):
        raise InputError(
            f"q has shape {q.shape} and focus {focus.shape}, but there are {len(y)} rows and "
            f"{len(x)} columns: give (rows, columns, actions) and (rows, columns, 2)"
        )
    direction = action_directions(q.argmax(axis=-1), focus, q.shape[-1])
    direction[np.isnan(q[..., 0])] = np.nan  # no arrow outside the arena
    x, y = unit.per_arena_unit * x, unit.per_arena_unit * y
    others = None if others is None else unit.per_arena_unit * others
    with style.figure_style():
        figure, panel = style.new_figure(4.2, 3.6)
        mesh = panel.pcolormesh(
            x, y, q.max(axis=-1), cmap=SEQUENTIAL, shading="nearest", rasterized=True
        )
        rows, columns = (slice(None, None, max(1, len(a) // 14)) for a in (y, x))
        panel.quiver(
            x[columns], y[rows], direction[rows, columns, 0], direction[rows, columns, 1],
            color=style.ON_MAP, pivot="mid", scale=24, width=0.004,
        )  # fmt: skip
        if others is not None:
            marks: dict[str, Any] = {"markeredgecolor": style.ON_MAP, "markeredgewidth": 1.0}
            marks["markersize"] = 6
            aims = np.array(targets, dtype=bool) if len(targets) else np.zeros(len(others), bool)
            panel.plot(*others[~aims].T, "o", color=themes.VERMILION.hex, **marks)
            panel.plot(*others[aims].T, "X", color=style.RECORDED_COLOUR, **marks)
        panel.set_aspect("equal")
        panel.set(xlabel=f"x ({unit.name})", ylabel=f"y ({unit.name})", title=title)
        if arena.shape == "disc":
            from matplotlib.patches import Circle

            radius = unit.per_arena_unit * arena.size
            panel.add_patch(Circle((0, 0), radius, fill=False, edgecolor=style.MUTED))
        figure.colorbar(mesh, ax=panel, label="Q of the best action", pad=0.02)
    return figure


def _check(q: Floats, wanted: str, ndim: int) -> None:
    full = q.shape[-1] >= NUM_ACTIONS and (q.shape[-1] - 1) % NUM_DIRECTIONS == 0
    if q.ndim != ndim or not full or q.size == 0:
        raise InputError(f"q has shape {q.shape}, not {wanted}: give one value per action")
