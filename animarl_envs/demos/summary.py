"""Demonstrations at a glance: a table per episode, and a figure to check them by eye."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from animarl_envs.demos.cutting import distances_to_target
from animarl_envs.demos.demonstrations import PURSUER_OUT, TARGET_OUT, TIME_OUT, Demonstrations
from animarl_envs.errors import MissingExtraError
from animarl_envs.files import write_then_rename

RESTING_SHARE = 0.05  # of the 99th percentile of speed: below it an individual counts as resting
OUTCOME_NAMES = {TIME_OUT: "time-out", TARGET_OUT: "target left", PURSUER_OUT: "a pursuer left"}
SHOWN_EPISODES = 12


def outcome_name(outcome: int, demos: Demonstrations) -> str:
    """An outcome code in words."""
    if outcome > 0:
        name, role = demos.individuals[outcome - 1], demos.roles[outcome - 1]
        return f"{name} reached the source" if role == "searcher" else f"contact by {name}"
    return OUTCOME_NAMES.get(outcome, "recording ended")


def episode_table(demos: Demonstrations) -> list[dict[str, Any]]:
    """One row per episode: duration [s], path length and top speed per individual, distances."""
    rows = []
    for one in demos:
        step = np.linalg.norm(np.diff(one.positions, axis=0), axis=2)
        speed = step / one.dt
        distance = distances_to_target(one.positions, demos.roles).min(axis=1)
        row: dict[str, Any] = {
            "episode": one.index, "recording": one.recording, "split": one.split,
            "condition": one.condition, "outcome": outcome_name(one.outcome, demos),
            "duration": one.duration,
        }  # fmt: skip
        for i, name in enumerate(demos.individuals):
            row[f"path_length_{name}"] = float(step[:, i].sum())
            row[f"median_speed_{name}"] = float(np.median(speed[:, i]))
            row[f"top_speed_{name}"] = float(speed[:, i].max())
        if np.isfinite(distance).all():
            row["first_distance"] = float(distance[0])
            row["least_distance"] = float(distance.min())
        rows.append(row)
    return rows


def summarise(demos: Demonstrations) -> dict[str, Any]:
    """The whole set in numbers, by name."""
    duration = (demos.lengths - 1) * demos.dt
    speed = np.linalg.norm(demos.velocities(), axis=2)
    found: dict[str, Any] = {
        "species": demos.species,
        "individuals": {n: r for n, r in zip(demos.individuals, demos.roles, strict=True)},
        "kind": "synthetic" if demos.synthetic else "recorded",
        "licence": str(demos.provenance["licence"]),
        "source": str(demos.provenance["source"]),
        "fingerprint": demos.fingerprint(),
        "dt": demos.dt,
        "arena": f"{demos.arena.shape}, boundary {demos.arena.boundary:g}",
        "episodes": demos.num_episodes,
        "recordings": len(np.unique(demos.recording)),
        "frames": int(demos.lengths.sum()),
        "total_duration": float(duration.sum()),
        "duration": {
            "shortest": float(duration.min()), "median": float(np.median(duration)),
            "longest": float(duration.max()),
        },
        "splits": {s: int((demos.split == s).sum()) for s in ("train", "val", "test")},
        "signals": list(demos.signals),
    }  # fmt: skip
    for i, name in enumerate(demos.individuals):
        top = float(np.quantile(speed[:, i], 0.99))
        found[f"speed of {name}"] = {
            "median": float(np.median(speed[:, i])),
            "99 %": top,
            "resting": float((speed[:, i] < RESTING_SHARE * top).mean()),
        }
    for condition in np.unique(demos.condition):
        outcome = demos.outcome[demos.condition == condition]
        found[f"outcomes, condition {condition}"] = {
            outcome_name(int(code), demos): f"{np.sum(outcome == code)} "
            f"({np.mean(outcome == code):.3f})"
            for code in np.unique(outcome)[::-1]
        }
    cleaning = demos.provenance.get("cleaning")
    if isinstance(cleaning, dict):
        for key in ("untracked", "filled", "jumps", "identity_swaps", "below_confidence"):
            counts = [one[key] for one in cleaning.values() if key in one]
            if counts:
                found[f"frames: {key.replace('_', ' ')}"] = int(sum(counts))
    return found


def plot_summary(demos: Demonstrations, path: str | Path) -> Path:
    """Tracks of the first episodes, durations, path lengths, speeds and distances to the target."""
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise MissingExtraError("the summary figure", "algos") from error
    figure = Figure(figsize=(11, 7), layout="constrained")
    tracks, durations, lengths, speeds, distances, bars = figure.subplots(2, 3).ravel()
    rows = episode_table(demos)
    for i, name in enumerate(demos.individuals):
        colour = f"C{i}"
        for index in range(min(demos.num_episodes, SHOWN_EPISODES)):
            x, y = demos.episode(index).positions[:, i].T
            tracks.plot(x, y, color=colour, lw=0.6, label=name if index == 0 else None)
        speed = np.linalg.norm(demos.velocities()[:, i], axis=1)
        speeds.hist(speed, bins=_bins(speed), histtype="step", color=colour, density=True)
        lengths.hist(
            [row[f"path_length_{name}"] for row in rows], 30, histtype="step", color=colour
        )
    tracks.set(aspect="equal", title=f"First {min(len(rows), SHOWN_EPISODES)} episodes")
    tracks.legend(fontsize="small")
    durations.hist([row["duration"] for row in rows], 30, color="0.5")
    durations.set(title="Duration", xlabel="s", ylabel="episodes")
    lengths.set(title="Path length", xlabel="arena units", ylabel="episodes")
    speeds.set(title="Speed", xlabel="arena units / s", ylabel="density")
    for one in demos:
        distance = distances_to_target(one.positions, demos.roles).min(axis=1)
        if np.isfinite(distance).all():
            time = (np.arange(len(distance)) - len(distance) + 1) * one.dt
            distances.plot(time, distance, color="0.3", lw=0.4, alpha=0.5)
    distances.set(title="Distance to the target", xlabel="s before the end", ylabel="arena units")
    names, counts = np.unique([row["outcome"] for row in rows], return_counts=True)
    bars.barh(names, counts, color="0.5")
    bars.set(title="Outcomes", xlabel="episodes")
    kind = "synthetic" if demos.synthetic else "recorded"
    figure.suptitle(f"{demos.species}: {demos.num_episodes} {kind} episodes")
    path = Path(path)
    with write_then_rename(path) as part:
        figure.savefig(part)
    return path


def _bins(speed: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.linspace(0.0, max(float(np.quantile(speed, 0.995)), 1e-9), 60)
