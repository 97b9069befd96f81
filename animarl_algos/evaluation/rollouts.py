"""Rollouts: simulated episodes of one method."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from animarl_envs.array_types import Bools, Floats, Ints
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.episode import Episodes
from animarl_envs.errors import InputError

RECORDED = "recorded"
NO_CUE = -1  # the policy was told no condition


@dataclass(frozen=True, eq=False, kw_only=True)
class Rollouts(Episodes):
    """Episodes of one method, laid end to end; arrays are read-only.

    Raises InputError if shapes do not fit or positions are not finite.

    Parameters
    ----------
    individuals, roles, dt, positions, lengths, outcome, condition
        As in :class:`~animarl_envs.demos.episode.Episodes`; the condition is the world's.
    method
        Name of what acted, as figures and tables show it; ``"recorded"`` for the animals.
    cue
        ``(rollouts,)``: the condition the policy was told, -1 if none.
    demo
        ``(rollouts,)``: index of the paired demonstration in the evaluated set.
    seed, repetition
        ``(rollouts,)``: training seed of the policy; which of the rollouts from that start.
    components, component_names
        ``(rollouts, individuals, components)``, task reward summed over the episode, by component.
    """

    FORMAT = "animarl-rollouts"
    MADE_BY = "make them with 'animarl evaluate'"
    EACH = {
        "lengths": np.int64,
        "outcome": np.int8,
        "condition": np.int8,
        "cue": np.int8,
        "demo": np.int64,
        "seed": np.int64,
        "repetition": np.int64,
        "components": np.float64,
    }
    TUPLES = ("individuals", "roles", "component_names")
    META = ("method", "individuals", "roles", "dt", "component_names")

    method: str
    cue: NDArray[np.int8]
    demo: Ints
    seed: Ints
    repetition: Ints
    component_names: tuple[str, ...] = ()
    components: Floats = field(default_factory=lambda: np.zeros((0, 0, 0)))

    def __post_init__(self) -> None:
        count, num = len(self.lengths), len(self.individuals)
        if not self.component_names:
            object.__setattr__(self, "components", np.zeros((count, num, 0)))
        super().__post_init__()
        if not np.isfinite(self.positions).all():
            self._refuse("a position is not a finite number: check the simulation")
        shape = (count, num, len(self.component_names))
        if self.components.shape != shape:
            self._refuse(f"components have shape {self.components.shape}, not {shape}")

    @property
    def label(self) -> str:
        return f"rollouts of {self.method}"

    @property
    def captured(self) -> Bools:
        """Whether a pursuer reached the target, or the searcher the source: ``(rollouts,)``."""
        return np.asarray(self.outcome > 0)

    @cached_property
    def copies(self) -> Bools:
        """Those to leave out of a null, as the policy did the same before: ``(rollouts,)``.

        Only where all policies (``seed``) always do the same from a start (``demo``). Who acts by
        chance may repeat itself too, as an animal that rests; there each rollout counts, or what is
        seldom done would weigh more than it should.
        """
        starts = list(zip(self.demo.tolist(), self.seed.tolist()))
        did = [(*start, self.path(i).tobytes()) for i, start in enumerate(starts)]
        first: dict[tuple[int, int, bytes], int] = {}
        repeats = [first.setdefault(one, i) < i for i, one in enumerate(did)]
        return np.array(repeats) & (len(first) == len(set(starts)))

    def is_factual(self, recorded: Demonstrations) -> Bools:
        """Whether the world is in the recorded condition, and the policy was told so or nothing."""
        same = self.condition == recorded.condition[self.demo]
        return np.asarray(same & ((self.cue == NO_CUE) | (self.cue == self.condition)))

    def factual(self, recorded: Demonstrations) -> Rollouts:
        """Those that may be compared with the recordings."""
        return self.select(self.is_factual(recorded))

    @property
    def movers(self) -> Ints:
        """Individuals whose paths are measured: pursuers, or the searcher."""
        return np.array([i for i, role in enumerate(self.roles) if role != "target"])

    def speeds(self) -> Floats:
        """Speed of every step of every individual, ``(steps, individuals)`` [arena unit / s]."""
        step = np.linalg.norm(np.diff(self.positions, axis=0), axis=-1) / self.dt
        keep = np.ones(len(step), dtype=bool)
        keep[self.offsets[1:-1] - 1] = False
        return np.asarray(step[keep])

    @classmethod
    def concatenate(cls, parts: Sequence[Rollouts], method: str | None = None) -> Rollouts:
        """Rollouts of several seeds or cues as one; individuals, dt and components must agree."""
        if not parts:
            raise InputError("there are no rollouts to join: collect some first")
        first = parts[0]
        for part in parts[1:]:
            for key in ("individuals", "roles", "dt", "component_names"):
                if getattr(part, key) != getattr(first, key):
                    raise InputError(
                        f"rollouts of {part.method} and {first.method} differ in {key}: "
                        "join rollouts of one scenario only"
                    )
        return replace(first, method=method or first.method, **cls.joined_arrays(parts))

    @classmethod
    def from_demonstrations(cls, demos: Demonstrations) -> Rollouts:
        """The recordings themselves, so that they are measured exactly as rollouts are."""
        count = len(demos)
        return cls(
            **{each.name: getattr(demos, each.name) for each in fields(Episodes)},
            method=RECORDED,
            cue=np.full(count, NO_CUE),
            demo=np.arange(count),
            seed=np.full(count, -1),
            repetition=np.zeros(count, dtype=np.int64),
        )
