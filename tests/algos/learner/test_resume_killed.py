"""SIGKILL at random moments, the offline phase included: the same weights as without."""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path

import killed_runs
import numpy as np
import pytest
import torch
from pair_learners import weights

from animarl_algos.learner.checkpoint import latest_checkpoint, steps_done


def kill(run: str, folder: Path, boundaries: int, delay: float) -> None:
    """Start ``run`` and kill it ``delay`` seconds after so many boundaries between updates."""
    command = [sys.executable, str(Path(killed_runs.__file__)), run, str(folder)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    with process.stdout:
        for _ in range(boundaries):
            assert process.stdout.readline() == "boundary\n", "it ended before it was to be killed"
        time.sleep(delay)
        process.kill()
        process.wait()


def kills_leave_no_trace(run: str, folder: Path, moments: list[tuple[int, float]]) -> None:
    """The first of the ``moments`` must lie in the offline phase, the others after it."""
    straight = killed_runs.RUNS[run](folder / "straight")
    killed, reached = folder / "killed", []
    for boundaries, delay in moments:
        kill(run, killed, boundaries, delay)
        found = next(iter(killed.rglob("checkpoint_*[0-9]"))).parent
        latest = latest_checkpoint(found)
        assert latest is not None
        reached.append(steps_done(latest))
    assert reached[0] == 0 < reached[-1] < straight.num_timesteps
    resumed = killed_runs.RUNS[run](killed)
    assert torch.equal(weights(straight), weights(resumed))
    assert straight._n_updates == resumed._n_updates > 0


def test_a_short_run_killed_offline_and_online(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    offline = (int(rng.integers(3, killed_runs.EPOCHS + 1)), rng.uniform(0.0, 0.05))
    online = (int(rng.integers(15, 25)), rng.uniform(0.0, 0.01))
    kills_leave_no_trace("toy", tmp_path, [offline, online])


@pytest.mark.slow
def test_a_run_of_the_agents_killed_again_and_again(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    offline = [(int(rng.integers(3, killed_runs.EPOCHS + 1)), rng.uniform(0.0, 1.0))]
    online = [(int(rng.integers(8, 16)), rng.uniform(0.0, 0.1)) for _ in range(4)]
    kills_leave_no_trace("agent", tmp_path, offline + online)
