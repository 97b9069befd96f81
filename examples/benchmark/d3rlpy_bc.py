"""Discrete behaviour cloning of d3rlpy, from a Minari export, as a row of the benchmark.

d3rlpy asks for an older Gymnasium than AnimaRL has, which its cloning does not use, so that it is
installed without what it asks for, best beside animarl[algos,data] in an environment of its own:

pip install --no-deps d3rlpy gym gym_notices structlog colorama dataclasses-json marshmallow \\
    typing-inspect mypy_extensions
PYTHONPATH=examples/benchmark animarl benchmark --preset short --species agent \\
    --method d3rlpy=d3rlpy_bc:make_discrete_bc
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import d3rlpy
import numpy as np
from d3rlpy.algos import DiscreteBCConfig
from d3rlpy.dataset import MDPDataset
from d3rlpy.logging import NoopAdapterFactory
from d3rlpy.preprocessing import StandardObservationScaler
from numpy.typing import NDArray

from animarl_algos.benchmark.methods import MethodSetting
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.fitting.transitions import demonstrated_actions
from animarl_envs.importing.minari_io import export_minari, import_minari
from animarl_envs.worlds import demonstration_observations

STEPS = 10_000  # gradient steps of each individual's network


def make_discrete_bc(
    setting: MethodSetting,
) -> Callable[[NDArray[np.floating]], NDArray[np.int64]]:
    """One network for each individual, cloned from the training episodes; it acts greedily."""
    d3rlpy.seed(setting.seed)
    with tempfile.TemporaryDirectory() as folder:
        train = setting.demos.select(split="train")
        demos = import_minari(export_minari(train, Path(folder) / "train"))
    flagged = setting.environment().condition_flag
    learners = [clone(dataset, STEPS) for dataset in datasets(setting, demos, flagged=flagged)]

    def act(observation: NDArray[np.floating]) -> NDArray[np.int64]:
        actions = np.empty(len(observation), dtype=np.int64)
        for k, learner in enumerate(learners):  # slot = copy * individuals + individual
            own = slice(k, None, len(learners))
            actions[own] = learner.predict(observation[own].astype(np.float32))
        return actions

    return act


def datasets(setting: MethodSetting, demos: Demonstrations, *, flagged: bool) -> list[MDPDataset]:
    """Transitions of each individual, as d3rlpy has them."""
    seen = demonstration_observations(setting.species, demos)
    taken = demonstrated_actions(demos, setting.species.locomotion).astype(np.int64)
    if flagged:
        column = np.repeat(demos.condition, demos.lengths)[:, None, None]
        column = np.broadcast_to(column, (*seen.shape[:2], 1)).astype(np.float32)
        seen = np.concatenate([seen, column], axis=2)
    steps = taken[:, 0] >= 0  # a last frame has no action
    ends = np.zeros(len(steps), dtype=np.float32)
    ends[demos.offsets[1:] - 2] = 1.0
    return [
        MDPDataset(
            observations=np.ascontiguousarray(seen[steps, k]),
            actions=taken[steps, k],
            rewards=np.zeros(int(steps.sum()), dtype=np.float32),
            terminals=ends[steps],
            action_space=d3rlpy.ActionSpace.DISCRETE,
            action_size=setting.species.num_actions,
        )
        for k in range(seen.shape[1])
    ]


def clone(dataset: MDPDataset, steps: int) -> Any:
    """A trained learner."""
    learner = DiscreteBCConfig(
        batch_size=256, observation_scaler=StandardObservationScaler()
    ).create(device=False)
    learner.fit(
        dataset, n_steps=steps, n_steps_per_epoch=steps, show_progress=False,
        save_interval=steps + 1, logger_adapter=NoopAdapterFactory(),
    )  # fmt: skip
    return learner
