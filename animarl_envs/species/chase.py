"""The spec of a species that chases: pursuers and a target, or targets and a pursuer."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from animarl_envs.errors import InputError
from animarl_envs.settings import CountOrZero, Positive
from animarl_envs.species.base import Species
from animarl_envs.species.turning import Turning, turnings_of


@dataclass(frozen=True, kw_only=True)
class ChaseSpecies(Species):
    """Pursuers and a target in an arena; with ``lone_pursuer`` targets and one pursuer.

    The last individual is the one whom all others face, the target or the lone pursuer. ``free``
    animals have nobody to face: one alone, or a group of animals that are alike.
    """

    world: ClassVar[str] = "chase"
    script: ClassVar[str] = "evade"

    start_half_side: Positive = 0.5  # starts without a demonstration: uniform in a square, at rest
    senses_centre: bool = False  # of "paper": adds the distance from the arena's centre
    senses_compass: bool = True  # without it "full" holds nothing that depends on where north is
    senses_time: bool = False  # adds the time since the start, where it tells how one moves
    senses_past: bool = False  # adds own velocity averaged over the last steps
    senses_course: bool = False  # adds in which of the directions of actions it goes and thrusts
    senses_heading: bool = False  # adds where its body and those of the others point
    turning: tuple[Turning | None, ...] = ()  # of each body, if one does not point where it walks
    shared_reward: bool = False  # in condition 1 a capture pays every pursuer
    lone_pursuer: bool = False  # the last individual pursues all others, as a dog does a flock
    free: bool = False  # nobody is pursued: each goes its own way, and contact ends nothing
    neighbours: CountOrZero = 4  # how many of the others a free animal sees, the nearest
    shoaling_reward: bool = (
        False  # pays a free animal for time within the contact radius of another
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.num_individuals < 2 and not self.free:
            raise InputError("a chase needs at least one pursuer and a target: name them both")
        if self.free and self.lone_pursuer:
            raise InputError("free animals have no pursuer: leave lone_pursuer out")
        object.__setattr__(self, "turning", turnings_of(self.turning, self.individuals))

    def of_individuals(
        self, chosen: Sequence[int], names: tuple[str, ...] = (), **changes: Any
    ) -> ChaseSpecies:
        """Return the species of these individuals, in this order, maybe under other ``names``."""
        return replace(
            self,
            individuals=names or tuple(self.individuals[i] for i in chosen),
            locomotion=tuple(self.locomotion[i] for i in chosen),
            turning=self.turning and tuple(self.turning[i] for i in chosen),
            traits=self.traits and self.traits.select(chosen),
            sense_scales=self.sense_scales and self.sense_scales.select(chosen),
            **changes,
        )

    def check_uniform_starts(self) -> None:
        """Refuse a square of starts that leaves the arena, or is too small to keep apart in."""
        half = self.start_half_side
        if not len(self.arena.free_places(half)):
            raise InputError(
                f"start_half_side is {half}: that square lies within obstacles, so make it larger"
            )
        if not replace(self.arena, obstacles=()).contains(np.array([half, half])):
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
    def num_seen(self) -> int:
        """How many of the others each individual sees."""
        others = self.num_individuals - 1
        return min(self.neighbours, others) if self.free else others

    @property
    def is_group(self) -> bool:
        """Whether these are three or more animals that are alike."""
        return self.free and self.num_individuals > 2

    @property
    def senses_steps(self) -> bool:
        """Whether averages over steps are seen; those of free animals are over seconds."""
        return self.senses_past and not self.free

    @property
    def roles(self) -> tuple[str, ...]:
        """Role of each individual, pursuer or target; free animals are all pursuers."""
        if self.free:
            return ("pursuer",) * self.num_individuals
        many, one = ("target", "pursuer") if self.lone_pursuer else ("pursuer", "target")
        return (many,) * (self.num_individuals - 1) + (one,)

    @property
    def has_headings(self) -> bool:
        """Whether headings are a state of their own, to turn or to be seen."""
        return bool(self.turning) or self.senses_heading

    @property
    def num_pursuers(self) -> int:
        """Number of pursuers."""
        return self.roles.count("pursuer")

    @property
    def goal(self) -> str:
        """What pursuers try to reach, in words."""
        return "a target" if self.lone_pursuer else super().goal
