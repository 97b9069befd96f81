"""Test episodes are out of reach: poisoned ones change nothing before they are scored."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from animarl_algos.data.vec_env import SlotVecEnv
from animarl_algos.runs.acting import acting_file
from animarl_algos.runs.pipeline import learn, open_run
from animarl_algos.runs.run_settings import RunSettings
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.packaged import load_packaged
from animarl_envs.demos.splits import learnable
from animarl_envs.errors import InputError
from animarl_envs.fitting.custom_species import species_of


def a_few() -> Demonstrations:
    """Sixteen packaged (synthetic) chases of all splits, as a species of one's own."""
    all_of_them = load_packaged("agent")
    chosen = [np.flatnonzero(all_of_them.split == s)[:n] for s, n in (("train", 10), ("val", 3))]
    test = np.flatnonzero(all_of_them.split == "test")[:3]
    kept = all_of_them.select(episodes=np.concatenate([*chosen, test]))
    return replace(kept, species="custom")


def poisoned(demos: Demonstrations) -> Demonstrations:
    """The same train and val episodes, beside absurd test episodes."""
    bad = np.repeat(demos.split == "test", demos.lengths)
    rng = np.random.default_rng(0)
    positions = demos.positions.copy()
    positions[bad] = rng.uniform(-0.9, 0.9, positions[bad].shape)
    test = demos.split == "test"
    return replace(
        demos,
        positions=positions,
        outcome=np.where(test, 1, demos.outcome).astype(np.int8),
        condition=np.where(test, 1 - demos.condition, demos.condition).astype(np.int8),
    )


def test_the_species_is_that_of_train_and_val() -> None:
    demos = a_few()
    assert species_of(demos) == species_of(poisoned(demos)) == species_of(learnable(demos))


@pytest.mark.parametrize("split", ["train", None])
def test_a_learners_environment_holds_no_test_episode(split: str | None) -> None:
    env = SlotVecEnv("custom", 2, demos=a_few(), split=split)
    assert env.demos is not None and env.scenario.demos is not None
    assert set(env.demos.split) == {"train", "val"}
    assert "test" not in env.scenario.demos.split


def test_the_test_split_is_refused() -> None:
    with pytest.raises(InputError, match="test split"):
        SlotVecEnv("custom", 2, demos=a_few(), split="test")


def test_poison_changes_neither_fit_nor_weights_nor_acting(tmp_path: Path) -> None:
    made = {}
    for name, demos in (("clean", a_few()), ("poisoned", poisoned(a_few()))):
        file = demos.save(tmp_path / f"{name}.npz")
        settings = RunSettings(
            file=str(file), species="custom", algo="soft-bc", steps=1, seed=3, baselines=False,
            overrides={"offline_epochs": 2},
        )  # fmt: skip
        run = open_run(settings, tmp_path / name, "test")
        model = learn(run, "soft-bc", progress_bar=False)
        chosen = acting_file(run, "soft-bc").read_text()
        made[name] = (model.policy.q_net.state_dict(), run.fit.locomotion, chosen)
    clean, bad = made["clean"], made["poisoned"]
    assert clean[1:] == bad[1:]
    assert all(torch.equal(value, bad[0][key]) for key, value in clean[0].items())
