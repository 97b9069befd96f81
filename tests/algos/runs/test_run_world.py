"""The evaluated and the watched world are the trained one."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from small_runs import few, made

from animarl_algos.cli.watch import prepare
from animarl_algos.evaluation.rollouts import Rollouts
from animarl_algos.runs import pipeline
from animarl_algos.runs.rolling_out import stored_rollouts
from animarl_envs.demos.pursuers import first_of_role

LIMIT = 20


@pytest.fixture(scope="module")
def limited(tmp_path_factory: pytest.TempPathFactory) -> pipeline.RunFolder:
    """A run whose episodes end after 20 steps; some of its recordings are longer."""
    longest = few().select(split="test").lengths.max() - 1
    assert longest > LIMIT
    options = {"time_limit": LIMIT, "contact_radius": 0.02, "arena": 1.5,
               "locomotion": {"prey": 0.5}, "observation_delay": 2}  # fmt: skip
    return made(tmp_path_factory.mktemp("limited"), env_kwargs=options)


def test_rollouts_end_at_the_trained_limit(limited: pipeline.RunFolder) -> None:
    rollouts = stored_rollouts(limited)["DQCIL-PT"]
    assert rollouts.lengths.max() - 1 <= LIMIT
    scenario = limited.scenario("test")
    assert scenario.species.time_limit == LIMIT and scenario.species.contact_radius == 0.02
    assert scenario.species.arena.size == 1.5 and scenario.observation_delay == 2


def test_training_evaluation_and_watching_share_their_world(limited: pipeline.RunFolder) -> None:
    """Every option once: a factor on the thrust is not applied again."""
    species = limited.species(limited.demos, limited.fit)
    fitted = limited.fit.locomotion[2]
    assert species.locomotion[2].thrust == pytest.approx(0.5 * fitted.thrust)
    env = limited.environment(species, limited.demos)
    world, _ = prepare("AnimaRL/Agent-v0", model=limited.path, acting="greedy")
    assert env.scenario.species == species == limited.scenario("test").species
    assert world.scenario.species == species
    assert env.scenario.observation_delay == world.scenario.observation_delay == 2


def test_the_page_lists_the_world(limited: pipeline.RunFolder) -> None:
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
