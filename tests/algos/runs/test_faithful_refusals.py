"""What cannot become a faithful simulator is refused in one sentence, before any training."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import toys
from commands import Done, refused
from pair_learners import demonstrations
from refusals import refuses

from animarl_algos.data.vec_env import SlotVecEnv, refuse_other_observation
from animarl_algos.learner.algorithm import SequenceQLearning
from animarl_algos.recipes.registry import DQDIL, IQLearn, SoftBC
from animarl_algos.runs import pipeline
from animarl_algos.runs.run import Run
from animarl_algos.runs.run_settings import RunSettings
from animarl_envs.demos.packaged import load_packaged


@pytest.mark.parametrize("recipe", [IQLearn, DQDIL])
def test_a_recipe_that_needs_the_simulator_and_is_given_none(
    recipe: type[SequenceQLearning], tmp_path: Path
) -> None:
    refuses("no environment to learn in: give env=", recipe, "MlpPolicy")
    settings: dict[str, Any] = {"demonstrations": demonstrations(), "buffer_size": 500}
    recipe("MlpPolicy", toys.Pair(2), offline_epochs=1, **settings).save(tmp_path / "model")
    loaded = recipe.load(tmp_path / "model", device="cpu")
    refuses("no environment to learn in: give env=", loaded.learn, 10)
    assert not loaded.offline_progress.epoch


@pytest.mark.parametrize(
    ("rule", "words"),
    [("boltzmann:1,2", "2 numbers for 3 individuals"), ("epsilon:2", "epsilon is 2")],
)
def test_an_acting_rule_for_others(rule: str, words: str, tmp_path: Path) -> None:
    def opened() -> Run:
        asked = {"file": "packaged", "species": "fly", "algo": "soft-bc", "steps": 1, "copies": 1}
        settings = RunSettings(**asked, acting=rule)
        return pipeline.open_run(settings, tmp_path / "run", "test", load_packaged("fly"))

    refuses(words, opened)
    assert not (tmp_path / "run").exists()


def test_a_model_of_another_observation() -> None:
    model = SoftBC(env=SlotVecEnv("fly", 2), device="cpu", seed=0)
    paper, before = SlotVecEnv("fly", 2, observation="paper"), model.env
    refuses("shows 'own position x', which this", model.set_env, paper)
    newt = SlotVecEnv("newt", 2)
    refuses("is of the species newt, this learner of fly", model.set_env, newt)
    assert model.env is before
    model.demonstrations = paper.offline_data()
    refuses("observation components, the environment", model.learn, 1)
    assert not model.offline_progress.epoch


@pytest.mark.parametrize(
    ("here", "word"),
    [
        (("moth", "speed", "place"), "of the species moth, this learner of fly"),
        (("fly", "speed", "wall"), "shows 'wall', which this learner has not"),
        (("fly", "speed"), "does not show 'place', which this learner has"),
        (("fly", "place", "speed"), "in another order"),
    ],
)
def test_observations_are_compared_by_name_where_both_are_known(
    here: tuple[str, ...], word: str
) -> None:
    learned = ("fly", "speed", "place")
    for unknown in ((), learned):  # an environment, or an older file, that does not say
        refuse_other_observation(learned, unknown)
        refuse_other_observation(unknown, learned)
    refuses(word, refuse_other_observation, learned, here)


@pytest.mark.parametrize(
    ("recordings", "fix"),
    [
        (["a", "b"], "it has 2 episodes, so record more or 'animarl import' with --piece"),
        (["a", "a", "b"], "it has 2 recordings, so deal with 'animarl data split --by episode'"),
        (["a", "b", "c"], "deal them again with 'animarl data split'"),
    ],
)
def test_demonstrations_too_few_to_split(
    recordings: list[str], fix: str, tmp_path: Path, animarl: Callable[..., Done]
) -> None:
    demos = load_packaged("fly").select(episodes=range(len(recordings)))
    split = np.array(["train", "val", "train"])[: len(recordings)]
    replace(demos, recording=np.array(recordings), split=split).save(tmp_path / "few.npz")
    refused(animarl("run", "few.npz", "--out", "run"), f"split 'test' holds no episode: {fix}")
    assert not (tmp_path / "run").exists()
