"""Rollouts: the episodes of one method, in one frozen container, stored without pickle."""

from __future__ import annotations

import json
from collections.abc import Hashable, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.errors import InputError
from animarl_envs.files import read_npz, write_then_rename

FORMAT = "animarl-rollouts"
FORMAT_VERSION = 1
RECORDED = "recorded"
NO_CUE = -1  # the policy was told no condition

_PER_ROLLOUT = {
    "lengths": np.int64, "outcome": np.int8, "condition": np.int8, "cue": np.int8,
    "demo": np.int64, "seed": np.int64, "repetition": np.int64,
}  # fmt: skip


def copies(demo: Sequence[int], seed: Sequence[int], did: Sequence[Hashable]) -> NDArray[np.bool_]:
    """Whether a policy did the same from a start before: ``(rollouts,)``.

    Only where all policies (``seed``) always do the same from a start (``demo``). Who acts by
    chance may repeat itself too, as an animal that rests; there each rollout counts, or what is
    seldom done would weigh more than it should.
    """
    seen: set[tuple[int, int, Hashable]] = set()
    repeats = np.zeros(len(demo), dtype=bool)
    for i, one in enumerate(zip(demo, seed, did, strict=True)):
        repeats[i] = one in seen
        seen.add(one)
    without_chance = len(seen) == len(set(zip(demo, seed)))
    return repeats & without_chance


@dataclass(frozen=True, eq=False, kw_only=True)
class Rollouts:
    """Episodes of one method, laid end to end; arrays are read-only.

    Parameters
    ----------
    method
        Name of what acted, as figures and tables show it; ``"recorded"`` for the animals.
    individuals, roles, dt
        As in :class:`~animarl_envs.demos.demonstrations.Demonstrations`.
    positions
        ``(frames, individuals, 2)``, arena frame [arena unit].
    lengths
        ``(rollouts,)``, frames of each; an episode of T steps has T + 1 frames.
    outcome, condition
        ``(rollouts,)``: outcome codes of the demonstrations; the condition the world was in.
    cue
        ``(rollouts,)``: the condition the policy was told, -1 if none.
    demo
        ``(rollouts,)``: index of the paired demonstration in the evaluated set.
    seed, repetition
        ``(rollouts,)``: training seed of the policy; which of the rollouts from that start.
    components, component_names
        ``(rollouts, individuals, components)``, task reward summed over the episode, by component.

    Raises
    ------
    InputError
        If shapes do not fit or positions are not finite.
    """

    method: str
    individuals: tuple[str, ...]
    roles: tuple[str, ...]
    dt: float
    positions: NDArray[np.float64]
    lengths: NDArray[np.int64]
    outcome: NDArray[np.int8]
    condition: NDArray[np.int8]
    cue: NDArray[np.int8]
    demo: NDArray[np.int64]
    seed: NDArray[np.int64]
    repetition: NDArray[np.int64]
    component_names: tuple[str, ...] = ()
    components: NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 0, 0)))

    def __post_init__(self) -> None:
        for key, dtype in {
            **_PER_ROLLOUT,
            "positions": np.float64,
            "components": np.float64,
        }.items():
            array = np.array(getattr(self, key), dtype=dtype)
            array.setflags(write=False)
            object.__setattr__(self, key, array)
        for key in ("individuals", "roles", "component_names"):
            object.__setattr__(self, key, tuple(getattr(self, key)))
        count, num = len(self.lengths), len(self.individuals)
        if not self.component_names:
            object.__setattr__(self, "components", np.zeros((count, num, 0)))
        name = f"rollouts of {self.method}"
        if count == 0:
            raise InputError(f"{name}: there is none: collect at least one")
        for key in _PER_ROLLOUT:
            if getattr(self, key).shape != (count,):
                raise InputError(
                    f"{name}: {key} has shape {getattr(self, key).shape} for {count} rollouts: "
                    "give one value for each"
                )
        if (self.lengths < 1).any() or self.positions.shape != (self.lengths.sum(), num, 2):
            raise InputError(
                f"{name}: positions have shape {self.positions.shape}, not "
                f"({self.lengths.sum()}, {num}, 2): one row per frame of all rollouts"
            )
        if not np.isfinite(self.positions).all():
            raise InputError(f"{name}: a position is not a finite number: check the simulation")
        if self.components.shape != (count, num, len(self.component_names)):
            raise InputError(
                f"{name}: components have shape {self.components.shape}, not "
                f"({count}, {num}, {len(self.component_names)})"
            )

    def __len__(self) -> int:
        return len(self.lengths)

    @property
    def offsets(self) -> NDArray[np.int64]:
        """First frame of each rollout, and one past the last: ``(rollouts + 1,)``."""
        return np.concatenate([[0], np.cumsum(self.lengths)])

    @property
    def captured(self) -> NDArray[np.bool_]:
        """Whether a pursuer reached the target, or the searcher the source: ``(rollouts,)``."""
        return np.asarray(self.outcome > 0)

    @cached_property
    def copies(self) -> NDArray[np.bool_]:
        """Those to leave out of a null, see :func:`copies`: ``(rollouts,)``."""
        paths = [self.path(i).tobytes() for i in range(len(self))]
        return copies(self.demo.tolist(), self.seed.tolist(), paths)

    @property
    def movers(self) -> NDArray[np.int64]:
        """Individuals whose paths are measured: pursuers, or the searcher."""
        return np.array([i for i, role in enumerate(self.roles) if role != "target"])

    def path(self, index: int) -> NDArray[np.float64]:
        """Positions of one rollout, ``(frames, individuals, 2)``."""
        start = int(self.offsets[index])
        return self.positions[start : start + int(self.lengths[index])]

    def speeds(self) -> NDArray[np.float64]:
        """Speed of every step of every individual, ``(steps, individuals)`` [arena unit / s]."""
        step = np.linalg.norm(np.diff(self.positions, axis=0), axis=-1) / self.dt
        keep = np.ones(len(step), dtype=bool)
        keep[self.offsets[1:-1] - 1] = False
        return np.asarray(step[keep])

    def select(self, chosen: NDArray[Any]) -> Rollouts:
        """The rollouts of a boolean mask or of indices, in that order."""
        chosen = np.asarray(chosen)
        index = np.flatnonzero(chosen) if chosen.dtype == bool else chosen
        if len(index) == 0:
            raise InputError(f"rollouts of {self.method}: the selection is empty: widen it")
        frames = [
            np.arange(self.offsets[i], self.offsets[i] + self.lengths[i]) for i in index.tolist()
        ]
        per_rollout: dict[str, Any] = {key: getattr(self, key)[index] for key in _PER_ROLLOUT}
        return replace(
            self,
            positions=self.positions[np.concatenate(frames)],
            components=self.components[index],
            **per_rollout,
        )

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
        joined: dict[str, Any] = {
            key: np.concatenate([getattr(part, key) for part in parts])
            for key in (*_PER_ROLLOUT, "positions", "components")
        }
        return replace(first, method=method or first.method, **joined)

    @classmethod
    def from_demonstrations(cls, demos: Demonstrations) -> Rollouts:
        """The recordings themselves, so that they are measured exactly as rollouts are."""
        count = demos.num_episodes
        return cls(
            method=RECORDED,
            individuals=demos.individuals,
            roles=demos.roles,
            dt=demos.dt,
            positions=demos.positions,
            lengths=demos.lengths,
            outcome=demos.outcome,
            condition=demos.condition,
            cue=np.full(count, NO_CUE),
            demo=np.arange(count),
            seed=np.full(count, -1),
            repetition=np.zeros(count, dtype=np.int64),
        )

    # -- storage ----------------------------------------------------------------------------------

    def save(self, path: str | Path) -> Path:
        """Write an ``.npz`` without pickle, whole or not at all."""
        path = Path(path)
        meta = {
            "format": FORMAT,
            "version": FORMAT_VERSION,
            "method": self.method,
            "individuals": self.individuals,
            "roles": self.roles,
            "dt": self.dt,
            "component_names": self.component_names,
        }
        arrays = {key: getattr(self, key) for key in (*_PER_ROLLOUT, "positions", "components")}
        with write_then_rename(path) as part:
            np.savez_compressed(part, meta=np.array(json.dumps(meta)), **arrays)
        return path

    @classmethod
    def load(cls, path: str | Path) -> Rollouts:
        """Read a file written by :meth:`save`.

        Raises
        ------
        InputError
            If the file is missing, damaged or of another format.
        """
        path = Path(path)
        arrays = read_npz(path)
        try:
            meta: dict[str, Any] = json.loads(str(arrays.pop("meta", "{}")))
            if meta.pop("format", None) != FORMAT:
                raise InputError(
                    f"{path}: it holds no rollouts of this project: make them with "
                    "'animarl evaluate'"
                )
            if meta.pop("version") > FORMAT_VERSION:
                raise InputError(f"{path}: it was written by a newer animarl: upgrade this one")
            known = {f.name for f in fields(cls)}
            return cls(**{k: v for k, v in (meta | arrays).items() if k in known})
        except InputError:
            raise
        except (TypeError, ValueError, AttributeError, KeyError) as error:
            raise InputError(
                f"{path}: its content is damaged ({error}): collect the rollouts again"
            ) from error
