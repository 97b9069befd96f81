"""Speed of the learners, beside the published figures of the authors' code and SB3's own DQN.

    python benchmarks/learners.py [--quick]
    python benchmarks/learners.py --profile
    python benchmarks/learners.py --devices

One run, one process, one thread, on the packaged demonstrations of the agents (three individuals,
each its own network). What is measured:

acting      collection without updates, all included: a step of 16 copies of the world, the rows of
            the dynamic time warping, the networks with their memories, one epsilon draw per slot,
            and recording into the replay memory. Steps of the world per second.
update      one update at the paper's batch, 32 episodes of 3 individuals, all included: drawing
            from the prioritised replay, both networks, masks, clipping per individual, Adam, new
            priorities. The replay is filled with synthetic episodes (random numbers) of 57 or 148
            steps on average, the lengths at which the authors' code was timed.
offline     one epoch over the 400 episodes of the training split, in batches of 16.
paper run   Agent, DQDIL, the paper's settings: a stretch of real training, and the evaluation of 5
            rollouts from each of 50 starts, extrapolated to 1,005,000 steps of the world.
CartPole    feed-forward DQN and QRDQN here and in stable-baselines3 and sb3-contrib: same widths,
            batch and frequency of updates, transitions drawn uniformly, no weight decay; the two in
            turns, by processor time, the ratio a median. Here the network is dueling and is asked
            about the next state too (double Q); there it is not.

A figure is the best of many short repeats, the one least disturbed by whatever else runs; between
processes of different sessions Linux shares the processor evenly whatever their nice level, so on a
busy machine look at the load in the last line.

``--profile`` prints what an update of DQDIL at mean length 57 is made of, and nothing else;
``--devices`` the time of an update on the CPU and on a CUDA device beside it, where there is one.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import gymnasium as gym
import numpy as np
import sb3_contrib
import stable_baselines3
import torch
from rich.console import Console
from rich.table import Table

from animarl_algos.data.vec_env import SlotVecEnv
from animarl_algos.evaluation.collect import collect_rollouts
from animarl_algos.evaluation.metrics import measure
from animarl_algos.learner.algorithm import SequenceQLearning
from animarl_algos.learner.presets import learner_preset
from animarl_algos.learner.pretraining import validation_figures
from animarl_algos.recipes.registry import DQDIL, named_recipe
from animarl_envs.scenario import make_scenario
from animarl_envs.species import AGENT
from animarl_envs.worlds import make_world

COPIES, BATCH = 16, 32
PAPER_STEPS = 1_005_000
TEST_STARTS, REPETITIONS = 50, 5

# Published: the authors' code on this kind of machine.
PUBLISHED_UPDATE = {
    ("dqdil", 57): 0.90,
    ("dqdil", 148): 3.95,
    ("dqaas", 57): 0.51,
    ("dqaas", 148): 1.55,
    ("dqn", 57): 0.30,
}
PUBLISHED_ACTING = 600.0  # steps/s
PUBLISHED_EPOCH = 83.0  # s
PUBLISHED_RUN = (5.0, 10.0)  # h
AIM_UPDATE = {("dqdil", 57): 0.040, ("dqdil", 148): 0.090}
AIM_ACTING, AIM_EPOCH, AIM_RUN = 40_000.0, 3.0, 25.0 * 60.0


@dataclass
class Budget:
    """How much is measured."""

    quick: bool
    seconds: float = field(init=False)
    updates: int = field(init=False)
    epochs: int = field(init=False)
    run_steps: int = field(init=False)

    def __post_init__(self) -> None:
        self.seconds = 1.5 if self.quick else 6.0
        self.updates = 4 if self.quick else 25
        self.epochs = 1 if self.quick else 3
        self.run_steps = 2_000 if self.quick else 12_000


def best_time(act: Callable[[], Any], *, repeats: int = 0, seconds: float = 0.0) -> float:
    """Seconds that ``act`` takes at best, after one call that compiles and warms up."""
    act()
    times: list[float] = []
    until = time.perf_counter() + seconds
    while len(times) < repeats or time.perf_counter() < until:
        start = time.perf_counter()
        act()
        times.append(time.perf_counter() - start)
    return min(times)


def learner(algo: str, **settings: Any) -> SequenceQLearning:
    """``algo`` on the agents, in 16 copies of their world."""
    named = named_recipe(algo)
    env = SlotVecEnv("agent", COPIES, condition_flag=named.algorithm.recipe.needs_condition)
    usual = {"device": "cpu", "batch_size": BATCH}
    return named.algorithm(env=env, seed=1, **usual | settings)


def acting_rate(seconds: float) -> float:
    """World steps per second of DQDIL without updates."""
    model = learner("dqdil", updates_per_episode=0.0, buffer_size=100_000)
    model.learn(COPIES)
    steps = 200 * COPIES

    def act() -> None:
        model.learn(steps, reset_num_timesteps=False, log_interval=None)

    return steps / best_time(act, seconds=seconds)


def update_time(algo: str, mean_length: int, updates: int, device: str = "cpu") -> float:
    """Seconds of one update on synthetic episodes of ``mean_length`` steps on average."""
    model = filled_learner(algo, mean_length, device)

    def update() -> None:
        model.train(1, BATCH)
        if device == "cuda":
            torch.cuda.synchronize()

    return best_time(update, repeats=updates)


def filled_learner(algo: str, mean_length: int, device: str = "cpu") -> SequenceQLearning:
    """``algo`` with a replay memory of synthetic episodes, ready to be updated."""
    model = learner(algo, buffer_size=40_000, offline_epochs=0, device=device)
    model.learn(COPIES)
    fill_with_synthetic_episodes(model, mean_length)
    return model


def fill_with_synthetic_episodes(model: SequenceQLearning, mean_length: int) -> None:
    """Random episodes, half to one and a half times the mean long, none past the time limit."""
    memory = model.replay_buffer
    assert memory is not None
    memory.drop_running()
    rng = np.random.default_rng(0)
    pair = (COPIES, model.layout.num_individuals)
    spread = min(mean_length // 2, AGENT.time_limit - mean_length)
    for _ in range(12):
        half = rng.integers(-spread, spread + 1, size=COPIES // 2)
        lengths = mean_length + np.concatenate([half, -half])
        for t in range(lengths.max()):
            memory.add(
                observations=rng.normal(size=(*pair, model.observation_size)),
                actions=rng.integers(model.policy.num_actions, size=pair),
                rewards=rng.normal(size=pair),
                next_observations=rng.normal(size=(*pair, model.observation_size)),
                terminated=np.asarray(t == lengths - 1),
                truncated=np.zeros(COPIES, dtype=bool),
                penalties=rng.random(pair),
                labels=rng.integers(model.policy.num_actions, size=pair),
                condition=np.arange(COPIES) % 2,
            )
            # A copy that is done before the others starts another episode, forgotten below.
        memory.drop_running()


def epoch_time(algo: str, epochs: int) -> float:
    """Seconds of one offline epoch, its validation included."""
    model = learner(algo, offline_learning_rate=1e-3, offline_batch_size=16)
    data, phase = model.demonstration_data(), model.offline_phase()

    def epoch() -> None:
        phase.train_epoch(data.train)
        validation_figures(model.demonstrated_values(data.val), model.layout.individuals)

    return best_time(epoch, repeats=epochs)


def paper_run(steps: int) -> tuple[float, float, float]:
    """Seconds of the paper's whole run, of its evaluation, and steps per update in the stretch."""
    preset = learner_preset("dqdil", "AnimaRL/Agent-v0", "paper")
    env = SlotVecEnv("agent", preset.n_envs, **preset.env_kwargs)
    model = DQDIL(env=env, seed=1, device="cpu", settings=preset.settings)
    model.learn(500)
    updates, start = model._n_updates, time.perf_counter()
    model.learn(steps, reset_num_timesteps=False)
    training = (time.perf_counter() - start) / steps * PAPER_STEPS
    per_update = steps / (model._n_updates - updates)

    scenario = make_scenario(AGENT, split="val", observation=env.scenario.species.observation)
    assert scenario.demos is not None
    start = time.perf_counter()
    rollouts = collect_rollouts(
        partial(make_world, scenario), model, method="DQDIL", seed=1, repetitions=REPETITIONS
    )
    measure(rollouts, scenario.demos)
    evaluation = (time.perf_counter() - start) * TEST_STARTS / scenario.demos.num_episodes
    return training + evaluation, evaluation, per_update


class Report:
    """The table, a row as soon as it is measured."""

    def __init__(self) -> None:
        self.table = Table(title="Learners, one thread, one run")
        self.table.add_column("what")
        for heading in ("here", "authors' code", "ratio", "aim", "met"):
            self.table.add_column(heading, justify="right")

    def row(self, what: str, here: str, published: str, ratio: float, aim: str, met: bool) -> None:
        faster = f"{ratio:,.1f} x" if ratio else ""
        self.table.add_row(
            what, here, published, faster, aim, ("yes" if met else "no") if aim else ""
        )

    def duration(
        self, what: str, seconds: float, published: float | None, aim: float | None
    ) -> None:
        """A row of seconds."""
        self.row(
            what,
            f"{seconds:.3f} s",
            f"{published:.2f} s" if published else "",
            published / seconds if published else 0.0,
            f"{aim:.3g} s" if aim else "",
            aim is not None and seconds <= aim,
        )


def cartpole_learners(algo: str, units: int, batch: int) -> tuple[Any, Any]:
    """A learner of CartPole here and its counterpart, alike in all settings, memories filled."""
    shared: dict[str, Any] = {
        "learning_rate": 1e-3,
        "buffer_size": 20_000,
        "learning_starts": 100,
        "batch_size": batch,
        "train_freq": 4,
        "gradient_steps": 1,
        "target_update_interval": 10_000,
        "seed": 1,
        "device": "cpu",
    }
    as_there: dict[str, Any] = {"sequence_length": 1, "prioritized": False, "lambda1": 0.0}
    quantiles = algo == "qr-dqn"
    shapes: tuple[dict[str, Any], ...] = ({"hidden": units}, {"net_arch": [units] * 2})
    if quantiles:
        shapes[0]["n_quantiles"] = shapes[1]["n_quantiles"] = 50
    env = partial(gym.make, "CartPole-v1")
    named = named_recipe(algo).algorithm
    here = named("MlpPolicy", env(), policy_kwargs=shapes[0], **as_there, **shared)
    peer = sb3_contrib.QRDQN if quantiles else stable_baselines3.DQN
    there = peer("MlpPolicy", env(), policy_kwargs=shapes[1], **shared)
    for model in (here, there):
        model.learn(2000)
    return here, there


def rates_in_turns(
    pair: tuple[Any, Any], act: Callable[[Any], Any], count: int, seconds: float
) -> tuple[float, float, float]:
    """Rates per second of two models at best, and the median ratio of the first to the second."""
    best, ratios = [float("inf"), float("inf")], []
    until = time.perf_counter() + 2.0 * seconds
    while time.perf_counter() < until:
        times = []
        for i, model in enumerate(pair):
            start = time.process_time()
            act(model)
            times.append(time.process_time() - start)
            best[i] = min(best[i], times[i])
        ratios.append(times[1] / times[0])
    return count / best[0], count / best[1], float(np.median(ratios))


def report_peers(report: Report, seconds: float) -> None:
    """Add rows of learning CartPole, of updates and of decisions, beside SB3 and sb3-contrib."""
    observation = np.zeros(4, dtype=np.float32)
    for algo, units, batch in (
        ("dqn", 64, 32),
        ("dqn", 256, 256),
        ("qr-dqn", 64, 32),
        ("qr-dqn", 256, 256),
    ):
        pair = cartpole_learners(algo, units, batch)
        name = f"{algo}, MlpPolicy, {units} wide"
        measures: list[tuple[str, Callable[[Any], Any], int]] = [
            (f"updates, {name}, batch {batch}", lambda model: model.train(10, model.batch_size), 10)
        ]
        if (algo, units) == ("dqn", 64):
            measures += [
                (
                    f"CartPole, {name}",
                    lambda model: model.learn(400, reset_num_timesteps=False),
                    400,
                ),
                (
                    f"predict of one row, {name}",
                    lambda model: [model.predict(observation) for _ in range(50)],
                    50,
                ),
            ]
        for what, act, count in measures:
            here, there, ratio = rates_in_turns(pair, act, count, seconds)
            report.table.add_row(
                what,
                f"{here:,.0f} /s",
                f"{there:,.0f} /s (SB3)",
                f"{ratio:.2f} x",
                "1",
                "yes" if ratio >= 1 else "no",
            )


def profile_update(mean_length: int = 57, updates: int = 40, rows: int = 12) -> Table:
    """Where the time of an update of DQDIL goes: each operation's own time, without its parts'."""
    model = filled_learner("dqdil", mean_length)
    model.train(3, BATCH)
    with torch.profiler.profile(activities=[torch.profiler.ProfilerActivity.CPU]) as profiler:
        model.train(updates, BATCH)
    operations = profiler.key_averages()
    total = sum(operation.self_cpu_time_total for operation in operations)
    table = Table(title=f"One update of DQDIL, mean length {mean_length}, by operation")
    table.add_column("operation")
    for heading in ("own time", "ms", "calls"):
        table.add_column(heading, justify="right")
    for operation in sorted(operations, key=lambda each: -each.self_cpu_time_total)[:rows]:
        table.add_row(
            operation.key,
            f"{operation.self_cpu_time_total / total:.0%}",
            f"{operation.self_cpu_time_total / updates / 1000:.2f}",
            f"{operation.count / updates:.0f}",
        )
    table.add_section()
    table.add_row(
        "all, replay and NumPy between them left out", "", f"{total / updates / 1000:.2f}"
    )
    return table


def print_devices(console: Console, updates: int) -> None:
    """Print the time of an update on the CPU, and on a CUDA device where there is one."""
    on_gpu = torch.cuda.is_available()
    for algo, length in PUBLISHED_UPDATE:
        said = f"{1e3 * update_time(algo, length, updates):.1f} ms on the CPU, one thread"
        if on_gpu:
            said += f"; {1e3 * update_time(algo, length, updates, 'cuda'):.1f} ms on the GPU"
        console.print(f"update, {algo}, mean length {length}: {said}")
    console.print(torch.cuda.get_device_name() if on_gpu else "There is no CUDA device here.")


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--quick", action="store_true", help="fewer repeats: a glance, not figures to quote"
    )
    parser.add_argument(
        "--profile", action="store_true", help="only what an update is made of, by operation"
    )
    parser.add_argument(
        "--devices", action="store_true", help="only an update on the CPU and on a CUDA device"
    )
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    console = Console()
    console.width = max(console.width, 110)
    if arguments.profile:
        console.print(profile_update())
        return
    budget = Budget(arguments.quick)
    if arguments.devices:
        print_devices(console, budget.updates)
        return
    start, report = time.perf_counter(), Report()

    rate = acting_rate(budget.seconds)
    report.row(
        f"acting, DQDIL, {COPIES} copies",
        f"{rate:,.0f} steps/s",
        f"{PUBLISHED_ACTING:,.0f} steps/s",
        rate / PUBLISHED_ACTING,
        f"{AIM_ACTING:,.0f} steps/s",
        rate >= AIM_ACTING,
    )
    for length in (57, 148):
        for algo in ("dqn", "dqaas", "dqdil", "dqcil", "qr-dqdil"):
            seconds = update_time(algo, length, budget.updates)
            key = (algo, length)
            report.duration(
                f"update, {algo}, mean length {length}",
                seconds,
                PUBLISHED_UPDATE.get(key),
                AIM_UPDATE.get(key),
            )
    for algo in ("bc", "dqaas", "dqdil-pt", "dqcil-pt"):
        for name in (algo, f"qr-{algo}"):
            report.duration(
                f"offline epoch, {name}",
                epoch_time(name, budget.epochs),
                PUBLISHED_EPOCH,
                AIM_EPOCH,
            )
    seconds, evaluation, per_update = paper_run(budget.run_steps)
    low, high = PUBLISHED_RUN
    report.row(
        f"paper run, Agent, DQDIL, {PAPER_STEPS:,} steps, extrapolated",
        f"{seconds / 60:.1f} min",
        f"{low:.0f} to {high:.0f} h",
        low * 3600 / seconds,
        f"{AIM_RUN / 60:.0f} min",
        seconds <= AIM_RUN,
    )
    report.table.add_section()
    report_peers(report, budget.seconds / 2)
    console.print(report.table)
    load = os.getloadavg()[0]
    console.print(
        f"paper run: {budget.run_steps:,} steps of it were run, {per_update:.0f} to an update; "
        f"evaluation {evaluation:.1f} s. Whole table: {time.perf_counter() - start:.0f} s, "
        f"load {load:.1f} on {os.cpu_count()} cores."
    )


if __name__ == "__main__":
    main()
