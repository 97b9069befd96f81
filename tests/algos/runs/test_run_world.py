"""The evaluated and the watched world are the trained one."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from small_runs import few, made

from animarl_algos.cli.watch import prepare
from animarl_algos.evaluation.rollouts import Rollouts
from animarl_algos.runs import pipeline
from animarl_algos.runs.pipeline import load_demonstrations
from animarl_algos.runs.rolling_out import stored_rollouts
from animarl_algos.runs.run import Run
from animarl_algos.runs.run_settings import RunSettings
from animarl_envs.demos.pursuers import first_of_role
from animarl_envs.fitting import fit_locomotion

LIMIT = 20


@pytest.fixture(scope="module")
def limited(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """A run whose episodes end after 20 steps; some of its recordings are longer."""
    longest = few().select(split="test").lengths.max() - 1
    assert longest > LIMIT
    options = {"time_limit": LIMIT, "contact_radius": 0.02, "arena": 1.5,
               "locomotion": {"prey": 0.5}, "observation_delay": 2}  # fmt: skip
    return made(tmp_path_factory.mktemp("limited"), env_kwargs=options)


def test_rollouts_end_at_the_trained_limit(limited: Run) -> None:
    rollouts = stored_rollouts(limited)["DQCIL-PT"]
    assert rollouts.lengths.max() - 1 <= LIMIT
    scenario = limited.scenario
    assert scenario.species.time_limit == LIMIT and scenario.species.contact_radius == 0.02
    assert scenario.species.arena.size == 1.5 and scenario.observation_delay == 2


def test_training_evaluation_and_watching_share_their_world(limited: Run) -> None:
    """Every option once: a factor on the thrust is not applied again."""
    species = limited.species
    fitted = limited.fit.locomotion[2]
    assert species.locomotion[2].thrust == pytest.approx(0.5 * fitted.thrust)
    env = limited.environment()
    world, _ = prepare("AnimaRL/Agent-v0", model=limited.path, acting="greedy")
    assert env.scenario.species == species == limited.scenario.species
    assert world.scenario.species == species
    assert env.scenario.observation_delay == world.scenario.observation_delay == 2


def test_the_page_lists_the_world(limited: Run) -> None:
    pipeline.evaluate_run(limited)
    page = pipeline.report(limited).read_text()
    for words in (f"{LIMIT} steps (2 s)", "0.02 arena units", "environment.time_limit",
                  "world.contact radius", "locomotion of prey"):  # fmt: skip
        assert words in page, words


def test_fewer_pursuers_hold_everywhere(tmp_path: Path) -> None:
    run = made(tmp_path, env_kwargs={"num_pursuers": 1})
    rollouts: Rollouts = stored_rollouts(run)["DQCIL-PT"]
    assert rollouts.individuals == ("predator_0", "prey")
    test = first_of_role(few(), "num_pursuers", 1).select(split="test")
    starts = rollouts.positions[rollouts.offsets[:-1]]
    recorded = test.positions[test.offsets[:-1]][rollouts.demo]
    assert np.abs(starts - recorded).max() < 1e-6
    world, actor = prepare("AnimaRL/Agent-v0", model=run.path, acting="greedy")
    world.reset()
    assert actor(world, True).shape == (1, 2)


@pytest.mark.parametrize(("preset", "kind"), [("default", "full"), ("paper", "paper")])
def test_a_run_keeps_its_world_whatever_the_defaults_become(
    tmp_path: Path, preset: str, kind: str
) -> None:
    settings = RunSettings(
        file="packaged", species="fly", algo="bc", steps=1, copies=2, preset=preset
    )
    run = Run(tmp_path)
    run.start(settings, load_demonstrations("packaged", species="fly"), "made by the test")
    recorded = json.loads((tmp_path / "settings.json").read_text())["environment"]
    assert recorded["observation"] == kind and recorded["rebound"] == (kind == "full")
    fit_locomotion(run.demos, "onset").save(tmp_path / "locomotion.json")
    assert run.species.observation == kind
    assert run.species.arena.edge == {"full": 1.0, "paper": 1.1}[kind]
    env = run.environment()
    assert env.scenario.species == run.species
    assert (env.observation_space.shape == (19,)) == (kind == "paper")
