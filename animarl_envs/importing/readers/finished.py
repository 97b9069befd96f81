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
from animarl_envs.errors import InputError, require
from animarl_envs.files import npz_members, read_npz
from animarl_envs.importing.minari_io import DATA_FILE, import_minari
from animarl_envs.importing.readers.registry import numbers, register_track_reader
from animarl_envs.locomotion import NUM_ACTIONS

HALF_SIDE = 1.0  # leaving [-1, 1]^2 ends an episode
SPLIT_SEED = 20240
CONDITIONS = {"indiv": 0, "share": 1}  # by the end of meta["cond"]
_MEMBERS = {"pos.npy", "actions.npy", "n_steps.npy", "outcome.npy", "meta.npy"}
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
    sniff=lambda path: npz_members(path) >= _MEMBERS,
    extensions=(".npz",),
    finished=True,
)
def read_agents(path: Path, split_seed: int = SPLIT_SEED) -> Demonstrations:
    """Read one file of episodes; individuals ``predator_0 ... prey``, condition from the file.

    Episodes start at rest. Four fifths are for training, a tenth each for validation and test.
    """
    arrays = read_npz(path)
    if missing := sorted(_MEMBERS - {f"{name}.npy" for name in arrays}):
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
