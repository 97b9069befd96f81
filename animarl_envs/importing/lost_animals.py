"""Turn what trackers write for a lost animal into gaps, by one rule for a whole import.

Some write a fixed place, such as (-1, -1), (0, 0) or 9999; some repeat the last place until the
animal is found again; some give a low likelihood. All recordings are judged together, since one of
them alone may hold too little to tell.
"""

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from animarl_envs.array_types import Bools, Floats
from animarl_envs.importing.cleaning import runs
from animarl_envs.importing.tracks import Tracks

Points = NDArray[np.complex128]  # x + iy, (frames, individuals times keypoints)
LIKELY = 0.6  # a lower likelihood is not used by default, as in DeepLabCut's own plots
LIKELIHOODS = -1.0, 1.5  # some trackers write -1 where lost; refined scores pass 1 a little
MAX_EXCEPTIONS = 0.01  # share of likelihoods beyond these, or of steps in short rests
MIN_FRAMES_IN_PLACE = 10  # frames in one place
MOST_PLACES = 5  # that are tried because they recur most
MIN_STEPS_TO_MARK = 2.0  # usual longest steps from a mark to the nearest other position
HELD = "the place before, held"


def mark_lost(recordings: Sequence[Tracks]) -> tuple[list[Tracks], list[dict[str, int]]]:
    """Turn marks of lost animals into gaps; return the count of each mark by recording."""
    points = [_points(tracks) for tracks in recordings]
    marks = _find_marks(points)
    held = _find_held([_without(marks, own) for own in points])
    cleaned, counts = [], []
    for tracks, own, kept in zip(recordings, points, held, strict=True):
        count = {f"({m.real:g}, {m.imag:g})": int((own == m).sum()) for m in marks}
        count = {place: n for place, n in (count | {HELD: int(kept.sum())}).items() if n}
        if count:
            gap = (np.isin(own, marks) | kept).reshape(*tracks.positions.shape[:3], 1)
            tracks = replace(tracks, positions=np.where(gap, np.nan, tracks.positions))
        cleaned.append(tracks)
        counts.append(count)
    return cleaned, counts


def default_confidence(recordings: Sequence[Tracks]) -> float | None:
    """Return the likelihood below which points of an import are not used unless stated.

    ``None`` where its scores are no likelihoods, such as percentages.
    """
    scores = [one.confidence for one in recordings if one.confidence is not None]
    values = np.concatenate([one[np.isfinite(one)] for one in scores]) if scores else np.empty(0)
    least, most = LIKELIHOODS
    beyond = (values < least) | (values > most)
    return LIKELY if len(values) and beyond.mean() <= MAX_EXCEPTIONS else None


def _points(tracks: Tracks) -> Points:
    """Return positions as complex numbers, without copying them: there may be a gigabyte."""
    return np.ascontiguousarray(tracks.positions).reshape(len(tracks), -1).view(np.complex128)


def _without(marks: Points, points: Points) -> Points:
    return np.where(np.isin(points, marks), np.nan, points) if len(marks) else points


def _steps(points: Iterable[Points]) -> Floats:
    """Return the lengths of all steps between two known positions, without rests."""
    with np.errstate(invalid="ignore"):
        lengths = (np.abs(np.diff(own, axis=0)) for own in points)
        return np.concatenate([one[one > 0] for one in lengths])


def _find_marks(points: Sequence[Points]) -> Points:
    """Return places far from all other positions that recur, or are usual for lost animals."""
    seen = np.concatenate([own[np.isfinite(own)] for own in points])
    seen.sort()  # in place, as numpy.unique does not
    first = np.flatnonzero(np.append(True, seen[1:] != seen[:-1])[: len(seen)])
    places, count = seen[first], np.diff(first, append=len(seen))
    x = places.real
    nines = [float(sign * (10**digits - 1)) for digits in range(3, 10) for sign in (1, -1)]
    usual = (x == places.imag) & np.isin(x, [0.0, -1.0, *nines])
    often = np.flatnonzero(count >= MIN_FRAMES_IN_PLACE)
    often = often[np.argsort(-count[often], kind="stable")[:MOST_PLACES]]
    tried = places[np.concatenate([np.flatnonzero(usual), often[~usual[often]]])]
    steps = _steps(_without(tried, own) for own in points) if len(tried) else np.empty(0)
    if not len(steps):
        return places[:0]
    others = places[~np.isin(places, tried)]
    reach = MIN_STEPS_TO_MARK * float(np.quantile(steps, 0.99))
    far = np.array([np.abs(others - place).min() > reach for place in tried])
    for at, place in enumerate(tried):  # an animal that never moves, or a thing, is not lost
        there = [own == place for own in points]
        elsewhere = [np.isfinite(own) & ~at_it for own, at_it in zip(points, there, strict=True)]
        far[at] &= any(
            (at_it.any(axis=0) & other.any(axis=0)).any()
            for at_it, other in zip(there, elsewhere, strict=True)
        )
    return np.asarray(tried[far])


def _find_held(points: Sequence[Points]) -> list[Bools]:
    """Return where a tracker repeats the last place: still for many frames, then off by a jump.

    Only where measured positions vary a little at nearly all other times: elsewhere animals at rest
    may stand still, and start.
    """
    held = [np.zeros(own.shape, dtype=bool) for own in points]
    steps, short, stretches = _steps(points), 0, []
    for number, own in enumerate(points):
        same = np.zeros(own.shape, dtype=bool)
        same[1:] = own[1:] == own[:-1]
        for track in np.flatnonzero(same.any(axis=0)).tolist():
            for start, stop in runs(same[:, track]):
                if stop - start < MIN_FRAMES_IN_PLACE:
                    short += stop - start
                else:
                    stretches.append((number, track, start, stop))
    if not stretches or not len(steps) or short > MAX_EXCEPTIONS * len(steps):
        return held
    reach = MIN_STEPS_TO_MARK * float(np.quantile(steps, 0.99))
    for number, column, start, stop in stretches:
        own = points[number][:, column]
        if stop < len(own) and np.abs(own[stop] - own[start]) > reach:
            held[number][start:stop, column] = True
    return held
