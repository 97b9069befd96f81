"""Files of finished episodes: this project's own, Minari datasets, and recorded artificial agents.

Artificial predators and prey are ``episodes_*.npz`` with the layout of its SOURCE.md: ``pos``
float32 ``(sum(n_steps + 1), individuals, 2)``, predators first, prey last; ``actions`` int8
``(sum(n_steps), individuals)``; ``n_steps`` per episode; ``outcome`` (k > 0: captured by predator
k; -1 the prey left, -2 a predator left; 0 time-out), the codes of :class:`Demonstrations`; ``meta``
JSON with ``dt``, ``damping``, ``speed_pred``, ``speed_prey``, ``cond``.

Recorded actions are relative to the opponent: the prey for a predator, the nearest predator for the
prey, action k at -30 deg * k, 12 for none. Measured against the accelerations of all 1,000
episodes, that is the numbering of :mod:`animarl_envs.locomotion`, so they are kept as they are.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from animarl_envs.arena import Arena
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.splits import assign_splits
from animarl_envs.errors import InputError
from animarl_envs.files import npz_members, read_npz
from animarl_envs.importing.minari_io import DATA_FILE, import_minari
from animarl_envs.importing.readers.registry import register_track_reader
from animarl_envs.locomotion import NUM_ACTIONS

HALF_SIDE = 1.0  # leaving [-1, 1]^2 ends an episode
SPLIT_SEED = 20240
CONDITIONS = {"indiv": 0, "share": 1}  # by the end of meta["cond"]
_AXES = {"pos": 3, "actions": 2, "n_steps": 1, "outcome": 1}
_OWN_MEMBERS = {"positions.npy", "lengths.npy", "initial_velocity.npy", "meta.npy"}


@register_track_reader(
    "animarl",
    "demonstrations of this project (.npz)",
    sniff=lambda path: npz_members(path) >= _OWN_MEMBERS,
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
    sniff=lambda path: npz_members(path) >= {f"{name}.npy" for name in (*_AXES, "meta")},
    extensions=(".npz",),
    finished=True,
)
def read_agents(path: Path, split_seed: int = SPLIT_SEED) -> Demonstrations:
    """Read one file of episodes; individuals ``predator_0 ... prey``, condition from the file.

    Episodes start at rest. Four fifths are for training, a tenth each for validation and test.
    """
    arrays = read_npz(path)
    if missing := sorted({*_AXES, "meta"} - set(arrays)):
        raise InputError(
            f"{path}: it lacks the array {missing[0]!r}: it is no episodes file of the agents"
        )
    meta = _meta(path, arrays["meta"])
    for key, axes in _AXES.items():
        array = arrays[key]
        if array.ndim != axes or array.dtype.kind not in "iuf":
            raise InputError(
                f"{path}: {key} is {array.dtype} of shape {array.shape}: give numbers with {axes} "
                "axes"
            )
    pos, actions, steps, outcome = (arrays[key] for key in _AXES)
    steps = steps.astype(np.int64)
    num = pos.shape[1]
    if num < 2 or pos.shape[2] != 2:
        raise InputError(
            f"{path}: pos has shape {pos.shape}, not (frames, individuals, 2) with two individuals "
            "or more: give predators and a prey"
        )
    if len(steps) == 0 or (steps < 1).any():
        place = f"episode {int(np.argmax(steps < 1))}" if len(steps) else "n_steps"
        raise InputError(f"{path}: {place} has no step: leave empty episodes out")
    if actions.shape != (int(steps.sum()), num):
        raise InputError(
            f"{path}: actions have shape {actions.shape}, n_steps ask for "
            f"({int(steps.sum())}, {num}): give one action per step and individual"
        )
    if len(pos) != int((steps + 1).sum()):
        raise InputError(
            f"{path}: pos has {len(pos)} frames, n_steps ask for {int((steps + 1).sum())}: "
            "give one frame more than steps per episode"
        )
    if ((actions < 0) | (actions >= NUM_ACTIONS)).any():
        raise InputError(f"{path}: an action lies outside 0 to {NUM_ACTIONS - 1}: check actions")
    signal = np.full((len(pos), num), -1, dtype=np.int8)
    acting = np.ones(len(pos), dtype=bool)
    acting[np.cumsum(steps + 1) - 1] = False
    signal[acting] = actions
    count = len(steps)
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
        split=assign_splits(recording, split_seed),
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
