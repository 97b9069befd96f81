"""Summaries of demonstrations: a table of episodes, numbers of the set, its unit of length."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from animarl_envs.array_types import Floats
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.episode import FILLED, PURSUER_OUT, TARGET_OUT, TIME_OUT, Episodes
from animarl_envs.focus import distances_to_target, is_free
from animarl_envs.species import SPECIES

RESTING_SHARE = 0.05  # of the 99th percentile of speed: below it an individual counts as resting
OUTCOME_NAMES = {TIME_OUT: "time-out", TARGET_OUT: "target left", PURSUER_OUT: "a pursuer left"}
LEARNED_FROM = "learned_from"
"""Key of a provenance: the source of the recordings that simulated tracks stand for."""
STAND_IN = (
    "The recordings that this model learned from ({}) are not in it: in their place are tracks "
    "that it simulated itself. How far it is from the animals is on its card alone."
)
TRACKING = (
    "untracked",
    "filled",
    "heading unknown",
    "below confidence",
    "jumps",
    "identity swaps",
)  # counts of frames


def outcome_name(outcome: int, demos: Episodes) -> str:
    """Return an outcome code in words."""
    if outcome > 0:
        name, role = demos.individuals[outcome - 1], demos.roles[outcome - 1]
        reached = {"searcher": f"{name} reached the source", "target": f"contact with {name}"}
        return reached.get(role, f"contact by {name}")
    if outcome == TARGET_OUT and demos.roles.count("target") > 1:
        return "a target left"
    if outcome == PURSUER_OUT and not demos.has_goal:
        return "an animal left"
    return OUTCOME_NAMES.get(outcome, "recording ended")


def condition_name(condition: int, demos: Demonstrations) -> str:
    """Return the number of a condition, and its name where the recordings state one."""
    names: Any = demos.provenance.get("conditions")
    known = isinstance(names, list | tuple) and condition < len(names)
    word = str(names[condition]) if known else ""
    return f"condition {condition}" + (f" ({word})" if word not in ("", str(condition)) else "")


def ending_in_words(outcome: int, individuals: Sequence[str], roles: Sequence[str]) -> str:
    """Return who reached whom, or who left the arena; empty if neither ended the episode."""
    if outcome > 0:
        name, role = individuals[outcome - 1], roles[outcome - 1]
        if role == "target":
            return f"{individuals[-1]} reached {name}"
        return f"{name} reached {'the source' if role == 'searcher' else individuals[-1]}"
    if outcome == TARGET_OUT:
        return f"{individuals[-1] if roles[-1] == 'target' else 'a target'} left the arena"
    leaving = "an animal" if is_free(roles) else "a pursuer"
    return f"{leaving} left the arena" if outcome == PURSUER_OUT else ""


def episode_table(demos: Demonstrations) -> list[dict[str, Any]]:
    """Return one row per episode: duration [s], path length, speeds and filled gaps, distances."""
    rows = []
    for one in demos:
        step = np.linalg.norm(np.diff(one.positions, axis=0), axis=2)
        speed = step / one.dt
        distance = distances_to_target(one.positions, demos.roles).min(axis=1)
        row: dict[str, Any] = {
            "episode": one.index,
            "recording": one.recording,
            "split": one.split,
            "condition": one.condition,
            "outcome": outcome_name(one.outcome, demos),
            "duration": one.duration,
        }
        for i, name in enumerate(demos.individuals):
            row[f"path_length_{name}"] = float(step[:, i].sum())
            row[f"median_speed_{name}"] = float(np.median(speed[:, i]))
            row[f"top_speed_{name}"] = float(speed[:, i].max())
        if FILLED in one.signals:
            for i, name in enumerate(demos.individuals):
                row[f"filled_frames_{name}"] = int(one.signals[FILLED][:, i].sum())
        if np.isfinite(distance).all():
            row["first_distance"] = float(distance[0])
            row["least_distance"] = float(distance.min())
        rows.append(row)
    return rows


def persistence(demos: Demonstrations) -> Floats:
    """Return the share of a step that the next one repeats, one number for each of ``demos.kinds``.

    The slope of the next step on the present one: 1 of steady motion, less of tracks that jump to
    and fro, -0.5 of somebody at rest whose position is known up to white noise. NaN of somebody who
    never moves.
    """
    onwards = np.zeros(demos.num_individuals)
    squares = np.zeros(demos.num_individuals)
    for one in demos:
        step = np.diff(one.positions, axis=0)
        onwards += (step[1:] * step[:-1]).sum(axis=(0, 2))
        squares += (step[:-1] ** 2).sum(axis=(0, 2))
    onwards = onwards.reshape(len(demos.kinds), -1).sum(axis=1)
    squares = squares.reshape(len(demos.kinds), -1).sum(axis=1)
    kept = np.divide(onwards, squares, out=np.full_like(squares, np.nan), where=squares > 0)
    return np.asarray(kept)


def tracking_noise(paths: Iterable[Floats]) -> float:
    """Return the standard deviation of white noise of positions, per axis [arena unit].

    White noise makes successive accelerations anti-correlated: their covariance at lag one is -4
    times its variance, to which damped motion adds little. ``paths`` are ``(frames, ..., 2)``.
    """
    bends = [np.diff(path, n=2, axis=0) for path in paths]
    products = np.concatenate([np.empty(0), *((bend[1:] * bend[:-1]).ravel() for bend in bends)])
    return float(np.sqrt(max(0.0, -products.mean() / 4.0))) if len(products) else 0.0


def tracking_counts(demos: Demonstrations) -> dict[str, int]:
    """Return the number of flagged frames by kind, where the tracks were cleaned."""
    cleaning: Mapping[str, Any] = demos.provenance.get("cleaning") or {}
    flagged = {}
    for key in TRACKING:
        entry = key.replace(" ", "_")
        counts = [one[entry] for one in cleaning.values() if entry in one]
        if counts:
            flagged[key] = int(sum(counts))
    return flagged


PHYSICAL_UNITS = ("um", "mm", "cm", "m", "inch")


@dataclass(frozen=True)
class Unit:
    """The unit in which lengths are reported, and how many of it make one arena unit."""

    name: str
    per_arena_unit: float


RECORDED_SCALE = Unit("arena units", 1.0)
METRES = Unit("m", 1.0)


def stand_in_note(demos: Demonstrations) -> str:
    """Return a sentence that says that tracks stand for recordings; empty if they do not."""
    source = demos.provenance.get(LEARNED_FROM)
    return STAND_IN.format(source) if source else ""


def unit_of(demos: Demonstrations) -> Unit:
    """Return the recordings' own unit if the provenance holds it, else the arena unit.

    If recordings have scales of their own, their mean is used. The arena unit of some species is
    the metre.
    """
    species = SPECIES.get(demos.species)
    unscaled = METRES if species and species.length_unit == "metre" else RECORDED_SCALE
    name, scales = demos.provenance.get("unit"), demos.provenance.get("scales")
    if name not in PHYSICAL_UNITS or not isinstance(scales, Mapping) or not scales:
        return unscaled
    used = [_scale(scales[r]) for r in np.unique(demos.recording).tolist() if r in scales]
    return Unit(str(name), float(np.mean(used))) if used else unscaled


def _scale(record: Any) -> float:
    return float(record["unit"])
