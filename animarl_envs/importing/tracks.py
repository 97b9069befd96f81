"""One recording as a tracker wrote it: positions with gaps, before cleaning and cutting."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from animarl_envs.array_types import Bools, Floats
from animarl_envs.demos.episode import HEADING
from animarl_envs.errors import InputError, require
from animarl_envs.settings import check_names

CENTROID = "centroid"
TOGETHER = 0.1  # share of frames with everybody, below which nobody needs them all at once
PRESENT = 0.5  # share of a group that is there on average, or of frames with everybody
LONE = "individual_0"  # of a recording of one animal without a name
BODY_LENGTH = "body_length"  # in the unit of positions, in notes
RATE_FROM = "rate_from"  # what says the frame rate, in notes
STATED_CONDITION = "stated_condition"  # by a column; empty where it changes, in notes
TRACKS, TOGETHER_AT_MOST = "tracks", "together_at_most"  # of a recording that was split, in notes
MAX_CLOCK_OFFSET = 0.25  # of a frame that files of one recording may be apart
LARGEST = 1e9  # no tracker writes larger coordinates


@dataclass(frozen=True, eq=False, kw_only=True)
class Tracks:
    """Tracked individuals of one recording.

    Parameters
    ----------
    recording
        Name of the recording; tracks of the same name are merged.
    individuals, keypoints
        Names; a tracker of whole bodies has the one keypoint ``"centroid"``.
    positions
        ``(frames, individuals, keypoints, 2)`` in ``unit``; NaN where not tracked.
    frame_rate
        [Hz]; ``None`` where the file does not say.
    start
        Number of the first frame here, as the file counts; frames before it hold nobody.
    start_time
        Time of frame 0 by the clock that the files of one recording share [s].
    unit
        Such as ``"px"``, ``"mm"``, ``"m"``.
    y_down
        Whether y grows downwards, as in images.
    confidence
        ``(frames, individuals, keypoints)`` or ``None``.
    signals
        Further channels by name, ``(frames, ...)``; ``heading`` ``(frames, individuals)`` is where
        bodies point, from x towards y as they are in the file [rad], NaN where not known.
    events
        Names of the signals that tell of something that happened in the frame, such as a hit: a
        longer step has it if any of its frames has. The others are sampled.
    condition, outcome
        Of the whole recording where it is one episode and the file says; see ``Demonstrations``.
    """

    recording: str
    individuals: tuple[str, ...]
    keypoints: tuple[str, ...] = (CENTROID,)
    positions: Floats
    frame_rate: float | None = None
    start: int = 0
    start_time: float = 0.0
    unit: str = "px"
    y_down: bool = False
    confidence: Floats | None = None
    signals: Mapping[str, NDArray[Any]] = field(default_factory=dict)
    events: tuple[str, ...] = ()
    condition: int = 0
    outcome: int | None = None
    provenance: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name in ("individuals", "keypoints", "events"):  # lists where they come from a file
            object.__setattr__(self, name, tuple(getattr(self, name)))
        shape = (len(self.individuals), len(self.keypoints), 2)
        require(
            self.positions.ndim == 4 and self.positions.shape[1:] == shape,
            f"{self.recording}: positions have shape {self.positions.shape}, not (frames, "
            f"{', '.join(map(str, shape))}): give x and y of each keypoint and individual",
        )
        require(len(self), f"{self.recording}: it has no frames: check the file")
        require(
            len(set(self.individuals)) == len(self.individuals),
            f"{self.recording}: individuals {self.individuals} are not all different: "
            "give each its own name",
        )
        check_names(f"{self.recording:.80}", "a recording", [self.recording])
        check_names(self.recording, "an individual", self.individuals)
        check_names(self.recording, "a keypoint", self.keypoints)
        require(
            self.frame_rate is None or 0 < self.frame_rate < float("inf"),
            f"{self.recording}: the frame rate is {self.frame_rate} Hz: it must be positive",
        )
        require(
            isinstance(self.unit, str),
            f"{self.recording}: the unit is {self.unit!r}: give a name, such as mm",
        )
        if np.isinf(self.positions).any():
            gaps = np.where(np.isinf(self.positions), np.nan, self.positions)
            object.__setattr__(self, "positions", gaps)
        absurd = np.abs(self.positions) > LARGEST
        if absurd.any():
            frame, individual = np.argwhere(absurd)[0][:2]
            raise InputError(
                f"{self.recording}, frame {frame}, {self.individuals[individual]}: the position "
                f"exceeds {LARGEST:g} {self.unit}: the file is damaged, or the column a wrong one"
            )

    def __len__(self) -> int:
        return len(self.positions)

    @property
    def bodies(self) -> Floats:
        """Positions ``(frames, individuals, 2)`` once a keypoint was chosen."""
        require(
            len(self.keypoints) == 1,
            f"{self.recording}: it has keypoints {', '.join(self.keypoints)}: choose one, "
            "or their centroid",
        )
        return self.positions[:, :, 0]

    @property
    def tracked(self) -> Bools:
        """Whether each body was tracked, ``(frames, individuals)``."""
        return np.asarray(np.isfinite(self.bodies).all(axis=2))

    def with_bodies(self, bodies: Floats, **changes: Any) -> Tracks:
        """Return the same with other positions ``(frames, individuals, 2)``."""
        return replace(self, positions=bodies[:, :, None], confidence=None, **changes)

    def within(self, frames: slice, **changes: Any) -> Tracks:
        """Return these frames of the recording, with further changes."""
        return replace(
            self,
            start=self.start + frames.start,
            positions=self.positions[frames],
            confidence=None if self.confidence is None else self.confidence[frames],
            signals={key: value[frames] for key, value in self.signals.items()},
            **changes,
        )

    def choose(self, names: Sequence[str]) -> Tracks:
        """Return only these individuals, in this order."""
        for name in names:
            require(
                name in self.individuals,
                f"{self.recording}: there is no individual {name!r}: choose among "
                f"{', '.join(self.individuals)}",
            )
        index = [self.individuals.index(name) for name in names]
        count = len(self.individuals)
        signals = {
            key: value[:, index] if value.ndim > 1 and value.shape[1] == count else value
            for key, value in self.signals.items()
        }
        return replace(
            self,
            individuals=tuple(names),
            positions=self.positions[:, index],
            confidence=None if self.confidence is None else self.confidence[:, index],
            signals=signals,
        )


def trim(tracks: Tracks) -> Tracks:
    """Cut the frames without animals before the first and after the last animal."""
    seen = np.flatnonzero(np.isfinite(tracks.positions).any(axis=(1, 2, 3)))
    if not len(seen) or (seen[0] == 0 and seen[-1] == len(tracks) - 1):
        return tracks
    return tracks.within(slice(int(seen[0]), int(seen[-1]) + 1))


def split_individuals(tracks: Tracks) -> list[Tracks]:
    """Return a recording of each animal, from its first to its last frame, if they come and go.

    The recording stays whole if all of its animals are there in a tenth of its frames or more, or
    if half of a group is there on average (:func:`in_groups`). Animals of one frame are left out.
    """
    seen = np.asarray(np.isfinite(tracks.positions).any(axis=(2, 3)))
    if not seen.any(axis=0).all() or seen.all(axis=1).mean() >= TOGETHER:
        return [tracks]
    if len(tracks.individuals) > 2 and seen.mean() >= PRESENT:
        return [tracks]
    alone = [trim(tracks.choose([name])) for name in tracks.individuals]
    note = {TOGETHER_AT_MOST: int(seen.sum(axis=1).max()), TRACKS: len(alone)}
    return [
        replace(
            one,
            recording=f"{tracks.recording}/{one.individuals[0]}",
            individuals=(LONE,),
            provenance={**tracks.provenance, **note},
        )
        for one in alone
        if len(one) > 1
    ]


def body_length(recordings: Sequence[Tracks]) -> float | None:
    """Return the animals' usual length in their unit, by the reader or the span of keypoints."""
    stated = [one.provenance[BODY_LENGTH] for one in recordings if BODY_LENGTH in one.provenance]
    if stated:
        return float(np.median(stated))
    spans = []
    for one in recordings:
        if len(one.keypoints) > 1:
            with np.errstate(invalid="ignore"):
                low, high = one.positions.min(axis=2), one.positions.max(axis=2)
            spans.append(np.linalg.norm(high - low, axis=-1).ravel())
    known = np.concatenate(spans) if spans else np.empty(0)
    known = known[np.isfinite(known)]
    return float(np.median(known)) if len(known) else None


def with_common_names(recordings: Sequence[Tracks]) -> list[Tracks]:
    """Name animals alike where recordings hold equally many under different names.

    One animal a recording is ``individual_0`` whatever its file calls it, several are
    ``animal_0``, ``animal_1``, ...
    """
    first = recordings[0].individuals
    if all(one.individuals == first for one in recordings) or any(
        len(one.individuals) != len(first) for one in recordings
    ):
        return list(recordings)
    names = (LONE,) if len(first) == 1 else tuple(f"animal_{k}" for k in range(len(first)))
    return [replace(one, individuals=names) for one in recordings]


def in_groups(recordings: Sequence[Tracks], piece: float | None, parts: int) -> list[list[Tracks]]:
    """Cut recordings into pieces with equally many animals, which are there throughout.

    Recordings of groups stay whole if they have the same animals, and these are all there in half
    of the frames. Otherwise they are cut into pieces of ``piece`` seconds, by default ``parts`` in
    all, and of each piece those animals are kept who are there from its first to its last frame: as
    many in each as keeps most of the tracks, the nearest to their common centre. Of the others
    nothing is seen.
    """
    seen = [tracks.tracked for tracks in recordings]
    alike = len({tracks.individuals for tracks in recordings}) == 1
    if min(len(tracks.individuals) for tracks in recordings) < 3 or (
        alike and np.concatenate(seen).all(axis=1).mean() >= PRESENT
    ):
        return [[tracks] for tracks in recordings]
    pieces = []  # of each recording: its frames, and who is there throughout
    for tracks, own in zip(recordings, seen, strict=True):
        length = sum(map(len, seen)) // parts
        if piece is not None:
            length = round(piece * (tracks.frame_rate or 1.0))
        length = max(2, length)
        starts = range(0, len(own) - length + 1, length)
        frames = [slice(start, start + length) for start in starts]
        pieces.append([(when, np.asarray(own[when].all(axis=0))) for when in frames])
    counts = np.array([there.sum() for some in pieces for _, there in some])
    least = np.unique(counts[counts > 2])
    if not len(least):
        raise InputError(
            f"{recordings[0].recording}: no three animals are there throughout a piece of "
            f"{length} frames: fill gaps by --max-gap, or choose a shorter --piece"
        )
    number = int(max(least, key=lambda k: k * (counts >= k).sum()))
    names = tuple(f"animal_{k}" for k in range(number))
    return [
        [_group_of(tracks, when, there, names) for when, there in some if there.sum() >= number]
        for tracks, some in zip(recordings, pieces, strict=True)
    ]


def _group_of(tracks: Tracks, when: slice, there: Bools, names: tuple[str, ...]) -> Tracks:
    """Return a piece with those animals that are ``there`` nearest to their centre."""
    present = np.flatnonzero(there)
    mean = tracks.bodies[when][:, present].mean(axis=0)
    inner = np.argsort(np.linalg.norm(mean - mean.mean(axis=0), axis=1), kind="stable")
    own = tracks.choose([tracks.individuals[i] for i in np.sort(present[inner[: len(names)]])])
    return own.within(when, individuals=names)


def one_per_individual(parts: Sequence[Tracks]) -> list[Tracks]:
    """Join files of one animal each; what differs in their names becomes the animal's name.

    ``pair1_maleDLC_resnet50`` and ``pair1_femaleDLC_resnet50`` are ``male`` and ``female``.
    """
    if len({part.recording for part in parts}) == 1 < len(parts):  # their reader joins them
        return [*parts]
    stems = [part.recording.partition("DLC_")[0].removesuffix("DLC") for part in parts]
    require(
        len(parts) == len(set(stems)) > 1 and all(len(part.individuals) == 1 for part in parts),
        f"{parts[0].recording}: merging individuals needs two files or more, of one animal "
        "each, with names that differ: leave --merge-individuals out",
    )
    words = [re.split(r"([\s_.\-]+)", stem) for stem in stems]
    same = len({len(one) for one in words}) == 1
    columns = list(zip(*words, strict=True)) if same else []
    differing = [i for i, column in enumerate(columns) if len(set(column)) > 1]
    names, recording = stems, "merged"
    if differing:
        first, last = differing[0], differing[-1] + 1
        names = ["".join(one[first:last]) for one in words]
        rest = "".join([*words[0][:first], *words[0][last:]])
        recording = rest.strip("_-. ") or recording
    return [
        replace(part, recording=recording, individuals=(name,))
        for part, name in zip(parts, names, strict=True)
    ]


def disambiguate_by_folder(parts: Sequence[tuple[Path, Tracks]]) -> list[tuple[Path, Tracks]]:
    """Name recordings by folder where files of one name in several folders have the same animals.

    Other files that share a recording hold different animals of it.
    """
    having: dict[str, dict[str, list[Path]]] = {}  # files by recording and individual
    for file, tracks in parts:
        for name in tracks.individuals:
            files = having.setdefault(tracks.recording, {}).setdefault(name, [])
            files += [file] * (file not in files)
    above: dict[str, str] = {}
    for recording, group in having.items():
        twice = [(name, files) for name, files in group.items() if len(files) > 1]
        paths = {file for files in group.values() for file in files}
        if twice and len({file.name for file in paths}) > 1:
            name, (first, second, *_) = twice[0]
            raise InputError(
                f"{first} and {second}: both have {name} of recording {recording}: leave one out, "
                "or give different recordings different names"
            )
        if twice:
            above[recording] = os.path.commonpath([file.parent.resolve() for file in paths])
    named = []
    for file, tracks in parts:
        name = tracks.recording
        if name in above:
            folder = file.parent.resolve().relative_to(above[name]).as_posix()
            name = name if folder == "." else f"{folder}/{name}"
        named.append((file, replace(tracks, recording=name)))
    return named


def separate_arenas(parts: Sequence[tuple[Path, Tracks]]) -> list[tuple[Path, Tracks]]:
    """Name recordings by their arena too where files of one recording have several arenas."""
    arenas: dict[str, set[str]] = {}
    for _, tracks in parts:
        arenas.setdefault(tracks.recording, set()).add(tracks.provenance.get("arena", ""))
    separated = []
    for file, tracks in parts:
        if len(arenas[tracks.recording]) > 1:
            arena = tracks.provenance.get("arena") or "no arena"
            tracks = replace(tracks, recording=f"{tracks.recording}/{arena}")
        separated.append((file, tracks))
    return separated


def merge(parts: Sequence[Tracks]) -> list[Tracks]:
    """Join tracks of one recording: individuals side by side, frames up to the longest."""
    by_name: dict[str, list[Tracks]] = {}
    for part in parts:
        by_name.setdefault(part.recording, []).append(part)
    return [group[0] if len(group) == 1 else _side_by_side(group) for group in by_name.values()]


def _side_by_side(group: Sequence[Tracks]) -> Tracks:
    first = group[0]
    kinds = {(part.keypoints, part.frame_rate) for part in group}
    require(
        len(kinds) == 1,
        f"{first.recording}: its files differ in keypoints or frame rate: import them one by one",
    )
    begin = min(part.start_time for part in group)
    exact = [(part.start_time - begin) * (part.frame_rate or 0.0) + part.start for part in group]
    late = [round(frames) for frames in exact]
    require(
        max(abs(a - b) for a, b in zip(exact, late, strict=True)) <= MAX_CLOCK_OFFSET,
        f"{first.recording}: its files begin at times between each other's frames: resample "
        "them, or import them one by one",
    )
    start = min(late)
    late = [after - start for after in late]
    frames = max(len(part) + after for part, after in zip(group, late, strict=True))
    require(
        frames <= 2 * sum(map(len, group)),
        f"{first.recording}: its files lie so far apart in time that they hardly are of one "
        "recording: import them one by one",
    )

    def joined(values: Sequence[NDArray[Any]]) -> Floats:
        shifted = []
        for own, after in zip(values, late, strict=True):
            shifted.append(np.full((frames, *own.shape[1:]), np.nan))
            shifted[-1][after : after + len(own)] = own
        return np.concatenate(shifted, axis=1)

    headings = [part.signals[HEADING] for part in group if HEADING in part.signals]
    all_have = len(headings) == len(group) and all(own.ndim == 2 for own in headings)
    scores = [part.confidence for part in group if part.confidence is not None]
    return replace(
        first,
        start=start,
        start_time=begin,
        individuals=tuple(name for part in group for name in part.individuals),
        positions=joined([part.positions for part in group]),
        confidence=joined(scores) if len(scores) == len(group) else None,
        signals={HEADING: joined(headings)} if all_have else {},
        events=(),
    )
