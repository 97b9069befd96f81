"""Hashes of what the packages compute: steps of every world, updates of every recipe, run folders.

Everything is asked for by public names and commands, so that the code behind them can be rewritten.
An entry holds exact hashes and a few rounded numbers. Another kind of processor (or another version
of NumPy, Numba or torch) rounds otherwise; there only the rounded numbers of the first steps can be
compared, and of the run folders which tables and columns there are.
"""

import hashlib
import json
import tempfile
import warnings
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import gymnasium as gym
import numba as nb
import numpy as np
import pandas as pd
import torch
from commands import animarl
from numpy.typing import NDArray
from small_runs import few

import animarl_algos
import animarl_envs
from animarl_algos import SlotVecEnv
from animarl_algos.recipes.registry import RECIPES
from animarl_envs import SPECIES
from animarl_envs.tasks import find_task
from animarl_envs.wrappers import (
    ConditionFlag,
    ConditionFlagParallel,
    ConditionFlagVector,
    DTWReward,
    DTWRewardParallel,
    DTWRewardVector,
)

HERE = Path(__file__).resolve().parent
STEPS = 10_000
COPIES = 50
FIRST = (1, 2, 5, 10, 20)
"""Steps after which the sum of all observations and rewards so far is written down."""
UPDATES = 50
SMALL: dict[str, Any] = {
    "batch_size": 4, "buffer_size": 2000, "learning_rate": 1e-3, "offline_batch_size": 4,
    "policy_kwargs": {"hidden": 8, "depth": 1}, "target_update_interval": (5, "episode"),
}  # fmt: skip
CROWD: dict[str, Any] = {"num_pursuers": 4, "start": "uniform", "rebound": True}
OFFLINE: dict[str, dict[str, Any]] = {
    "GruPolicy": {"offline_epochs": 6},  # of whole episodes
    "MlpPolicy": {
        "offline_epochs": 2,
        "offline_kwargs": {"sequence_length": 4, "updates_per_epoch": UPDATES // 2},
    },
}
RUNS = {"agent": "dqcil-pt", "fly": "soft-bc", "newt": "bc", "silkmoth": "dqdil-pt"}
"""The recipe of each species' small run folder."""


@nb.njit
def _sums(x: NDArray[np.float64]) -> float:
    total = 0.0
    for value in x:
        total += np.exp(np.sin(value)) * np.tanh(value) / np.sqrt(1.0 + value * value)
    return total


def fingerprint() -> str:
    """Hash of arithmetic in Numba, NumPy and torch, and of their versions."""
    x = np.linspace(-3.0, 3.0, 4001)
    matrix = np.outer(np.sin(x[:67]), np.cos(x[:67]))
    weights = torch.sin(torch.arange(67 * 130, dtype=torch.float32)).reshape(67, 130)
    network = torch.tanh(weights.T @ (weights / 7)).exp().sum(0)
    return digest(
        np.array([_sums(x), float((matrix @ matrix).sum())]), np.log(np.abs(x) + 0.5),
        network.numpy(), np.array([np.__version__, nb.__version__, torch.__version__]),
    )  # fmt: skip


def digest(*arrays: Any) -> str:
    """Hash of the values, shapes and kinds of some arrays."""
    found = hashlib.sha256()
    for array in map(np.ascontiguousarray, arrays):
        found.update(f"{array.dtype.kind}{array.dtype.itemsize}{array.shape}".encode())
        found.update(array.tobytes())
    return found.hexdigest()[:16]


def steps_of(
    observations: list[Any], rewards: list[Any], ends: list[Any], outcomes: list[Any]
) -> dict[str, Any]:
    """Exact hashes of what a view handed out, and sums over the first steps."""
    first = [
        round(float(sum(np.sum(o, dtype=np.float64) for o in observations[: n + 1])), 3)
        + round(float(sum(np.sum(r, dtype=np.float64) for r in rewards[:n])), 3)
        for n in FIRST
    ]
    return {
        "observations": digest(np.array(observations)), "rewards": digest(np.array(rewards)),
        "ends": digest(np.array(ends)), "outcomes": digest(np.array(outcomes)),
        "first": [round(value, 3) for value in first],
    }  # fmt: skip


def actions_for(num_actions: int, shape: tuple[int, ...]) -> NDArray[np.int64]:
    """Straight at the focus every other time, else drawn with seed 0."""
    rng = np.random.default_rng(0)
    drawn = rng.integers(num_actions, size=shape)
    return np.where(rng.random(shape) < 0.5, 0, drawn)


def single(env: gym.Env[Any, Any]) -> dict[str, Any]:
    """Steps of one focal individual."""
    space: Any = env.action_space
    observation, _ = env.reset(seed=1)
    observations, rewards, ends, outcomes = [observation], [], [], []
    for action in actions_for(int(space.n), (STEPS,)).tolist():
        observation, reward, terminated, truncated, info = env.step(action)
        observations.append(observation)
        rewards.append(reward)
        ends.append((terminated, truncated))
        outcomes.append((info["outcome"], info["demo"], info["condition"], info["executed"]))
        if terminated or truncated:
            observation, _ = env.reset()
            observations.append(observation)
    return steps_of(observations, rewards, ends, outcomes)


def vector(env: Any) -> dict[str, Any]:
    """Steps of copies, each with one focal individual."""
    observation, _ = env.reset(seed=1)
    observations, rewards, ends, outcomes = [observation], [], [], []
    for actions in actions_for(int(env.single_action_space.n), (STEPS // COPIES, COPIES)):
        observation, reward, terminated, truncated, info = env.step(actions)
        observations.append(observation.copy())
        rewards.append(reward.copy())
        ends.append((terminated.copy(), truncated.copy()))
        outcomes.append([info[key].copy() for key in ("outcome", "demo", "condition", "executed")])
    return steps_of(observations, rewards, ends, outcomes)


def parallel(env: Any) -> dict[str, Any]:
    """Steps in which all individuals act."""
    names = env.possible_agents
    observation, _ = env.reset(seed=1)
    observations, rewards, ends, outcomes = [list(observation.values())], [], [], []
    for row in actions_for(int(env.action_space(names[0]).n), (STEPS, len(names))).tolist():
        observation, reward, terminated, truncated, info = env.step(dict(zip(names, row)))
        observations.append([observation[name] for name in names])
        rewards.append([reward[name] for name in names])
        ends.append((terminated[names[0]], truncated[names[0]]))
        outcomes.append([info[name]["outcome"] for name in names])
        if not env.agents:
            observation, _ = env.reset()
            observations.append([observation[name] for name in names])
    return steps_of(observations, rewards, ends, outcomes)


FULL = {"observation": "full"}  # of which the compact one, that of tasks, is a part
VIEWS: dict[str, tuple[Callable[..., Any], Callable[[Any], Any], Any, Any]] = {
    "single": (
        lambda species, **o: gym.make(id_of(species), **FULL | o),
        single, DTWReward, ConditionFlag,
    ),
    "vector": (
        lambda species, **o: gym.make_vec(id_of(species), num_envs=COPIES, **FULL | o),
        vector, DTWRewardVector, ConditionFlagVector,
    ),
    "parallel": (
        lambda species, **o: animarl_envs.parallel_env(species, **FULL | o),
        parallel, DTWRewardParallel, ConditionFlagParallel,
    ),
}  # fmt: skip


def id_of(species: str) -> str:
    return animarl_envs.environment_id(species)


def worlds() -> Iterator[tuple[str, Callable[[], dict[str, Any]]]]:
    """Every species through every view: as recorded, as in the paper, wrapped, and as a task."""
    for species, spec in SPECIES.items():
        for view, (make, walk, dtw, flag) in VIEWS.items():
            kinds: dict[str, Callable[..., Any]] = {
                "full": lambda s, make=make: make(s),
                "paper": lambda s, make=make: make(s, observation="paper"),
                "dtw": lambda s, make=make, dtw=dtw: dtw(make(s)),
            }
            if find_task(f"{species}Task") is not None:
                kinds["task"] = lambda s, make=make: make(f"{s}Task")
            if view != "parallel":
                kinds["scripted"] = lambda s, make=make: make(s, others="scripted")
            if len(spec.individuals) > 1 and view == "vector":
                kinds["crowd"] = lambda s, make=make: make(s, **CROWD)
            if spec.conditions:
                kinds["flag"] = lambda s, make=make, flag=flag: flag(make(s))
            for kind, made in kinds.items():
                yield (
                    f"{species} {view} {kind}",
                    lambda s=species, made=made, walk=walk: walk(made(s)),
                )


def learned(name: str, policy: str) -> dict[str, Any]:
    """Weights of a small learner of the agents after some updates, offline and online."""
    named, torch_threads = RECIPES[name], torch.get_num_threads()
    settings = dict(SMALL)
    if named.pretrained:
        settings |= OFFLINE[policy]
    flag = named.algorithm.recipe.needs_condition
    env = SlotVecEnv("agent", 2, demos=few("agent"), condition_flag=flag, time_limit=10)
    torch.set_num_threads(1)
    try:
        model = getattr(animarl_algos, named.algorithm.__name__)(
            policy, env, seed=3, device="cpu", **settings
        )
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # so small a clone knows little
            model.learn(UPDATES * 10)
        observation = env.reset()
        model.policy.set_training_mode(False)
        acted, _ = model.predict(observation, deterministic=True)
    finally:
        torch.set_num_threads(torch_threads)
    parameters = [p.detach().numpy() for p in model.policy.parameters()]
    return {
        # In whatever order the parameters stand, so that a layer may be renamed.
        "weights": digest(*sorted(digest(p) for p in parameters)),
        "actions": digest(acted),
        "updates": int(model._n_updates),
        "size": sum(p.size for p in parameters),
        "sum": float(f"{sum(float(np.abs(p, dtype=np.float64).sum()) for p in parameters):.3g}"),
    }


def recipes() -> Iterator[tuple[str, Callable[[], dict[str, Any]]]]:
    """Every recipe with and without a memory."""
    for name in RECIPES:
        for policy in ("GruPolicy", "MlpPolicy"):
            yield f"{name} {policy}", lambda n=name, p=policy: learned(n, p)


def run_folder(species: str) -> dict[str, Any]:
    """The numbers in the rollouts and tables of a small run."""
    with tempfile.TemporaryDirectory() as temporary, warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        file, out = Path(temporary) / "few.npz", Path(temporary) / "run"
        few(species).save(file)
        animarl(
            "run", file, "--species", species, "--algo", RUNS[species], "--steps", 40,
            "--copies", 2, "--thrusts", 1, "--acting", "boltzmann:0.5", "--repetitions", 2,
            "--no-baselines", "--folds", 0, "--set", "offline_epochs=1",
            "--set", "offline_kwargs={sequence_length: 8, updates_per_epoch: 3}",
            "--set", "policy_kwargs={hidden: 16, depth: 1}", "--out", out,
        )  # fmt: skip
        found = {}
        for path in sorted([*out.glob("rollouts/*.npz"), *out.glob("evaluation/*.csv"),
                            *out.glob("evaluation/*.json"), out / "locomotion.json"]):  # fmt: skip
            found[str(path.relative_to(out))] = numbers_of(path)
    return found


def numbers_of(path: Path) -> dict[str, str]:
    """Hash of each array of an archive, column of a table, or entry of a JSON file."""
    if path.suffix == ".npz":
        with np.load(path) as arrays:
            return {name: digest(rounded(arrays[name])) for name in sorted(arrays)}
    if path.suffix == ".csv":
        if not path.read_text().strip():
            return {}
        table = pd.read_csv(path)
        return {
            name: digest(rounded(table[name].to_numpy()))
            if table[name].dtype.kind in "if"
            else digest(table[name].astype(str).to_numpy(dtype=str))
            for name in map(str, table.columns)
        }
    return {name: digest(np.array(json.dumps(to_digits(value), sort_keys=True)))
            for name, value in sorted(json.loads(path.read_text()).items())
            if name not in ("fingerprint", "version")}  # fmt: skip


def rounded(array: Any) -> Any:
    """To six significant digits."""
    array = np.asarray(array)
    if array.dtype.kind != "f":
        return array
    return np.array([f"{value:.6g}" for value in array.ravel().tolist()]).reshape(array.shape)


def to_digits(value: Any) -> Any:
    """Numbers anywhere in plain data to six significant digits."""
    if isinstance(value, float):
        return float(f"{value:.6g}")
    if isinstance(value, list):
        return [to_digits(each) for each in value]
    if isinstance(value, dict):
        return {key: to_digits(each) for key, each in value.items()}
    return value


def runs() -> Iterator[tuple[str, Callable[[], dict[str, Any]]]]:
    """A small run of each species."""
    for species in RUNS:
        yield species, lambda s=species: run_folder(s)


PARTS: Mapping[str, Callable[[], Iterator[tuple[str, Callable[[], dict[str, Any]]]]]] = {
    "worlds": worlds,
    "recipes": recipes,
    "runs": runs,
}


def stored(part: str) -> dict[str, Any]:
    """The committed entries of a part, and the fingerprint of the processor that made them."""
    found: dict[str, Any] = json.loads((HERE / f"{part}.json").read_text())
    return found


def store(part: str, entries: Mapping[str, Any]) -> None:
    """Write the entries of a part with this processor's fingerprint."""
    lines = [f"  {json.dumps(name)}: {json.dumps(entry)}" for name, entry in entries.items()]
    text = f'{{"fingerprint": {json.dumps(fingerprint())}, "entries": {{\n'
    (HERE / f"{part}.json").write_text(text + ",\n".join(lines) + "\n}}\n")
