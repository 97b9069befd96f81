"""What there is to see of an episode at one moment: a :class:`Scene`, and its recorder.

A scene is plain data in the arena frame. The renderer draws it; the views make it with a
:class:`SceneRecorder`, which follows one copy of a world.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from animarl_envs.arena import Arena
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.summary import ending_in_words
from animarl_envs.demos.units import RECORDED_SCALE, unit_of
from animarl_envs.errors import InputError
from animarl_envs.species.base import PLAIN_BODY, body_of_each
from animarl_envs.worlds.plume.plume import PlumeField

AT_REST = 1e-9  # a slower individual keeps its heading [arena unit / s]
GLOW_TIME = 1.0  # an odour fades from the picture over this time [s]
GLOW_RATE = 20.0  # instants of the plume per second that the picture unites [Hz]


@dataclass(frozen=True, eq=False, kw_only=True)
class Scene:
    """One moment of one episode, arena frame, K individuals.

    Parameters
    ----------
    arena, contact_radius
        The field, and the distance that counts as contact [arena unit].
    names, roles, bodies
        For each individual its name, ``"pursuer"``, ``"target"`` or ``"searcher"``, and which of
        :data:`animarl_envs.drawing.bodies.BODIES` it has; ``bodies`` may be left out.
    positions, headings
        ``(K, 2)`` [arena unit] and ``(K,)``, counter-clockwise from x [rad].
    trails
        ``(t, K, 2)``, positions so far, oldest first; t may be 0.
    touched
        ``(K,)``, individuals in contact now.
    rewards
        ``(K,)``, shown beside the names; the views give the return of the episode so far.
    title, condition, note
        Text: the species, its condition, and how the episode ended.
    step, time
        Decisions taken, and seconds since the start.
    unit, per_arena_unit
        Unit of length for the scale bar: ``"m"``, ``"cm"``, or ``"unit"`` for scaled arenas; and
        how many of it make an arena unit.
    plume, demonstration, source, wind, antennae, odour
        Optional: an odour field; recorded paths ``(frames, K, 2)`` to show faintly; the odour
        source ``(2,)``; the direction the wind blows to [rad]; positions ``(2, 2)`` of a
        searcher's left and right antenna and what they smell ``(2,)`` in [0, 1].
    """

    arena: Arena
    contact_radius: float
    names: tuple[str, ...]
    roles: tuple[str, ...]
    positions: NDArray[np.floating]
    headings: NDArray[np.floating]
    trails: NDArray[np.floating]
    touched: NDArray[np.bool_]
    rewards: NDArray[np.floating]
    bodies: tuple[str, ...] = ()
    title: str = ""
    condition: str = ""
    note: str = ""
    step: int = 0
    time: float = 0.0
    unit: str = "unit"
    per_arena_unit: float = 1.0
    plume: PlumeField | None = None
    demonstration: NDArray[np.floating] | None = None
    source: tuple[float, float] | None = None
    wind: float | None = None
    antennae: NDArray[np.floating] | None = None
    odour: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        num = len(self.names)
        shapes: dict[str, tuple[int, ...]] = {
            "positions": (num, 2), "headings": (num,), "touched": (num,), "rewards": (num,),
            "trails": (*self.trails.shape[:1], num, 2),
        }  # fmt: skip
        if self.demonstration is not None:
            shapes["demonstration"] = (*self.demonstration.shape[:1], num, 2)
        for key, shape in shapes.items():
            if getattr(self, key).shape != shape:
                raise InputError(
                    f"{key} of the scene has shape {getattr(self, key).shape}, not {shape}: "
                    f"give one entry for each of {', '.join(self.names)}"
                )
        for what, given in (("roles", self.roles), ("bodies", self.bodies or self.roles)):
            if len(given) != num:
                raise InputError(f"the scene has {len(given)} {what} for {num} individuals")

    def body(self, i: int) -> str:
        """What individual ``i`` looks like."""
        return self.bodies[i] if self.bodies else PLAIN_BODY


@dataclass(eq=False)
class SceneRecorder:
    """Follows one copy of a world and makes its scenes.

    Call :meth:`start` after every reset, :meth:`follow` after every step, :meth:`scene` to look.

    Parameters
    ----------
    world
        A chase or search world.
    copy
        Which of its copies.
    """

    world: Any
    copy: int = 0
    _trail: list[NDArray[np.float64]] = field(default_factory=list, init=False)
    _headings: NDArray[np.float64] = field(default_factory=lambda: np.zeros(0), init=False)
    _returns: NDArray[np.float64] = field(default_factory=lambda: np.zeros(0), init=False)
    _glow: Afterglow | None = field(default=None, init=False)
    _lengths: dict[str, Any] | None = field(default=None, init=False)

    def start(self) -> None:
        """Begin with the state after a reset; individuals at rest face their target."""
        position = self.world.position[self.copy]
        towards = position[-1] - position if len(position) > 1 else -position
        self._headings = np.arctan2(towards[:, 1], towards[:, 0])
        self._trail = []
        self._returns = np.zeros(len(position))
        smells = hasattr(self.world, "plume")
        self._glow = Afterglow(self.world, self.copy) if smells else None
        self._look()

    def follow(self) -> None:
        """Take in the step that was just made."""
        self._returns = self._returns + self.world.reward[self.copy]
        self._look()

    def _look(self) -> None:
        velocity = self.world.velocity[self.copy]
        moving = np.hypot(velocity[:, 0], velocity[:, 1]) > AT_REST
        direction = np.arctan2(velocity[:, 1], velocity[:, 0])
        self._headings = np.where(moving, direction, self._headings)
        self._trail.append(self.world.position[self.copy].copy())

    def scene(self, *, demonstration: bool = False) -> Scene:
        """The scene now; ``demonstration=True`` adds the paired recorded paths."""
        if not self._trail:
            raise InputError("there is nothing to see before the first episode: call reset first")
        world, b = self.world, self.copy
        species = world.scenario.species
        position = world.position[b].copy()
        number = int(world.condition[b])
        condition = (
            f"condition {number}: {species.conditions[number]}" if species.conditions else ""
        )
        recorded = None
        if demonstration and world.demos is not None and world.demo[b] >= 0:
            recorded = world.demos.episode(int(world.demo[b])).positions
        step = int(world.step_count[b])
        plain: dict[str, Any] = {"headings": self._headings.copy()}
        details = world.scene_details(b)
        if self._glow is not None:
            details["plume"] = self._glow.plume()
        if self._lengths is None:
            self._lengths = _lengths(world.demos)
        return Scene(
            arena=species.arena,
            contact_radius=species.contact_radius,
            names=species.individuals,
            roles=species.roles,
            bodies=body_of_each(species.bodies, species.roles),
            positions=position,
            trails=np.stack(self._trail),
            touched=_touched(position, species.contact_radius),
            rewards=self._returns.copy(),
            title=species.title,
            condition=condition,
            note=self._ending(),
            step=step,
            time=step * species.dt,
            demonstration=recorded,
            **(plain | self._lengths | details),
        )

    def _ending(self) -> str:
        """How the episode ended, or nothing if it goes on."""
        species = self.world.scenario.species
        if self.world.truncated[self.copy]:
            return "time limit"
        if not self.world.terminated[self.copy]:
            return ""
        outcome = int(self.world.outcome[self.copy])
        return ending_in_words(outcome, species.individuals, species.roles)


class Afterglow:
    """The plume of the last moments, fading with age.

    Puffs cross the field faster than pictures follow each other, so an instant alone would flicker;
    what is drawn is the greatest of the recent fields, each faded over :data:`GLOW_TIME`.
    """

    def __init__(self, world: Any, copy: int) -> None:
        self.world = world
        self.copy = copy
        self._drawn: float = -np.inf  # time of the last field in ``_values`` [s]
        self._values: NDArray[np.float32] | None = None
        self._extent: tuple[float, ...] = ()

    def plume(self) -> PlumeField:
        """The field at the end of the step that led to the world's present state."""
        world, b = self.world, self.copy
        dt = world.scenario.species.dt
        now = (int(world.phase[b] + world.step_count[b]) + 1) * dt
        pattern, wait = world.patterns[world.pattern[b]], 1.0 / GLOW_RATE
        # Only what is new since the last picture, and nothing that has faded already.
        time = max(self._drawn + wait, now - 3.0 * GLOW_TIME)
        while time <= now + 1e-9 or self._values is None:
            fresh, self._extent = world.plume.field(pattern, time)
            if self._values is None:
                self._values = fresh
            self._values = np.maximum(self._values * np.exp(-wait / GLOW_TIME), fresh)
            self._drawn, time = time, time + wait
        scale = world.scenario.species.metres_per_unit
        left, right, low, high = (edge / scale for edge in self._extent)
        return PlumeField(values=self._values, extent=(left, right, low, high))


def _lengths(demos: Demonstrations | None) -> dict[str, Any]:
    """The unit of the scale bar, where the recordings have one."""
    unit = RECORDED_SCALE if demos is None else unit_of(demos)
    if unit == RECORDED_SCALE:
        return {}
    return {"unit": unit.name, "per_arena_unit": unit.per_arena_unit}


def _touched(position: NDArray[np.float64], contact_radius: float) -> NDArray[np.bool_]:
    """``(K,)``: who is within reach of the last one (a searcher: of the source), and that one."""
    aim = position[-1] if len(position) > 1 else np.zeros(2)
    touched = np.hypot(*(position - aim).T) < contact_radius
    if len(position) > 1:
        touched[-1] = touched[:-1].any()
    return np.asarray(touched)
