"""Export demonstrations as a Minari dataset in a local folder, and read them back exactly.

An episode of T steps has T + 1 observations and T actions. Observations are a dictionary with an
entry per individual: x, y [arena unit], then their velocity [arena unit / s], arena frame. Actions
are one of 13 per individual: the recorded ones, or else those inferred by inverse dynamics with the
joint fit. Rewards are the pursuers' touch. Signals travel as infos; condition, outcome, split,
recording, roles, arena and provenance (licence included) as metadata.
"""

import json
import tempfile
from collections.abc import Iterable
from copy import deepcopy
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.episode import TIME_OUT, UNFINISHED, refusing_damage
from animarl_envs.demos.packaged import load_packaged, packaged_names
from animarl_envs.errors import InputError, require, require_extra
from animarl_envs.files import refuse_special
from animarl_envs.importing.hdf import open_hdf, read_dataset
from animarl_envs.locomotion import NUM_ACTIONS
from animarl_envs.settings import plain

DATASET = "demonstrations-v0"
DATA_FILE = "main_data.hdf5"
METADATA_KEY = "animarl"
RECORDED, INFERRED = "recorded", "inferred"
PER_EPISODE = ("condition", "outcome", "split", "recording")


def export_minari(demos: Demonstrations, folder: str | Path, dataset_id: str | None = None) -> Path:
    """Write a dataset into ``folder/data``; the folder must not exist yet.

    With ``MINARI_DATASETS_PATH`` set to the folder's parent, ``minari.load_dataset(folder.name)``
    finds it, and its ``recover_environment`` makes the animals' world, in which one individual
    acts. ``dataset_id`` is by default the folder's name.
    """
    with require_extra("Minari datasets", "data"):
        import gymnasium as gym
        import minari
        from minari.data_collector import EpisodeBuffer
        from minari.dataset.minari_storage import MinariStorage
    folder = Path(folder).resolve()  # Minari mishandles relative paths
    require(not folder.exists(), f"{folder}: it exists already: name a new folder")
    actions, origin = _actions(demos)
    folder.parent.mkdir(parents=True, exist_ok=True)
    box = gym.spaces.Box(-np.inf, np.inf, (4,), dtype=np.float64)
    with tempfile.TemporaryDirectory(dir=folder.parent, prefix=f".{folder.name}.") as part:
        data = Path(part) / folder.name / "data"
        data.mkdir(parents=True)
        storage = MinariStorage.new(
            data,
            observation_space=gym.spaces.Dict({name: box for name in demos.individuals}),
            action_space=gym.spaces.Dict(
                {name: gym.spaces.Discrete(NUM_ACTIONS) for name in demos.individuals}
            ),
            env_spec=_environment(demos, folder),
            data_format="hdf5",
        )
        kind = "synthetic" if demos.synthetic else "recorded"
        storage.update_metadata(
            {
                "dataset_id": dataset_id or folder.name,
                "minari_version": minari.__version__,
                "description": f"{demos!r}; {kind} animals. Source: {demos.provenance['source']}. "
                f"Licence: {demos.provenance['licence']}. Actions are {origin}.",
                "author": {"AnimaRL"},
                "algorithm_name": "none: demonstrations",
                METADATA_KEY: json.dumps(_metadata(demos, origin), default=plain),
            }
        )
        storage.update_episodes(
            EpisodeBuffer(**_episode(demos, actions, index)) for index in range(len(demos))
        )
        data.parent.rename(folder)
    return folder


def _environment(demos: Demonstrations, folder: Path) -> Any:
    """Return Gymnasium's spec of the animals' world, for Minari's ``recover_environment``.

    Animals of one's own start from the dataset, so that it has to stay in its ``folder``.
    """
    import gymnasium as gym

    spec = deepcopy(gym.spec(f"AnimaRL/{demos.species.capitalize()}-v0"))
    if demos.species == "custom":
        spec.kwargs |= {"demos": str(folder), "split": None}
    return spec


def export_packaged(root: str | Path) -> list[str]:
    """Write every packaged set below ``root``, under stable ids, and return these.

    ``MINARI_DATASETS_PATH=root`` lets Minari find them: ``animarl/newt/demonstrations-v0``.

    Raises InputError if a folder exists already.
    """
    made = []
    for name in packaged_names():
        made.append(f"animarl/{name}/{DATASET}")
        folder = export_minari(load_packaged(name), Path(root) / made[-1], made[-1])
        for space in (folder.parent, folder.parent.parent):
            about = f"Demonstrations of {name}" if space == folder.parent else "Sets of AnimaRL"
            (space / "namespace_metadata.json").write_text(json.dumps({"description": about}))
    return made


def import_minari(folder: str | Path) -> Demonstrations:
    """Read what :func:`export_minari` wrote; the package Minari is not needed for it.

    Raises InputError if it is no Minari dataset, or one that this project did not write.
    """
    folder = Path(folder).resolve()
    file = folder / "data" / DATA_FILE
    require(file.is_file(), f"{folder}: it holds no data/{DATA_FILE}: name the dataset's folder")
    described = file.with_name("metadata.json")
    refuse_special(described)
    try:
        meta = dict(json.loads(json.loads(described.read_text(encoding="utf-8"))[METADATA_KEY]))
    except KeyError:
        raise InputError(
            f"{folder}: it is a Minari dataset of another project, which does not say which entry "
            "is a position: convert it to a table or array first"
        ) from None
    except (OSError, ValueError, TypeError, RecursionError) as error:
        raise InputError(
            f"{folder}: the Minari dataset is damaged ({error}): copy it again"
        ) from None
    with refusing_damage(folder):
        return _rebuilt(folder, meta, file)


def _rebuilt(folder: Path, meta: dict[str, Any], path: Path) -> Demonstrations:
    """Rebuild demonstrations from the arrays of the file.

    Minari's own reader follows what the file says (formats, spaces, its environment).
    """
    names = [str(name) for name in meta["demonstrations"]["individuals"]]
    states, actions = [], []
    infos: list[dict[str, NDArray[Any]]] = []
    with open_hdf(path) as file:
        count = len(meta["demonstrations"]["recording"])
        require(
            len(file) == count,
            f"{folder}: it holds {len(file)} episodes, its metadata {count}: copy it again",
        )
        for number in range(count):

            def arrays(part: str, keys: Iterable[str], at: str = f"episode_{number}") -> Any:
                return {key: read_dataset(path, file, f"{at}/{part}/{key}") for key in keys}

            states.append(np.stack([*arrays("observations", names).values()], axis=1))
            taken = np.full(states[-1].shape[:2], -1, dtype=np.int8)
            taken[:-1] = np.stack([*arrays("actions", names).values()], axis=1)
            actions.append(taken)
            infos.append(arrays("infos", meta["signals"]))
    signals: dict[str, NDArray[Any]] = {
        key: np.concatenate([info[key] for info in infos]).astype(kind)
        for key, kind in meta["signals"].items()
    }
    if meta["actions"] == RECORDED:
        signals["actions"] = np.concatenate(actions)
    known: dict[str, Any] = meta["demonstrations"]
    stored = {key: np.array(known[key]) for key in PER_EPISODE} | {
        "positions": np.concatenate([state[..., :2] for state in states]),
        "lengths": np.array([len(state) for state in states]),
        "initial_velocity": np.stack([state[0, :, 2:] for state in states]),
    }
    stored |= {f"signal_{key}": signals[key] for key in meta["signal_order"]}
    return Demonstrations(**Demonstrations.from_stored(folder, known, stored))


def _actions(demos: Demonstrations) -> tuple[NDArray[np.int8], str]:
    if "actions" in demos.signals:
        recorded = demos.signals["actions"]
        if recorded.dtype == np.int8 and recorded.shape == demos.positions.shape[:2]:
            return recorded, RECORDED
    from animarl_envs.fitting.result import fit_locomotion
    from animarl_envs.fitting.transitions import demonstrated_actions

    fit = fit_locomotion(demos, split=None, bootstrap=0)
    return demonstrated_actions(demos, fit.locomotion), INFERRED


def _metadata(demos: Demonstrations, origin: str) -> dict[str, Any]:
    as_infos = {
        key: str(value.dtype)
        for key, value in demos.signals.items()
        if not (key == "actions" and origin == RECORDED)
    }
    known: dict[str, Any] = {key: getattr(demos, key).tolist() for key in PER_EPISODE}
    known |= {key: getattr(demos, key) for key in demos.META}
    return {
        "demonstrations": known,
        "signals": as_infos,
        "signal_order": list(demos.signals),
        "actions": origin,
        "licence": demos.provenance["licence"],
    }


def _episode(demos: Demonstrations, actions: NDArray[np.int8], index: int) -> dict[str, Any]:
    one = demos.episode(index)
    first = int(demos.offsets[index])
    taken = actions[first : first + one.num_steps]
    state = np.concatenate([one.positions, one.velocities], axis=2)
    ended = np.arange(one.num_steps) == one.num_steps - 1
    by_itself = one.outcome not in (TIME_OUT, UNFINISHED)
    return {
        "id": index,
        "observations": {name: state[:, i] for i, name in enumerate(demos.individuals)},
        "actions": {name: taken[:, i] for i, name in enumerate(demos.individuals)},
        "rewards": (ended & (one.outcome > 0)).astype(np.float64).tolist(),
        "terminations": (ended & by_itself).tolist(),
        "truncations": (ended & (not by_itself)).tolist(),
        "infos": {key: np.asarray(value) for key, value in one.signals.items() if key != "actions"},
    }
