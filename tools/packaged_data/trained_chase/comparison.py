"""What the chases look like, in numbers: beside published ones, between conditions, by who plays.

Intervals are percentile intervals over resampled episodes. They speak of the networks that were
trained, once per condition; how much another training run would differ is not in them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from animarl_algos.evaluation.statistics import RESAMPLES, Interval, percentile_interval
from animarl_algos.evaluation.teams import load_weights, make_policy
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.episode import PURSUER_OUT, TARGET_OUT, TIME_OUT, UNFINISHED
from animarl_envs.errors import InputError
from animarl_envs.importing.readers import load_readers, read
from animarl_envs.species import AGENT
from tools.packaged_data.trained_chase.chases import Chases, chase
from tools.packaged_data.trained_chase.training import (
    mixed_weights,
    weights_file,
)

Floats = NDArray[np.float64]
CROSS_EPISODES = 500
LOCAL_FILES = ("episodes_c2ae_indiv_slow2.4.npz", "episodes_c2ae_share_slow2.4.npz")


@dataclass(frozen=True)
class Quantity:
    """One value per episode, ``of(outcome (E,), durations (E,) [s], paths)``; NaN: none."""

    name: str
    of: Callable[[NDArray[np.int8], Floats, Sequence[Floats]], Floats]
    digits: int = 2


def _share(*codes: int) -> Callable[..., Floats]:
    return lambda outcome, duration, paths: np.isin(outcome, codes).astype(np.float64)


def _captured(outcome: NDArray[np.int8], duration: Floats, paths: Sequence[Floats]) -> Floats:
    return (outcome > 0).astype(np.float64)


def _duration(outcome: NDArray[np.int8], duration: Floats, paths: Sequence[Floats]) -> Floats:
    return duration


def _path_length(outcome: NDArray[np.int8], duration: Floats, paths: Sequence[Floats]) -> Floats:
    """Mean over the predators [arena unit]."""
    steps = (
        float(np.linalg.norm(np.diff(p[:, :-1], axis=0), axis=-1).sum(axis=0).mean()) for p in paths
    )
    return np.fromiter(steps, np.float64)


def _apart(outcome: NDArray[np.int8], duration: Floats, paths: Sequence[Floats]) -> Floats:
    """Distance between the two predators, mean over frames [arena unit]."""
    means = (np.linalg.norm(p[:, 0] - p[:, 1], axis=-1).mean() for p in paths)
    return np.fromiter(means, np.float64)


def _farther(outcome: NDArray[np.int8], duration: Floats, paths: Sequence[Floats]) -> Floats:
    """Distance from the prey to the farther predator, mean over frames [arena unit]."""
    means = (np.linalg.norm(p[:, :2] - p[:, 2:], axis=-1).max(axis=1).mean() for p in paths)
    return np.fromiter(means, np.float64)


def encirclement(path: Floats) -> Floats:
    """Angle between the two predators as seen from the prey, ``(frames,)`` [deg], 0 to 180.

    ``path`` is ``(frames, 3, 2)``, the prey last.
    """
    first, second = path[:, 0] - path[:, 2], path[:, 1] - path[:, 2]
    cross = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]
    return np.asarray(np.degrees(np.abs(np.arctan2(cross, (first * second).sum(axis=1)))))


def _encirclement(outcome: NDArray[np.int8], duration: Floats, paths: Sequence[Floats]) -> Floats:
    return np.fromiter((encirclement(p).mean() for p in paths), np.float64)


def _among_captures(of: Callable[..., Floats]) -> Callable[..., Floats]:
    return lambda outcome, duration, paths: np.where(
        outcome > 0, of(outcome, duration, paths), np.nan
    )


def _within_limit(outcome: NDArray[np.int8], duration: Floats, paths: Sequence[Floats]) -> Floats:
    return ((outcome > 0) & (duration <= AGENT.dt * AGENT.time_limit + 1e-9)).astype(np.float64)


QUANTITIES = (
    Quantity("captured by predator_0", _share(1), 3),
    Quantity("captured by predator_1", _share(2), 3),
    Quantity("captured", _captured, 3),
    Quantity("captured within 14.8 s", _within_limit, 3),
    Quantity("prey left the arena", _share(TARGET_OUT), 3),
    Quantity("a predator left the arena", _share(PURSUER_OUT), 3),
    Quantity("time-out", _share(TIME_OUT, UNFINISHED), 3),
    Quantity("duration, mean [s]", _duration),
    Quantity("duration of captures, mean [s]", _among_captures(_duration)),
    Quantity("predators' path length, mean [arena unit]", _path_length),
    Quantity("... among captures", _among_captures(_path_length)),
    Quantity("distance between the predators [arena unit]", _apart),
    Quantity("distance of the farther predator from the prey [arena unit]", _farther),
    Quantity("angle between the predators, seen from the prey [deg]", _encirclement, 1),
)
PUBLISHED = {
    "captured by predator_0": ("0.424", ""),
    "captured by predator_1": ("0.248", ""),
    "captured": ("0.672", "0.814"),
}
"""Paper, "Artificial agent dataset": individual and shared reward."""


def measure(demos: Demonstrations) -> dict[str, Floats]:
    """Every quantity of every episode, ``(episodes,)`` each."""
    if demos.num_individuals != AGENT.num_individuals:
        raise InputError(f"{demos.name}: chases are compared for two predators and a prey")
    durations = np.asarray((demos.lengths - 1) * demos.dt, dtype=np.float64)
    paths: list[Floats] = np.split(demos.positions, demos.offsets[1:-1])
    return {q.name: q.of(demos.outcome, durations, paths) for q in QUANTITIES}


def _resampled(values: Floats, rng: np.random.Generator) -> tuple[float, Floats]:
    """The mean over episodes that have a value, and over each of the resamples of episodes."""
    chosen = rng.integers(len(values), size=(RESAMPLES, len(values)))
    weights = np.apply_along_axis(np.bincount, 1, chosen, minlength=len(values))
    counts = np.isfinite(values)
    with np.errstate(invalid="ignore", divide="ignore"):
        drawn = (weights @ np.where(counts, values, 0.0)) / (weights @ counts)
    return float(values[counts].mean()) if counts.any() else np.nan, drawn


def mean_interval(values: Floats, rng: np.random.Generator) -> Interval:
    """Mean over episodes with its bootstrap interval."""
    return percentile_interval(*_resampled(values, rng))


def difference_interval(first: Floats, second: Floats, rng: np.random.Generator) -> Interval:
    """Difference of the means of two independent samples of episodes, with its interval."""
    (mean, drawn), (other, other_drawn) = _resampled(first, rng), _resampled(second, rng)
    return percentile_interval(mean - other, drawn - other_drawn)


# -- tables ---------------------------------------------------------------------------------------


def statistics_table(demos: Demonstrations, local: Path | None) -> list[str]:
    """Markdown: statistic, published, local recordings, generated; individual / shared each."""
    generated = [measure(demos.select(condition=c)) for c in (0, 1)]
    load_readers(Path(__file__).parents[3] / "benchmarks" / "paper_readers.py")
    recorded = None if local is None else [read(local / file, "agents") for file in LOCAL_FILES]
    lines = [
        "| statistic (individual / shared reward) | published | local recordings | generated |",
        "|---|---|---|---|",
    ]
    own = [measure(one) for one in recorded or []]
    for q in QUANTITIES:
        published = " / ".join(value or "-" for value in PUBLISHED.get(q.name, ("", "")))
        here = " / ".join(f"{np.nanmean(one[q.name]):.{q.digits}f}" for one in own) or "-"
        made = " / ".join(f"{np.nanmean(one[q.name]):.{q.digits}f}" for one in generated)
        lines.append(f"| {q.name} | {published} | {here} | {made} |")
    totals: tuple[tuple[str, str, Callable[[Demonstrations], str]], ...] = (
        ("episodes", "250 / 250", lambda d: f"{d.num_episodes}"),
        ("longest [s]", "17.9", lambda d: f"{(d.lengths.max() - 1) * d.dt:.1f}"),
        ("total [s]", "2983.8", lambda d: f"{(d.lengths - 1).sum() * d.dt:.1f}"),
    )
    for name, published, of in totals:
        here = " / ".join(of(one) for one in recorded or []) or "-"
        made = " / ".join(of(demos.select(condition=c)) for c in (0, 1))
        lines.append(f"| {name} | {published} | {here} | {made} |")
    return lines


def condition_table(demos: Demonstrations, rng: np.random.Generator) -> list[str]:
    """Markdown: every quantity per condition, and shared minus individual, with 95 % intervals."""
    individual, shared = (measure(demos.select(condition=c)) for c in (0, 1))
    lines = [
        "| quantity | individual | shared | shared - individual | differs |",
        "|---|---|---|---|---|",
    ]
    for q in QUANTITIES:
        if q.name == "captured within 14.8 s":
            continue  # all are, here
        difference = difference_interval(shared[q.name], individual[q.name], rng)
        each = [_written(mean_interval(one[q.name], rng), q.digits) for one in (individual, shared)]
        lines.append(
            f"| {q.name} | {each[0]} | {each[1]} | {_written(difference, q.digits)} | "
            f"{'yes' if difference.excludes_zero else 'no'} |"
        )
    return lines


def _written(interval: Interval, digits: int) -> str:
    low, high = interval.low, interval.high
    return f"{interval.estimate:.{digits}f} [{low:.{digits}f}, {high:.{digits}f}]"


def cross_table(
    folder: Path, seed: int, epsilon: float, rng: np.random.Generator, episodes: int
) -> list[str]:
    """Markdown: predators of one training against the prey of another, or against untrained ones.

    The untrained networks are those that training began with.
    """
    teams = {
        name: load_weights(weights_file(folder, c))[0] for c, name in enumerate(AGENT.conditions)
    }
    untrained = make_policy(None, epsilon=0.0, seed=seed).q_net.state_dict()
    teams["untrained"] = {key: value.numpy() for key, value in untrained.items()}
    lines = [
        "| predators | prey | captured | prey left | a predator left | time-out | duration [s] |",
        "|---|---|---|---|---|---|---|",
    ]
    for hunters in teams:
        for hunted in teams:
            who = dict.fromkeys(AGENT.individuals[:-1], teams[hunters])
            weights = mixed_weights({**who, AGENT.individuals[-1]: teams[hunted]})
            policy = make_policy(weights, epsilon=epsilon, seed=seed)
            found = chase(policy, 0, episodes, seed)  # the reward condition does not move anybody
            lines.append(_cross_row(hunters, hunted, found, rng))
    return lines


def _cross_row(hunters: str, hunted: str, found: Chases, rng: np.random.Generator) -> str:
    duration = np.array([(len(path) - 1) * AGENT.dt for path in found.paths])
    shares = [
        f"{np.isin(found.outcome, codes).mean():.3f}"
        for codes in ((1, 2), (TARGET_OUT,), (PURSUER_OUT,), (TIME_OUT,))
    ]
    lasted = _written(mean_interval(duration, rng), 2)
    return f"| {hunters} | {hunted} | {' | '.join(shares)} | {lasted} |"
