"""Episodes of published agents, which the networks of collaborative hunting were rolled out to.

    animarl import episodes.npz --readers benchmarks/paper_readers.py --out agents.npz

A file has ``pos`` float32 ``(sum(n_steps + 1), individuals, 2)``, predators first, prey last;
``actions`` int8 ``(sum(n_steps), individuals)``, numbered as in :mod:`animarl_envs.locomotion`;
``n_steps`` and ``outcome`` per episode (codes of :class:`Demonstrations`); ``meta``, JSON with
``dt`` and ``cond``.
"""

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
from animarl_envs.importing.readers.registry import numbers, register_track_reader
from animarl_envs.locomotion import NUM_ACTIONS

HALF_SIDE = 1.0  # leaving [-1, 1]^2 ends an episode
SPLIT_SEED = 20240
CONDITIONS = {"indiv": 0, "share": 1}  # by the end of meta["cond"]
AGENTS = {"pos.npy", "actions.npy", "n_steps.npy", "outcome.npy", "meta.npy"}


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
