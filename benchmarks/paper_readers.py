"""Published recordings and agents that this project was tried on, each in its own layout.

    animarl import case1.csv --readers benchmarks/paper_readers.py --source mothvr --out moth.npz

``docs/data/readers.md`` says where they come from and how silkmoth runs end. Of these the final
recorded frame is kept as the last sample, and an antenna is hit in a step if it is hit in any of
its frames. Termites and flies are an ``.npz`` of int16 arrays, one per recording. Agents are
``pos`` float32 ``(sum(n_steps + 1), individuals, 2)``, predators first, prey last; ``actions`` int8
``(sum(n_steps), individuals)``, numbered as in :mod:`animarl_envs.locomotion`; ``n_steps`` and
``outcome`` per episode (codes of :class:`Demonstrations`); ``meta``, JSON with ``dt`` and ``cond``.
"""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from animarl_envs.arena import Arena
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.episode import TIME_OUT, UNFINISHED
from animarl_envs.demos.splits import assign_splits
from animarl_envs.errors import InputError, require
from animarl_envs.files import npz_members, read_npz
from animarl_envs.importing.readers.authors import MOTH_DEFAULTS
from animarl_envs.importing.readers.registry import numbers, register_track_reader
from animarl_envs.importing.tables import plain_table, read_rows
from animarl_envs.importing.tracks import Tracks
from animarl_envs.locomotion import NUM_ACTIONS

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

HALF_SIDE = 1.0  # leaving [-1, 1]^2 ends an episode
SPLIT_SEED = 20240
CONDITIONS = {"indiv": 0, "share": 1}  # by the end of meta["cond"]
AGENTS = {"pos.npy", "actions.npy", "n_steps.npy", "outcome.npy", "meta.npy"}


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
    found = []
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
        found.append(
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
    if not found:
        raise InputError(f"{path}: no recording of kind {kind!r}: choose Cf or Rs")
    return found


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
    found = []
    for key, array in read_npz(path).items():
        if not key.endswith("__xy"):
            continue
        positions = numbers(path, key, array, "frames", "flies", 2) / FLY_STEPS
        found.append(
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
    return found


@register_track_reader(
    "agents",
    "artificial predators and prey, episodes_*.npz of collaborative hunting",
    sniff=lambda path: npz_members(path) >= AGENTS,
    extensions=(".npz",),
    finished=True,
)
def read_agents(path: Path) -> Demonstrations:
    """Read one file of episodes; individuals ``predator_0 ... prey``, condition from the file.

    Episodes start at rest. Four fifths are for training, a tenth each for validation and test.
    """
    arrays = read_npz(path)
    if missing := sorted(AGENTS - {f"{name}.npy" for name in arrays}):
        raise InputError(f"{path}: it lacks {missing[0]}: it is no episodes file of the agents")
    meta = _meta(path, arrays["meta"])
    steps = numbers(path, "n_steps", arrays["n_steps"], "episodes").astype(np.int64)
    count, num = len(steps), arrays["pos"].shape[1] if arrays["pos"].ndim > 1 else 0
    empty = [*np.flatnonzero(steps < 1), *[0] * (count == 0)]
    require(not empty, f"{path}: episode {[*empty, 0][0]} has no step: leave empty episodes out")
    require(num > 1, f"{path}: pos is not of two individuals or more: give predators and a prey")
    pos = numbers(path, "pos", arrays["pos"], int(steps.sum()) + count, num, 2)
    actions = numbers(path, "actions", arrays["actions"], int(steps.sum()), num)
    outcome = numbers(path, "outcome", arrays["outcome"], count).astype(np.int8)
    if ((actions < 0) | (actions >= NUM_ACTIONS)).any():
        raise InputError(f"{path}: an action lies outside 0 to {NUM_ACTIONS - 1}: check actions")
    signal = np.full((len(pos), num), -1, dtype=np.int8)
    acting = np.ones(len(pos), dtype=bool)
    acting[np.cumsum(steps + 1) - 1] = False
    signal[acting] = actions
    recording = np.array([f"{path.stem}/{i:04d}" for i in range(count)])
    return Demonstrations(
        species="agent",
        individuals=(*(f"predator_{i}" for i in range(num - 1)), "prey"),
        roles=("pursuer",) * (num - 1) + ("target",),
        dt=float(meta["dt"]),
        arena=Arena("square", size=HALF_SIDE, boundary=HALF_SIDE),
        positions=pos,
        lengths=steps + 1,
        initial_velocity=np.zeros((count, num, 2)),
        condition=np.full(count, meta["condition"]),
        outcome=outcome,
        split=assign_splits(recording, SPLIT_SEED),
        recording=recording,
        signals={"actions": signal},
        provenance={
            "source": "rolled out from the networks of TsutsuiKazushi/collaborative-hunting",
            "file": path.name,
            "licence": "MIT",
            "citation": "Tsutsui K, Tanaka R, Takeda K, Fujii K (2024) Collaborative hunting in "
            "artificial agents with deep reinforcement learning. eLife.",
            "synthetic": True,
            "kind": "artificial agents",
            "meta": meta,
        },
        name=str(path),
    )


def _meta(path: Path, raw: NDArray[Any]) -> dict[str, Any]:
    try:
        meta = dict(json.loads(str(raw)))
        meta["dt"] = float(meta["dt"])
        meta["condition"] = CONDITIONS[str(meta["cond"]).rsplit("_", 1)[-1]]
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(
            f"{path}: meta is not the JSON of an episodes file ({type(error).__name__}: {error}): "
            "it must give dt and cond, ending in _indiv or _share"
        ) from None
    return meta
