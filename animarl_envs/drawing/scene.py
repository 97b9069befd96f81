"""A scene is one moment of an episode to be drawn; a recorder makes them of a world."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from animarl_envs.array_types import Bools, Floats
from animarl_envs.demos.summary import METRES, RECORDED_SCALE, Unit, ending_in_words, unit_of
from animarl_envs.errors import InputError
from animarl_envs.species import Species
from animarl_envs.worlds.plume.plume import PlumeField

AT_REST = 1e-9  # a slower individual keeps its heading [arena unit / s]
GLOW_TIME = 1.0  # an odour fades from the picture over this time [s]
GLOW_RATE = 20.0  # instants of the plume per second that the picture unites [Hz]


@dataclass(frozen=True, eq=False, kw_only=True)
class Scene:
    """One moment of one episode, arena frame, K individuals."""

    species: Species  # gives the arena, and what everybody is called and looks like
    positions: NDArray[np.floating]  # (K, 2) [arena unit]
    headings: NDArray[np.floating]  # (K,), counter-clockwise from x [rad]
    trails: NDArray[np.floating]  # (t, K, 2), positions so far, oldest first; t may be 0
    rewards: NDArray[np.floating]  # (K,), shown beside the names; of the episode so far
    condition: str = ""  # the experimental one, as text
    note: str = ""  # how the episode ended
    title: str = ""  # in place of the species' own
    step: int = 0  # decisions taken
    unit: Unit = RECORDED_SCALE  # of the scale bar
    plume: PlumeField | None = None
    antennae: NDArray[np.floating] | None = None  # (2, 2), left and right of a searcher ...
    odour: tuple[float, float] = (0.0, 0.0)  # ... and what they smell, in [0, 1]

    @property
    def searching(self) -> bool:
        """Whether there is an odour source, at the origin, and wind towards +x."""
        return "searcher" in self.species.roles

    @property
    def touched(self) -> Bools:
        """Individuals within reach of the target or source, and that target, ``(K,)``."""
        aim = np.zeros(2) if self.searching else self.positions[-1]
        touched = np.hypot(*(self.positions - aim).T) < self.species.contact_radius
        if not self.searching:
            touched[-1] = touched[:-1].any()
        return np.asarray(touched)


class SceneRecorder:
    """Follows one ``copy`` of a ``world`` and makes its scenes.

    Call :meth:`start` after every reset, :meth:`follow` after every step, :meth:`scene` to look.
    """

    def __init__(self, world: Any, copy: int = 0, title: str = "") -> None:
        self.world, self.copy, self.title = world, copy, title
        self._trail: list[Floats] = []
        self._glow: NDArray[np.float32] | None = None  # the plume, last drawn at this time [s]
        self._drawn = -np.inf
        self.unit = RECORDED_SCALE if world.demos is None else unit_of(world.demos)
        if hasattr(world, "plume") and self.unit in (RECORDED_SCALE, METRES):
            self.unit = Unit("m", world.scenario.species.metres_per_unit)

    def start(self) -> None:
        """Begin with the state after a reset; individuals at rest face their target."""
        position = self.world.position[self.copy]
        towards = position[-1] - position if len(position) > 1 else -position
        self._headings = np.arctan2(towards[:, 1], towards[:, 0])
        self._trail, self._returns = [], np.zeros(len(position))
        self._glow, self._drawn = None, -np.inf
        self._look()

    def follow(self) -> None:
        """Record the step that was just made."""
        self._returns = self._returns + self.world.reward[self.copy]
        self._look()

    def _look(self) -> None:
        velocity = self.world.velocity[self.copy]
        moving = np.hypot(velocity[:, 0], velocity[:, 1]) > AT_REST
        direction = np.arctan2(velocity[:, 1], velocity[:, 0])
        self._headings = np.where(moving, direction, self._headings)
        self._trail.append(self.world.position[self.copy].copy())

    def scene(self) -> Scene:
        """Return the scene now."""
        if not self._trail:
            raise InputError("there is nothing to see before the first episode: call reset first")
        world, b = self.world, self.copy
        species, number = world.scenario.species, int(world.condition[b])
        details: dict[str, Any] = {"headings": self._headings.copy()} | world.scene_details(b)
        if hasattr(world, "plume"):
            details["plume"] = self._plume()
        if species.conditions:
            details["condition"] = f"condition {number}: {species.conditions[number]}"
        if world.truncated[b]:
            details["note"] = "time limit"
        elif world.terminated[b]:
            outcome = int(world.outcome[b])
            details["note"] = ending_in_words(outcome, species.individuals, species.roles)
        return Scene(
            species=species,
            positions=world.position[b].copy(),
            trails=np.stack(self._trail),
            rewards=self._returns.copy(),
            title=self.title,
            step=int(world.step_count[b]),
            unit=self.unit,
            **details,
        )

    def _plume(self) -> PlumeField:
        """Return the plume at the end of the last step, fading with age.

        Puffs cross the field faster than pictures follow each other, so an instant alone would
        flicker; what is drawn is the greatest of the recent fields, each faded over
        :data:`GLOW_TIME`.
        """
        world, b, wait = self.world, self.copy, 1.0 / GLOW_RATE
        species, pattern = world.scenario.species, world.patterns[world.pattern[b]]
        now = (int(world.phase[b] + world.step_count[b]) + 1) * species.dt
        # Only what is new since the last picture, and nothing that has faded already.
        time = max(self._drawn + wait, now - 3.0 * GLOW_TIME)
        while time <= now + 1e-9 or self._glow is None:
            fresh, self._extent = world.plume.field(pattern, time)
            old = fresh if self._glow is None else self._glow
            self._glow = np.maximum(old * np.exp(-wait / GLOW_TIME), fresh)
            self._drawn, time = time, time + wait
        left, right, low, high = (edge / species.metres_per_unit for edge in self._extent)
        return PlumeField(values=self._glow, extent=(left, right, low, high))
