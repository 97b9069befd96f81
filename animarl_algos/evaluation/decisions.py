"""What a trained learner values: along a recorded path, and over the arena at one moment of it."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from animarl_envs.arena import Arena
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.errors import InputError
from animarl_envs.files import read_npz, write_then_rename
from animarl_envs.fitting.transitions import demonstrated_actions
from animarl_envs.focus import first_pursuer
from animarl_envs.species import ChaseSpecies, Species
from animarl_envs.worlds import demonstration_observations
from animarl_envs.worlds.chase.world import demonstration_headings, observe

Floats = NDArray[np.float64]

MAP_POINTS = 41  # along each side of the map
OPEN_MARGIN = 1.1  # of a map of an open field, around where animals went


@dataclass(frozen=True, eq=False, kw_only=True)
class Decisions:
    """Action values of one individual.

    Parameters
    ----------
    individual
        Whose values they are.
    demo
        The demonstration, counted in the evaluated set.
    q, actions
        ``(steps, actions)`` and ``(steps,)``: values before each recorded step, and the action that
        inverse dynamics finds in it.
    moment
        The frame at which the map is taken.
    x, y
        ``(columns,)`` and ``(rows,)``, where the individual is put, at rest [arena unit].
    map_q, focus
        ``(rows, columns, actions)`` and ``(rows, columns, 2)``: its values there and the direction
        towards its focus. All four are empty for a searcher, of whom no map is drawn.
    others
        ``(K - 1, 2)``, where the others stand at that moment, the target last if it is one of them.
    """

    individual: str
    demo: int
    q: Floats
    actions: NDArray[np.int64]
    moment: int
    x: Floats
    y: Floats
    map_q: Floats
    focus: Floats
    others: Floats

    def save(self, file: Path) -> None:
        """Write arrays only, whole or not at all."""
        with write_then_rename(file) as part, part.open("wb") as stream:
            np.savez_compressed(stream, **asdict(self))

    @classmethod
    def load(cls, file: Path) -> Decisions:
        """Read what :meth:`save` wrote, or raise InputError if the file is damaged."""
        values: dict[str, Any] = read_npz(file)
        try:
            plain = {"individual": str, "demo": int, "moment": int}
            return cls(**values | {name: kind(values[name]) for name, kind in plain.items()})
        except (ValueError, KeyError, TypeError) as error:
            raise InputError(f"{file}: it is damaged ({error}): evaluate the run again") from error


def decide_along(
    policy: Any,
    species: Species,
    demos: Demonstrations,
    *,
    condition_flag: bool = False,
    focal: str | None = None,
    demo: int | None = None,
) -> Decisions:
    """What ``policy`` values in one demonstration, where all move as recorded.

    Parameters
    ----------
    policy
        Of all individuals, in the order of ``demos``, or of ``focal`` alone; its ``advance`` gives
        Q-values ``(slots, actions)`` and the next memory.
    species
        As the policy was trained in; its locomotion tells the recorded actions.
    demos, demo
        The evaluated set, and which of it; by default the one of median length.
    condition_flag
        Whether the condition is the last component of an observation.
    focal
        The individual that learned, whose values are told. If all did: those of the first that
        moves towards the target or source.
    """
    if demo is None:
        demo = int(np.argsort(demos.lengths, kind="stable")[len(demos) // 2])
    one = demos.select(episodes=[demo])
    steps = int(one.lengths[0]) - 1
    who = first_pursuer(one.roles) if focal is None else one.individuals.index(focal)
    slots = np.arange(len(one.roles)) if focal is None else np.array([who])
    own = slots.tolist().index(who)
    flag = one.condition[0] if condition_flag else None
    observations = _flagged(demonstration_observations(species, one)[:, slots], flag)
    actions = demonstrated_actions(one, species.locomotion).astype(np.int64)
    values = np.empty((steps, species.num_actions))
    state: Any = None
    moment, memory = steps // 2, None
    for t in range(steps):
        memory = state if t == moment else memory
        q_values, hidden, _ = policy.advance(observations[t], state, np.zeros(len(slots), bool))
        values[t] = q_values[own]
        state = (hidden, np.maximum(actions[t, slots], 0))
    empty = np.empty(0)
    shown: dict[str, Any] = {
        "x": empty, "y": empty, "map_q": empty, "focus": empty, "others": np.empty((0, 2))
    }  # fmt: skip
    if isinstance(species, ChaseSpecies):
        shown = _map(policy, species, one, slots, own, moment, memory, flag)
    return Decisions(
        individual=one.individuals[who],
        demo=demo,
        q=values,
        actions=actions[:steps, who],
        moment=moment,
        **shown,
    )


def _map(
    policy: Any,
    species: ChaseSpecies,
    one: Demonstrations,
    slots: NDArray[np.int64],
    own: int,
    moment: int,
    memory: Any,
    flag: Any,
) -> dict[str, Any]:
    """Values of one individual put at every place of the arena, the others where they were.

    ``slots`` are the individuals that the policy acts for, ``own`` the place of one among them.
    """
    x, y = map_sides(species.arena, one.positions)
    places = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    count, who, shape = len(places), slots[own], (len(y), len(x))
    position = np.repeat(one.positions[moment][None], count, axis=0)
    velocity = np.repeat(one.velocities()[moment][None], count, axis=0)
    position[:, who], velocity[:, who] = places, 0.0
    heading = demonstration_headings(species, one)[[moment]].repeat(count, axis=0)
    observations, focus = observe(species, position, velocity, heading=heading)
    flat = _flagged(observations[:, slots], flag).reshape(count * len(slots), -1)
    state = None if memory is None else tuple(np.tile(m.T, count).T for m in memory)
    q_values = policy.advance(flat, state, np.zeros(len(flat), dtype=bool))[0]
    map_q = q_values.reshape(count, len(slots), -1)[:, own].astype(np.float64)
    if species.arena.shape == "disc":
        map_q[np.hypot(places[:, 0], places[:, 1]) > species.arena.size] = np.nan
    return {
        "x": x,
        "y": y,
        "map_q": map_q.reshape(*shape, species.num_actions),
        "focus": np.asarray(focus[:, who]).reshape(*shape, 2),
        "others": np.delete(one.positions[moment], who, axis=0),
    }


def map_sides(arena: Arena, positions: Floats) -> tuple[Floats, Floats]:
    """Coordinates of a map ``(MAP_POINTS,)`` along x and y: the arena, or where animals went.

    An open field has no size; its map is a square around all ``positions`` ``(..., 2)``.
    """
    centre, half = np.zeros(2), arena.size
    if arena.shape == "open":
        places = positions.reshape(-1, 2)
        low, high = places.min(axis=0), places.max(axis=0)
        centre = (low + high) / 2
        half = OPEN_MARGIN * float((high - low).max()) / 2 or arena.size
    x, y = (np.linspace(c - half, c + half, MAP_POINTS) for c in centre.tolist())
    return x, y


def _flagged(observations: NDArray[np.float32], flag: Any) -> NDArray[np.float32]:
    """Observations ``(N, K, n)``, with the condition of the episode behind them if there is one."""
    if flag is None:
        return observations
    column = np.full((*observations.shape[:2], 1), flag, dtype=np.float32)
    return np.concatenate([observations, column], axis=2)
