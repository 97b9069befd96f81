"""How hard the registered tasks are: what policies earn in ``gym.make("AnimaRL/AgentTask-v0")``

    python benchmarks/tasks.py [--quick] [--task AgentTask ...] [--seed 0 ...] [--out FOLDER]

A task has a part of the table for each individual that may act: ``AgentTask`` is for the first
pursuer, ``AgentTask:prey`` for ``focal="prey"``. Rows: actions drawn at random; the best of all
policies that always take one action; the individual's own script (pursuers intercept, targets flee;
the moth's is the programme ``animarl_envs.worlds.search.programmed_moth``, which needs the full
observation, and finds few sources from starts to the side and upwind); the packaged clone, where it
can act in the task's world; stable-baselines3's PPO, which has no memory, and sb3-contrib's
RecurrentPPO, both with the settings below for every task; and the packaged demonstrations, which
are synthetic: what the task would have paid the individual for its episode, from its start there.

Returns are means of the first episode of 500 copies, whose starts no learner was trained on; all
policies act as they do in training, at random where their distribution says so. A score is the
return with random at 0 and the best learner's mean over seeds at 1 (of the learners with the most
seeds); the spread is that of the seeds' returns. A row of a learner is written when it is done, so
that a stopped command goes on; rows of earlier commands with other steps stay in the table.
``--quick``: one seed, few steps, two minutes, into ``out/tasks_quick``; it shows that everything
runs, not what learners can do.
"""

from __future__ import annotations

import argparse
import csv
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table
from sb3_contrib import RecurrentPPO
from sb3_contrib.common.recurrent.policies import RecurrentActorCriticPolicy
from stable_baselines3 import PPO
from stable_baselines3.common.on_policy_algorithm import OnPolicyAlgorithm
from stable_baselines3.common.vec_env import VecEnv, VecMonitor, VecNormalize
from stable_baselines3.common.vec_env.base_vec_env import VecEnvObs, VecEnvStepReturn

from animarl_envs.demos.packaged import load_packaged
from animarl_envs.files import write_then_rename
from animarl_envs.focus import first_pursuer
from animarl_envs.species import SearchSpecies
from animarl_envs.tasks import TASKS
from animarl_envs.views.vector import AnimalVectorEnv
from animarl_envs.worlds import make_world
from animarl_envs.worlds.search.programmed_moth import ProgrammedMoth

EPISODES, STARTS, CHOICE_STARTS = 500, 1_000_000, 2_000_000
"""Episodes of a mean, the seed of their starts, and that of those the constant is chosen by."""
COPIES, ROLLOUT = 64, 128
STEPS = {
    "AgentTask": 500_000,
    "FlyTask": 2_000_000,
    "NewtTask": 3_000_000,
    "SilkmothTask": 1_000_000,
    "SilkmothMemory": 2_000_000,
    "AgentTask:prey": 500_000,
    "FlyTask:female": 2_000_000,
    "NewtTask:female": 2_000_000,
}
"""Steps of training, the same for both learners; those of a task hold for its other pursuers."""
SETTINGS: dict[str, Any] = {
    "n_steps": ROLLOUT, "batch_size": 2048, "n_epochs": 5, "gamma": 0.998, "gae_lambda": 0.95,
    "learning_rate": 1e-3, "ent_coef": 0.005, "device": "cpu",
}  # fmt: skip


class WholeSequences(RecurrentActorCriticPolicy):
    """sb3-contrib's recurrent policy, whose LSTM goes over a sequence in one call.

    Sequences of a minibatch end where their episode does, so only their first step can be a start.
    sb3-contrib calls the LSTM for every step of them instead, which takes several times as long.
    """

    @staticmethod
    def _process_sequence(
        features: torch.Tensor,
        lstm_states: tuple[torch.Tensor, torch.Tensor],
        episode_starts: torch.Tensor,
        lstm: torch.nn.LSTM,
    ) -> tuple[torch.Tensor, torch.Tensor]:
        starts = episode_starts.reshape(lstm_states[0].shape[1], -1)
        assert not starts[:, 1:].any()
        kept = (1.0 - starts[:, :1])[None]
        states = (kept * lstm_states[0], kept * lstm_states[1])
        return RecurrentActorCriticPolicy._process_sequence(
            features, states, torch.zeros_like(episode_starts), lstm
        )


LEARNERS: dict[str, tuple[type[OnPolicyAlgorithm], Any, dict[str, Any]]] = {
    "PPO": (PPO, "MlpPolicy", {"net_arch": [64, 64]}),
    "RecurrentPPO": (
        RecurrentPPO, WholeSequences,
        {"net_arch": [64], "lstm_hidden_size": 64, "enable_critic_lstm": False,
         "shared_lstm": True},
    ),
}  # fmt: skip
SHOWN = "demonstrations (synthetic)"
Act = Callable[[NDArray[np.float32], NDArray[np.bool_]], NDArray[np.int64]]
"""Actions of all copies, from what they see and which of them have just begun."""


def tasks_by_individual() -> list[str]:
    """The tasks, and behind a colon which individual acts where it is not the first pursuer."""
    listed = []
    for name, task in TASKS.items():
        names, first = task.base.individuals, first_pursuer(task.base.roles)
        listed += [name] + [f"{name}:{who}" for i, who in enumerate(names) if i != first]
    return listed


def of_task(task: str) -> dict[str, Any]:
    """Arguments of ``gym.make`` for one of :func:`tasks_by_individual`."""
    name, _, focal = task.partition(":")
    return {"id": f"AnimaRL/{name}-v0"} | ({"focal": focal} if focal else {})


class SlotsOnly(VecEnv):
    """A ``VecEnv`` of arrays, whose slots are no environments of their own."""

    def close(self) -> None:
        """Nothing is open."""

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        return [getattr(self, attr_name)] * self.num_envs

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        setattr(self, attr_name, value)

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any) -> Any:
        return [getattr(self, method_name)(*args, **kwargs)] * self.num_envs

    def env_is_wrapped(self, wrapper_class: type, indices: Any = None) -> list[bool]:
        return [False] * self.num_envs


class ManyCopies(SlotsOnly):
    """``gym.make_vec``'s native copies as a stable-baselines3 ``VecEnv``."""

    def __init__(self, task: str, copies: int, seed: int, **options: Any) -> None:
        made = gym.make_vec(**of_task(task), num_envs=copies, autoreset_mode="SameStep", **options)
        assert isinstance(made.unwrapped, AnimalVectorEnv)
        self.env, self.first, self.render_mode = made.unwrapped, seed, None
        super().__init__(copies, self.env.single_observation_space, self.env.single_action_space)

    def reset(self) -> VecEnvObs:
        return self.env.reset(seed=self.first)[0]

    def step_async(self, actions: NDArray[Any]) -> None:
        self.actions = actions

    def step_wait(self) -> VecEnvStepReturn:
        seen, reward, terminated, truncated, told = self.env.step(self.actions)
        done, infos = terminated | truncated, [{} for _ in range(self.num_envs)]
        for b in np.flatnonzero(done):
            infos[b] = {
                "terminal_observation": told["final_obs"][b],
                "TimeLimit.truncated": bool(truncated[b]),
            }
        return seen, reward, done, infos


def mean_return(task: str, act: Act, episodes: int, seed: int = STARTS, **options: Any) -> float:
    """Mean return of the first episode of each copy."""
    env = ManyCopies(task, episodes, seed, **options)
    seen: Any = env.reset()
    total, running, begun = np.zeros(episodes), np.ones(episodes, bool), np.ones(episodes, bool)
    while running.any():
        env.step_async(act(seen, begun))
        seen, reward, begun, _ = env.step_wait()
        total += reward * running
        running &= ~begun
    return float(total.mean())


def constant(action: int) -> Act:
    """Always the same action."""
    return lambda seen, begun: np.full(len(seen), action)


# -- rows that nobody learns -----------------------------------------------------------------------


def world_of(task: str) -> Any:
    """The task's world, one copy."""
    env = gym.make(**of_task(task)).unwrapped
    return env.world  # type: ignore[attr-defined]


def random_row(task: str, episodes: int) -> float:
    """Actions drawn at random."""
    count, rng = world_of(task).num_actions, np.random.default_rng(0)
    return mean_return(task, lambda seen, begun: rng.integers(count, size=len(seen)), episodes)


def best_constant(task: str, episodes: int) -> tuple[int, float]:
    """The action that earns most if it is always taken, on other starts, and what it earns."""
    actions = range(world_of(task).num_actions)
    earned = [mean_return(task, constant(a), episodes, CHOICE_STARTS) for a in actions]
    best = int(np.argmax(earned))
    return best, mean_return(task, constant(best), episodes)


def scripted_row(task: str, episodes: int) -> float | None:
    """The individual's own script: a pursuer intercepts, a target flees, the moth has a programme.

    The programme needs more than odour.
    """
    made: Any = ManyCopies(task, episodes, STARTS).env
    species, focal = made.scenario.species, made.focal_index
    if not isinstance(species, SearchSpecies):
        drivers = ("scripted",) * species.num_individuals
        world = make_world(replace(made.scenario, drivers=drivers), episodes)
        world.seed(STARTS + np.arange(episodes))
        world.reset()
        total, running = np.zeros(episodes), np.ones(episodes, bool)
        while running.any():
            world.step(np.zeros((episodes, species.num_individuals), dtype=np.int64))
            total += world.reward[:, focal] * running
            running &= ~(world.terminated | world.truncated)
        return float(total.mean())
    if species.observation == "odour":
        return None
    moths = ProgrammedMoth(episodes, np.random.default_rng(0), species)

    def act(seen: NDArray[np.float32], begun: NDArray[np.bool_]) -> NDArray[np.int64]:
        moths.reset(begun)
        return moths.act(seen[:, None])[:, 0]

    return mean_return(task, act, episodes, observation="full")


def clone_row(task: str, episodes: int) -> float | None:
    """The packaged clone drives the first pursuer, by all that it observed when it learned."""
    if world_of(task).scenario.species.observation == "odour":
        return None
    from animarl_algos.evaluation.collect import remembered  # baselines.py may not have what they
    from animarl_algos.runs.pretrained import load_pretrained  # need, and imports this file

    view: Any = gym.make(**of_task(task), observation="full").unwrapped
    model = load_pretrained(view.scenario.species.name)
    world, focal = make_world(view.scenario, episodes), view.focal_index
    world.seed(STARTS + np.arange(episodes))
    world.reset()
    model.set_random_seed(0)
    count, flagged = world.num_individuals, len(world.observation_components)
    flag = model.observation_space.shape[0] - flagged  # clones of two conditions are told which
    if flag not in (0, 1):
        return None  # it saw walls, or none, and the task has it the other way
    total, running, state = np.zeros(episodes), np.ones(episodes, bool), None
    begun = np.ones(episodes * count, bool)
    while running.any():
        seen = world.observation.reshape(episodes * count, flagged)
        told = np.repeat(world.condition, count)[:, None].astype(np.float32)[:, :flag]
        actions, state = model.predict(np.hstack([seen, told]), state, begun)
        asked = np.asarray(actions).reshape(episodes, count)
        state = remembered(model, state, asked, world.executed(asked))
        world.step(asked)
        begun[:] = False
        total += world.reward[:, focal] * running
        running &= ~(world.terminated | world.truncated)
    return float(total.mean())


def shown_row(task: str) -> float:
    """What the individual's packaged episodes would have been paid."""
    made: Any = gym.make(**of_task(task)).unwrapped
    species, i = made.scenario.species, made.focal_index
    demos = load_packaged(species.name).select(split="train")
    steps = np.minimum(demos.lengths - 1, species.time_limit)
    if len(species.roles) > 1 and species.roles[i] == "target":
        return float(np.mean(species.dt * (steps - (demos.outcome > 0))))
    shared = demos.condition == 1 if getattr(species, "shared_reward", False) else False
    touched = (demos.outcome == i + 1) | ((demos.outcome > 0) & shared)
    return float(np.mean(touched - species.step_cost * steps))


# -- learners --------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Learned:
    """A trained policy as it acts: its observations normalised, its memory kept."""

    model: OnPolicyAlgorithm
    scaling: VecNormalize

    def policy(self) -> Act:
        """Acts from the first step on."""
        memory: list[Any] = [None]

        def act(seen: NDArray[np.float32], begun: NDArray[np.bool_]) -> NDArray[np.int64]:
            scaled: Any = self.scaling.normalize_obs(seen)
            actions, memory[0] = self.model.predict(scaled, memory[0], begun, deterministic=False)
            return actions

        return act


def train(task: str, name: str, seed: int, steps: int) -> Learned:
    """A learner after so many steps."""
    torch.set_num_threads(1)
    kind, policy, widths = LEARNERS[name]
    copies = ManyCopies(task, COPIES, seed * COPIES)
    env = VecNormalize(VecMonitor(copies), gamma=SETTINGS["gamma"])
    model: Any = kind(policy, env, seed=seed, policy_kwargs=widths, **SETTINGS)  # type: ignore[arg-type]
    model.learn(steps)
    return Learned(model, env)


def learned_row(task: str, name: str, seed: int, steps: int, episodes: int) -> float:
    """A learner trained and then asked."""
    return mean_return(task, train(task, name, seed, steps).policy(), episodes)


# -- the table -------------------------------------------------------------------------------------

COLUMNS = ("task", "policy", "steps", "return", "spread", "score", "seeds")
HEADINGS = ("task", "policy", "seed", "steps", "return")


class Rows:
    """Rows of the CSV file: those there are, and those that are computed now."""

    def __init__(self, path: Path) -> None:
        self.path, self.rows = path, dict[tuple[str, ...], str]()
        if path.exists():
            with path.open() as file:
                self.rows = {tuple(row[:4]): row[4] for row in list(csv.reader(file))[1:]}

    def need(
        self, task: str, policy: str, seed: str, steps: str, find: Callable[[], float | None]
    ) -> float | None:
        """The return of a row, found now or before."""
        key = (task, policy, seed, steps)
        if key not in self.rows:
            began, value = time.process_time(), find()
            self.rows[key] = "" if value is None else f"{value:.4f}"
            print(*key, self.rows[key], f"{time.process_time() - began:.0f} s", flush=True)
            self.path.parent.mkdir(parents=True, exist_ok=True)
            with write_then_rename(self.path) as part, part.open("w", newline="") as file:
                csv.writer(file, lineterminator="\n").writerows(
                    [HEADINGS, *sorted((*key, value) for key, value in self.rows.items())]
                )
        return float(self.rows[key]) if self.rows[key] else None


def measure(
    rows: Rows, task: str, learners: Sequence[str], seeds: Sequence[int], quick: bool
) -> None:
    """All rows of a task."""
    episodes = 50 if quick else EPISODES
    rows.need(task, "random", "", "", lambda: random_row(task, episodes))
    actions = world_of(task).num_actions
    done = [policy for of, policy, *_ in rows.rows if of == task and "constant" in policy]
    if not done:
        best, earned = best_constant(task, episodes)
        rows.need(task, f"constant {best} of {actions}", "", "", lambda: earned)
    rows.need(task, "scripted", "", "", lambda: scripted_row(task, episodes))
    rows.need(task, "packaged clone", "", "", lambda: clone_row(task, episodes))
    rows.need(task, SHOWN, "", "", lambda: shown_row(task))
    for name in learners:
        steps = 2 * COPIES * ROLLOUT if quick else STEPS.get(task, STEPS[task.partition(":")[0]])
        for seed in seeds:
            find = partial(learned_row, task, name, seed, steps, episodes)
            rows.need(task, name, str(seed), str(steps), find)


def scores(rows: Rows, task: str) -> list[tuple[str, ...]]:
    """Rows of the table of a task: policies that have a return, learners once for all steps."""
    found: dict[tuple[str, str], list[float]] = {}
    for (of, policy, _, steps), value in rows.rows.items():
        if of == task and value:
            found.setdefault((policy, steps), []).append(float(value))
    seeds = {key: len(values) for key, values in found.items() if key[0] in LEARNERS}
    if not seeds:
        return []
    means = {key: float(np.mean(values)) for key, values in found.items()}
    floor = means["random", ""]
    best = max(means[key] for key, count in seeds.items() if count == max(seeds.values()))
    constants = [policy for policy, _ in means if policy.startswith("constant")]
    order = ["random", *constants, "scripted", "packaged clone", *LEARNERS, SHOWN]
    listed: list[tuple[str, ...]] = []
    for key in sorted(found, key=lambda key: (order.index(key[0]), int(key[1] or 0))):
        policy, steps = key
        mean, score = f"{means[key]:.3f}", f"{(means[key] - floor) / (best - floor):.2f}"
        low, high = min(found[key]), max(found[key])
        spread = f"{low:.2f} to {high:.2f}" if len(found[key]) > 1 else ""
        listed.append((task, policy, steps, mean, spread, score, str(seeds.get(key, ""))))
    return listed


def parsed_arguments(
    doc: str | None, tasks: Sequence[str], learners: Iterable[str]
) -> argparse.Namespace:
    """Options of this benchmark and of that of teams, with what they are by default."""
    parser = argparse.ArgumentParser(
        description=doc, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--task", action="append", choices=tasks, help="one of them; default all")
    parser.add_argument("--seed", action="append", type=int, help="default 0, 1 and 2")
    parser.add_argument(
        "--learner", action="append", choices=list(learners), help="one of them; default all"
    )
    parser.add_argument("--quick", action="store_true", help="that everything runs")
    parser.add_argument("--out", type=Path)
    found = parser.parse_args()
    found.task = found.task or list(tasks)
    found.learner = found.learner or list(learners)
    found.seed = found.seed or ([0] if found.quick else [0, 1, 2])
    return found


def write_table(
    title: str, columns: Sequence[str], rows: Sequence[tuple[str, ...]], path: Path
) -> None:
    """Print a table, and write it as CSV."""
    table = Table(title=title)
    for heading in columns:
        table.add_column(heading)
    for row in rows:
        table.add_row(*row)
    with write_then_rename(path) as part, part.open("w", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows([columns, *rows])
    Console().print(table)


def main() -> None:
    arguments = parsed_arguments(__doc__, tasks_by_individual(), LEARNERS)
    out = arguments.out or Path("out/tasks_quick" if arguments.quick else "docs/results/tasks")
    rows = Rows(out / "scores.csv")
    for task in arguments.task:
        measure(rows, task, arguments.learner, arguments.seed, arguments.quick)
    listed = [
        row for task in tasks_by_individual() for row in scores(rows, task)
    ]  # of earlier commands too
    title = "Returns and scores (random 0, best learner 1)"
    write_table(title, COLUMNS, listed, out / "table.csv")


if __name__ == "__main__":
    main()
