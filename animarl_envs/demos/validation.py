"""What demonstrations must be: each departure is refused in one sentence that names the place."""

from __future__ import annotations

from typing import TYPE_CHECKING, NoReturn

import numpy as np

from animarl_envs.checks import check_names
from animarl_envs.demos.episode import HEADING, INTERVAL, SPLITS, UNFINISHED
from animarl_envs.errors import InputError
from animarl_envs.focus import lone_pursuer

if TYPE_CHECKING:
    from animarl_envs.demos.demonstrations import Demonstrations


def validate(demos: Demonstrations) -> None:
    """Refuse what is missing, misshapen or out of range.

    Raises
    ------
    InputError
        It begins with the name of the demonstrations: the file they came from.
    """
    _check_individuals(demos)
    _check_shapes(demos)
    _check_tracks(demos)
    _check_codes(demos)


def _refuse(demos: Demonstrations, what: str) -> NoReturn:
    raise InputError(f"{demos.name}: {what}")


def _check_individuals(demos: Demonstrations) -> None:
    names, num = demos.individuals, demos.num_individuals
    if num == 0:
        _refuse(demos, "it has no individuals: name at least one")
    if len(set(names)) != num:
        twice = next(n for n in names if names.count(n) > 1)
        _refuse(demos, f"individual {twice!r} appears twice: give each individual its own name")
    if len(demos.roles) != num or set(demos.roles) - {"pursuer", "target", "searcher"}:
        _refuse(demos, f"roles {demos.roles} do not fit: give pursuer, target or searcher to each")
    check_names(demos.name, "an individual", names)
    check_names(demos.name, "a species", [demos.species])
    check_names(demos.name, "a recording", map(str, np.unique(demos.recording)))
    check_names(demos.name, "a signal", demos.signals)
    targets = demos.roles.count("target")
    one_target = targets == 1 and demos.roles[-1] == "target"
    if targets and not one_target and not lone_pursuer(demos.roles):
        _refuse(
            demos,
            f"roles are {demos.roles}: there is one target at most and it comes last, or one "
            "pursuer of several targets and it comes last",
        )


def _check_shapes(demos: Demonstrations) -> None:
    num = demos.num_individuals
    if not 0 < demos.dt < float("inf"):
        _refuse(demos, f"dt is {demos.dt} s: it must be positive; give the frame rate")
    if demos.positions.ndim != 3 or demos.positions.shape[1:] != (num, 2):
        _refuse(
            demos,
            f"positions have shape {demos.positions.shape}, not (frames, {num}, 2): "
            f"give x and y of {num} individuals per frame",
        )
    count = len(demos.lengths)
    if demos.lengths.ndim != 1 or count == 0:
        _refuse(demos, "it holds no episode: check the cut or the split")
    for i, length in enumerate(demos.lengths.tolist()):
        if length < 2:
            _refuse(
                demos,
                f"episode {i} has {length} frame{'s' * (length != 1)}: "
                "leave it out, an episode needs at least two",
            )
    if demos.lengths.sum() != len(demos.positions):
        _refuse(
            demos,
            f"episode lengths add up to {demos.lengths.sum()} frames but there are "
            f"{len(demos.positions)} positions: cut the episodes again",
        )
    for key in ("condition", "outcome", "split", "recording"):
        if getattr(demos, key).shape != (count,):
            _refuse(
                demos,
                f"{key} has {getattr(demos, key).size} entries for {count} episodes: "
                "give one for each",
            )
    if demos.initial_velocity.shape != (count, num, 2):
        _refuse(
            demos,
            f"initial_velocity has shape {demos.initial_velocity.shape}, not ({count}, {num}, 2)"
            ": give x and y of each individual and episode",
        )


def _check_tracks(demos: Demonstrations) -> None:
    names, num = demos.individuals, demos.num_individuals
    if not np.isfinite(demos.initial_velocity).all():
        _refuse(demos, "initial_velocity holds NaN or infinity: use zeros for a start at rest")
    bad = np.argwhere(~np.isfinite(demos.positions).all(axis=2))
    if len(bad):
        _refuse(
            demos,
            f"{_place(demos, *bad[0])}: the position is not a number: fill the gap or cut it out",
        )
    outside = ~demos.arena.contains(demos.positions, margin=demos.OUTSIDE_MARGIN)
    if outside.any():
        place = np.argwhere(outside)[0]
        x, y = demos.positions[tuple(place)]
        _refuse(
            demos,
            f"{_place(demos, *place)}: position ({x:.3g}, {y:.3g}) lies outside the arena "
            f"({demos.arena.shape}, boundary {demos.arena.boundary:g}): scale the tracks "
            "or declare a larger arena",
        )
    for first in range(num):
        for second in range(first + 1, num):
            if np.array_equal(demos.positions[:, first], demos.positions[:, second]):
                _refuse(
                    demos,
                    f"individuals {names[first]!r} and {names[second]!r} have the same track: "
                    "drop the duplicate",
                )


def _check_codes(demos: Demonstrations) -> None:
    num = demos.num_individuals
    if set(np.unique(demos.condition)) - {0, 1}:
        _refuse(demos, f"condition {sorted(set(demos.condition.tolist()))}: it must be 0 or 1")
    if (demos.outcome > num).any() or (demos.outcome < UNFINISHED).any():
        _refuse(
            demos,
            f"outcome {demos.outcome.min()} to {demos.outcome.max()} is out of range: use "
            f"{UNFINISHED} to {num}",
        )
    unknown = sorted(set(demos.split.tolist()) - set(SPLITS))
    if unknown:
        _refuse(demos, f"split {unknown[0]!r} is unknown: choose one of {', '.join(SPLITS)}")
    for key, value in demos.signals.items():
        if len(value) != len(demos.positions):
            _refuse(
                demos,
                f"signal {key!r} has {len(value)} frames, positions have "
                f"{len(demos.positions)}: give one value per frame",
            )
    heading = demos.signals.get(HEADING)
    if heading is not None and heading.shape == (len(demos.positions), num):
        numbers = heading.dtype.kind in "iuf"
        bad = np.argwhere(~np.isfinite(heading)) if numbers else np.zeros((1, 2), dtype=int)
        if len(bad):
            _refuse(
                demos,
                f"{_place(demos, *bad[0])}: signal {HEADING!r} is not a number: fill the gap or "
                "cut it out",
            )
    interval = demos.signals.get(INTERVAL)
    if interval is not None and not (
        interval.shape == demos.positions.shape[:1]
        and interval.dtype.kind == "f"
        and ((interval > 0) & (interval < demos.dt * 1.001)).all()
    ):
        _refuse(demos, f"signal {INTERVAL!r}: give a time per frame, more than 0 s, at most dt")
    for key in ("source", "licence", "synthetic"):
        if key not in demos.provenance:
            _refuse(demos, f"the provenance lacks {key!r}: say where the data comes from")


def _place(demos: Demonstrations, frame: int, individual: int) -> str:
    episode = int(np.searchsorted(demos.offsets, frame, side="right") - 1)
    within = frame - demos.offsets[episode]
    return f"episode {episode}, frame {within}, {demos.individuals[individual]}"
