"""Published recordings of living animals, each in its own layout.

Of silkmoth runs the final recorded frame is kept as the last sample, and an antenna is hit in a
step if it is hit in any of its frames. Termites and flies are an ``.npz`` of int16 arrays, one per
recording. ``docs/data/readers.md`` says where they come from and how silkmoth runs end.
"""

import math
from pathlib import Path

import numpy as np

from animarl_envs.demos.episode import TIME_OUT, UNFINISHED
from animarl_envs.errors import InputError, require
from animarl_envs.files import npz_members, read_npz
from animarl_envs.importing.readers.arrays import matlab_variables
from animarl_envs.importing.readers.authors import MOTH_DEFAULTS
from animarl_envs.importing.readers.matlab_structs import variable_names
from animarl_envs.importing.readers.registry import numbers, register_track_reader
from animarl_envs.importing.tables import plain_table, read_rows
from animarl_envs.importing.tracks import Tracks

HEADER = ("Time", "X", "Y", "Theta", "Odor", "Wind")
ODOUR = {"N": (0, 0), "R": (0, 1), "L": (1, 0), "B": (1, 1)}  # left, right antenna
WIND = {"F": 0, "R": 1, "L": 2, "B": 3}  # the side the air comes from
FRAME_RATE = 30.0  # [Hz]
GOAL_RADIUS = 50.0  # [mm]
FRAME_WALK = 1.2  # one frame at the moths' top speed of 36 mm/s [mm]
TIME_LIMIT = 300.0  # [s]

TERMITE_STEPS = 50.0  # stored as (pixel - offset) * 50
FLY_STEPS = 100.0  # stored as position * 100
FLY_ARENA = 120.0  # diameter of the arena [unit of the file]
BAT_RATE = 60.0  # [Hz]
BATS = "batsS"  # rows of frame, bat, x, y, z
MOST_BAT_FRAMES = 1_000_000  # of a film of hours


@register_track_reader(
    "mothvr",
    "silkmoth runs of the MothVR set-up (case*.csv)",
    sniff=lambda path: plain_table(path).names == HEADER,
    extensions=(".csv",),
    defaults=MOTH_DEFAULTS
    | {"splitting": {"by": "recording", "fractions": (0.6, 0.2, 0.2), "seed": 0}},
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
        for entry in word[column].entries:
            known = ", ".join(codes)
            require(entry in codes, f"{path}: column {column} holds {entry!r}: use one of {known}")
    for name in ("X", "Y", "Theta"):
        bad = ~np.isfinite(number[name])
        if bad.any():
            raise InputError(
                f"{path}: {table.place(int(bad.argmax()))}, column {name} is not a number: "
                "correct it"
            )
    odour = np.array([ODOUR[entry] for entry in word["Odor"].entries], dtype=bool)
    wind = np.array([WIND[entry] for entry in word["Wind"].entries], dtype=np.int8)
    left, right = odour[word["Odor"].number].T
    positions = np.column_stack([number["X"], number["Y"]])
    outcome = TIME_OUT if len(positions) / FRAME_RATE >= TIME_LIMIT else UNFINISHED
    if np.hypot(*positions[-1]) <= GOAL_RADIUS + FRAME_WALK:
        outcome = 1
    return [
        Tracks(
            recording=path.stem,
            individuals=("moth",),
            positions=positions[:, None, None],
            frame_rate=FRAME_RATE,
            unit="mm",
            signals={
                "odour_left": left,
                "odour_right": right,
                "heading": number["Theta"],
                "wind": wind[word["Wind"].number],
            },
            events=("odour_left", "odour_right"),
            outcome=outcome,
            provenance={
                "source": "nhat-14/CPT-IRL, MothVR",
                "citation": "Yamada M et al. (2021) eLife 10:e72001",
                "licence": "none stated: ask before redistributing",
            },
        )
    ]


@register_track_reader(
    "termites",
    "termite tandem pairs (tracks_30fps_int16.npz with index.csv)",
    sniff=lambda path: path.name == "tracks_30fps_int16.npz",
    extensions=(".npz",),
    defaults={
        "target": "female",
        "decision_rate": 10.0,
        "licence": "MIT",
        "cleaning": {"smoothing_cutoff": 2.0},
        "scaling": {"shape": "disc", "each": True},  # dishes filmed one by one
    },
)
def read_termites(path: Path, kind: str | None = None) -> list[Tracks]:
    """Male and female in mm; ``kind`` ``"Cf"`` or ``"Rs"`` takes one species."""
    rows, _ = read_rows(path.parent / "index.csv", {"key"})
    index = {row["key"]: row for _, row in rows}
    tracks = []
    for key, array in read_npz(path).items():
        if kind and not key.startswith(kind):
            continue
        require(key in index, f"{path}: {key} has no row in index.csv: add it")
        try:
            mm = float(index[key]["mm_per_px_est"])
        except (KeyError, ValueError):
            mm = math.nan
        if not 0 < mm < math.inf:
            raise InputError(f"{path.parent / 'index.csv'}: {key} has no scale: correct it")
        pixels = numbers(path, key, array, "frames", 4) / TERMITE_STEPS
        female, male = pixels[:, :2] * mm, pixels[:, 2:] * mm
        tracks.append(
            Tracks(
                recording=key, individuals=("male", "female"),
                positions=np.stack([male, female], axis=1)[:, :, None], frame_rate=30.0,
                unit="mm", y_down=True,
                provenance={
                    "source": "nobuaki-mzmt/SexMovementAfterSeparation",
                    "citation": "Mizumoto N, Dobata S (2019) Science Advances 5(6):eaau6108",
                },
            )
        )  # fmt: skip
    if not tracks:
        raise InputError(f"{path}: no recording of kind {kind!r}: choose Cf or Rs")
    return tracks


@register_track_reader(
    "fly-groups",
    "groups of fruit flies in a round arena (tracks_24fps_int16.npz with index.csv)",
    sniff=lambda path: any(name.endswith("__xy.npy") for name in npz_members(path)),
    extensions=(".npz",),
    defaults={
        "target": "auto",
        "decision_rate": 12.0,
        "licence": "none stated: ask before redistributing",
        "cleaning": {"smoothing_cutoff": 2.0},
        "scaling": {
            "shape": "disc", "width": FLY_ARENA, "centre": (FLY_ARENA / 2, FLY_ARENA / 2),
            "boundary": 1.3,
        },
    },
)  # fmt: skip
def read_fly_groups(path: Path) -> list[Tracks]:
    """All flies of each recording; the arena is 120 units wide."""
    tracks = []
    for key, array in read_npz(path).items():
        if not key.endswith("__xy"):
            continue
        positions = numbers(path, key, array, "frames", "flies", 2) / FLY_STEPS
        tracks.append(
            Tracks(
                recording=key.removesuffix("__xy"),
                individuals=tuple(f"fly_{i + 1}" for i in range(positions.shape[1])),
                positions=positions[:, :, None], frame_rate=24.0,
                unit="1/120 of the arena", y_down=True,
                provenance={
                    "source": "milanXpetrovic/drosophila-social-interaction-criteria",
                    "citation": "Schneider J, Levine JD (2014) Biol Lett 10:20140749 (method)",
                },
            )
        )  # fmt: skip
    return tracks


@register_track_reader(
    "gray-bats",
    "flights of gray bats (.mat with batsS: frame, bat, x, y, z), seen from above",
    sniff=lambda path: BATS in variable_names(path),
    extensions=(".mat",),
    defaults={"decision_rate": 20.0, "scaling": {"shape": "open"}},
)
def read_gray_bats(path: Path) -> list[Tracks]:
    """Bats in m, each a recording of its own, whose name says how it flew; others are left out."""
    table = numbers(path, BATS, matlab_variables(path)[BATS], "rows", 5)
    bad = ~(np.isfinite(table[:, :2]).all(axis=1) & (np.abs(table[:, 0]) < MOST_BAT_FRAMES))
    require(
        not bad.any(), f"{path}: row {bad.argmax() + 1} of {BATS} has no frame or bat: correct it"
    )
    how = f"{'alone' if 'singletons' in path.stem else 'company'}_"
    how += "obstacles" if "obsref" in path.stem else "free"
    tracks = []
    for bat in np.unique(table[:, 1]):
        own = table[table[:, 1] == bat]
        frame = (own[:, 0] - own[:, 0].min()).astype(int)
        positions = np.full((frame.max() + 1, 1, 1, 2), np.nan)
        positions[frame, 0, 0] = own[:, 2:4]
        tracks.append(
            Tracks(
                recording=f"{how}_{bat:g}", individuals=("bat",), positions=positions,
                frame_rate=BAT_RATE, unit="m",
            )
        )  # fmt: skip
    return tracks
