"""Baselines of a team: all pursuers of a task act, and the target follows its script.

    python benchmarks/baselines.py [--quick] [--task AgentTask ...] [--seed 0 ...] [--out FOLDER]

Independent PPO and DQN are stable-baselines3's, one network for all pursuers, who are rows of one
``VecEnv``. IPPO, MAPPO and QMIX are BenchMARL's, which learns all pursuers of 64 copies as one
batched TorchRL environment. BenchMARL 1.5.2 needs an older TorchRL (0.11) than this project's
tests, so it lives in an environment of its own, which can run all rows:

    python -m venv marl && marl/bin/pip install benchmarl==1.5.2 stable-baselines3 sb3-contrib \\
        numba pettingzoo scipy pyyaml pydantic rich
    PYTHONPATH=. marl/bin/python benchmarks/baselines.py

Without BenchMARL its rows are left out. Agents share the reward of a capture (condition 1); males
of flies and newts do not. A return is the mean over the pursuers of the first episode of 500
copies, whose starts no learner was trained on; PPO's policies draw their actions, as in training,
and those of Q-learning take the best one. All learners see observations that are scaled by the mean
and the deviation of random play. A score is the return with random at 0 and the packaged
demonstrations at 1, which are synthetic, started elsewhere and met no scripted target. A row is
written when it is done, so that a stopped command goes on. ``--quick``: one seed and few steps; it
shows that everything runs.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Sequence
from functools import cache, partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3 import DQN, PPO
from stable_baselines3.common.vec_env.base_vec_env import VecEnvObs, VecEnvStepReturn
from tasks import SHOWN, Rows, SlotsOnly, parsed_arguments, write_table

from animarl_envs.demos.packaged import load_packaged
from animarl_envs.scenario import make_scenario
from animarl_envs.species import Species
from animarl_envs.tasks import find_task
from animarl_envs.worlds import make_world

TASKS = ("AgentTask", "FlyTask", "NewtTask")
EPISODES, STARTS, SCALING_STARTS = 500, 1_000_000, 3_000_000
COPIES, ROLLOUT, STEPS = 64, 128, 1_200_000
GAMMA, WIDTHS = 0.995, [64, 64]
Act = Callable[[NDArray[np.float32]], NDArray[np.int64]]
"""Actions ``(B, P)`` of all pursuers from what they see, ``(B, P, n)``."""


def animals(task: str) -> Species:
    """The species of a task, whose name may be in capitals or not."""
    found = find_task(task)
    assert found is not None
    return found.base


class Team:
    """Copies of a task's world; observations ``(B, P, n)``, actions and rewards ``(B, P)``."""

    def __init__(self, task: str, copies: int, seed: int) -> None:
        species = animals(task)
        shared = {"condition": 1} if getattr(species, "shared_reward", False) else {}
        drivers = {
            name: "scripted"
            for name, role in zip(species.individuals, species.roles)
            if role == "target"
        }
        scenario = make_scenario(task, drivers=drivers, **shared)
        self.pursuers = [i for i, role in enumerate(species.roles) if role != "target"]
        self.names = [species.individuals[i] for i in self.pursuers]
        self.world = make_world(scenario, copies, self.pursuers)
        self.world.seed(seed + np.arange(copies))
        self._asked = np.zeros((copies, len(species.individuals)), dtype=np.int64)

    def reset(self, mask: NDArray[np.bool_] | None = None) -> NDArray[np.float32]:
        """Begin new episodes, everywhere or where ``mask`` says; return what is seen."""
        self.world.reset(mask)
        return self.seen()

    def seen(self) -> NDArray[np.float32]:
        """What the pursuers see, as a copy."""
        return self.world.observation[:, self.pursuers]

    def step(
        self, actions: NDArray[Any]
    ) -> tuple[NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_]]:
        """Rewards, and which copies were terminated or truncated; none begins anew."""
        self._asked[:, self.pursuers] = actions
        self.world.step(self._asked)
        world = self.world
        return world.reward[:, self.pursuers], world.terminated.copy(), world.truncated.copy()


@cache
def scaling(task: str) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Mean and deviation of what pursuers see who act at random."""
    team, rng, rows = Team(task, COPIES, SCALING_STARTS), np.random.default_rng(0), []
    team.reset()
    for _ in range(200):
        _, terminated, truncated = team.step(
            rng.integers(team.world.num_actions, size=(COPIES, len(team.pursuers)))
        )
        rows.append(team.reset(terminated | truncated))
    seen = np.concatenate(rows).reshape(-1, rows[0].shape[-1])
    return seen.mean(axis=0), np.maximum(seen.std(axis=0), 1e-3)


def scaled(task: str, seen: NDArray[np.float32]) -> NDArray[np.float32]:
    """What learners are shown."""
    mean, deviation = scaling(task)
    return np.clip((seen - mean) / deviation, -10.0, 10.0)


def mean_return(task: str, act: Act, episodes: int) -> float:
    """Mean return of a pursuer in the first episode of each copy."""
    team = Team(task, episodes, STARTS)
    seen = team.reset()
    total, running = np.zeros(episodes), np.ones(episodes, bool)
    while running.any():
        reward, terminated, truncated = team.step(act(scaled(task, seen)))
        total += reward.mean(axis=1) * running
        running &= ~(terminated | truncated)
        seen = team.seen()
    return float(total.mean())


def random_row(task: str, episodes: int) -> float:
    """Actions drawn at random."""
    count, rng = animals(task).num_actions, np.random.default_rng(0)
    return mean_return(task, lambda seen: rng.integers(count, size=seen.shape[:2]), episodes)


def shown_row(task: str) -> float:
    """What the pursuers' packaged episodes would have been paid, the mean over pursuers."""
    team, demos = Team(task, 1, 0), load_packaged(animals(task).name).select(split="train")
    species = team.world.scenario.species
    touched = (demos.outcome > 0).astype(float)
    touched /= 1 if getattr(species, "shared_reward", False) else len(team.pursuers)
    steps = np.minimum(demos.lengths - 1, species.time_limit)
    return float(np.mean(touched - species.step_cost * steps))


# -- stable-baselines3: every pursuer of every copy is one environment -----------------------------


class Slots(SlotsOnly):
    """Pursuer ``s % P`` of copy ``s // P`` as slot ``s``."""

    def __init__(self, task: str, seed: int) -> None:
        self.task, self.team, self.render_mode = task, Team(task, COPIES, seed), None
        self.each, components = len(self.team.pursuers), len(self.team.world.observation_components)
        box = gym.spaces.Box(-10.0, 10.0, (components,))
        super().__init__(COPIES * self.each, box, gym.spaces.Discrete(self.team.world.num_actions))

    def _shown(self) -> NDArray[np.float32]:
        return scaled(self.task, self.team.seen()).reshape(self.num_envs, -1)

    def reset(self) -> VecEnvObs:
        self.team.reset()
        return self._shown()

    def step_async(self, actions: NDArray[Any]) -> None:
        self.actions = actions

    def step_wait(self) -> VecEnvStepReturn:
        reward, terminated, truncated = self.team.step(self.actions.reshape(COPIES, self.each))
        ended, last = terminated | truncated, self._shown()
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        for s in np.flatnonzero(np.repeat(ended, self.each)):
            cut = bool(truncated[s // self.each])
            infos[s] = {"terminal_observation": last[s], "TimeLimit.truncated": cut}
        if ended.any():
            self.team.reset(ended)
        done = np.repeat(ended, self.each)
        return self._shown(), reward.reshape(-1).astype(np.float32), done, infos


def of_stable_baselines(task: str, name: str, seed: int, steps: int) -> Act:
    """PPO or DQN after so many steps of the world."""
    env = Slots(task, seed * COPIES)
    usual: dict[str, Any] = {"gamma": GAMMA, "seed": seed, "device": "cpu"}
    usual["policy_kwargs"] = {"net_arch": WIDTHS}
    if name == "PPO":
        model: Any = PPO(
            "MlpPolicy", env, n_steps=ROLLOUT, batch_size=2048 * env.each, n_epochs=5,
            gae_lambda=0.95, learning_rate=1e-3, ent_coef=0.005, **usual,
        )  # fmt: skip
    else:
        model = DQN(
            "MlpPolicy", env, learning_rate=5e-4, buffer_size=200_000, batch_size=512,
            learning_starts=10_000, train_freq=4, gradient_steps=4, target_update_interval=8192,
            exploration_fraction=0.5, exploration_final_eps=0.05, **usual,
        )  # fmt: skip
    model.learn(steps * env.each)

    def act(seen: NDArray[np.float32]) -> NDArray[np.int64]:
        flat = seen.reshape(-1, seen.shape[-1])
        actions = model.predict(flat, deterministic=name == "DQN")[0]
        return np.asarray(actions).reshape(seen.shape[:2])

    return act


# -- BenchMARL: the copies are one batched TorchRL environment -------------------------------------


def of_benchmarl(task: str, name: str, seed: int, steps: int) -> Act:
    """IPPO, MAPPO or QMIX after so many steps of the world."""
    from benchmarl.algorithms import IppoConfig, MappoConfig, QmixConfig
    from benchmarl.experiment import Experiment, ExperimentConfig
    from benchmarl.models.mlp import MlpConfig
    from tensordict import TensorDict
    from torchrl.envs import ExplorationType, set_exploration_type
    from torchrl_team import TeamTask

    model = MlpConfig.get_from_yaml()
    model.num_cells = WIDTHS
    kinds = {"IPPO": IppoConfig, "MAPPO": MappoConfig, "QMIX": QmixConfig}
    algorithm: Any = kinds[name].get_from_yaml()
    on_policy = name != "QMIX"
    if on_policy:
        # No bonus for entropy: advantages are not scaled, so it would outweigh them.
        algorithm.lmbda = 0.95
    config = ExperimentConfig.get_from_yaml()
    changed = {
        "gamma": GAMMA, "lr": 1e-3 if on_policy else 5e-4, "max_n_frames": steps,
        "on_policy_collected_frames_per_batch": COPIES * ROLLOUT,
        "on_policy_n_envs_per_worker": COPIES, "on_policy_n_minibatch_iters": 5,
        "on_policy_minibatch_size": 2048, "off_policy_n_envs_per_worker": COPIES,
        "off_policy_collected_frames_per_batch": 4 * COPIES, "off_policy_n_optimizer_steps": 4,
        "off_policy_train_batch_size": 512, "off_policy_memory_size": 100_000,
        "off_policy_init_random_frames": 5_120, "exploration_eps_init": 1.0,
        "exploration_eps_end": 0.05, "exploration_anneal_frames": steps // 2,
        "evaluation": False, "render": False, "loggers": [], "create_json": False,
    }  # fmt: skip
    with tempfile.TemporaryDirectory() as folder:
        for key, value in {**changed, "save_folder": folder}.items():
            assert hasattr(config, key), key
            setattr(config, key, value)
        experiment = Experiment(
            TeamTask(task.upper(), {}), algorithm, model, seed, config, MlpConfig(**vars(model))
        )
        experiment.run()
    kind = ExplorationType.RANDOM if on_policy else ExplorationType.DETERMINISTIC

    def act(seen: NDArray[np.float32]) -> NDArray[np.int64]:
        shown = TensorDict({"observation": torch.as_tensor(seen)}, seen.shape[:2])
        with torch.no_grad(), set_exploration_type(kind):
            told = experiment.policy(TensorDict({"team": shown}, seen.shape[:1]))
        return np.asarray(told["team", "action"].numpy())

    return act


# -- the table -------------------------------------------------------------------------------------

LEARNERS = {
    "PPO": ("stable-baselines3", of_stable_baselines),
    "DQN": ("stable-baselines3", of_stable_baselines),
    "IPPO": ("BenchMARL", of_benchmarl),
    "MAPPO": ("BenchMARL", of_benchmarl),
    "QMIX": ("BenchMARL", of_benchmarl),
}
COLUMNS = ("task", "policy", "library", "steps", "return", "spread", "score", "seeds")


def learned_row(task: str, name: str, seed: int, steps: int, episodes: int) -> float:
    """A learner trained and then asked."""
    torch.set_num_threads(1)
    return mean_return(task, LEARNERS[name][1](task, name, seed, steps), episodes)


def table(rows: Rows) -> list[tuple[str, ...]]:
    """Mean, lowest and highest return over seeds of every task and policy that has any."""
    listed: list[tuple[str, ...]] = []
    for task in TASKS:
        found: dict[str, list[float]] = {}
        trained: dict[str, str] = {}
        for (of, policy, _, steps), value in rows.rows.items():
            if of == task:
                found.setdefault(policy, []).append(float(value))
                trained[policy] = steps
        if {"random", SHOWN} - found.keys():
            continue
        floor, top = found["random"][0], found[SHOWN][0]
        for policy in ("random", *LEARNERS, SHOWN):
            if policy not in found:
                continue
            values = found[policy]
            mean = float(np.mean(values))
            spread = f"{min(values):.2f} to {max(values):.2f}" if len(values) > 1 else ""
            library = LEARNERS[policy][0] if policy in LEARNERS else ""
            score, seeds = f"{(mean - floor) / (top - floor):.2f}", str(len(values))
            listed.append(
                (task, policy, library, trained[policy], f"{mean:.3f}", spread, score,
                 seeds if library else "")
            )  # fmt: skip
    return listed


def measure(
    rows: Rows, task: str, learners: Sequence[str], seeds: Sequence[int], quick: bool
) -> None:
    """All rows of a task that can be computed here."""
    episodes = 50 if quick else EPISODES
    rows.need(task, "random", "", "", lambda: random_row(task, episodes))
    rows.need(task, SHOWN, "", "", lambda: shown_row(task))
    for name in learners:
        if LEARNERS[name][0] == "BenchMARL" and find_spec("benchmarl") is None:
            print(f"{task} {name}: left out, BenchMARL is not installed here")
            continue
        steps = 2 * COPIES * ROLLOUT if quick else STEPS
        for seed in seeds:
            find = partial(learned_row, task, name, seed, steps, episodes)
            rows.need(task, name, str(seed), str(steps), find)


def main() -> None:
    arguments = parsed_arguments(__doc__, TASKS, LEARNERS)
    out = arguments.out or Path("out/baselines_quick" if arguments.quick else "docs/results/tasks")
    rows = Rows(out / "team_scores.csv")
    for task in arguments.task:
        measure(rows, task, arguments.learner, arguments.seed, arguments.quick)
    title = "Teams: returns and scores (random 0, demonstrations 1)"
    write_table(title, COLUMNS, table(rows), out / "teams.csv")


if __name__ == "__main__":
    main()
