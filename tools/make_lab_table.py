"""Make ``examples/data/lab_table.csv``: synthetic chases in pixels, as a tracker would export them.

Usage: python -m tools.make_lab_table

No animal was recorded: a pursuer and a target, accelerating along scripted directions with damping,
are stepped at 10 Hz in a field of 1000 by 1000 pixels until contact. The file is called synthetic
in its recordings' names. Seeded: the same bytes each time.
"""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from animarl_envs.files import write_then_rename

OUT = Path(__file__).resolve().parents[1] / "examples" / "data" / "lab_table.csv"
CHASES, LONGEST, RATE = 60, 120, 10.0  # episodes, frames, Hz
PIXELS = 500.0  # to an arena unit, whose origin is the middle of the field
CONTACT = 0.1  # [arena unit]
THRUST = np.array([3.0, 1.8])  # of pursuer and target [arena unit/s^2]
DAMPING, NOISE = 1.5, 0.4  # [1/s], [rad]
SEED = 14


def chase(rng: np.random.Generator) -> NDArray[np.float64]:
    """Positions ``(frames, 2, 2)`` [arena unit] of pursuer and target until contact."""
    angle = rng.uniform(0, 2 * np.pi)
    place = np.stack([-0.6 * np.array([np.cos(angle), np.sin(angle)]), rng.uniform(-0.3, 0.3, 2)])
    speed, path = np.zeros((2, 2)), [place]
    while len(path) < LONGEST and np.linalg.norm(place[0] - place[1]) > CONTACT:
        apart = place[1] - place[0]
        away = apart / np.linalg.norm(apart) - 1.5 * place[1]  # from the pursuer, off the walls
        for who, goal in enumerate((apart, away)):
            turn = np.arctan2(goal[1], goal[0]) + rng.normal(0, NOISE)
            push = THRUST[who] * np.array([np.cos(turn), np.sin(turn)])
            speed[who] += (push - DAMPING * speed[who]) / RATE
        place = np.clip(place + speed / RATE, -1, 1)
        path.append(place)
    return np.stack(path)


def write(out: Path = OUT, chases: int = CHASES) -> Path:
    """Write the table: recording, time [s], individual, x and y [px]."""
    rng = np.random.default_rng(SEED)
    with write_then_rename(out) as part, part.open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["recording", "time", "individual", "x", "y"])
        for number in range(chases):
            for frame, bodies in enumerate((chase(rng) + 1) * PIXELS):
                for who, (x, y) in zip(("chaser", "bait"), bodies, strict=True):
                    place = (f"{x:.1f}", f"{y:.1f}")
                    writer.writerow([f"synthetic_{number:02d}", f"{frame / RATE:.1f}", who, *place])
    return out


if __name__ == "__main__":
    print(f"wrote {write()}")
