"""The chase world: pursuers and a target in an arena (agents, flies, newts and your own).

State per copy and individual: position, velocity, the acceleration of the last step, focus, the
unit vector towards the focus, and where the species has it the heading and its last turn. The focus
of a pursuer is the target; the focus of the target is its nearest pursuer, chosen anew at each step
(ties: the lower index). Where one pursues several, the focus of each target is the pursuer and that
of the pursuer its nearest target: positions, senses and contact know the last individual and the
many others, whoever pursues. Of free animals each has its own course for its focus, sees its
nearest few others, and only leaving ends an episode.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from animarl_envs.array_types import Bools, Floats, Ints
from animarl_envs.compiling import by_reference
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.locomotion import action_vectors, residual
from animarl_envs.scenario import Scenario
from animarl_envs.species import ChaseSpecies
from animarl_envs.worlds.base import World
from animarl_envs.worlds.chase import kernels as kernels
from animarl_envs.worlds.chase import senses
from animarl_envs.worlds.chase.cells import cells_of
from animarl_envs.worlds.chase.headings import bodies_of, first_headings, recorded_bodies
from animarl_envs.worlds.chase.layout import observation_components as observation_components
from animarl_envs.worlds.chase.layout import past_scales
from animarl_envs.worlds.chase.neighbours import neighbours_of


class ChaseWorld(World):
    """Batched chase; see :class:`animarl_envs.worlds.base.World` for the arrays.

    Rewards: ``touch`` +1 to a pursuer that touches the target (with shared reward, condition 1, to
    every pursuer); ``elapsed`` dt to the target for every step it lasts, and to a pursuer the cost
    of time (``time_cost``), if any; ``boundary`` -10 to each
    individual that leaves the boundary, if there are no walls. Contact is judged before the
    boundary. Of several targets the first touch ends the episode, for all.

    Attributes
    ----------
    acceleration
        ``(B, K, 2)``: ``(v_t - (1 - d) v_{t-1}) / (u dt)`` of the last step, the push of walls and
        recordings included, arena frame, in multiples of the thrust u; zero at the start. ``d`` and
        ``u dt`` are those of ``species.scales``.
    past
        ``(B, scales, K, 2)``: velocities before the present one, exponential means over the steps
        of ``layout.PAST`` [arena unit / s]; no scales where the species does not sense them. Of
        free animals over the times of ``layout.MEMORY``, and then by the same times how their
        course turned [rad / s] and their speed.
    towards
        ``(B, K, 2)``, unit vectors towards the focus.
    heading, turn
        ``(B, K)``, where bodies point and how far the last step turned them, counter-clockwise in
        the arena frame [rad]; ``(B, 0)`` where the species has no headings.
    traits
        ``(B, K, 2)``, how individuals differ from the mean one, see
        :mod:`animarl_envs.species.traits` [sd].
    course
        ``(B, K, 2)``, mean velocity up to the present, whose frame cells are in; where there are
        cells.
    """

    reward_components = ("touch", "elapsed", "boundary")
    _state_names = (*World._state_names, "acceleration", "past", "towards")
    _describe = observation_components

    def __init__(
        self, scenario: Scenario, num_copies: int = 1, observers: Iterable[int] | None = None
    ) -> None:
        super().__init__(scenario, num_copies, observers)
        species = scenario.species
        assert isinstance(species, ChaseSpecies)
        self._species = species
        B, K = num_copies, species.num_individuals
        self._acceleration = np.zeros((K, 2, B))
        self.acceleration = self._acceleration.transpose(2, 0, 1)
        self._past = np.zeros((past_scales(species), K, 2, B))
        self.past = self._past.transpose(3, 0, 1, 2)
        self._towards = np.zeros((K, 2, B))
        self._towards[:, 0] = 1.0
        self.towards = self._towards.transpose(2, 0, 1)
        self._senses = senses.senses_of(species, self.observers)
        free, headed, full = senses.branches_of(species)
        self._neighbours = neighbours_of(species, B)
        recorded = None if scenario.demos is None else scenario.demos.headings()
        self._bodies = bodies_of(species, B, recorded)
        self.heading, self.turn = self._bodies.heading.T, self._bodies.turn.T
        self.traits = self._bodies.traits.transpose(2, 1, 0)
        if species.has_headings:  # not in what was saved of a world without
            self._state_names = (*self._state_names, "heading", "turn")
        if species.traits is not None:
            self._state_names = (*self._state_names, "traits")
        self._cells = cells_of(species, B)
        if self._cells is not None:
            self.course = self._cells.course.transpose(2, 0, 1)
            self._state_names = (*self._state_names, "course")
        arena, start = species.arena, scenario.start
        self._reference = by_reference(
            kernels.make_reference,
            kernels.ChaseState(
                **self._shared_state(),
                actions=np.zeros((K, B), dtype=np.uint64),
                drivers=self._drivers,
                driven=any(driver != "action" for driver in scenario.drivers),
                fixed=np.zeros((0, 2)) if isinstance(start, str) else np.asarray(start),
                half_side=species.start_half_side,
                # Elsewhere a condition is a label that changes no reward.
                sharing=self.condition if species.shared_reward else 0 * self.condition,
                damping=np.array([m.damping for m in species.locomotion]),
                thrust=np.array([m.thrust for m in species.locomotion]),
                pushes=np.stack(
                    [
                        np.ascontiguousarray(action_vectors(m.magnitudes).T)
                        for m in species.locomotion
                    ]
                ),
                dt=species.dt,
                penalty=species.boundary_penalty,
                step_cost=species.step_cost,
                field=arena.field,
                walled=arena.walled,
                lone=species.lone_pursuer,
                free=free,
                shoaling=species.shoaling_reward,
                position=self._position,
                velocity=self._velocity,
                acceleration=self._acceleration,
                past=self._past,
                towards=self._towards,
                bodies=self._bodies,
                headed=headed,
                traits=np.zeros((0, 1, 2)) if species.traits is None else species.traits.table,
                own_traits=recorded_traits(species, scenario.demos),
                neighbours=self._neighbours,
                nearest=np.zeros(B),
                code=np.zeros(B, dtype=np.int64),
                components=self._components,
                reward=self._reward,
                observation=self._sensed,
                senses=self._senses,
                full=full,
                cells=self._cells,
            ),
        )

    def _start(self, mask: Bools) -> None:
        kernels.start(mask, self._reference)
        if len(self._past):
            senses.first_past(self._velocity, mask, self._past)
        if self._species.has_headings:
            self._wake(mask)
        if self._cells is not None:
            self.course[mask] = self.velocity[mask]
        self._look()

    def _look(self) -> None:
        """Observe the present state, by the kernel of a step: there is one to compile."""
        kernels.advance(np.zeros((0, 0), dtype=np.int64), False, True, self._reference)

    def look_at(self, world: ChaseWorld) -> None:
        """Observe the present state of a world that differs from this one in observations alone."""
        for name in set(self._state_names) - {"sensed"}:
            getattr(self, name)[...] = getattr(world, name)
        self._look()

    def _wake(self, mask: Bools) -> None:
        """Set the first headings of new episodes."""
        recorded = np.full((int(mask.sum()), self.num_individuals), np.nan)
        demo = self.demo[mask]
        if len(self._bodies.recorded):
            paired = demo >= 0
            recorded[paired] = self._bodies.recorded[self._demos.start[demo[paired]]]
        self.heading[mask] = first_headings(
            self._species, self.position[mask], self.velocity[mask], recorded
        )
        self.turn[mask] = 0.0

    def _advance(self, actions: NDArray[np.integer], observed: bool) -> None:
        kernels.advance(actions, True, observed, self._reference)

    def scene_details(self, copy: int) -> dict[str, Any]:
        """Return the headings, where they are a state of their own."""
        return {"headings": self.heading[copy].copy()} if self._species.has_headings else {}


def observing_world(
    species: ChaseSpecies, num_copies: int, observers: Iterable[int] | None = None
) -> ChaseWorld:
    """Return a world that makes observations of states that are given, and is never stepped."""
    count = species.num_individuals
    start = species.arena.free_places(species.arena.size)[:1].repeat(count, axis=0)
    still = Scenario(species=species, start=start, drivers=("action",) * count)
    return ChaseWorld(still, num_copies, observers)


def observe(
    species: ChaseSpecies,
    position: Floats,
    velocity: Floats,
    acceleration: Floats | None = None,
    steps: Ints | None = None,
    heading: Floats | None = None,
    traits: Floats | None = None,
) -> tuple[NDArray[np.float32], Floats]:
    """Return observations ``(frames, K, n)`` and focus directions ``(frames, K, 2)`` of states.

    The same kernel as in simulation, for recorded states ``(frames, K, 2)``; ``acceleration`` in
    multiples of the thrust, by default none, ``steps`` ``(frames,)`` since the start, by default 0
    of all, so that each is a start. ``heading`` ``(frames, K)`` are recorded ones [rad], by default
    none; a species without headings does not look at them. ``traits`` ``(frames, K, 2)`` are by
    default those of the mean individual [sd].
    """
    frames = len(position)
    acceleration = np.zeros_like(velocity) if acceleration is None else acceleration
    steps = np.zeros(frames, dtype=np.int64) if steps is None else steps
    world = observing_world(species, frames)  # a copy for each frame
    world.position[:], world.velocity[:], world.acceleration[:] = position, velocity, acceleration
    if species.has_headings:
        world.heading[:] = recorded_bodies(species, position, velocity, steps, heading).heading.T
    if traits is not None:
        world.traits[:] = traits
    world.step_count[:] = steps
    world._past[:] = senses.remembered(species, world._velocity, steps)
    world._look()
    return np.ascontiguousarray(world.observation), np.ascontiguousarray(world.towards)


def demonstration_observations(species: ChaseSpecies, demos: Demonstrations) -> NDArray[np.float32]:
    """Return observations of all recorded frames ``(frames, K, n)``, as its world gives them."""
    velocity, scales = demos.velocities(), species.scales
    pushes = np.zeros_like(velocity)  # in multiples of the thrust; zero at first frames
    for i, own in enumerate(scales.locomotion):
        added = residual(velocity[1:, i], velocity[:-1, i], own.damping)
        pushes[1:, i] = added / (own.thrust * scales.dt)
    pushes[demos.offsets[:-1]] = 0.0
    traits = np.repeat(recorded_traits(species, demos), demos.lengths, axis=0)
    return observe(
        species, demos.positions, velocity, pushes, demos.steps(), demos.headings(), traits
    )[0]


def recorded_traits(species: ChaseSpecies, demos: Demonstrations | None) -> Floats:
    """Return traits of the individuals of recorded episodes, ``(episodes, K, 2)`` [sd]."""
    if demos is None or species.traits is None:
        count = 0 if demos is None else len(demos)
        return np.zeros((count, species.num_individuals, 2))
    return species.traits.of_recordings(
        demos.positions, demos.lengths, demos.dt, demos.condition, demos.recording
    )
