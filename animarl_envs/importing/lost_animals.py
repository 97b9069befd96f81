"""What trackers write where an animal was lost becomes a gap: one rule for a whole import.

Some write a fixed place, such as (-1, -1), (0, 0) or 9999; some repeat the last place until the
animal is found again; some give a low likelihood. All recordings are judged together, since one of
them alone may hold too little to tell.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from animarl_envs.importing.tracks import Tracks

Floats = NDArray[np.float64]
Points = NDArray[np.complex128]  # x + iy, (frames, individuals times keypoints)
Mask = NDArray[np.bool_]

LIKELY = 0.6  # a lower likelihood is not used by default, as in DeepLabCut's own plots
LIKELIHOODS = -1.0, 1.5  # some trackers write -1 where lost; refined scores pass 1 a little
FEW = 0.01  # share of likelihoods beyond these, or of short rests of animals never quite at rest
MANY = 10  # frames in one place
MOST_PLACES = 5  # that are tried because they recur most
APART = 2.0  # usual longest steps from a mark to the nearest other position
HELD = "the place before, held"


def mark_lost(recordings: Sequence[Tracks]) -> tuple[list[Tracks], list[dict[str, int]]]:
    """Turn marks of lost animals into gaps; return how often which mark was in each recording."""
    points = [_points(tracks) for tracks in recordings]
    marks = _find_marks(points)
    lost = [np.isin(own, marks) for own in points]
    held = _find_held([np.where(gone, np.nan, own) for own, gone in zip(points, lost, strict=True)])
    found, counts = [], []
    for tracks, own, gone, kept in zip(recordings, points, lost, held, strict=True):
        count = {f"({m.real:g}, {m.imag:g})": int((own == m).sum()) for m in marks}
        count = {place: n for place, n in (count | {HELD: int(kept.sum())}).items() if n}
        if count:
            gap = (gone | kept).reshape(*tracks.positions.shape[:3], 1)
            tracks = replace(tracks, positions=np.where(gap, np.nan, tracks.positions))
        found.append(tracks)
        counts.append(count)
    return found, counts


def default_confidence(recordings: Sequence[Tracks]) -> float | None:
    """Return the likelihood below which points of an import are not used unless stated.

    ``None`` where its scores are no likelihoods, such as percentages.
    """
    scores = [one.confidence for one in recordings if one.confidence is not None]
    values = np.concatenate([one[np.isfinite(one)] for one in scores]) if scores else np.empty(0)
    least, most = LIKELIHOODS
    beyond = (values < least) | (values > most)
    return LIKELY if len(values) and beyond.mean() <= FEW else None


def _points(tracks: Tracks) -> Points:
    x, y = np.moveaxis(tracks.positions.reshape(len(tracks), -1, 2), -1, 0)
    return np.asarray(x + 1j * y)


def _steps(points: Sequence[Points], use: Sequence[Mask]) -> Floats:
    """Return the lengths of all steps between two positions in use, but of rests."""
    with np.errstate(invalid="ignore"):
        steps = [
            np.abs(np.diff(own, axis=0))[both[1:] & both[:-1]]
            for own, both in zip(points, use, strict=True)
        ]
    lengths = np.concatenate(steps)
    return np.asarray(lengths[lengths > 0])


def _find_marks(points: Sequence[Points]) -> Points:
    """Return places far from all other positions that recur, or are usual for lost animals."""
    seen = np.concatenate([own[np.isfinite(own)] for own in points])
    places, count = np.unique(seen, return_counts=True)
    x = places.real
    nines = [float(sign * (10**digits - 1)) for digits in range(3, 10) for sign in (1, -1)]
    usual = (x == places.imag) & np.isin(x, [0.0, -1.0, *nines])
    often = np.argsort(-count, kind="stable")[:MOST_PLACES]
    often = often[(count[often] >= MANY) & ~usual[often]]
    tried = places[np.concatenate([np.flatnonzero(usual), often])]
    others = seen[~np.isin(seen, tried)]
    steps = _steps(points, [np.isfinite(own) & ~np.isin(own, tried) for own in points])
    if not len(tried) or not len(steps):
        return places[:0]
    reach = APART * float(np.quantile(steps, 0.99))
    far = np.array([np.abs(others - place).min() > reach for place in tried])
    for at, place in enumerate(tried):  # an animal that never moves, or a thing, is not lost
        there = [own == place for own in points]
        elsewhere = [np.isfinite(own) & ~at_it for own, at_it in zip(points, there, strict=True)]
        far[at] &= any(
            (at_it.any(axis=0) & other.any(axis=0)).any()
            for at_it, other in zip(there, elsewhere, strict=True)
        )
    return np.asarray(tried[far])


def _find_held(points: Sequence[Points]) -> list[Mask]:
    """Return where a tracker repeats the last place: still for many frames, then off by a jump.

    Only where measured positions vary a little at nearly all other times: elsewhere animals at rest
    may stand still, and start.
    """
    held = [np.zeros(own.shape, dtype=bool) for own in points]
    steps = _steps(points, [np.isfinite(own) for own in points])
    stretches, short = [], 0
    for number, own in enumerate(points):
        same = np.diff(own, axis=0, prepend=np.nan) == 0
        for track in np.flatnonzero(same.any(axis=0)).tolist():
            edges = np.flatnonzero(np.diff(np.concatenate([[0], same[:, track], [0]])))
            for start, stop in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
                if stop - start < MANY:
                    short += int(stop - start)
                else:
                    stretches.append((number, int(track), start, stop))
    if not stretches or not len(steps) or short > FEW * len(steps):
        return held
    reach = APART * float(np.quantile(steps, 0.99))

    for number, column, start, stop in stretches:
        own = points[number][:, column]
        if stop < len(own) and np.abs(own[stop] - own[start]) > reach:
            held[number][start:stop, column] = True
    return held
