"""Files of finished episodes (this project's, Minari's, agents'), and published collections.

``docs/data/readers.md`` says where they come from and how silkmoth runs end. Of these the final
recorded frame is kept as the last sample, and an antenna is hit in a step if it is hit in any of
its frames. Termites and flies are an ``.npz`` of int16 arrays, one per recording. Agents are
``pos`` float32 ``(sum(n_steps + 1), individuals, 2)``, predators first, prey last; ``actions`` int8
``(sum(n_steps), individuals)``, numbered as in :mod:`animarl_envs.locomotion`; ``n_steps`` and
``outcome`` per episode (codes of :class:`Demonstrations`); ``meta``, JSON with ``dt`` and ``cond``.

The layouts in which the authors of the paper publish theirs are below, ``authors-...``.
"""

import json
import math
import os
import re
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from animarl_envs.arena import Arena
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.episode import TIME_OUT, UNFINISHED
from animarl_envs.demos.splits import assign_splits
from animarl_envs.errors import InputError, require
from animarl_envs.files import npz_members, read_npz, refuse_unfinished
from animarl_envs.importing.minari_io import DATA_FILE, import_minari
from animarl_envs.importing.readers.arrays import load_plain
from animarl_envs.importing.readers.registry import Floats, numbers, register_track_reader
from animarl_envs.importing.tables import plain_table, read_rows
from animarl_envs.importing.tracks import Tracks
from animarl_envs.locomotion import NUM_ACTIONS
from animarl_envs.species import AGENT, FLY, NEWT, SILKMOTH, Species

HEADER = ("Time", "X", "Y", "Theta", "Odor", "Wind")
ODOUR = {"N": (0, 0), "R": (0, 1), "L": (1, 0), "B": (1, 1)}  # left, right antenna
WIND = {"F": 0, "R": 1, "L": 2, "B": 3}  # the side the air comes from
FRAME_RATE = 30.0  # [Hz]
GOAL_RADIUS = 50.0  # [mm]
FRAME_WALK = 1.2  # one frame at the moths' top speed of 36 mm/s [mm]
TIME_LIMIT = 300.0  # [s]
MOTH_DEFAULTS = {
    "species": "silkmoth",
    "searcher": True,
    "decision_rate": 2.0,
    "keep_last_frame": True,
    "cutting": {"piece": math.inf},
    "scaling": {"shape": "open", "units_per_arena_unit": 1000.0},
}

TERMITE_STEPS = 50.0  # stored as (pixel - offset) * 50
FLY_STEPS = 100.0  # stored as position * 100
FLY_ARENA = 120.0  # diameter of the arena [unit of the file]

HALF_SIDE = 1.0  # leaving [-1, 1]^2 ends an episode
SPLIT_SEED = 20240
CONDITIONS = {"indiv": 0, "share": 1}  # by the end of meta["cond"]
AGENTS = {"pos.npy", "actions.npy", "n_steps.npy", "outcome.npy", "meta.npy"}
OWN = {"positions.npy", "lengths.npy", "initial_velocity.npy", "meta.npy"}


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
    "animarl",
    "demonstrations of this project (.npz)",
    sniff=lambda path: npz_members(path) >= OWN,
    extensions=(".npz",),
    finished=True,
)
def read_native(path: Path) -> Demonstrations:
    """Read a file written by :meth:`Demonstrations.save`."""
    return Demonstrations.load(path)


@register_track_reader(
    "minari",
    "a Minari dataset written by 'animarl data convert' (its folder, or the file in it)",
    sniff=lambda path: path.name == DATA_FILE or (path / "data" / DATA_FILE).is_file(),
    extensions=(".hdf5", ""),  # a folder has no suffix
    finished=True,
)
def read_minari(path: Path) -> Demonstrations:
    """Read the dataset back, exactly as it was exported."""
    return import_minari(path.parent.parent if path.name == DATA_FILE else path)


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


PAPER = {
    "source": "Fujii et al., Data-driven simulator of multi-animal behavior",
    "licence": "as published by its authors",
}
FEWEST_AGENT_FRAMES = 3
FEWEST_FLY_FRAMES = 5  # more than three velocity samples
FEWEST_NEWT_FRAMES = 45
NEWT_STEPS = 500  # of the decision rate, kept from the end
NEWT_JUMP = 3.0  # speed beyond which a position is wrong [arena unit / s]
NEWT_JUMP_FRAMES = 100  # a jump this early is cut off, a later one drops the episode
NEWT_COLUMNS = (0, 2, 4)  # positions of male 1, male 2, female
MOTH_SECONDS = 300.0


def _chase_defaults(species: Species) -> dict[str, Any]:
    return {
        "species": species.name,
        "target": species.individuals[-1],
        "synthetic": species is AGENT,
        "cutting": {"piece": math.inf},
        "decision_rate": 1.0 / species.dt,
        "cleaning": {"smoothing_cutoff": species.recording.smoothing_cutoff},
        "scaling": {
            "shape": species.arena.shape, "width": 2.0, "centre": (0.0, 0.0),
            "boundary": species.arena.boundary,
        },
    }  # fmt: skip


def _nested(value: Any) -> list[Any]:
    """A list, or the list of a squeezed object array."""
    if isinstance(value, np.ndarray):
        value = np.squeeze(value)
        return _nested(value.item()) if value.ndim == 0 and value.dtype.hasobject else list(value)
    if not isinstance(value, (list, tuple)):
        raise TypeError(f"{type(value).__name__} in place of a list")
    return list(value)


def _tracks(path: Path, number: int, paths: list[Any], species: Species, **more: Any) -> Tracks:
    """One episode; a path holds x and y per frame, and whatever else."""
    found: list[Floats] = []
    for value in paths:
        array = np.asarray(value, dtype=np.float64)
        array = array.reshape(len(array), -1)
        require(array.shape[1] > 1, f"{path}: episode {number} has no x and y per frame: check it")
        found.append(array[:, :2])
    lengths = sorted({len(one) for one in found})
    require(
        len(lengths) == 1,
        f"{path}: episode {number} has {lengths} frames for its individuals: give each as many",
    )
    return Tracks(
        recording=f"{path.stem}/{number:04d}",
        individuals=species.individuals,
        positions=np.stack(found, axis=1)[:, :, None],
        frame_rate=species.recording.frame_rate,
        unit="arena unit",
        provenance=PAPER,
        **more,
    )


@register_track_reader(
    "authors-agents",
    "the paper's agents (pos_val_rep_2on1_{indiv,share}_equal_K_*.npz)",
    sniff=lambda path: npz_members(path) == {"pos.npy"} and path.name.startswith("pos_val_rep"),
    extensions=(".npz",),
    defaults=_chase_defaults(AGENT)
    | {"cutting": {"piece": math.inf, "contact": AGENT.contact_radius}},
)
def read_authors_agents(path: Path) -> list[Tracks]:
    """Key ``pos``: (episodes, 3 individuals: prey, predators) of lists of (x, y) at 10 Hz."""
    condition = 1 if "share" in path.name else 0
    found = []
    for number, episode in enumerate(_nested(read_npz(path, load_plain)["pos"])):
        prey, *predators = _nested(episode)
        if len(prey) >= FEWEST_AGENT_FRAMES:
            found.append(_tracks(path, number, [*predators, prey], AGENT, condition=condition))
    return found


@register_track_reader(
    "authors-fly",
    "the paper's flies (fly/data.npz)",
    sniff=lambda path: npz_members(path) == {"states.npy", "actions.npy", "rewards.npy"},
    extensions=(".npz",),
    defaults=_chase_defaults(FLY),
)
def read_authors_fly(path: Path) -> list[Tracks]:
    """Key ``states``: [individual][episode] of (frames, 1, >= 2) at 30 Hz; ``rewards`` likewise."""
    objects = read_npz(path, load_plain)
    states, rewards = ([*map(_nested, _nested(objects[key]))] for key in ("states", "rewards"))
    require(
        len(states) == 3 and len({len(one) for one in states}) == 1,
        f"{path}: states are of {len(states)} individuals, not 3: check the file",
    )
    found = []
    for number, paths in enumerate(zip(*states, strict=True)):
        if len(paths[0]) >= FEWEST_FLY_FRAMES:
            ends = [np.asarray(own[number], np.float64).ravel()[-1] > 0 for own in rewards[:2]]
            outcome = ends.index(True) + 1 if any(ends) else UNFINISHED
            found.append(_tracks(path, number, [*paths], FLY, outcome=outcome))
    return found


@register_track_reader(
    "authors-newt",
    "the paper's newts (newt/state_m1_data*.npz beside reward_*_data*.npz)",
    sniff=lambda path: re.fullmatch(r"state_m1_data\d+\.npz", path.name) is not None,
    extensions=(".npz",),
    defaults=_chase_defaults(NEWT),
)
def read_authors_newt(path: Path) -> list[Tracks]:
    """One array per episode, (frames, >= 5, >= 2), positions at columns 0, 2, 4; 30 Hz."""
    number_of_file = path.stem.removeprefix("state_m1_data")
    rewards = []
    for male in ("m1", "m2"):
        beside = path.with_name(f"reward_{male}_data{number_of_file}.npz")
        rewards.append(read_npz(beside, load_plain) if beside.exists() else {})
    rate = NEWT.recording.frame_rate
    kept = round(NEWT_STEPS * NEWT.dt * rate) + 1
    found = []
    for number, (key, value) in enumerate(read_npz(path, load_plain).items()):
        array = numbers(path, key, np.asarray(value, np.float64), "frames", "columns", "x, y, ...")
        array = array[:, NEWT_COLUMNS, :2]
        speed = np.linalg.norm(np.diff(array, axis=0), axis=2).max(axis=1) * rate
        for jump in np.flatnonzero(speed > NEWT_JUMP)[-1:]:
            array = array[jump + 1 :] if jump < NEWT_JUMP_FRAMES else array[:0]
        if len(array) >= FEWEST_NEWT_FRAMES:
            ends = [np.asarray(r[key]).ravel()[-1] if key in r else 0.0 for r in rewards]
            outcome = ends.index(max(ends)) + 1 if max(ends) > 0 else UNFINISHED
            paths = [array[-kept:, i] for i in range(3)]
            found.append(_tracks(path, number, paths, NEWT, outcome=outcome))
    return found


@register_track_reader(
    "authors-silkmoth",
    "the paper's silkmoths ({AllStim,Odoronly}/Movie*/trial*_mod.csv)",
    sniff=lambda path: re.fullmatch(r"trial\d+_mod\.csv", path.name) is not None,
    extensions=(".csv",),
    defaults={
        **MOTH_DEFAULTS,
        "decision_rate": 1.0 / SILKMOTH.dt,
        "splitting": {"by": "group", "pattern": r"(Movie\d+)", "fractions": (0.6, 0.2, 0.2)},
    },
)
def read_authors_silkmoth(path: Path) -> list[Tracks]:
    """No header: time, x, y [mm], angle, left odour, right odour, vision, wind sector; 30 Hz."""
    refuse_unfinished(path)
    table = np.loadtxt(path, delimiter=",", ndmin=2, comments=None)
    table = numbers(path, "its table", table, "frames", 8)
    bad = np.argwhere(~np.isfinite(table))
    if len(bad):
        raise InputError(
            f"{path}: line {bad[0][0] + 1} holds a value that is no number: correct it"
        )
    rate = SILKMOTH.recording.frame_rate
    frames = table[:, 0] * rate
    off = np.abs(np.diff(frames, prepend=frames[:1] - 1.0) - 1.0) > 0.5
    if len(table) < 2 or off.any() or not -0.5 < frames[0] < 1.5:
        line = int(off.argmax())
        raise InputError(
            f"{path}: line {line + 1} is at {table[line, 0]:g} s: give every frame, from the first "
            f"at {rate:g} Hz"
        )
    movie, stimulus = Path(os.path.normpath(path.absolute())).parts[-2:-4:-1]
    return [
        Tracks(
            recording=f"{stimulus}/{movie}/{path.stem}",
            individuals=SILKMOTH.individuals,
            positions=table[:, None, None, 1:3],
            frame_rate=rate,
            unit="mm",
            signals={
                "heading": table[:, 3],
                "odour_left": table[:, 4] > 0,
                "odour_right": table[:, 5] > 0,
                "vision": table[:, 6],
                "wind": table[:, 7].astype(np.int8),
            },
            condition=1 if stimulus.lower() == "odoronly" else 0,
            outcome=1 if len(table) / rate < MOTH_SECONDS else TIME_OUT,
            provenance=PAPER,
        )
    ]
