"""Recorded episodes with their metadata, checked when they are made."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations
from pathlib import Path
from types import MappingProxyType
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from animarl_envs.arena import Arena
from animarl_envs.array_types import Bools, Floats, Ints
from animarl_envs.demos.episode import (
    HEADING,
    INTERVAL,
    SPLITS,
    UNFINISHED,
    Episode,
    Episodes,
    Resolution,
    joint_resolution,
    read_only,
)
from animarl_envs.errors import InputError
from animarl_envs.focus import focus_directions, lone_pursuer
from animarl_envs.locomotion import velocities
from animarl_envs.settings import check_names

HIT_SHARE = 0.5  # a recorded odour signal of at least this is a hit


@dataclass(frozen=True, eq=False, kw_only=True)
class Demonstrations(Episodes):
    """Recorded episodes of the same individuals, laid end to end.

    Raises InputError if anything is missing, misshapen or out of range; the sentence says where,
    and how to fix it.

    Parameters
    ----------
    individuals, roles, dt, positions, lengths, outcome, condition
        As in :class:`~animarl_envs.demos.episode.Episodes`; pursuers come first, an episode has two
        frames at least.
    species
        Name of the species spec they belong to, or ``"custom"``.
    arena
        The field; every position must lie within its boundary, widened by ``OUTSIDE_MARGIN``.
    initial_velocity
        ``(episodes, individuals, 2)``, velocity at each first frame [arena unit / s]. A reader that
        does not know it drops the first recorded frame and keeps the velocity that it makes.
    split
        ``(episodes,)``, ``"train"``, ``"val"`` or ``"test"``.
    recording
        ``(episodes,)``, the recording each episode was cut from.
    signals
        Further channels by name, each ``(frames,)`` or ``(frames, individuals, ...)``, such as
        ``actions`` (int8; the action taken at a frame, -1 at the last one), ``odour`` or
        ``heading`` (:meth:`headings`).
    provenance
        JSON-like: ``source``, ``licence``, ``synthetic`` (bool) at least; further what was done.
    """

    FORMAT = "animarl-demonstrations"
    MADE_BY = "make it again with 'animarl import', or name its --source"
    FEWEST_FRAMES = 2
    EACH = {
        "lengths": np.int64,
        "initial_velocity": np.float64,
        "condition": np.int8,
        "outcome": np.int8,
        "split": np.str_,
        "recording": np.str_,
    }
    META = ("species", "individuals", "roles", "dt", "arena", "provenance")
    STORED_AS = {"lengths": np.int32}
    OUTSIDE_MARGIN = 0.5  # the last frame may lie a step beyond the boundary [arena unit]

    species: str
    arena: Arena
    initial_velocity: Floats
    split: NDArray[np.str_]
    recording: NDArray[np.str_]
    signals: Mapping[str, NDArray[Any]] = field(default_factory=dict)
    provenance: Mapping[str, Any] = field(default_factory=dict)
    name: str = "demonstrations"  # for messages: the file they came from

    def __post_init__(self) -> None:
        self._check_individuals()
        super().__post_init__()
        signals = {key: read_only(value, None) for key, value in self.signals.items()}
        object.__setattr__(self, "signals", MappingProxyType(signals))
        object.__setattr__(self, "provenance", MappingProxyType(dict(self.provenance)))
        self._check_tracks()
        self._check_codes()
        self._check_signals()

    @property
    def label(self) -> str:
        """Name of the set."""
        return self.name

    def __deepcopy__(self, memo: dict[int, Any]) -> Demonstrations:
        return self  # immutable

    def __getstate__(self) -> dict[str, Any]:
        return vars(self) | {"signals": dict(self.signals), "provenance": dict(self.provenance)}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__init__(**state)  # type: ignore[misc]

    # -- shape ------------------------------------------------------------------------------------

    @property
    def num_episodes(self) -> int:
        """Number of episodes."""
        return len(self.lengths)

    @property
    def synthetic(self) -> bool:
        """Whether the tracks were simulated."""
        return bool(self.provenance["synthetic"])

    def __repr__(self) -> str:
        kind = "synthetic" if self.synthetic else "recorded"
        return (
            f"Demonstrations({self.species}, {self.num_episodes} {kind} episodes of "
            f"{', '.join(self.individuals)}, {(self.lengths - 1).sum() * self.dt:.1f} s)"
        )

    def episode(self, index: int) -> Episode:
        """Return episode ``index`` (negative counts from the end), as read-only views."""
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

    def intervals(self, frames: slice = slice(None)) -> Floats:
        """Return the time before each frame, ``(frames,)`` [s]: dt, or less at a last frame."""
        if INTERVAL in self.signals:
            return self.signals[INTERVAL][frames].astype(np.float64)
        return np.full(len(self.positions[frames]), self.dt)

    def steps(self) -> Ints:
        """Return the steps since the start of its episode of each frame, ``(frames,)``."""
        return np.arange(len(self.positions)) - np.repeat(self.offsets[:-1], self.lengths)

    def velocities(self) -> Floats:
        """Return the velocities of all frames, ``(frames, individuals, 2)`` [arena unit / s]."""
        out = velocities(self.positions, self.initial_velocity[0], self.dt)
        if INTERVAL in self.signals:
            out *= (self.dt / self.intervals())[:, None, None]
        out[self.offsets[:-1]] = self.initial_velocity
        return out

    def focus(self) -> Floats:
        """Return unit vectors towards the focus at all frames, ``(frames, individuals, 2)``."""
        velocities, steps = self.velocities(), self.steps()
        return focus_directions(self.positions, self.roles, velocities, steps, self.dt)

    def headings(self) -> Floats | None:
        """Return recorded headings ``(frames, individuals)``, counter-clockwise from x [rad].

        ``None`` where the signal ``heading`` is absent or has not a column for each individual.
        """
        heading = self.signals.get(HEADING)
        if heading is None or heading[:1].size != self.num_individuals:
            return None
        return heading.astype(np.float64).reshape(len(heading), -1)

    def odour_hits(self) -> Bools | None:
        """Return hits of a searcher's left and right antenna since the last frame, ``(frames, 2)``.

        ``None`` where they were not recorded.
        """
        if not {"odour_left", "odour_right"} <= self.signals.keys():
            return None
        sides = [np.squeeze(self.signals[f"odour_{side}"]) for side in ("left", "right")]
        return np.stack(sides, axis=-1).astype(np.float64) >= HIT_SHARE

    def resolution(self) -> Resolution | None:
        """Return the grid on which all positions lie, such as pixels; None where there is none."""
        return joint_resolution(self.positions, np.repeat(self.recording, self.lengths))

    # -- selection --------------------------------------------------------------------------------

    def select(
        self,
        episodes: Any = None,
        *,
        split: str | None = None,
        condition: int | None = None,
    ) -> Self:
        """Return the episodes that meet all conditions given, in the order of ``episodes``."""
        chosen = np.arange(len(self))
        if episodes is not None:
            chosen = chosen[np.asarray(episodes)]
        if split is not None:
            if split not in SPLITS:
                raise InputError(f"split {split!r} is unknown: choose one of {', '.join(SPLITS)}")
            chosen = chosen[self.split[chosen] == split]
        if condition is not None:
            chosen = chosen[self.condition[chosen] == condition]
        if split is not None and not len(chosen):
            wanted = f", condition {condition}" * (condition is not None)
            self._refuse(
                f"split {split!r}{wanted} holds no episode: split the file again or choose "
                "another split"
            )
        return super().select(chosen)

    def of_individuals(self, kept: Sequence[int]) -> Self:
        """Return the recordings of some of the individuals.

        An episode that ended by the contact of one who is left out is unfinished. Recorded actions
        are left out: their directions may refer to somebody who is gone.
        """
        own, everyone, outcome = list(kept), self.num_individuals, self.outcome.copy()
        for k in np.unique(outcome[outcome > 0]).tolist():
            ended = own.index(k - 1) + 1 if k - 1 in own else UNFINISHED
            outcome[self.outcome == k] = ended
        signals = {
            key: value[:, own] if value.ndim > 1 and value.shape[1] == everyone else value
            for key, value in self.signals.items()
            if key != "actions"
        }
        return replace(
            self,
            individuals=tuple(self.individuals[i] for i in own),
            roles=tuple(self.roles[i] for i in own),
            positions=self.positions[:, own],
            initial_velocity=self.initial_velocity[:, own],
            outcome=outcome,
            signals=signals,
        )

    def _frames(self, frames: Ints) -> dict[str, Any]:
        signals = {key: value[frames] for key, value in self.signals.items()}
        return super()._frames(frames) | {"signals": signals}

    def fingerprint(self) -> str:
        """Return a hash of the content, without the provenance: 16 hexadecimal digits."""
        digest = hashlib.sha256()
        later = ("obstacles", "landmarks")  # without them the hash is that of former versions
        arena = {key: value for key, value in vars(self.arena).items() if value or key not in later}
        head = [self.species, self.individuals, self.roles, self.dt, arena]
        digest.update(json.dumps(head, sort_keys=True).encode())
        for key in ("positions", "lengths", "initial_velocity", "condition", "outcome"):
            digest.update(np.ascontiguousarray(getattr(self, key)).tobytes())
        digest.update("\n".join([*self.split, *self.recording]).encode())
        for key in sorted(self.signals):
            digest.update(key.encode() + np.ascontiguousarray(self.signals[key]).tobytes())
        return digest.hexdigest()[:16]

    # -- storage ----------------------------------------------------------------------------------

    def _more_arrays(self) -> dict[str, NDArray[Any]]:
        return {f"signal_{key}": value for key, value in self.signals.items()}

    @classmethod
    def from_stored(
        cls, path: Path, meta: dict[str, Any], arrays: dict[str, NDArray[Any]]
    ) -> dict[str, Any]:
        """Return the constructor's arguments from a file's metadata and arrays."""
        arena = dict(meta["arena"])
        known = {name: arrays[name] for name in ("positions", *cls.EACH)}
        return {
            **{name: meta[name] for name in cls.META},
            **known,
            "dt": float(meta["dt"]),
            "arena": Arena(**arena | {"boundary": float(arena["boundary"])}),
            "signals": {k[7:]: v for k, v in arrays.items() if k.startswith("signal_")},
            "name": str(path),
        }

    # -- checks -----------------------------------------------------------------------------------

    def _check_individuals(self) -> None:
        names, num = self.individuals, self.num_individuals
        if num == 0:
            self._refuse("it has no individuals: name at least one")
        if len(set(names)) != num:
            twice = next(n for n in names if names.count(n) > 1)
            self._refuse(f"individual {twice!r} appears twice: give each individual its own name")
        if len(self.roles) != num or set(self.roles) - {"pursuer", "target", "searcher"}:
            self._refuse(f"roles {self.roles} do not fit: give pursuer, target or searcher to each")
        check_names(self.name, "an individual", names)
        check_names(self.name, "a species", [self.species])
        check_names(self.name, "a recording", map(str, np.unique(self.recording)))
        check_names(self.name, "a signal", self.signals)
        targets = self.roles.count("target")
        if targets and (targets, self.roles[-1]) != (1, "target") and not lone_pursuer(self.roles):
            self._refuse(
                f"roles are {self.roles}: there is one target at most and it comes last, or one "
                "pursuer of several targets and it comes last",
            )

    def _check_tracks(self) -> None:
        initial, num, names = self.initial_velocity, self.num_individuals, self.individuals
        if not 0 < self.dt < float("inf"):
            self._refuse(f"dt is {self.dt} s: it must be positive; give the frame rate")
        if initial.shape != (len(self), num, 2):
            self._refuse(
                f"initial_velocity has shape {initial.shape}, not ({len(self)}, {num}, 2)"
                ": give x and y of each individual and episode",
            )
        if not np.isfinite(initial).all():
            self._refuse("initial_velocity holds NaN or infinity: use zeros for a start at rest")
        for place in np.argwhere(~np.isfinite(self.positions).all(axis=2))[:1]:
            self._refuse(
                f"{self._place(*place)}: the position is not a number: fill the gap or cut it out",
            )
        whole = replace(self.arena, obstacles=())  # tracks may cross them
        outside = ~whole.contains(self.positions, margin=self.OUTSIDE_MARGIN)
        for place in np.argwhere(outside)[:1]:
            x, y = self.positions[tuple(place)]
            self._refuse(
                f"{self._place(*place)}: position ({x:.3g}, {y:.3g}) lies outside the arena "
                f"({self.arena.shape}, boundary {self.arena.boundary:g}): scale the tracks "
                "or declare a larger arena",
            )
        for first, second in combinations(range(num), 2):
            if np.array_equal(self.positions[:, first], self.positions[:, second]):
                self._refuse(
                    f"individuals {names[first]!r} and {names[second]!r} have the same track: "
                    "drop the duplicate",
                )

    def _check_codes(self) -> None:
        num = self.num_individuals
        if set(np.unique(self.condition)) - {0, 1}:
            self._refuse(f"condition {sorted(set(self.condition.tolist()))}: it must be 0 or 1")
        if (self.outcome > num).any() or (self.outcome < UNFINISHED).any():
            self._refuse(
                f"outcome {self.outcome.min()} to {self.outcome.max()} is out of range: use "
                f"{UNFINISHED} to {num}",
            )
        unknown = sorted(set(self.split.tolist()) - set(SPLITS))
        if unknown:
            self._refuse(f"split {unknown[0]!r} is unknown: choose one of {', '.join(SPLITS)}")
        for key in ("source", "licence", "synthetic"):
            if key not in self.provenance:
                self._refuse(f"the provenance lacks {key!r}: say where the data comes from")

    def _check_signals(self) -> None:
        for key, value in self.signals.items():
            if len(value) != len(self.positions):
                self._refuse(
                    f"signal {key!r} has {len(value)} frames, positions have "
                    f"{len(self.positions)}: give one value per frame",
                )
        heading, interval = self.signals.get(HEADING), self.signals.get(INTERVAL)
        if heading is not None and heading.shape == self.positions.shape[:2]:
            numbers = heading.dtype.kind in "iuf"
            bad = np.argwhere(~np.isfinite(heading)) if numbers else np.zeros((1, 2), dtype=int)
            for place in bad[:1]:
                self._refuse(
                    f"{self._place(*place)}: signal {HEADING!r} is not a number: fill the gap or "
                    "cut it out",
                )
        if interval is not None and not (
            interval.shape == self.positions.shape[:1]
            and interval.dtype.kind == "f"
            and ((interval > 0) & (interval < self.dt * 1.001)).all()
        ):
            self._refuse(f"signal {INTERVAL!r}: give a time per frame, more than 0 s, at most dt")

    def _place(self, frame: int, individual: int) -> str:
        episode = int(np.searchsorted(self.offsets, frame, side="right") - 1)
        within = frame - self.offsets[episode]
        return f"episode {episode}, frame {within}, {self.individuals[individual]}"
