"""Runs to be killed, each of which goes on from its last checkpoint if it finds one.

    python killed_runs.py toy FOLDER

runs in a process of its own and prints a line at every boundary between updates.
"""

import sys
from pathlib import Path

import torch
from pair_learners import make_pair_learner
from stable_baselines3.common.utils import LinearSchedule

from animarl_algos.learner.algorithm import SequenceQLearning
from animarl_algos.learner.callbacks import CheckpointCallback
from animarl_algos.learner.checkpoint import latest_checkpoint, load_checkpoint
from animarl_algos.runs.pipeline import learn, open_run
from animarl_algos.runs.run_settings import RunSettings

ALGO = "qr-dqcil-pt"
EPOCHS = 4
TOY_STEPS = 400


def toy_run(folder: Path) -> SequenceQLearning:
    """The pair of the toys, for a second or two."""
    model = make_pair_learner(
        ALGO, learning_rate=LinearSchedule(1e-2, 0.0, 1.0), offline_epochs=EPOCHS
    )
    resumed = latest_checkpoint(folder) is not None
    if resumed:
        load_checkpoint(model, folder)
    callback = CheckpointCallback(folder, every=50)
    steps = TOY_STEPS - model.num_timesteps
    return model.learn(steps, callback=callback, reset_num_timesteps=not resumed)


def agent_run(folder: Path) -> SequenceQLearning:
    """The packaged agents through the whole of ``animarl train``."""
    settings = RunSettings(
        file="packaged", species="agent", algo=ALGO, steps=3000, seed=1, copies=4,
        checkpoint_every=200, baselines=False,
        overrides={"offline_epochs": EPOCHS, "learning_rate": "lin_1e-3"},
    )  # fmt: skip
    return learn(open_run(settings, folder, "animarl train"), ALGO, progress_bar=False)


RUNS = {"toy": toy_run, "agent": agent_run}


class Announcing(CheckpointCallback):
    def at_boundary(self) -> None:
        print("boundary", flush=True)
        super().at_boundary()


if __name__ == "__main__":
    import animarl_algos.runs.pipeline

    torch.set_num_threads(1)
    CheckpointCallback = animarl_algos.runs.pipeline.CheckpointCallback = Announcing  # type: ignore
    RUNS[sys.argv[1]](Path(sys.argv[2]))
