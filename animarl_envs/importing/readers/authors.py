"""The layouts in which the authors of the paper publish theirs: agents, flies, newts, silkmoths."""

import math
import os
import re
from pathlib import Path
from typing import Any

import numpy as np

from animarl_envs.array_types import Floats
from animarl_envs.demos.episode import TIME_OUT, UNFINISHED
from animarl_envs.errors import InputError, require
from animarl_envs.files import npz_members, read_npz, refuse_unfinished
from animarl_envs.importing.plain_pickle import load_plain
from animarl_envs.importing.readers.registry import numbers, register_track_reader
from animarl_envs.importing.tracks import Tracks
from animarl_envs.species import AGENT, FLY, NEWT, SILKMOTH, Species

MOTH_DEFAULTS = {
    "species": "silkmoth",
    "searcher": True,
    "decision_rate": 2.0,
    "keep_last_frame": True,
    "cutting": {"piece": math.inf},
    "scaling": {"shape": "open", "units_per_arena_unit": 1000.0},
}
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
            "shape": species.arena.shape,
            "width": 2.0,
            "centre": (0.0, 0.0),
            "boundary": species.arena.boundary,
        },
    }


def _nested(value: Any) -> list[Any]:
    """Return a list, also of a squeezed object array."""
    if isinstance(value, np.ndarray):
        value = np.squeeze(value)
        return _nested(value.item()) if value.ndim == 0 and value.dtype.hasobject else list(value)
    if not isinstance(value, (list, tuple)):
        raise TypeError(f"{type(value).__name__} in place of a list")
    return list(value)


def _tracks(path: Path, number: int, paths: list[Any], species: Species, **more: Any) -> Tracks:
    """Return one episode; a path holds x and y per frame, and further columns."""
    tracks: list[Floats] = []
    for value in paths:
        array = np.asarray(value, dtype=np.float64)
        array = array.reshape(len(array), -1)
        require(array.shape[1] > 1, f"{path}: episode {number} has no x and y per frame: check it")
        tracks.append(array[:, :2])
    lengths = sorted({len(one) for one in tracks})
    require(
        len(lengths) == 1,
        f"{path}: episode {number} has {lengths} frames for its individuals: give each as many",
    )
    return Tracks(
        recording=f"{path.stem}/{number:04d}",
        individuals=species.individuals,
        positions=np.stack(tracks, axis=1)[:, :, None],
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
    """Read key ``pos``: (episodes, 3 individuals: prey, predators) of lists of (x, y) at 10 Hz."""
    condition = 1 if "share" in path.name else 0
    episodes = []
    for number, episode in enumerate(_nested(read_npz(path, load_plain)["pos"])):
        prey, *predators = _nested(episode)
        if len(prey) >= FEWEST_AGENT_FRAMES:
            episodes.append(_tracks(path, number, [*predators, prey], AGENT, condition=condition))
    return episodes


@register_track_reader(
    "authors-fly",
    "the paper's flies (fly/data.npz)",
    sniff=lambda path: npz_members(path) == {"states.npy", "actions.npy", "rewards.npy"},
    extensions=(".npz",),
    defaults=_chase_defaults(FLY),
)
def read_authors_fly(path: Path) -> list[Tracks]:
    """Read key ``states``, [individual][episode] of (frames, 1, >= 2) at 30 Hz, and ``rewards``."""
    objects = read_npz(path, load_plain)
    states, rewards = ([*map(_nested, _nested(objects[key]))] for key in ("states", "rewards"))
    require(
        len(states) == 3 and len({len(one) for one in states}) == 1,
        f"{path}: states are of {len(states)} individuals, not 3: check the file",
    )
    episodes = []
    for number, paths in enumerate(zip(*states, strict=True)):
        if len(paths[0]) >= FEWEST_FLY_FRAMES:
            ends = [np.asarray(own[number], np.float64).ravel()[-1] > 0 for own in rewards[:2]]
            outcome = ends.index(True) + 1 if any(ends) else UNFINISHED
            episodes.append(_tracks(path, number, [*paths], FLY, outcome=outcome))
    return episodes


@register_track_reader(
    "authors-newt",
    "the paper's newts (newt/state_m1_data*.npz beside reward_*_data*.npz)",
    sniff=lambda path: re.fullmatch(r"state_m1_data\d+\.npz", path.name) is not None,
    extensions=(".npz",),
    defaults=_chase_defaults(NEWT),
)
def read_authors_newt(path: Path) -> list[Tracks]:
    """Read one array per episode, (frames, >= 5, >= 2), positions at columns 0, 2, 4; 30 Hz."""
    number_of_file = path.stem.removeprefix("state_m1_data")
    rewards = []
    for male in ("m1", "m2"):
        beside = path.with_name(f"reward_{male}_data{number_of_file}.npz")
        rewards.append(read_npz(beside, load_plain) if beside.exists() else {})
    rate = NEWT.recording.frame_rate
    kept = round(NEWT_STEPS * NEWT.dt * rate) + 1
    episodes = []
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
            episodes.append(_tracks(path, number, paths, NEWT, outcome=outcome))
    return episodes


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
    """Read a table without header, at 30 Hz.

    Its columns are time, x, y [mm], angle, left odour, right odour, vision and wind sector.
    """
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
