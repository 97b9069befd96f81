"""DQCIL's treatment head: does it fall to chance, and is the memory then blind to the condition?

    python benchmarks/treatment_head.py toy --seeds 5
    python benchmarks/treatment_head.py demonstrations agent --seeds 3
    python benchmarks/treatment_head.py demonstrations INDIVIDUAL.npz SHARED.npz --seeds 1

``toy`` is the confounded condition of ``tests/toys.py``: in training a loud nuisance always agrees
with the flag. ``demonstrations`` is the offline phase (DQDIL-PT, DQCIL-PT) with the default preset.

head        balanced accuracy of the treatment head on data that it was not trained on, at the end;
            0.5 is chance.
last third  its mean over the last third of the epochs, and its standard deviation there.
nat         the head's cross-entropy then; chance is 0.69.
probe       balanced accuracy of a classifier of the head's form, fitted anew to the frozen memory,
            without an opponent.
variance    share of the memory's variance that lies between the conditions' means.

A cell is the mean over seeds (and individuals), with the smallest and the largest in brackets.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import torch
import typer
from rich.console import Console
from rich.table import Table
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.utils import LinearSchedule

from animarl_algos.cli.shared import parse_settings
from animarl_algos.data.vec_env import SlotVecEnv
from animarl_algos.learner.algorithm import SequenceQLearning
from animarl_algos.learner.presets import learner_preset
from animarl_algos.learner.pretraining import OfflineDataset
from animarl_algos.learner.updates import minibatch_values
from animarl_algos.recipes.registry import DQCIL, DQDIL, named_recipe
from animarl_envs import environment_id
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.packaged import load_packaged, packaged_names
from animarl_envs.importing.readers import read

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

import toys
from confounded import (
    NO_MOMENTUM,
    SETTINGS,
    SETTLED,
    flip_behaviour,
    probe_balanced_accuracy,
    read_condition,
    share_of_variance,
)

app = typer.Typer(help=__doc__.split("\n", 1)[0], add_completion=False)
Figures = dict[str, float]


@dataclass(frozen=True)
class Setting:
    """A row of the toy's table: a learner and what it has beside the toy's own settings."""

    label: str
    algorithm: type[SequenceQLearning]
    policy: str
    steps: int
    arguments: dict[str, Any] = field(default_factory=dict)
    annealed: bool = False


def toy_settings(steps: int) -> list[Setting]:
    decayed = {"learning_rate": LinearSchedule(SETTINGS["learning_rate"], 0.0, 1.0)}
    rows = []
    for policy in ("MlpPolicy", "GruPolicy"):
        rows += [
            Setting("DQDIL", DQDIL, policy, steps),
            Setting("DQCIL", DQCIL, policy, steps),
            Setting("DQCIL, rate to 0", DQCIL, policy, steps, decayed),
            Setting("..., reversal annealed", DQCIL, policy, steps, decayed, annealed=True),
            Setting("DQCIL, no momentum", DQCIL, policy, steps, NO_MOMENTUM),
            Setting("..., rate to 0", DQCIL, policy, steps, SETTLED),
        ]
    longer = SETTLED | {"lambda2": 1.0}
    return [
        *rows,
        Setting("DQDIL, thrice the steps", DQDIL, "GruPolicy", 3 * steps, SETTLED),
        Setting("..., lambda2 1, thrice the steps", DQCIL, "GruPolicy", 3 * steps, longer),
    ]


class AnnealedReversal(BaseCallback):
    """Reversal strength ``2 / (1 + exp(-10 p)) - 1`` at progress p (Ganin et al. 2016)."""

    def _on_step(self) -> bool:
        return True

    def _on_rollout_start(self) -> None:
        model: SequenceQLearning = self.model  # type: ignore[assignment]
        progress = 1.0 - model._current_progress_remaining
        model.policy.q_net.reversal = 2.0 / (1.0 + np.exp(-10.0 * progress)) - 1.0


def run_toy(setting: Setting, seed: int) -> Figures:
    world, arguments = toys.Confounded(16, seed=seed), SETTINGS | setting.arguments
    model = setting.algorithm(setting.policy, world, seed=seed, **arguments)
    model.learn(setting.steps, callback=AnnealedReversal() if setting.annealed else None)
    train, test = (read_condition(model, seed=s) for s in (1234, 4321))
    figures = dict(zip(("factual", "flipped"), flip_behaviour(model)))
    figures["probe"] = probe_balanced_accuracy(train.rows(), test.rows())
    figures["variance"] = share_of_variance(*test.rows())
    if test.logits is not None:
        figures |= {"head": test.head_accuracy(), "nats": test.head_cross_entropy()}
    return figures


@app.command()
def toy(
    steps: Annotated[int, typer.Option(help="Of the world; 0.8 updates per episode of 4.")] = 3000,
    seeds: Annotated[int, typer.Option(help="Seeds 0, 1, ...")] = 5,
) -> None:
    """The confounded condition: settings of the adversary against DQDIL."""
    torch.set_num_threads(1)
    columns = {
        "head": "head", "nat": "nats", "probe": "probe", "variance": "variance",
        "acts rightly": "factual", "follows a flip": "flipped",
    }  # fmt: skip
    rows = []
    for setting in toy_settings(steps):
        results = [run_toy(setting, seed) for seed in range(seeds)]
        rows.append((f"{setting.policy.removesuffix('Policy')}: {setting.label}", results))
        print(".", end="", flush=True)
    show(f"Confounded toy, {steps} steps, {seeds} seeds", rows, columns)


# -- demonstrations -------------------------------------------------------------------------------


def pooled(files: Sequence[str]) -> Demonstrations:
    """One file or packaged set, or the episodes of several files of the same layout."""
    parts = [load_packaged(f) if f in packaged_names() else read(f) for f in files]
    arrays = ("positions", "lengths", "initial_velocity", "condition", "outcome", "split")
    joined = {name: np.concatenate([getattr(p, name) for p in parts]) for name in arrays}
    recording = np.concatenate(
        [np.char.add(f"{i}/", part.recording) for i, part in enumerate(parts)]
    )
    return replace(parts[0], **joined, recording=recording, signals={})


@torch.no_grad()
def memories(
    model: SequenceQLearning, dataset: OfflineDataset
) -> list[tuple[torch.Tensor, torch.Tensor]]:
    """Per individual: hidden states ``(N, H)`` and conditions ``(N,)`` of all valid steps."""
    parts: list[list[tuple[torch.Tensor, torch.Tensor]]] = [[] for _ in model.layout.individuals]
    policy = model.policy
    for batch in dataset.batches(model.settings.offline_batch_size):
        seen = minibatch_values(policy, batch, model.settings.phase("offline"), needs_target=False)
        hidden = seen.online.hidden[:, :-1]  # type: ignore[attr-defined]
        condition = seen.batch.condition.unsqueeze(1).expand(hidden.shape[:-1])
        for k, part in enumerate(parts):
            part.append((hidden[k][seen.valid[k]], condition[k][seen.valid[k]]))
    return [(torch.cat([h for h, _ in p]), torch.cat([c for _, c in p])) for p in parts]


def run_demonstrations(
    demos: Demonstrations, algo: str, settings: dict[str, Any], seed: int
) -> list[Figures]:
    """A row of figures per individual."""
    preset = learner_preset(algo, environment_id(demos.species), "default", settings)
    env = SlotVecEnv(demos.species, 1, demos=demos, condition_flag=True)
    whole = preset.settings.changed(buffer_size=2000)
    model = named_recipe(algo).algorithm(env=env, seed=seed, device="cpu", settings=whole)
    model.set_logger(Logger(folder=None, output_formats=[]))
    progress = model.pretrain()
    data = env.offline_data()
    rows = []
    for name, train, val in zip(
        model.layout.individuals, memories(model, data.train), memories(model, data.val)
    ):
        figures = {
            "probe": probe_balanced_accuracy(train, val),
            "variance": share_of_variance(*val),
        }
        figures["rank"] = progress.history[progress.best_epoch - 1][f"val/mean_rank/{name}"]
        key = f"val/treatment_balanced_accuracy/{name}"
        if key in progress.history[0]:
            curve = [row[key] for row in progress.history]
            tail = np.array(curve[-max(1, len(curve) // 3) :])
            figures |= {"tail": float(tail.mean()), "tail_sd": float(tail.std())}
            figures["head"] = curve[progress.best_epoch - 1]
        rows.append(figures)
    return rows


@app.command()
def demonstrations(
    files: Annotated[
        list[str], typer.Argument(help="agent, silkmoth, or files of both conditions.")
    ],
    settings: Annotated[list[str] | None, typer.Option("--set", help="KEY=VALUE.")] = None,
    seeds: Annotated[int, typer.Option(help="Seeds 0, 1, ...")] = 3,
) -> None:
    """The offline phase: the head on validation episodes, at the epoch that is kept."""
    torch.set_num_threads(1)
    demos, given = pooled(files), parse_settings(settings)
    columns = {
        "last third": "tail", "head": "head", "probe": "probe", "variance": "variance",
        "mean rank": "rank",
    }  # fmt: skip
    variants: list[tuple[str, str, dict[str, Any]]] = [
        ("DQDIL-PT", "dqdil-pt", {}),
        ("DQCIL-PT", "dqcil-pt", {}),
        ("DQCIL-PT, no momentum", "dqcil-pt", NO_MOMENTUM),
    ]
    rows = []
    title = f"{demos.name}: offline phase, {demos.num_episodes} episodes, {seeds} seeds"
    for label, algo, more in variants:
        results = [
            figures
            for seed in range(seeds)
            for figures in run_demonstrations(demos, algo, given | more, seed)
        ]
        rows.append((label, results))
        print(".", end="", flush=True)
    show(title, rows, columns)


def show(title: str, rows: list[tuple[str, list[Figures]]], columns: dict[str, str]) -> None:
    table = Table(title=title)
    table.add_column("learner")
    for heading in columns:
        table.add_column(heading, justify="right")
    for label, results in rows:
        table.add_row(label, *(cell(results, key) for key in columns.values()))
    Console(width=160).print(table)


def cell(results: list[Figures], key: str) -> str:
    values = np.array([row[key] for row in results if key in row])
    if not len(values):
        return "-"
    if key == "tail":
        spread = np.mean([row["tail_sd"] for row in results])
        return f"{values.mean():.2f} (sd {spread:.2f})"
    return f"{values.mean():.2f} [{values.min():.2f}, {values.max():.2f}]"


if __name__ == "__main__":
    app()
