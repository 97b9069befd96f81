"""Draw what a trained model values along one recorded episode: Q-values of each action.

    python examples/inspect_episode.py runs/first --episode 3 --individual prey --out values.png

Above are the mean of Q over actions and the best action's Q; below is the advantage of each
direction of acceleration, taken from the direction to the individual's focus. Dots are the actions
that inverse dynamics finds in the recording.
"""

import argparse
from collections.abc import Sequence

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from animarl_algos import load_run
from animarl_envs.fitting.transitions import demonstrated_actions
from animarl_envs.locomotion import NUM_DIRECTIONS

DIRECTIONS = {0: "towards focus", 3: "right", 6: "away", 9: "left"}


def draw_values(q_values: NDArray[np.float64], actions: NDArray[np.integer], dt: float) -> Figure:
    """Draw Q-values ``(steps, actions)`` and the recorded ``actions`` ``(steps,)``.

    An action of -1 is unknown; ``dt`` is one step [s].
    """
    time, number = np.arange(len(q_values)) * dt, q_values.shape[1]
    figure, (above, below) = plt.subplots(
        2, 1, sharex=True, height_ratios=[1, 2], layout="constrained"
    )
    above.plot(time, q_values.mean(axis=1), label="mean over actions")
    above.plot(time, q_values.max(axis=1), label="best action")
    above.set(ylabel="Q")
    above.legend()
    advantage = (q_values - q_values.mean(axis=1, keepdims=True)).T
    limit = np.abs(advantage).max()
    edges = np.append(time, time[-1] + dt) - dt / 2
    rows = np.arange(number + 1) - 0.5
    mesh = below.pcolormesh(edges, rows, advantage, cmap="RdBu_r", vmin=-limit, vmax=limit)
    below.plot(time[actions >= 0], actions[actions >= 0], "k.", markersize=3)
    magnitudes = (number - 1) // NUM_DIRECTIONS  # the largest thrust first
    ticks = {
        NUM_DIRECTIONS * m + k: f"{m + 1}: {name}" if magnitudes > 1 else name
        for m in range(magnitudes)
        for k, name in DIRECTIONS.items()
    } | {number - 1: "coast"}
    below.set_yticks(list(ticks), list(ticks.values()))
    below.set(xlabel="time (s)", ylabel="acceleration")
    figure.colorbar(mesh, ax=below, label="advantage")
    return figure


def main(arguments: Sequence[str] | None = None) -> None:
    """Read the arguments and draw one episode."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("run", help="a run folder, or a packaged model such as fly")
    parser.add_argument("--episode", type=int, default=0, help="number in the test split")
    parser.add_argument("--individual", help="by default the first")
    parser.add_argument("--out", default="values.png")
    given = parser.parse_args(arguments)
    run = load_run(given.run)
    learned = run.learned_individuals
    number = learned.index(given.individual) if given.individual else 0
    test = run.demos.select(split="test").select(episodes=[given.episode])
    values = run.action_values(given.episode)[:, number]
    actions = demonstrated_actions(test, run.species.locomotion)
    column = test.individuals.index(learned[number])
    draw_values(values, actions[: len(values), column], test.dt).savefig(given.out, dpi=200)


if __name__ == "__main__":
    main()
