"""The odour-search world: one searcher, a plume, two antennae, wind and visual flow.

The source lies at the origin and the air flows towards +x. The searcher is never told where it is:
the focus of its egocentric frame is the fixed upwind direction (-1, 0), "left" is then -y.

State beside position and velocity: the heading of the body and its last turn, the signals of the
two antennae, and the plume's pattern and phase. All readings are those of the step that led to the
present state.
"""

import math
from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from animarl_envs.array_types import Bools, Floats, Ints
from animarl_envs.compiling import by_reference
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.errors import InputError
from animarl_envs.scenario import Scenario
from animarl_envs.species import SearchSpecies
from animarl_envs.worlds.base import World
from animarl_envs.worlds.plume.plume import ModelPlume, as_plume, hit_table, odour_weights
from animarl_envs.worlds.search import kernels as kernels
from animarl_envs.worlds.search.kernels import Body, senses_of
from animarl_envs.worlds.search.layout import observation_components as observation_components


class SearchWorld(World):
    """Batched odour search; see :class:`animarl_envs.worlds.base.World` for the arrays.

    Reward: ``touch`` +1 at the source, ``elapsed`` the cost of time (``time_cost``), if any.
    Contact terminates, the time limit truncates.

    Attributes
    ----------
    heading
        ``(B, 2)`` unit vector, arena frame: a state with the dynamics ``species.turning``, and as
        recorded where a demonstration with headings is replayed; without ``turning`` the direction
        of the velocity, kept at rest.
    body_angle, turn
        ``(B,)``, the heading from upwind, and how far the last step turned it; counter-clockwise
        (to the left) [rad].
    odour, trace
        ``(B, 2)``, signals of the left and right antenna: 1 when hit, then decaying, fast to the
        baseline and slowly to zero.
    traits
        ``(B, 2)``, how the individual differs from the mean one, see
        :mod:`animarl_envs.species.traits` [sd].
    pattern, phase
        ``(B,)``: index into ``patterns``, and the plume's step at the start of the episode.
    """

    reward_components = ("touch", "elapsed")
    _state_names = (
        *World._state_names,
        "heading",
        "body_angle",
        "turn",
        "odour",
        "trace",
        "traits",
        "past",
        "pattern",
        "phase",
    )
    _describe = observation_components

    def __init__(
        self, scenario: Scenario, num_copies: int = 1, observers: Iterable[int] | None = None
    ) -> None:
        species = scenario.species
        assert isinstance(species, SearchSpecies)
        if species.num_individuals != 1:
            raise InputError(
                f"{species.name} has {species.num_individuals} searchers: it needs one"
            )
        if scenario.drivers[0] == "scripted":
            raise InputError(
                f"{species.individuals[0]} has no scripted rule in the world: drive it by actions, "
                "for instance with animarl_envs.worlds.search.programmed_moth"
            )
        super().__init__(scenario, num_copies, observers)
        self._body = body = Body.of(num_copies, species.odour_baseline)
        self.heading, self.odour, self.trace = body.heading.T, body.odour.T, body.trace.T
        self.body_angle, self.turn, self.traits = body.angle, body.turn, body.traits.T
        self.past = body.past.T
        self.pattern, self.phase = np.zeros((2, num_copies), dtype=np.int64)
        self.plume = as_plume(species.plume)
        # Of the model, patterns are dealt to training and test; a user's plume is for both.
        model = isinstance(self.plume, ModelPlume)
        every = tuple(range(self.plume.num_patterns))
        groups = (species.train_plumes, species.test_plumes) if model else (every, every)
        self.patterns = tuple(sorted({p for group in groups for p in group}))
        scale = species.metres_per_unit
        table = hit_table(self.plume, self.patterns, species.dt, species.antenna_radius * scale)
        own, start = species.locomotion[0], scenario.start
        region = np.tile([species.start_distance, 0.0] if isinstance(start, str) else start[0], 2)
        if isinstance(start, str) and species.start_region:
            low, high, width = species.start_region
            region = np.array([low, -width, high, width])
        self._reference = by_reference(
            kernels.make_reference,
            kernels.SearchState(
                **self._shared_state(),
                driver=int(self._drivers[0]),
                recorded=_recorded_senses(species, scenario.demos, self.patterns, groups, model),
                first=region.astype(np.float64).reshape(2, 2),
                traits=np.zeros((0, 2)) if species.traits is None else species.traits.table[:, 0],
                step_cost=species.step_cost,
                table=table._replace(cell=table.cell / scale),  # from here on in arena units
                odour=odour_weights(self.plume),
                senses=senses_of(species),
                damping=own.damping,
                thrust=own.thrust,
                pushes=np.array(own.action_vectors),
                condition=self.condition,
                pattern=self.pattern,
                phase=self.phase,
                position=self._position[0],
                velocity=self._velocity[0],
                body=self._body,
                components=self._components[0],
                reward=self._reward[0],
                sensed=self._sensed[0],
            ),
        )

    def _start(self, mask: Bools) -> None:
        kernels.start(mask, self._reference)

    def _advance(self, actions: NDArray[np.integer], observed: bool) -> None:
        kernels.step(actions, self._reference)

    def antennae(self) -> Floats:
        """Return positions of the left and right antenna, ``(B, 2, 2)``, arena frame."""
        return antennae_at(self.scenario.species, self.position[:, 0], self.heading)

    def scene_details(self, copy: int) -> dict[str, Any]:
        """Return what a picture shows beside the searcher."""
        return {
            "antennae": self.antennae()[copy],
            "odour": (float(self.odour[copy, 0]), float(self.odour[copy, 1])),
            "headings": np.array([math.atan2(self.heading[copy, 1], self.heading[copy, 0])]),
        }


def antennae_at(species: Any, position: Floats, heading: Floats) -> Floats:
    """Return both antennae ``(..., 2, 2)`` of bodies at ``(..., 2)``, headings as unit vectors."""
    angle = np.deg2rad(species.antenna_angle)
    ahead = species.antenna_length * math.cos(angle) * heading
    beside = species.antenna_length * math.sin(angle) * heading
    left = np.stack([-beside[..., 1], beside[..., 0]], axis=-1)
    return np.stack([position + ahead + left, position + ahead - left], axis=-2)


def demonstration_observations(
    species: SearchSpecies, demos: Demonstrations, condition: int | None = None
) -> NDArray[np.float32]:
    """Return observations of recorded episodes, ``(frames, 1, n)``, for offline learning.

    The kernel is that of the simulation, so both mean the same. A species with its own ``turning``
    has the recorded heading (signal ``heading``), where there is one; without ``turning`` the
    heading is the direction of the recorded velocity. The odour is what was recorded: signals
    ``odour_left`` and ``odour_right``, hit or not in the step that led to each frame.
    ``condition`` replaces the recorded one.

    Raises InputError if the demonstrations hold no odour signals.
    """
    recorded = _recorded_senses(species, demos, (), ((), ()), False)
    if not len(recorded.hits):
        raise InputError(
            f"{demos.name}: it lacks the signals 'odour_left' and 'odour_right', without which "
            "there is no observation of a search: import them with the tracks"
        )
    out = np.zeros((len(observation_components(species)), len(demos.positions)), np.float32)
    conditions = demos.condition if condition is None else np.full_like(demos.condition, condition)
    kernels.sense_recorded(
        demos.velocities(),
        demos.offsets.astype(np.int64),
        conditions,
        recorded.hits,
        recorded.heading,
        recorded.traits,
        senses_of(species),
        Body.of(1),
        out,
    )
    return np.ascontiguousarray(out.T)[:, None]


# -- numbers and recordings for the kernels ---------------------------------------------------


class _RecordedSenses(NamedTuple):
    hits: Bools  # (frames, 2), or empty
    heading: Floats  # (frames,) [rad], or empty
    candidates: Ints  # (2, patterns), first those of training, then of test
    num_candidates: Ints  # (2,)
    group: Ints  # (episodes,), row of candidates
    pattern: Ints  # (episodes,), -1: draw it
    phase: Ints  # (episodes,), -1: draw it
    traits: Floats  # (episodes, 2) [sd]


def _recorded_senses(
    species: SearchSpecies,
    demos: Demonstrations | None,
    patterns: tuple[int, ...],
    groups: tuple[tuple[int, ...], tuple[int, ...]],
    model: bool,
) -> _RecordedSenses:
    candidates = np.zeros((2, max(1, *map(len, groups))), dtype=np.int64)
    for row, group in enumerate(groups):
        candidates[row, : len(group)] = [patterns.index(p) for p in group]
    count = demos.num_episodes if demos else 0
    group_of = np.zeros(count, dtype=np.int64)
    pattern, phase = np.full(count, -1), np.full(count, -1)
    traits = np.zeros((count, 2))
    hits = headings = None
    if demos is not None:
        hits, headings = demos.odour_hits(), demos.headings()
        signals = {name: np.squeeze(value) for name, value in demos.signals.items()}
        group_of[demos.split != "train"] = 1
        if species.traits is not None:
            traits = species.traits.of_recordings(
                demos.positions, demos.lengths, demos.dt, demos.condition, demos.recording
            )[:, 0]
        if model and "plume" in signals:
            numbers = signals["plume"][demos.offsets[:-1]]
            strange = sorted(set(numbers.tolist()) - set(patterns))
            if strange:
                raise InputError(
                    f"{demos.name}: signal 'plume' names pattern {strange[0]}, which is neither in "
                    "train_plumes nor in test_plumes: add it, or pass demos=None to search "
                    f"patterns {patterns} only"
                )
            pattern = np.searchsorted(patterns, numbers).astype(np.int64)
            if "plume_step" in signals:
                phase = signals["plume_step"][demos.offsets[:-1]].astype(np.int64)
    return _RecordedSenses(
        np.zeros((0, 2), dtype=bool) if hits is None else hits,
        np.zeros(0) if headings is None else headings.ravel(),
        candidates,
        np.array([len(g) for g in groups]),
        group_of,
        pattern,
        phase,
        traits,
    )
