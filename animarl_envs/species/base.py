"""Specs of species: frozen numbers with units, without behaviour."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Literal

import numpy as np

from animarl_envs.arena import Arena
from animarl_envs.array_types import Bools
from animarl_envs.errors import InputError
from animarl_envs.locomotion import Locomotion
from animarl_envs.settings import Count, CountOrZero, NotNegative, Positive, check_fields
from animarl_envs.species.traits import Traits

COMPACT = "compact"
PLAIN_BODY = "animal"
BODIES = (PLAIN_BODY, "predator", "prey", "fly", "newt", "moth")
"""Looks of an individual; :mod:`animarl_envs.drawing.palette` draws them."""


@dataclass(frozen=True, kw_only=True)
class Recording:
    """How the paper recorded and cut the species; used by import and by the generators."""

    frame_rate: float  # [Hz]
    smoothing_cutoff: float | None = None  # Butterworth low-pass, order 1, zero phase [Hz]
    onset_threshold: float  # th_acc of the onset fit [arena unit / s^2]
    start_farther_than: float | None = None  # episodes are cut from this distance [arena unit]
    end_closer_than: float | None = None  # ... to this distance [arena unit]
    longest: float | None = None  # only the last seconds of longer episodes are kept [s]


@dataclass(frozen=True, kw_only=True)
class Species(ABC):
    """Numbers that every world needs. Lengths are in arena units, times in seconds or steps.

    ``individuals`` are in order: pursuers first, the target (if any) last; of one pursuer and
    several targets the targets first. What all species of a
    world have in common are class attributes: ``world`` and ``script`` name the simulator and the
    scripted rule (``animarl_envs.worlds`` has them by name), ``length_unit`` is what an arena unit
    is called, and ``condition_is_sensed`` says whether the condition changes what is sensed, and so
    what happens, or the reward alone.
    """

    world: ClassVar[str]
    script: ClassVar[str]
    length_unit: ClassVar[str] = "arena unit"
    condition_is_sensed: ClassVar[bool] = False
    observations: ClassVar[tuple[str, ...]] = (COMPACT, "full", "paper")

    name: str
    title: str
    individuals: tuple[str, ...]
    locomotion: tuple[Locomotion, ...]  # one per individual
    arena: Arena
    contact_radius: Positive  # [arena unit]
    dt: Positive  # one decision step [s]
    time_limit: Count  # [steps]
    warmup: CountOrZero = 0  # steps replayed from the demonstration
    conditions: tuple[str, ...] = ()  # names of conditions 0 and 1, or none
    boundary_penalty: float = -10.0
    time_cost: NotNegative = 0.0  # what a whole episode costs pursuer or searcher, in captures
    observation: str = "full"  # one of ``observations``
    sense_scales: SenseScales | None = None  # of a policy trained elsewhere; None: of this world
    traits: Traits | None = None  # in which individuals differ; None: they are all alike
    mirror_symmetric: bool = True  # left and right are alike to it
    recording: Recording
    bodies: tuple[str, ...] = (PLAIN_BODY,)  # in pictures; a second one is the target's
    source: str = ""
    version_history: tuple[str, ...] = ("v0: first release",)
    reward_components = ("touch", "elapsed", "boundary")

    def __post_init__(self) -> None:
        if not self.individuals or not all(isinstance(n, str) and n for n in self.individuals):
            raise InputError(f"individuals are {self.individuals}: give each a name")
        if len(set(self.individuals)) != len(self.individuals):
            raise InputError(f"individuals {self.individuals} are not all different: rename them")
        if len(self.locomotion) != len(self.individuals):
            raise InputError(
                f"{len(self.locomotion)} sets of locomotion parameters for "
                f"{len(self.individuals)} individuals: give one each"
            )
        cells = {type(m) for m in self.locomotion} != {Locomotion}
        if cells and (
            self.world != "chase" or len({(type(m), m.num_actions) for m in self.locomotion}) > 1
        ):
            raise InputError(
                f"{self.name}: cells are for animals that search no source, and all have the same "
                "number of them: fit them with the option cells"
            )
        counts = {
            name: m.thrusts for name, m in zip(self.individuals, self.locomotion, strict=True)
        }
        if len(set(counts.values())) > 1:
            listed = ", ".join(f"{name} {count}" for name, count in counts.items())
            raise InputError(
                f"the individuals have different numbers of thrust magnitudes ({listed}): give all "
                "the same number"
            )
        check_fields(self)
        if self.warmup >= self.time_limit:
            raise InputError(
                f"warmup is {self.warmup} steps: give fewer than the time limit, {self.time_limit}"
            )
        given: Any = self.conditions
        named = isinstance(given, Sequence) and not isinstance(given, str)
        if not named or len(given) not in (0, 2):
            raise InputError(f"conditions are {given!r}: give two names, or none")
        object.__setattr__(self, "conditions", tuple(str(name) for name in given))
        if self.observation not in self.observations:
            raise InputError(
                f"observation is {self.observation!r}: "
                f"choose one of {', '.join(map(repr, self.observations))}"
            )
        scales = self.sense_scales
        if scales is not None and (
            not isinstance(scales, SenseScales) or len(scales.locomotion) != len(self.individuals)
        ):
            raise InputError(
                f"sense_scales is {scales!r}: give SenseScales of {len(self.individuals)} "
                "individuals, or None"
            )
        if not isinstance(self.traits, Traits | None):
            raise InputError(f"traits is {self.traits!r}: give Traits or None")
        object.__setattr__(self, "bodies", checked_bodies(self.bodies))

    @property
    def num_individuals(self) -> int:
        """Number of individuals, K."""
        return len(self.individuals)

    @property
    def scales(self) -> SenseScales:
        """The scales of observations: those given, or those of this world."""
        own = (1.0,) * self.num_individuals
        return self.sense_scales or SenseScales(
            self.locomotion, self.dt, self.arena.size, self.time_limit, own
        )

    @property
    def thrusts(self) -> int:
        """Thrust magnitudes that each individual chooses among, M."""
        return self.locomotion[0].thrusts

    @property
    def num_actions(self) -> int:
        """Actions of each individual, ``12 M + 1``; the last is to coast."""
        return self.locomotion[0].num_actions

    @property
    @abstractmethod
    def roles(self) -> tuple[str, ...]:
        """``"pursuer"``, ``"target"`` or ``"searcher"`` for each individual."""

    @property
    def pursuing(self) -> Bools:
        """Mask of the individuals that are not targets, ``(K,)``."""
        return np.array([role != "target" for role in self.roles])

    @property
    def goal(self) -> str:
        """What the others head for, in words."""
        return self.individuals[-1]

    @property
    def step_cost(self) -> float:
        """What each step costs a pursuer or searcher."""
        return self.time_cost / self.time_limit


def checked_bodies(given: Any) -> tuple[str, ...]:
    """Return one or two names of :data:`BODIES` as a tuple; refuse others.

    Raises
    ------
    InputError
        If they are none.
    """
    bodies = (given,) if isinstance(given, str) else tuple(given)
    if not 1 <= len(bodies) <= 2 or not set(bodies) <= set(BODIES):
        raise InputError(
            f"bodies is {given!r}: give one of {', '.join(BODIES)} for all, or two of them, the "
            "second for the target"
        )
    return bodies


def body_of_each(bodies: tuple[str, ...], roles: tuple[str, ...]) -> tuple[str, ...]:
    """Return the body of each individual: the target's is the last name, all others' the first."""
    return tuple(bodies[-1] if role == "target" else bodies[0] for role in roles)


Reading = Literal["habit", "knows"]
"""How a trained policy perceives a changed world. ``"habit"``: in the scales it was trained with,
so the same places and velocities give the same inputs. ``"knows"``: individuals know their changed
bodies, so their own velocities are in units of the new thrust. What they did in the last step is in
units of the body that did it in both: a full thrust stays a full thrust."""


@dataclass(frozen=True)
class SenseScales:
    """Scales of observations.

    Parameters
    ----------
    locomotion
        Of each individual: its velocity is measured in what this thrust adds in a step. Recorded
        accelerations are what this damping leaves unexplained, in multiples of this thrust;
        simulated ones are those of the present body.
    dt
        The step that goes with it [s].
    arena_size
        Scale of distances, to the others and to walls [arena unit].
    time_limit
        Longest time since the start that is perceived [steps].
    own_velocity
        Of each individual: factor on the inputs that are its own velocity without a scale.
    """

    locomotion: tuple[Locomotion, ...]
    dt: float
    arena_size: float
    time_limit: int
    own_velocity: tuple[float, ...]

    def with_bodies(self, locomotion: tuple[Locomotion, ...], dt: float) -> SenseScales:
        """Return the same scales for individuals that know the bodies they have."""
        return replace(
            self,
            locomotion=locomotion,
            dt=dt,
            own_velocity=tuple(
                factor * (old.thrust * self.dt) / (new.thrust * dt)
                for factor, old, new in zip(
                    self.own_velocity, self.locomotion, locomotion, strict=True
                )
            ),
        )

    def select(self, individuals: Sequence[int]) -> SenseScales:
        """Return the scales of these individuals, in this order."""
        return replace(
            self,
            locomotion=tuple(self.locomotion[i] for i in individuals),
            own_velocity=tuple(self.own_velocity[i] for i in individuals),
        )
