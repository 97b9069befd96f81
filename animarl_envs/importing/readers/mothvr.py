"""Silkmoth runs of the MothVR set-up: ``case*.csv`` with Time [s], X, Y [mm], Theta, Odor, Wind.

30 frames a second, source at the origin, start at (300, 0) mm, one run per file. The set-up stopped
a run at 50 mm from the source or after 300 s; seven of the 24 public runs end 0.04 to 0.23 mm
outside the 50, so a run that ends within one frame's walk of it counts as having reached the
source. Decisions are taken at 2 Hz; the final recorded frame is kept as the last sample. An antenna
is hit in a step if it is hit in any of its frames.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from animarl_envs.demos.episode import TIME_OUT, UNFINISHED
from animarl_envs.errors import InputError
from animarl_envs.importing.readers.registry import register_track_reader
from animarl_envs.importing.readers.tables import plain_table
from animarl_envs.importing.tracks import Tracks

HEADER = ("Time", "X", "Y", "Theta", "Odor", "Wind")
ODOUR = {"N": (0, 0), "R": (0, 1), "L": (1, 0), "B": (1, 1)}  # left, right antenna
WIND = {"F": 0, "R": 1, "L": 2, "B": 3}  # the side the air comes from
FRAME_RATE = 30.0  # [Hz]
GOAL_RADIUS = 50.0  # [mm]
FRAME_WALK = 1.2  # one frame at the moths' top speed of 36 mm/s [mm]
TIME_LIMIT = 300.0  # [s]

DEFAULTS = {
    "species": "silkmoth",
    "searcher": True,
    "decision_rate": 2.0,
    "keep_last_frame": True,
    "cutting": {"piece": math.inf},
    "scaling": {"shape": "open", "units_per_arena_unit": 1000.0},
    "splitting": {"by": "recording", "fractions": (0.6, 0.2, 0.2), "seed": 0},
}


@register_track_reader(
    "mothvr",
    "silkmoth runs of the MothVR set-up (case*.csv)",
    sniff=lambda path: plain_table(path).names == HEADER,
    extensions=(".csv",),
    defaults=DEFAULTS,
)
def read_mothvr(path: Path) -> list[Tracks]:
    """One run.

    Signals: odour_left, odour_right; heading [rad, arena frame]; wind, the side the air comes from
    (0 front, 1 right, 2 left, 3 back).
    """
    table = plain_table(path)
    number, word = table.columns(("Time", "X", "Y", "Theta"), ("Odor", "Wind"))
    time = number["Time"]
    uneven = ~(np.abs(np.diff(time) - 1 / FRAME_RATE) <= 1e-3)
    if len(time) < 2 or uneven.any():
        row = int(uneven.argmax()) + 1 if len(time) > 1 else 0
        raise InputError(
            f"{path}: {table.place(row)}: Time does not run at "
            f"{FRAME_RATE:g} frames a second: check it"
        )
    for column, codes in (("Odor", ODOUR), ("Wind", WIND)):
        unknown = sorted(set(word[column].entries) - set(codes))
        if unknown:
            raise InputError(
                f"{path}: column {column} holds {unknown[0]!r}: use one of {', '.join(codes)}"
            )
    odour = np.array([ODOUR[entry] for entry in word["Odor"].entries], dtype=bool)
    odour = odour[word["Odor"].number]
    wind = np.array([WIND[entry] for entry in word["Wind"].entries], dtype=np.int8)
    signals = {
        "odour_left": odour[:, 0],
        "odour_right": odour[:, 1],
        "heading": number["Theta"],
        "wind": wind[word["Wind"].number],
    }
    for name in ("X", "Y", "Theta"):
        bad = ~np.isfinite(number[name])
        if bad.any():
            raise InputError(
                f"{path}: {table.place(int(bad.argmax()))}, column {name} is not a number: "
                "correct it"
            )
    positions = np.column_stack([number["X"], number["Y"]])
    outcome = UNFINISHED
    if np.hypot(*positions[-1]) <= GOAL_RADIUS + FRAME_WALK:
        outcome = 1
    elif len(positions) / FRAME_RATE >= TIME_LIMIT:
        outcome = TIME_OUT
    return [
        Tracks(
            recording=path.stem,
            individuals=("moth",),
            positions=positions[:, None, None],
            frame_rate=FRAME_RATE,
            unit="mm",
            signals=signals,
            events=("odour_left", "odour_right"),
            outcome=outcome,
            provenance={
                "source": "nhat-14/CPT-IRL, MothVR",
                "citation": "Yamada M et al. (2021) eLife 10:e72001",
                "licence": "none stated: ask before redistributing",
            },
        )
    ]
