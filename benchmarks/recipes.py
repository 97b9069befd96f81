"""Every recipe on DQN and on quantiles, trained, saved, loaded and resumed: does it hold out?

    python benchmarks/recipes.py [--species agent silkmoth] [--steps 100000] [--out out/recipes]

Each learner takes its default preset and learns for so many steps of the world. Weights and losses
are looked at after every round of updates and must stay finite. Then it is saved and loaded (same
weights and decisions), and its last checkpoint is loaded into a learner of another seed; both go on
for some steps more and must end with the same weights, bit for bit. At last it acts from the starts
of the validation demonstrations.

One process, one thread. What is finished is kept in the folder and not done again; a run that was
killed goes on from its checkpoint.
"""

from __future__ import annotations

import argparse
import json
import time
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from rich.console import Console
from rich.table import Table
from stable_baselines3.common.callbacks import BaseCallback

from animarl_algos.data.vec_env import SlotVecEnv
from animarl_algos.evaluation.collect import collect_rollouts
from animarl_algos.evaluation.metrics import measure
from animarl_algos.learner.algorithm import SequenceQLearning
from animarl_algos.learner.callbacks import BoundaryCallback, CheckpointCallback
from animarl_algos.learner.checkpoint import latest_checkpoint, load_checkpoint
from animarl_algos.learner.presets import learner_preset
from animarl_algos.recipes.registry import RECIPES, named_recipe
from animarl_envs import environment_id
from animarl_envs.errors import InputError
from animarl_envs.files import write_then_rename
from animarl_envs.scenario import make_scenario
from animarl_envs.species import SPECIES, get_species
from animarl_envs.worlds import make_world

FURTHER_STEPS = 1600
CHECKPOINT_EVERY = 25_000


class StaysFinite(BoundaryCallback):
    """Fails the run at the first update that leaves a weight or a loss that is no number."""

    def at_boundary(self) -> None:
        require_finite(self.model)


def require_finite(model: SequenceQLearning) -> None:
    """Online and target weights, the mean losses since the last log, the offline curves."""
    step = f"{type(model).__name__} at step {model.num_timesteps}"
    for network in (model.policy.q_net, model.policy.q_net_target):
        for name, parameter in network.named_parameters():
            if not torch.isfinite(parameter).all():
                raise FloatingPointError(f"{step}: weight {name} is not finite")
    for name, mean in model.logger.name_to_value.items():
        if name.startswith("train/") and not np.isfinite(mean):
            raise FloatingPointError(f"{step}: {name} is not finite")
    for row in model.offline_progress.history:
        for name, value in row.items():
            if name.startswith("train/") and not np.isfinite(value):
                raise FloatingPointError(f"{step}: offline {name} is {value}")


def make(species: str, algo: str, seed: int, copies: int | None = None) -> SequenceQLearning:
    """The learner with its default preset in its own environment."""
    named = named_recipe(algo)
    preset = learner_preset(algo, environment_id(species))
    env = SlotVecEnv(
        species,
        copies or preset.n_envs,
        condition_flag=named.algorithm.recipe.needs_condition,
        **preset.env_kwargs,
    )
    env.seed(seed)
    return named.algorithm(env=env, seed=seed, device="cpu", settings=preset.settings)


def weights(model: SequenceQLearning) -> torch.Tensor:
    """All weights of the online and the target network, flat."""
    networks = (model.policy.q_net, model.policy.q_net_target)
    return torch.cat([p.detach().flatten() for net in networks for p in net.parameters()])


def run(species: str, algo: str, steps: int, seed: int, folder: Path) -> dict[str, Any]:
    """Train, check, save, load, resume and act; a row of the table."""
    start = time.perf_counter()
    model = make(species, algo, seed)
    online = bool(model.recipe.online)
    resumed = latest_checkpoint(folder) is not None
    if resumed:
        load_checkpoint(model, folder)
    began, epochs_before = model.num_timesteps, model.offline_progress.epoch
    if named_recipe(algo).pretrained and not model.offline_progress.done:
        # Through learn, so that the offline phase is checkpointed and looked at as well.
        model.learn(0, callback=callbacks(folder), reset_num_timesteps=not resumed)
        resumed = True
    offline_seconds = time.perf_counter() - start
    if online:
        model.learn(steps - began, callback=callbacks(folder), reset_num_timesteps=not resumed)
    require_finite(model)
    online_seconds = time.perf_counter() - start - offline_seconds

    save_and_load(model, folder / "model.zip")
    if online:
        go_on_twice(model, make(species, algo, seed + 1), folder)
    returned, distance = act(model, species, seed)
    memory = model.replay_buffer
    assert memory is not None
    return {
        "species": species,
        "recipe": algo,
        "epochs": model.offline_progress.epoch - epochs_before,
        "offline_seconds": offline_seconds,
        "steps": steps - began if online else 0,
        "online_seconds": online_seconds,
        "updates": model._n_updates,
        "return": returned,
        "dtw_per_step": distance,
        "memory_mib": memory.nbytes / 2**20,
        "rss_mib": resident_mib(),
    }


def callbacks(folder: Path) -> list[BaseCallback]:
    return [StaysFinite(), CheckpointCallback(folder, CHECKPOINT_EVERY)]


def save_and_load(model: SequenceQLearning, file: Path) -> None:
    """The loaded learner has the same weights and makes the same decisions."""
    with write_then_rename(file) as part:
        model.save(part)
        loaded = type(model).load(part, env=model.get_env(), device="cpu")
    if not torch.equal(weights(model), weights(loaded)):
        raise AssertionError(f"{file}: the loaded weights differ")
    shape = (model.n_envs, model.observation_size)
    state = loaded_state = None
    for seed in range(20):
        seen = np.random.default_rng(seed).normal(size=shape).astype(np.float32)
        actions, state = model.predict(seen, state, deterministic=True)
        loaded_actions, loaded_state = loaded.predict(seen, loaded_state, deterministic=True)
        if not np.array_equal(actions, loaded_actions):
            raise AssertionError(f"{file}: the loaded learner decides otherwise")


def go_on_twice(model: SequenceQLearning, other: SequenceQLearning, folder: Path) -> None:
    """``other`` takes up the checkpoint of ``model``; both learn on and end alike."""
    load_checkpoint(other, folder)
    for learner in (model, other):
        learner.learn(FURTHER_STEPS, callback=StaysFinite(), reset_num_timesteps=False)
    if not torch.equal(weights(model), weights(other)):
        raise AssertionError(f"{folder}: the resumed run differs from the one that went on")


def act(model: SequenceQLearning, species: str, seed: int) -> tuple[float, float]:
    """Return and DTW distance per step, means over the validation demonstrations' starts."""
    scenario = make_scenario(get_species(species), split="val")
    if scenario.demos is None:
        raise InputError(f"species {species!r} has no packaged demonstrations to start from")
    model.policy.seed(seed)
    rollouts = collect_rollouts(
        partial(make_world, scenario),
        model,
        method=type(model).__name__,
        seed=seed,
        repetitions=1,
        cue="actual" if model.layout.condition_flag else None,
    )
    table = measure(rollouts, scenario.demos)
    return float(table["reached"].mean()), float(table["dtw_per_step"].mean())


def resident_mib() -> float:
    """Memory of this process now [MiB]."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * 4096 / 2**20


def table_of(rows: list[dict[str, Any]]) -> Table:
    table = Table(title="Default presets: finite throughout, loaded alike, resumed bit for bit")
    table.add_column("species")
    table.add_column("recipe")
    for heading in (
        "epochs", "s / epoch", "steps", "steps / s", "updates", "return", "DTW / step",
        "replay MiB", "RSS MiB",
    ):  # fmt: skip
        table.add_column(heading, justify="right")
    for row in rows:
        epochs, steps = row["epochs"], row["steps"]
        table.add_row(
            row["species"],
            row["recipe"],
            f"{epochs}" if epochs else "-",
            f"{row['offline_seconds'] / epochs:.2f}" if epochs else "-",
            f"{steps:,}" if steps else "-",
            f"{steps / row['online_seconds']:,.0f}" if steps else "-",
            f"{row['updates']:,}" if steps else "-",
            f"{row['return']:.2f}",
            f"{row['dtw_per_step']:.3f}",
            f"{row['memory_mib']:.0f}",
            f"{row['rss_mib']:.0f}",
        )
    return table


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--species", nargs="+", choices=SPECIES, default=["agent", "silkmoth"])
    parser.add_argument("--recipes", nargs="+", choices=RECIPES, default=list(RECIPES))
    parser.add_argument("--steps", type=int, default=100_000, help="steps of the world, each run")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path, default=Path("out/recipes"), help="where results go")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    rows = []
    for species in arguments.species:
        for algo in arguments.recipes:
            name = f"{species}_{algo}_{arguments.steps}_{arguments.seed}"
            result = arguments.out / f"{name}.json"
            if not result.exists():
                row = run(species, algo, arguments.steps, arguments.seed, arguments.out / name)
                with write_then_rename(result) as part:
                    part.write_text(json.dumps(row, indent=1))
                print(json.dumps(row), flush=True)
            rows.append(json.loads(result.read_text()))
    console = Console()
    console.width = max(console.width, 110)
    console.print(table_of(rows))


if __name__ == "__main__":
    main()
