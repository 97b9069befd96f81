"""``python -m tools.packaged_data.trained_chase``: train the agents, roll them out, compare."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from animarl_algos.evaluation.teams import load_weights, make_policy
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.packaged import FOLDER
from animarl_envs.errors import InputError, MissingExtraError
from animarl_envs.species import AGENT
from tools.packaged_data.trained_chase.chases import EPSILON, chase, generate, write_csv
from tools.packaged_data.trained_chase.comparison import (
    CROSS_EPISODES,
    condition_table,
    cross_table,
    statistics_table,
)
from tools.packaged_data.trained_chase.training import PACKAGED_WEIGHTS, ChaseTraining, train

app = typer.Typer(help=__doc__, no_args_is_help=True, pretty_exceptions_enable=False)

OutOption = Annotated[Path, typer.Option(help="Demonstrations file to write.")]
SeedOption = Annotated[int, typer.Option(help="Root of all randomness.")]
EpisodesOption = Annotated[int, typer.Option(help="Episodes per reward condition.")]
EpsilonOption = Annotated[
    float, typer.Option(help="Share of random actions, of all individuals.", min=0.0, max=1.0)
]
WeightsOption = Annotated[Path, typer.Option(help="Folder with individual.npz and shared.npz.")]


@app.command("make")
def make_command(
    out: OutOption = Path("agent.npz"),
    folder: Annotated[
        Path, typer.Option(help="Gets weights, checkpoints and logs; continued if killed.")
    ] = Path("runs/trained_chase"),
    seed: SeedOption = 0,
    episodes: EpisodesOption = 250,
    steps: Annotated[
        int, typer.Option(help="World steps of training, per condition.")
    ] = ChaseTraining.steps,
    epsilon: EpsilonOption = EPSILON,
) -> None:
    """Train both reward conditions with one budget, then roll them out into a file.

    Example:

      python -m tools.packaged_data.trained_chase make --seed 0 --out agent.npz
    """
    training = replace(ChaseTraining(), steps=steps)
    for condition, name in enumerate(AGENT.conditions):
        print(f"training with {name} reward, {steps} steps")
        print(f"wrote {train(condition, seed, training, folder)}")
    _roll_out(folder, out, seed, episodes, epsilon)


@app.command("roll-out")
def roll_out_command(
    out: OutOption = Path("agent.npz"),
    weights: WeightsOption = PACKAGED_WEIGHTS,
    seed: SeedOption = 0,
    episodes: EpisodesOption = 250,
    epsilon: EpsilonOption = EPSILON,
) -> None:
    """Only the rollouts, from weights that were trained before (by default the packaged ones).

    Example:

      python -m tools.packaged_data.trained_chase roll-out --seed 0 --out agent.npz
    """
    _roll_out(weights, out, seed, episodes, epsilon)


@app.command("table")
def table_command(
    out: Annotated[Path, typer.Option(help="Table to write (.csv).")] = Path("chases.csv"),
    folder: Annotated[Path, typer.Option(help="As of make.")] = Path("runs/other_chase"),
    pursuers: Annotated[int, typer.Option(help="Predators.", min=1)] = 3,
    seed: SeedOption = 0,
    episodes: Annotated[int, typer.Option(help="Chases to write.")] = 200,
    steps: Annotated[int, typer.Option(help="World steps of training.")] = ChaseTraining.steps,
    epsilon: EpsilonOption = EPSILON,
) -> None:
    """Train other numbers of predators, each for its own reward; write a table of their tracks.

    The table says no more than a stranger's would: who was where at 10 frames a second. A chase
    that its time limit ends stops there like the others.

    Example:

      python -m tools.packaged_data.trained_chase table --pursuers 3 --out chases.csv
    """
    training = replace(ChaseTraining(), steps=steps)
    weights, _ = load_weights(train(0, seed, training, folder, pursuers=pursuers))
    policy = make_policy(weights, epsilon=epsilon, seed=seed, pursuers=pursuers)
    chases = chase(policy, 0, episodes, seed)
    write_csv(chases, policy.individuals, out)
    share = float((chases.outcome > 0).mean())
    print(f"wrote {out}: {episodes} synthetic chases, {share:.3f} of them end by contact")


@app.command("compare")
def compare_command(
    file: Annotated[Path, typer.Argument(help="Chases made by this command.")] = (
        FOLDER / "agent.npz"
    ),
    weights: WeightsOption = PACKAGED_WEIGHTS,
    local: Annotated[
        Path | None, typer.Option(help="Folder agents_collab_hunting, for its column.")
    ] = None,
    seed: SeedOption = 0,
    episodes: Annotated[
        int, typer.Option(help="Episodes per pair of predators and prey.")
    ] = CROSS_EPISODES,
    epsilon: EpsilonOption = EPSILON,
) -> None:
    """Three tables: beside published numbers; shared against individual reward; who plays whom.

    Example:

      python -m tools.packaged_data.trained_chase compare \\
        --local ../shared/data/agents_collab_hunting
    """
    demos = Demonstrations.load(file)
    rng = np.random.default_rng(seed)
    tables = (
        statistics_table(demos, local),
        condition_table(demos, rng),
        cross_table(weights, seed, epsilon, rng, episodes),
    )
    print("\n\n".join("\n".join(lines) for lines in tables))


def _roll_out(weights: Path, out: Path, seed: int, episodes: int, epsilon: float) -> None:
    generate(weights, seed, episodes, epsilon).save(out, dtype=np.float32)
    demos = Demonstrations.load(out)  # float32: the fingerprint is that of the file
    for condition, name in enumerate(AGENT.conditions):
        part = demos.select(condition=condition)
        rates = [float((part.outcome == k).mean()) for k in (1, 2)]
        print(
            f"{name:>10} reward: {part.num_episodes} synthetic episodes, captured by predator_0 "
            f"{rates[0]:.3f}, by predator_1 {rates[1]:.3f}, "
            f"mean {(part.lengths - 1).mean() * part.dt:.1f} s"
        )
    print(f"wrote {out} ({out.stat().st_size / 1e3:.0f} kB, fingerprint {demos.fingerprint()})")


def main() -> None:
    """The command line; bad input is one sentence and exit code 2."""
    try:
        app(prog_name="python -m tools.packaged_data.trained_chase")
    except (InputError, MissingExtraError) as error:
        print(f"trained_chase: {error}", file=sys.stderr)
        sys.exit(2)


if __name__ == "__main__":
    main()
