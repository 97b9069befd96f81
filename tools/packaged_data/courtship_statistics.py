"""The packaged courtship beside what is published and recorded, as a table."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.drawing import markdown_table
from animarl_envs.focus import distances_to_target
from animarl_envs.species import get_species
from tools.packaged_data.courtship_published import SHAPES, Published
from tools.packaged_data.courtship_shapes import LEVELS, Shape, fit, measure

BINS = 20
SHOWN = (0.1, 0.3, 0.5, 0.7, 0.9)


def table(demos: Demonstrations, published: Published, data: Path | None = None) -> str:
    """Two tables in Markdown: statistics with their published values, and shapes.

    With ``data``, the recordings' quantiles are measured anew; without, those that were shipped.
    """
    steps = demos.lengths - 1
    duration = steps * demos.dt
    species = get_species(demos.species)
    farther = species.recording.start_farther_than
    starts = demos.positions[demos.offsets[:-1]]
    start = distances_to_target(starts, demos.roles).min(axis=1)
    final = distances_to_target(demos.positions[demos.offsets[1:] - 1], demos.roles).min(axis=1)
    touched = demos.outcome > 0
    rows = [
        ("episodes", f"{published.episodes}", f"{demos.num_episodes}"),
        ("shortest", f"{published.shortest:.1f} s", f"{duration.min():.1f} s"),
        ("longest", f"{published.longest:.1f} s", f"{duration.max():.1f} s"),
        ("total", f"{published.total:.1f} s", f"{duration.sum():.1f} s"),
    ]
    for i, rate in enumerate(published.touch_rates):
        rows.append(
            (f"touch rate of male_{i}", f"{rate:.3f}", f"{(demos.outcome == i + 1).mean():.3f}")
        )
    rows += [
        ("no contact", f"{1 - sum(published.touch_rates):.3f}", f"{(~touched).mean():.3f}"),
        ("distance of the nearer male at the start", f"> {farther}", f"> {_down(start.min())}"),
        ("the same at contact", f"< {species.contact_radius}", f"< {_up(final[touched].max())}"),
        ("train / val / test", _splits(published.splits),
         _splits(tuple(int((demos.split == s).sum()) for s in ("train", "val", "test")))),
    ]  # fmt: skip
    speed = np.linalg.norm(demos.velocities(), axis=2)
    for i, name in enumerate(demos.individuals):
        histogram = speed_histogram(speed[:, i])
        rank = 1 + int((histogram > histogram[0]).sum())
        rows.append((f"near-zero speed, {name}: share", "no number", f"{histogram[0]:.3f}"))
        rows.append((f"near-zero speed, {name}: rank among {BINS} bins", "dominates", f"{rank}"))
    terminal = np.array([m.terminal_speed(species.dt) for m in species.locomotion])
    faster = int((speed[demos.offsets[:-1]] > terminal).any(axis=1).sum())
    rows.append(("episodes that start faster than the terminal speed", "not known", f"{faster}"))
    text = markdown_table(("statistic", "published", "generated"), rows)
    recorded = SHAPES[demos.species] if data is None else fit(demos.species, data)
    made = measure([one.positions for one in demos], demos.dt, demos.name)
    return text + "\n\n" + _shapes(recorded, made)


def speed_histogram(speed: NDArray[np.float64]) -> NDArray[np.float64]:
    """Share of speeds in ``BINS`` equal bins up to the 99th percentile; faster ones in the last."""
    top = np.quantile(speed, 0.99)
    return np.histogram(np.minimum(speed, top), BINS, (0.0, top))[0] / len(speed)


def _shapes(recorded: Shape, made: Shape) -> str:
    rows = []
    for title, key, unit in (
        ("pause", "pause", " s"), ("move", "move", " s"), ("mean speed of a move", "speed", ""),
    ):  # fmt: skip
        for level in SHOWN:
            k = LEVELS.index(level)
            values = [getattr(shape, key)[k] for shape in (recorded, made)]
            digits = 1 if unit else 2
            rows.append((f"{title}, {level:.0%}", *(f"{v:.{digits}f}{unit}" for v in values)))
    rows.append(("99 % of all speeds [arena unit / s]", f"{recorded.top:.3f}", f"{made.top:.3f}"))
    rows.append(("turning [rad / s^(1/2)]", f"{recorded.turning:.2f}", f"{made.turning:.2f}"))
    source = recorded.source.split("/")[0]
    return markdown_table(("quantile", f"recorded ({source})", "generated"), rows)


def _splits(counts: tuple[int, ...]) -> str:
    return " / ".join(map(str, counts))


def _down(value: float) -> str:
    return f"{np.floor(value * 1000) / 1000:.3f}"


def _up(value: float) -> str:
    return f"{np.ceil(value * 1000) / 1000:.3f}"
