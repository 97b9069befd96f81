"""The layouts in which the paper's authors publish their recordings (agents, flies, newts, moths).

Their ``.npz`` files hold pickles, and a pickle names the functions that it calls.
:func:`load_plain` reads plain lists, numbers, text and arrays as ``np.save`` writes them, and
nothing else: NumPy's names lead to inert stand-ins, all others to a refusal, so that nothing of the
file runs. Arrays are made once the whole pickle has been read.
"""

from __future__ import annotations

import io
import math
import os
import pickle
import re
from pathlib import Path
from typing import Any

import numpy as np

from animarl_envs.demos.episode import TIME_OUT, UNFINISHED
from animarl_envs.errors import InputError, require
from animarl_envs.files import checked_text, npz_members, read_npz, refuse_unfinished
from animarl_envs.importing.readers.published import MOTH_DEFAULTS
from animarl_envs.importing.readers.registry import Floats, numbers, register_track_reader
from animarl_envs.importing.tracks import Tracks
from animarl_envs.species import AGENT, FLY, NEWT, SILKMOTH, Species

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


PLAIN_CODE = re.compile(r"[<>|=]?(b1|\?|i[1248]|u[1248]|f[248]|[US][1-9]\d{0,5}|O8?)")
PLAIN = (str, bytes, int, float, bool, type(None))
DEEPEST = 40  # lists within lists; no recording nests deeper


def load_plain(raw: bytes, name: str) -> Any:
    """Return the value pickled in ``raw``, if it is made of plain things.

    Raises InputError if it is of anything else, or damaged.
    """
    try:
        return _made(_Restricted(io.BytesIO(raw)).load())
    except Exception as error:
        what = str(error).splitlines()[0][:120] if str(error) else type(error).__name__
        raise InputError(
            f"{name}: it holds a pickle that is damaged or not of numbers and lists ({what}): "
            "it is not opened; save plain arrays instead"
        ) from None


def _need(met: bool, what: str) -> None:
    if not met:
        raise pickle.UnpicklingError(what)


class _StandIn:
    """Keeps what an object of NumPy's was called with, and its state; nothing else is done."""

    def __init__(self, *given: Any) -> None:
        self.given, self.state = given, None

    def __setstate__(self, state: Any) -> None:
        _need(self.state is None, "a state is set twice")
        self.state = state


class _Dtype(_StandIn):
    pass


class _Array(_StandIn):
    pass


class _Scalar(_StandIn):
    pass


KNOWN = {"ndarray": object(), "dtype": _Dtype, "_reconstruct": _Array, "scalar": _Scalar}


class _Restricted(pickle.Unpickler):
    """Looks up nothing but the stand-ins."""

    def find_class(self, module: str, name: str) -> Any:
        place = "numpy" if name in ("ndarray", "dtype") else "numpy.core.multiarray"
        known = name in KNOWN and module.replace("._core.", ".core.") == place
        _need(known, f"it names {module}.{name}")
        return KNOWN[name]


def _made(value: Any, depth: int = 0) -> Any:
    """The value with arrays in place of their stand-ins, all of it copied."""
    kind, below = type(value), depth + 1
    _need(depth <= DEEPEST, "its lists nest too deep")
    if kind in PLAIN:
        return value
    if kind is dict:
        _need({type(key) for key in value} <= {str, int, bool}, "a dictionary has an unusual key")
        return {key: _made(entry, below) for key, entry in value.items()}
    if kind in (list, tuple):
        return kind([_made(entry, below) for entry in value])
    if kind is _Scalar:
        return _numbers(value.given[1], _plain_dtype(value.given[0]), (), "C").item()
    _need(kind is _Array, f"it holds a bare {kind.__name__}")
    shape, dtype, fortran, content = value.state[-4:]
    usual = type(shape) is tuple and all(type(n) is int and n >= 0 for n in shape)
    _need(usual, "an array has an unusual shape")
    if not (plain := _plain_dtype(dtype)).hasobject:
        return _numbers(content, plain, shape, "F" if fortran else "C")
    whole = type(content) is list and len(content) == math.prod(shape)
    _need(whole, "an array holds more or fewer objects than its shape says")
    array = np.empty(len(content), dtype=object)  # NumPy lists objects in C's order always
    for place, entry in enumerate(content):
        array[place] = _made(entry, below)
    return array.reshape(shape)


def _plain_dtype(given: Any) -> Any:
    """The kind of an array, whose state may say its byte order and nothing else."""
    plain = type(given) is _Dtype and PLAIN_CODE.fullmatch(given.given[0]) is not None
    _need(plain, "an array is not of plain numbers, text or objects")
    code, state = given.given[0], given.state
    if state is None:
        return np.dtype(code)
    _need(state[2:5] == (None,) * 3, "a dtype has fields, or an unusual state")
    return np.dtype(code).newbyteorder(state[1])


def _numbers(raw: Any, dtype: np.dtype[Any], shape: tuple[int, ...], order: Any) -> Any:
    """A copy of the bytes as an array, if each of its values exists."""
    whole = type(raw) is bytes and len(raw) == math.prod(shape) * dtype.itemsize
    _need(whole and not dtype.hasobject, "numbers have more or fewer bytes than their kind")
    _need(dtype.kind != "b" or not raw.strip(b"\0\1"), "a truth value is neither true nor false")
    array = np.frombuffer(raw, dtype=dtype).reshape(shape, order=order)
    return checked_text(Path("a text"), array.copy())
