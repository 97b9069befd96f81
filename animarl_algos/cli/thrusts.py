"""``animarl fit --thrusts``: how closely so many thrust magnitudes can follow recorded episodes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.table import Table
from rich.text import Text

from animarl_algos.cli.reading import write_csv
from animarl_algos.evaluation.thrust_choice import tracking_floor
from animarl_envs.demos import Demonstrations
from animarl_envs.errors import InputError
from animarl_envs.fitting import LocomotionFit, track
from animarl_envs.fitting.custom_species import arena_of
from animarl_envs.fitting.joint import FAST
from animarl_envs.fitting.tracking import speed_distances, tracking_errors
from animarl_envs.locomotion import MOST_THRUSTS


@dataclass(frozen=True)
class ThrustRow:
    """One individual under one number of magnitudes; a further column is a further field."""

    thrusts: int
    individual: str
    damping: float
    thrust: float  # [arena unit / s^2]
    magnitudes: tuple[float, ...]  # multiples of the thrust
    tracking_error: float  # median over steps [arena unit]
    speed_distance: float  # Wasserstein distance over the mean recorded speed
    terminal_speed: float  # [arena unit / s]
    fast_speed: float  # 99 % quantile of the recorded speed [arena unit / s]
    floor: float  # a classifier's AUC of tracked against recorded, all individuals; NaN: too few


def parse_thrusts(given: str) -> tuple[int, ...]:
    """Return the numbers of magnitudes in ``1,2,3``, each once, in order.

    Raises
    ------
    InputError
        If one is no whole number from 1 to 10.
    """
    texts = [text.strip() for text in given.split(",")]
    if not all(text.isdecimal() and 1 <= int(text) <= MOST_THRUSTS for text in texts):
        raise InputError(
            f"--thrusts is {given!r}: give whole numbers of thrust magnitudes from 1 to "
            f"{MOST_THRUSTS}, such as 1,2,3"
        )
    return tuple(sorted({int(text) for text in texts}))


def thrust_rows(
    fits: Sequence[LocomotionFit], seen: Demonstrations, *, seed: int = 0
) -> list[ThrustRow]:
    """What each fit makes of the episodes ``seen``, followed in closed loop.

    ``seed`` is that of the classifier's folds.
    """
    steps = np.delete(np.arange(len(seen.positions)), seen.offsets[:-1])
    speed = np.linalg.norm(seen.velocities()[steps], axis=2)
    fast = np.quantile(speed, FAST, axis=0)
    rows = []
    for fit in fits:
        tracking = track(seen, fit.locomotion, arena_of(seen))
        errors, speeds = tracking_errors(seen, tracking), speed_distances(seen, tracking)
        floor = tracking_floor(seen, fit.locomotion, seed=seed).estimate
        for i, one in enumerate(fit.individuals):
            rows.append(
                ThrustRow(
                    len(one.magnitudes), one.name, one.damping, one.thrust, one.magnitudes,
                    float(errors[i]), float(speeds[i]), one.terminal_speed, float(fast[i]),
                    floor,
                )
            )  # fmt: skip
    return rows


def format_thrust_table(rows: Sequence[ThrustRow], seen: Demonstrations, which: str) -> Table:
    """A line per number of magnitudes and individual."""
    kind = "synthetic" if seen.synthetic else "recorded"
    caption = (
        f"{len(seen)} {kind} episodes ({which}) followed in closed loop. Tracking error: median "
        "distance over steps. Speed distance: Wasserstein distance of tracked and recorded speeds "
        "over the mean recorded speed. Floor: how often a classifier ranks tracked motion above "
        "recorded motion (0.5: cannot tell them apart). Lengths in arena units."
    )
    table = Table(
        title=f"Thrust magnitudes of {seen.species}", caption=caption, box=SIMPLE_HEAD,
        padding=(0, 1),
    )  # fmt: skip
    table.add_column("thrusts", justify="right")
    table.add_column("individual", no_wrap=True)
    for heading in (
        "d", "u", "multiples of u", "tracking\nerror", "speed\ndistance", "terminal\nspeed",
        "99 %\nspeed", "floor\n(AUC)",
    ):  # fmt: skip
        table.add_column(heading, justify="right")
    for row in rows:
        table.add_row(
            str(row.thrusts), Text(row.individual), f"{row.damping:.4f}", f"{row.thrust:.3g}",
            " ".join(f"{m:.2f}" for m in row.magnitudes),
            f"{row.tracking_error:.2g}", f"{row.speed_distance:.1%}",
            f"{row.terminal_speed:.3g}", f"{row.fast_speed:.3g}",
            f"{row.floor:.2f}" if math.isfinite(row.floor) else "-",
        )  # fmt: skip
    return table


def save_thrust_rows(rows: Sequence[ThrustRow], out: Path) -> None:
    """Write all rows as ``.csv``."""
    write_csv(out, [asdict(r) | {"magnitudes": " ".join(map(str, r.magnitudes))} for r in rows])
