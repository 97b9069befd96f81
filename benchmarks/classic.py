"""Ordinary tasks: this project's DQN beside stable-baselines3's, and sb3-contrib's RecurrentPPO.

    python benchmarks/classic.py [--task CartPole-v1 ...] [--seed 0 ...] [--out out/classic]

Both learners of a task take as many steps, one process and one thread each. Ours has the settings
of its section in ``zoo_configs/dqn.yml``; the others have those that rl_zoo3 2.9 tuned for them
(its ``dqn.yml`` and ``ppo_lstm.yml``), written out below, RecurrentPPO with the normalised
observations and rewards that they ask for.

After every tenth of the steps the learner acts greedily in 20 episodes, whose starts are the same
for all. Tabled are the mean return of these episodes at the end, and of the mean of the last five
looks (a policy that wanders has a lower one); that of the network of the best look, which is kept
as stable-baselines3's EvalCallback keeps it, in 20 episodes from other starts; the processor
seconds of training, the looks left out; and the latter return per processor second, where returns
are positive. Intervals are Student's t over seeds, 95 %.

A learner and a seed make a file in ``--out``, and are not trained again where it exists.
"""

from __future__ import annotations

import argparse
import copy
import json
import os
import time
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import rl_zoo3.import_envs  # noqa: F401  registers CartPoleNoVel-v1
import torch
from gymnasium.error import DependencyNotInstalled
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table
from sb3_contrib import RecurrentPPO
from scipy import stats
from stable_baselines3 import DQN as SB3DQN
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.utils import LinearSchedule
from stable_baselines3.common.vec_env import VecEnv, VecNormalize, unwrap_vec_normalize

from animarl_algos.learner.presets import learner_preset
from animarl_algos.recipes.registry import DQN
from animarl_envs.files import write_then_rename

LOOKS, LAST_LOOKS = 10, 5
EPISODES, STARTS, FRESH_STARTS = 20, 10_000, 20_000
"""Episodes of a look, the seed of their starts, and that of those for the best network."""

TUNED_DQN: dict[str, dict[str, Any]] = {
    "CartPole-v1": {
        "learning_rate": 2.3e-3, "batch_size": 64, "buffer_size": 100_000, "learning_starts": 1000,
        "gamma": 0.99, "target_update_interval": 10, "train_freq": 256, "gradient_steps": 128,
        "exploration_fraction": 0.16, "exploration_final_eps": 0.04,
    },
    "Acrobot-v1": {
        "learning_rate": 6.3e-4, "batch_size": 128, "buffer_size": 50_000, "learning_starts": 0,
        "gamma": 0.99, "target_update_interval": 250, "train_freq": 4, "gradient_steps": -1,
        "exploration_fraction": 0.12, "exploration_final_eps": 0.1,
    },
}  # fmt: skip
TUNED_DQN["LunarLander-v3"] = TUNED_DQN["Acrobot-v1"]
TUNED_PPO: dict[str, Any] = {
    "n_steps": 32, "batch_size": 256, "gae_lambda": 0.8, "gamma": 0.98, "n_epochs": 20,
    "ent_coef": 0.0, "learning_rate": LinearSchedule(1e-3, 0.0, 1.0),
    "clip_range": LinearSchedule(0.2, 0.0, 1.0),
    "policy_kwargs": {
        "ortho_init": False, "activation_fn": torch.nn.ReLU, "lstm_hidden_size": 64,
        "enable_critic_lstm": True, "net_arch": {"pi": [64], "vf": [64]},
    },
}  # fmt: skip
MASKED = "CartPoleNoVel-v1"
TASKS = ("CartPole-v1", MASKED, "Acrobot-v1", "LunarLander-v3")


@dataclass(frozen=True)
class Learner:
    """A learner of a task.

    Attributes
    ----------
    name
        As shown.
    make
        The model, from the task and the seed.
    """

    name: str
    make: Callable[[str, int], BaseAlgorithm]


def ours(task: str, seed: int) -> BaseAlgorithm:
    """DQN of this project with its section."""
    preset = learner_preset("dqn", task)
    env = make_vec_env(task, n_envs=preset.n_envs, seed=seed)
    return DQN(env=env, seed=seed, device="cpu", settings=preset.settings)


def sb3(task: str, seed: int) -> BaseAlgorithm:
    """DQN of stable-baselines3."""
    env, widths = make_vec_env(task, seed=seed), {"net_arch": [256, 256]}
    settings = TUNED_DQN[task]
    return SB3DQN("MlpPolicy", env, seed=seed, device="cpu", policy_kwargs=widths, **settings)


def recurrent_ppo(task: str, seed: int) -> BaseAlgorithm:
    """RecurrentPPO of sb3-contrib."""
    env = VecNormalize(make_vec_env(task, n_envs=8, seed=seed), gamma=TUNED_PPO["gamma"])
    return RecurrentPPO("MlpLstmPolicy", env, seed=seed, device="cpu", **TUNED_PPO)


def learners(task: str) -> tuple[Learner, Learner]:
    """Ours and the other one."""
    policy = learner_preset("dqn", task).arguments["policy"]
    if task == MASKED:
        return Learner(f"DQN, {policy}", ours), Learner("sb3-contrib RecurrentPPO", recurrent_ppo)
    return Learner(f"DQN, {policy}", ours), Learner("stable-baselines3 DQN", sb3)


def returns(model: BaseAlgorithm, task: str, starts: int = STARTS) -> NDArray[np.float64]:
    """Of one greedy episode from each start."""
    env: VecEnv = make_vec_env(task, n_envs=EPISODES, seed=starts)
    statistics = unwrap_vec_normalize(model.get_env())
    total, running = np.zeros(EPISODES), np.ones(EPISODES, dtype=bool)
    observation, state, begun = env.reset(), None, np.ones(EPISODES, dtype=bool)
    while running.any():
        if statistics is not None:
            observation = statistics.normalize_obs(observation)
        actions, state = model.predict(observation, state, begun, deterministic=True)
        observation, reward, begun, _ = env.step(actions)
        total += reward * running
        running &= ~begun
    env.close()
    return total


class Looks(BaseCallback):
    """Looks at the policy after every tenth of the steps, and leaves that out of the time.

    The networks of the best look are kept, with what scales their observations.
    """

    def __init__(self, task: str, steps: int) -> None:
        super().__init__()
        self.task, self.every = task, steps // LOOKS
        self.means: list[float] = []
        self.seconds: list[float] = []
        self.looking, self.begun = 0.0, time.process_time()
        self.best: tuple[dict[str, Any], Any] = ({}, None)

    def _on_step(self) -> bool:
        if self.num_timesteps >= self.every * (len(self.means) + 1) and len(self.means) < LOOKS - 1:
            self.look()
        return True

    def look(self) -> None:
        """The mean return now, and the processor time until now [s]."""
        before = time.process_time()
        self.seconds.append(before - self.begun - self.looking)
        self.means.append(float(returns(self.model, self.task).mean()))
        if self.means[-1] == max(self.means):
            scaling = unwrap_vec_normalize(self.model.get_env())
            self.best = copy.deepcopy(
                (self.model.policy.state_dict(), None if scaling is None else scaling.obs_rms)
            )
        self.looking += time.process_time() - before

    def best_again(self) -> float:
        """Mean return of the best look's networks, from starts that were not looked at."""
        weights, scales = self.best
        self.model.policy.load_state_dict(weights)
        scaling = unwrap_vec_normalize(self.model.get_env())
        if scaling is not None:
            scaling.obs_rms = scales
        return float(returns(self.model, self.task, FRESH_STARTS).mean())


def train(task: str, learner: Learner, seed: int, steps: int) -> dict[str, Any]:
    """Train and look; plain data."""
    torch.set_num_threads(1)
    model, looks = learner.make(task, seed), Looks(task, steps)
    model.learn(steps, callback=looks, log_interval=None)
    looks.look()  # the last one, after the last update
    found = {"returns": looks.means, "seconds": looks.seconds, "steps": steps}
    return found | {"best": looks.best_again()}


def cell(folder: Path, task: str, learner: Learner, seed: int, steps: int | None) -> dict[str, Any]:
    """What :func:`train` gave, now or before."""
    steps = learner_preset("dqn", task).n_timesteps if steps is None else steps
    name = learner.name.replace(" ", "_").replace(",", "")
    path = folder / f"{task}_{name}_{steps}_{seed}.json"
    if not path.exists():
        folder.mkdir(parents=True, exist_ok=True)
        found = train(task, learner, seed, steps)
        with write_then_rename(path) as part:
            part.write_text(json.dumps(found))
    found = json.loads(path.read_text())
    assert isinstance(found, dict)
    return found


def interval(values: Sequence[float]) -> str:
    """Mean and, of more than one, Student's t interval over seeds."""
    mean, n = float(np.mean(values)), len(values)
    digits = 0 if abs(mean) >= 20 else 2
    if n == 1:
        return f"{mean:.{digits}f}"
    sd = float(np.std(values, ddof=1))
    half = float(stats.t.ppf(0.975, n - 1)) * sd / np.sqrt(n)
    return f"{mean:.{digits}f} [{mean - half:.{digits}f}, {mean + half:.{digits}f}]"


def row(task: str, name: str, cells: Sequence[dict[str, Any]]) -> list[str]:
    """A row of the table."""
    end = [each["returns"][-1] for each in cells]
    late = [float(np.mean(each["returns"][-LAST_LOOKS:])) for each in cells]
    seconds = [each["seconds"][-1] for each in cells]
    best = [each["best"] for each in cells]
    paid = interval([r / s for r, s in zip(best, seconds, strict=True)]) if min(best) > 0 else "–"
    ends, bests = (", ".join(f"{r:.0f}" for r in values) for values in (end, best))
    return [task, name, f"{cells[0]['steps']:,}", interval(end), ends, interval(late),
            interval(best), bests, f"{np.mean(seconds):.0f}", paid]  # fmt: skip


def lacking(task: str) -> str | None:
    """Why a task cannot be made, or None."""
    try:
        make_vec_env(task).close()
    except DependencyNotInstalled as error:
        return f"{task} is left out: {str(error).splitlines()[0]} (pip install animarl[classic])"
    return None


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--task", action="append", choices=TASKS, help="one of them; default all")
    parser.add_argument("--seed", action="append", type=int, help="default 0, 1 and 2")
    parser.add_argument("--steps", type=int, help="instead of those of the section")
    parser.add_argument("--out", type=Path, default=Path("out/classic"))
    arguments = parser.parse_args()
    warnings.filterwarnings("ignore", category=UserWarning)
    table = Table(title="Ordinary tasks, greedy return, one thread")
    table.add_column("task")
    table.add_column("learner")
    for heading in ("steps", "return at the end", "per seed", "mean of the last looks",
                    "best look, other starts", "per seed", "processor s",
                    "its return per processor s"):  # fmt: skip
        table.add_column(heading, justify="right")
    console = Console()
    console.width = max(console.width, 180)
    for task in arguments.task or TASKS:
        if reason := lacking(task):
            console.print(reason, markup=False)
            continue
        for learner in learners(task):
            cells = []
            for seed in arguments.seed or (0, 1, 2):
                cells.append(cell(arguments.out, task, learner, seed, arguments.steps))
                last = cells[-1]
                console.print(
                    f"{task}, {learner.name}, seed {seed}: returns "
                    f"{[round(r) for r in last['returns']]}, {last['seconds'][-1]:.0f} s"
                )
            table.add_row(*row(task, learner.name, cells))
    console.print(table)
    console.print(f"load {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores")


if __name__ == "__main__":
    main()
