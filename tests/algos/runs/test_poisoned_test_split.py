"""Test episodes are out of reach: poisoned ones change nothing before they are scored."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from refusals import refuses
from slow import slowly
from small_runs import few

from animarl_algos.benchmark.matrix import Matrix, plan
from animarl_algos.data.vec_env import SlotVecEnv
from animarl_algos.runs.pipeline import learn, open_run
from animarl_algos.runs.run import Run
from animarl_algos.runs.run_files import weights_file
from animarl_algos.runs.run_settings import AUTO, CHOSEN, RunSettings
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.splits import learnable
from animarl_envs.fitting.custom_species import species_of
from tools.make_pretrained import validation_mismatch

SMALL: dict[str, Any] = {
    "policy_kwargs": {"hidden": 16, "depth": 1},
    "offline_epochs": 1,
    "offline_kwargs": {"updates_per_epoch": 3, "warm_up": 1},
}


def a_few(species: str = "custom") -> Demonstrations:
    """Packaged (synthetic) chases of all splits, as a species of one's own."""
    return replace(few(train=5, val=2, test=2), species=species)


def poisoned(demos: Demonstrations, split: str = "test") -> Demonstrations:
    """The same episodes, but for absurd ones of one split."""
    bad = np.repeat(demos.split == split, demos.lengths)
    rng = np.random.default_rng(0)
    positions = demos.positions.copy()
    positions[bad] = rng.uniform(-0.9, 0.9, positions[bad].shape)
    within = demos.split == split
    return replace(
        demos, positions=positions, outcome=np.where(within, 1, demos.outcome).astype(np.int8),
        condition=np.where(within, 1 - demos.condition, demos.condition).astype(np.int8),
    )  # fmt: skip


def learned(run: Run) -> tuple[bytes, ...]:
    """All that a run learned and chose, as it is stored."""
    algo = run.settings.algo
    files = weights_file(run.path / "policies", algo), run.acting_file(algo)
    return tuple(file.read_bytes() for file in (*files, run.path / "locomotion.json"))


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
    refuses("test split", SlotVecEnv, "custom", 2, demos=a_few(), split="test")


@pytest.mark.parametrize(
    ("algo", "species", "overrides"),
    [
        ("soft-bc", "custom", {}),
        # Their episodes begin with replayed demonstrations, as those of the benchmark below.
        *slowly(("dqdil-pt", "agent", {}), ("dqaas", "agent", {})),
    ],
)
def test_poison_changes_neither_what_is_learned_nor_what_is_packaged(
    tmp_path: Path, algo: str, species: str, overrides: dict[str, Any]
) -> None:
    def trained(demos: Demonstrations, name: str) -> Run:
        settings = RunSettings(
            file=str(demos.save(tmp_path / f"{name}.npz")), species=species, algo=algo, steps=300,
            copies=4, seed=3, baselines=False, thrusts=AUTO if algo == "soft-bc" else "1",
            overrides=SMALL | overrides,
        )  # fmt: skip
        run = open_run(settings, tmp_path / name, "test")
        model = learn(run, algo, progress_bar=False)
        assert bool(model._n_updates) == bool(model.recipe.online)
        return run

    demos = a_few(species)
    clean, bad = trained(demos, "clean"), trained(poisoned(demos), "poisoned")
    assert learned(clean) == learned(bad)
    assert validation_mismatch(clean) == validation_mismatch(bad)


def test_poison_changes_no_trained_cell_of_a_benchmark(tmp_path: Path) -> None:
    def trained(demos: Demonstrations, name: str) -> tuple[bytes, ...]:
        matrix = Matrix(
            files={"own": str(demos.save(tmp_path / f"{name}.npz"))}, recipes=("dqdil-pt",),
            references=(), episodes={"train": 8, "val": 2, "test": 2}, steps=100, thrusts="1",
            acting=CHOSEN, settings={"dqdil-pt": SMALL | {"n_envs": 4}},
        )  # fmt: skip
        asked, out = plan(matrix), tmp_path / name
        for piece in (*asked.worlds, *asked.cells):
            piece.perform(out)
        return learned(Run(asked.cells[0].folder(out) / "run"))

    clean = trained(a_few(), "clean")
    assert clean == trained(poisoned(a_few()), "poisoned")
    assert clean != trained(poisoned(a_few(), "train"), "noticed")
