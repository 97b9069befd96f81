"""The container for recorded episodes: immutable, validated when made, stored without pickle."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from animarl_envs.arena import Arena
from animarl_envs.demos import storage
from animarl_envs.demos.episode import (
    INTERVAL,
    PURSUER_OUT,
    SPLITS,
    TARGET_OUT,
    TIME_OUT,
    UNFINISHED,
    Episode,
)
from animarl_envs.demos.resolution import Resolution, find_resolution
from animarl_envs.demos.validation import validate
from animarl_envs.errors import InputError
from animarl_envs.focus import focus_directions
from animarl_envs.locomotion import velocities
from animarl_envs.species.base import Species

__all__ = [
    "PURSUER_OUT", "SPLITS", "TARGET_OUT", "TIME_OUT", "UNFINISHED", "Demonstrations", "Episode",
]  # fmt: skip


@dataclass(frozen=True, eq=False, kw_only=True)
class Demonstrations:
    """Recorded episodes of the same individuals, laid end to end.

    Parameters
    ----------
    species
        Name of the species spec they belong to, or ``"custom"``.
    individuals, roles
        Names, and for each ``"pursuer"``, ``"target"`` or ``"searcher"``; pursuers first.
    dt
        Time between frames [s].
    arena
        The field; every position must lie within its boundary, widened by ``OUTSIDE_MARGIN``.
    positions
        ``(frames, individuals, 2)``, all episodes end to end, arena frame [arena unit].
    lengths
        ``(episodes,)``, frames per episode; an episode of T steps has T + 1 frames.
    initial_velocity
        ``(episodes, individuals, 2)``, velocity at each first frame [arena unit / s]. A reader that
        does not know it drops the first recorded frame and keeps the velocity that it makes.
    condition, outcome
        ``(episodes,)`` int8: 0 or 1; and the outcome codes of :mod:`animarl_envs.demos.episode`.
    split
        ``(episodes,)``, ``"train"``, ``"val"`` or ``"test"``.
    recording
        ``(episodes,)``, the recording each episode was cut from.
    signals
        Further channels by name, each ``(frames,)`` or ``(frames, individuals, ...)``, such as
        ``actions`` (int8; the action taken at a frame, -1 at the last one), ``odour`` or
        ``heading`` (:mod:`animarl_envs.demos.headings`).
    provenance
        JSON-like: ``source``, ``licence``, ``synthetic`` (bool) at least; further what was done.

    Raises
    ------
    InputError
        If anything is missing, misshapen or out of range; the sentence names place and mend.
    """

    OUTSIDE_MARGIN = 0.5  # the last frame may lie a step beyond the boundary [arena unit]

    species: str
    individuals: tuple[str, ...]
    roles: tuple[str, ...]
    dt: float
    arena: Arena
    positions: NDArray[np.float64]
    lengths: NDArray[np.int64]
    initial_velocity: NDArray[np.float64]
    condition: NDArray[np.int8]
    outcome: NDArray[np.int8]
    split: NDArray[np.str_]
    recording: NDArray[np.str_]
    signals: Mapping[str, NDArray[Any]] = field(default_factory=dict)
    provenance: Mapping[str, Any] = field(default_factory=dict)
    name: str = "demonstrations"  # for messages: the file they came from

    def __post_init__(self) -> None:
        as_array = {
            "positions": np.float64, "lengths": np.int64, "initial_velocity": np.float64,
            "condition": np.int8, "outcome": np.int8, "split": np.str_, "recording": np.str_,
        }  # fmt: skip
        for key, dtype in as_array.items():
            object.__setattr__(self, key, _frozen(getattr(self, key), dtype))
        signals = {key: _frozen(value, None) for key, value in self.signals.items()}
        object.__setattr__(self, "signals", MappingProxyType(signals))
        object.__setattr__(self, "provenance", MappingProxyType(dict(self.provenance)))
        object.__setattr__(self, "individuals", tuple(self.individuals))
        object.__setattr__(self, "roles", tuple(self.roles))
        validate(self)

    @classmethod
    def of_species(
        cls,
        species: Species,
        paths: Sequence[NDArray[np.float64]],
        signals: Mapping[str, Sequence[NDArray[Any]]],
        **more: Any,
    ) -> Demonstrations:
        """Episodes of all individuals of a species, one by one.

        Parameters
        ----------
        species
            Gives its name, the individuals and their roles, ``dt`` and the arena.
        paths
            Of each episode, ``(frames, individuals, 2)``, arena frame [arena unit].
        signals
            By name, for each episode ``(frames,)`` or ``(frames, individuals, ...)``.
        more
            The other fields; by default everybody starts at rest.
        """
        at_rest = np.zeros((len(paths), species.num_individuals, 2))
        return cls(
            species=species.name,
            individuals=species.individuals,
            roles=species.roles,
            dt=species.dt,
            arena=species.arena,
            positions=np.concatenate(paths),
            lengths=np.array([len(path) for path in paths]),
            signals={name: np.concatenate(series) for name, series in signals.items()},
            **{"initial_velocity": at_rest} | more,
        )

    def __deepcopy__(self, memo: dict[int, Any]) -> Demonstrations:
        return self  # immutable

    def __getstate__(self) -> dict[str, Any]:
        return vars(self) | {"signals": dict(self.signals), "provenance": dict(self.provenance)}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__init__(**state)  # type: ignore[misc]

    # -- shape ------------------------------------------------------------------------------------

    @property
    def num_episodes(self) -> int:
        return len(self.lengths)

    @property
    def num_individuals(self) -> int:
        return len(self.individuals)

    @property
    def offsets(self) -> NDArray[np.int64]:
        """First frame of each episode, and one past the last: ``(episodes + 1,)``."""
        return np.concatenate([[0], np.cumsum(self.lengths)])

    @property
    def synthetic(self) -> bool:
        return bool(self.provenance["synthetic"])

    def __len__(self) -> int:
        return self.num_episodes

    def __repr__(self) -> str:
        kind = "synthetic" if self.synthetic else "recorded"
        return (
            f"Demonstrations({self.species}, {self.num_episodes} {kind} episodes of "
            f"{', '.join(self.individuals)}, {(self.lengths - 1).sum() * self.dt:.1f} s)"
        )

    def episode(self, index: int) -> Episode:
        """Episode ``index`` (negative counts from the end), as read-only views."""
        index = range(self.num_episodes)[index]
        frames = slice(int(self.offsets[index]), int(self.offsets[index + 1]))
        positions = self.positions[frames]
        return Episode(
            index=index,
            positions=positions,
            velocities=velocities(positions, self.initial_velocity[index], self.dt)
            * (self.dt / self.intervals(frames))[:, None, None],
            signals={key: value[frames] for key, value in self.signals.items()},
            condition=int(self.condition[index]),
            outcome=int(self.outcome[index]),
            split=str(self.split[index]),
            recording=str(self.recording[index]),
            dt=self.dt,
        )

    def __iter__(self) -> Iterator[Episode]:
        return (self.episode(i) for i in range(self.num_episodes))

    def intervals(self, frames: slice = slice(None)) -> NDArray[np.float64]:
        """Time that led to each frame ``(frames,)`` [s]: dt, or less at a last frame kept so."""
        if INTERVAL in self.signals:
            return self.signals[INTERVAL][frames].astype(np.float64)
        return np.full(len(self.positions[frames]), self.dt)

    def steps(self) -> NDArray[np.int64]:
        """Steps from the start of its episode to each frame, ``(frames,)``."""
        return np.arange(len(self.positions)) - np.repeat(self.offsets[:-1], self.lengths)

    def velocities(self) -> NDArray[np.float64]:
        """Velocities of all frames, ``(frames, individuals, 2)`` [arena unit / s]."""
        out = velocities(self.positions, self.initial_velocity[0], self.dt)
        if INTERVAL in self.signals:
            out *= (self.dt / self.intervals())[:, None, None]
        out[self.offsets[:-1]] = self.initial_velocity
        return out

    def focus(self) -> NDArray[np.float64]:
        """Unit vectors towards the focus at all frames, ``(frames, individuals, 2)``."""
        return focus_directions(self.positions, self.roles)

    def resolution(self) -> Resolution | None:
        """The grid on which all positions lie, such as pixels; ``None`` where there is none."""
        return find_resolution(self.positions)

    # -- selection --------------------------------------------------------------------------------

    def select(
        self,
        *,
        split: str | None = None,
        condition: int | None = None,
        episodes: Sequence[int] | NDArray[np.integer] | None = None,
    ) -> Demonstrations:
        """The episodes that fulfil all that is given, in their order or that of ``episodes``."""
        chosen = np.arange(self.num_episodes) if episodes is None else np.asarray(episodes)
        if split is not None:
            if split not in SPLITS:
                raise InputError(f"split {split!r} is unknown: choose one of {', '.join(SPLITS)}")
            chosen = chosen[self.split[chosen] == split]
        if condition is not None:
            chosen = chosen[self.condition[chosen] == condition]
        if len(chosen) == 0:
            wanted = f"split {split!r}" + (
                f", condition {condition}" if condition is not None else ""
            )
            raise InputError(
                f"{self.name}: {wanted} holds no episode: split the file again "
                "or choose another split"
            )
        offsets = self.offsets
        frames = np.concatenate([np.arange(offsets[i], offsets[i + 1]) for i in chosen])
        return replace(
            self,
            positions=self.positions[frames],
            lengths=self.lengths[chosen],
            initial_velocity=self.initial_velocity[chosen],
            condition=self.condition[chosen],
            outcome=self.outcome[chosen],
            split=self.split[chosen],
            recording=self.recording[chosen],
            signals={key: value[frames] for key, value in self.signals.items()},
        )

    def fingerprint(self) -> str:
        """SHA-256 of the content (not of the provenance), 16 hexadecimal digits."""
        digest = hashlib.sha256()
        head = [self.species, self.individuals, self.roles, self.dt, vars(self.arena)]
        digest.update(json.dumps(head, sort_keys=True).encode())
        for key in ("positions", "lengths", "initial_velocity", "condition", "outcome"):
            digest.update(np.ascontiguousarray(getattr(self, key)).tobytes())
        digest.update("\n".join([*self.split, *self.recording]).encode())
        for key in sorted(self.signals):
            digest.update(key.encode() + np.ascontiguousarray(self.signals[key]).tobytes())
        return digest.hexdigest()[:16]

    # -- storage ----------------------------------------------------------------------------------

    def save(self, path: str | Path, *, dtype: type[np.floating] = np.float64) -> Path:
        """Write an ``.npz`` without pickle; see :func:`animarl_envs.demos.storage.save`."""
        return storage.save(vars(self), path, dtype=dtype)

    @classmethod
    def load(cls, path: str | Path) -> Demonstrations:
        """Read a file written by :meth:`save`; see :func:`animarl_envs.demos.storage.load`."""
        with storage.refusing_damage(path):
            return cls(**storage.load(path))


def _frozen(value: Any, dtype: Any) -> NDArray[Any]:
    array = np.array(value, dtype=dtype)
    if array.dtype == object:
        raise InputError("an array holds Python objects: give plain numbers or strings")
    array.setflags(write=False)
    return array
