"""What a species is: numbers with units, no behaviour, in one frozen spec per species."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np

from animarl_envs.arena import Arena
from animarl_envs.checks import is_number, is_whole
from animarl_envs.errors import InputError
from animarl_envs.locomotion import Locomotion
from animarl_envs.species.bodies import PLAIN_BODY, checked_bodies
from animarl_envs.species.turning import Turning

OBSERVATIONS = ("full", "paper")


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
class Species:
    """Numbers that every world needs. Lengths are in arena units, times in seconds or steps.

    ``individuals`` are in order: pursuers first, the target (if any) last. What all species of a
    world have in common are class attributes: ``world`` and ``script`` name the simulator and the
    scripted rule (``animarl_envs.worlds`` has them by name), ``length_unit`` is what an arena unit
    is called, ``condition_is_sensed`` says whether the condition changes what is sensed, and so
    what happens, or the reward alone, and ``pretrained_main`` whether the paper's main
    counterfactual is that of pretrained learners.
    """

    world: ClassVar[str]
    script: ClassVar[str]
    length_unit: ClassVar[str] = "arena unit"
    condition_is_sensed: ClassVar[bool] = False
    pretrained_main: ClassVar[bool] = True

    name: str
    title: str
    individuals: tuple[str, ...]
    locomotion: tuple[Locomotion, ...]  # one per individual
    arena: Arena
    contact_radius: float  # [arena unit]
    dt: float  # one decision step [s]
    time_limit: int  # [steps]
    warmup: int = 0  # steps replayed from the demonstration
    conditions: tuple[str, ...] = ()  # names of conditions 0 and 1, or none
    boundary_penalty: float = -10.0
    observation: str = "full"  # or "paper": the components of the paper
    mirror_symmetric: bool = True  # left and right are alike to it
    planned_flip: tuple[int, int] | None = None  # conditions (world, cue) that the paper compares
    recording: Recording
    bodies: tuple[str, ...] = (PLAIN_BODY,)  # in pictures; a second one is the target's
    source: str = ""
    version_history: tuple[str, ...] = field(default=("v0: first release",))
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
        counts = {
            name: m.thrusts for name, m in zip(self.individuals, self.locomotion, strict=True)
        }
        if len(set(counts.values())) > 1:
            told = ", ".join(f"{name} {count}" for name, count in counts.items())
            raise InputError(
                f"the individuals have different numbers of thrust magnitudes ({told}): give all "
                "the same number"
            )
        self._positive("contact_radius", "dt")
        if not is_whole(self.time_limit) or self.time_limit < 1:
            raise InputError(
                f"time_limit is {self.time_limit!r} steps: it must be a whole number, at least 1"
            )
        if not is_whole(self.warmup) or not 0 <= self.warmup < self.time_limit:
            raise InputError(
                f"warmup is {self.warmup!r} steps: give a whole number between 0 and the time limit"
            )
        object.__setattr__(self, "time_limit", int(self.time_limit))
        object.__setattr__(self, "warmup", int(self.warmup))
        object.__setattr__(self, "conditions", _names(self.conditions))
        if not is_number(self.boundary_penalty) or not abs(self.boundary_penalty) < float("inf"):
            raise InputError(f"boundary_penalty is {self.boundary_penalty!r}: it must be a number")
        object.__setattr__(self, "boundary_penalty", float(self.boundary_penalty))
        if self.observation not in OBSERVATIONS:
            raise InputError(
                f"observation is {self.observation!r}: "
                f"choose {' or '.join(map(repr, OBSERVATIONS))}"
            )
        self._true_or_false("mirror_symmetric")
        object.__setattr__(self, "bodies", checked_bodies(self.bodies))
        flip = self.planned_flip
        if flip is not None and (not self.conditions or tuple(flip) not in ((0, 1), (1, 0))):
            raise InputError(
                f"planned_flip is {flip!r}: give (0, 1) or (1, 0) to a species with conditions, "
                "or None"
            )

    @property
    def num_individuals(self) -> int:
        return len(self.individuals)

    @property
    def thrusts(self) -> int:
        """Thrust magnitudes that each individual chooses among, M."""
        return self.locomotion[0].thrusts

    @property
    def num_actions(self) -> int:
        """Actions of each individual, ``12 M + 1``; the last is to coast."""
        return self.locomotion[0].num_actions

    @property
    def roles(self) -> tuple[str, ...]:
        """``"pursuer"``, ``"target"`` or ``"searcher"`` for each individual."""
        raise NotImplementedError

    @property
    def goal(self) -> str:
        """Whom or what the others head for, in words."""
        return self.individuals[-1]

    def _true_or_false(self, *names: str) -> None:
        for name in names:
            if not isinstance(getattr(self, name), bool):
                raise InputError(f"{name} is {getattr(self, name)!r}: choose True or False")

    def _positive(self, *names: str, or_zero: bool = False) -> None:
        """Refuse what is not a finite positive number (or zero, if that will do).

        NumPy's numbers become Python's, of which the kernels have compiled forms.
        """
        for name in names:
            value = getattr(self, name)
            low = is_number(value) and (value >= 0 if or_zero else value > 0)
            if not (low and value < float("inf")):
                allowed = "zero or positive" if or_zero else "a positive number"
                raise InputError(f"{name} is {value!r}: it must be {allowed}")
            object.__setattr__(self, name, float(value))


@dataclass(frozen=True, kw_only=True)
class ChaseSpecies(Species):
    """Pursuers and a target (the last individual) in an arena."""

    world: ClassVar[str] = "chase"
    script: ClassVar[str] = "evade"

    start_half_side: float = 0.5  # starts without a demonstration: uniform in a square, at rest
    senses_centre: bool = False  # of "paper": adds the distance from the arena's centre
    shared_reward: bool = False  # in condition 1 a capture pays every pursuer

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.num_individuals < 2:
            raise InputError("a chase needs at least one pursuer and a target: name them both")
        self._positive("start_half_side")
        self._true_or_false("senses_centre", "shared_reward")

    def check_uniform_starts(self) -> None:
        """Refuse a square of starts that leaves the arena, or is too small to keep apart in."""
        half = self.start_half_side
        if not self.arena.contains(np.array([half, half])):
            raise InputError(
                f"start_half_side is {half}: a corner of that square is out of bounds "
                f"({self.arena.shape}, boundary {self.arena.boundary:g}), so make it smaller"
            )
        if self.contact_radius > half:
            raise InputError(
                f"contact_radius is {self.contact_radius} but starts lie in a square of half side "
                f"{half}, where all would touch: make it smaller, or start_half_side larger"
            )

    @property
    def num_pursuers(self) -> int:
        return self.num_individuals - 1

    @property
    def roles(self) -> tuple[str, ...]:
        return ("pursuer",) * self.num_pursuers + ("target",)


@dataclass(frozen=True, kw_only=True)
class SearchSpecies(Species):
    """One searcher and an odour source at the origin; upwind is the direction -x.

    What the senses tell is in ``docs/plume.md`` ("What the moth senses").
    """

    world: ClassVar[str] = "search"
    script: ClassVar[str] = "programmed moth"
    length_unit: ClassVar[str] = "metre"
    condition_is_sensed: ClassVar[bool] = True
    pretrained_main: ClassVar[bool] = False

    metres_per_unit: float = 1.0  # the plume is in metres
    start_distance: float = 0.3  # downwind of the source [arena unit]
    antenna_length: float = 0.013  # ahead of the body centre [arena unit]
    antenna_angle: float = 19.0  # to either side [deg]
    antenna_radius: float = 0.0025  # an antenna senses the plume within this radius [arena unit]
    odour_decay: float = 1.96  # time constant after the last hit [s]
    odour_baseline: float = 0.07
    trace_decay: float = 10.0  # time constant of the slow trace of hits [s]
    flow_threshold: float = 0.1  # yaw rates below it give no visual flow [rad/s]
    flow_limit: float = 1.2  # visual flow is clipped here [rad/s]
    turning: Turning | None = None  # of the body; None: it points where it walks
    rest_speed: float = (
        1e-4  # a body without turning keeps its heading when slower [arena unit / s]
    )
    plume: Any = "model"  # "model", "off", "continuous" or a worlds.plume.Plume
    train_plumes: tuple[int, ...] = (0, 1, 2)  # the five fixed patterns: training ...
    test_plumes: tuple[int, ...] = (3, 4)  # ... and held out

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.arena.shape != "open":
            raise InputError(
                f"arena is a {self.arena.shape} but a search is in the open: give a size to draw, "
                "or Arena('open', size)"
            )
        self._positive(
            "metres_per_unit", "start_distance", "antenna_length", "odour_decay", "trace_decay",
            "flow_limit",
        )  # fmt: skip
        self._positive(
            "antenna_radius", "flow_threshold", "rest_speed", "odour_baseline", "antenna_angle",
            or_zero=True,
        )  # fmt: skip
        if not self.odour_baseline < 1:
            raise InputError(f"odour_baseline is {self.odour_baseline}: it must lie in [0, 1)")
        if not self.antenna_angle <= 90:
            raise InputError(
                f"antenna_angle is {self.antenna_angle}: it must lie between 0 and 90 degrees"
            )
        if isinstance(self.turning, Mapping):
            try:
                object.__setattr__(self, "turning", Turning(**self.turning))
            except TypeError as error:
                raise InputError(
                    f"turning is {dict(self.turning)!r}: name persistence, gain, slip and speed"
                ) from error
        elif not isinstance(self.turning, Turning | None):
            raise InputError(
                f"turning is {self.turning!r}: give a Turning, its numbers by name, or None"
            )
        for name in ("train_plumes", "test_plumes"):
            chosen = getattr(self, name)
            listed = isinstance(chosen, Sequence | np.ndarray) and not isinstance(chosen, str)
            if not listed or len(chosen) == 0 or not all(is_whole(p) for p in chosen):
                raise InputError(
                    f"{name} is {chosen!r}: name one or more plume patterns, 0 to 4, as a list"
                )
            object.__setattr__(self, name, tuple(int(p) for p in chosen))
        if self.plume != "model":
            from animarl_envs.worlds.plume.plume import (
                as_plume,  # the model itself is made when needed
            )

            as_plume(self.plume)

    @property
    def roles(self) -> tuple[str, ...]:
        return ("searcher",) * self.num_individuals

    @property
    def body_of_each(self) -> tuple[str, ...]:
        """What each individual looks like in pictures."""
        last = {"target": self.bodies[-1]}
        return tuple(last.get(role, self.bodies[0]) for role in self.roles)

    @property
    def goal(self) -> str:
        return "the source"


def _names(conditions: Any) -> tuple[str, ...]:
    listed = isinstance(conditions, Sequence) and not isinstance(conditions, str)
    if not listed or len(conditions) not in (0, 2):
        raise InputError(f"conditions are {conditions!r}: give two names, or none")
    return tuple(str(name) for name in conditions)
