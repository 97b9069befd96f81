"""What cannot become a faithful simulator is refused in one sentence, before any training."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import toys
from commands import Done
from pair_learners import demonstrations

from animarl_algos.data.vec_env import SlotVecEnv, refuse_other_observation
from animarl_algos.learner.algorithm import SequenceQLearning
from animarl_algos.recipes.registry import DQDIL, IQLearn, SoftBC
from animarl_algos.runs import pipeline
from animarl_algos.runs.run import Run
from animarl_algos.runs.run_settings import RunSettings
from animarl_envs.demos.packaged import load_packaged
from animarl_envs.errors import InputError
from animarl_envs.species import FLY


def is_one_sentence(said: str) -> bool:
    return "\n" not in said and ". " not in said.replace("...", "")


@pytest.mark.parametrize("recipe", [IQLearn, DQDIL])
def test_a_recipe_that_needs_the_simulator_and_is_given_none(
    recipe: type[SequenceQLearning], tmp_path: Path
) -> None:
    with pytest.raises(InputError, match="no environment to learn in: give env=") as said:
        recipe("MlpPolicy")
    assert is_one_sentence(str(said.value))
    settings: dict[str, Any] = {"demonstrations": demonstrations(), "buffer_size": 500}
    recipe("MlpPolicy", toys.Pair(2), offline_epochs=1, **settings).save(tmp_path / "model")
    loaded = recipe.load(tmp_path / "model", device="cpu")
    with pytest.raises(InputError, match="no environment to learn in: give env="):
        loaded.learn(10)
    assert not loaded.offline_progress.epoch


def test_a_recipe_that_needs_recordings_in_the_simulator_and_is_given_none() -> None:
    bare = SlotVecEnv("fly", 2, demos=None)
    for recipe, lacks in (
        (IQLearn, "was given demonstrations"),
        (DQDIL, "needs the distance to a"),
    ):
        with pytest.raises(InputError, match=lacks) as said:
            recipe("MlpPolicy", bare, offline_epochs=0, buffer_size=2000, device="cpu")
        assert is_one_sentence(str(said.value))


def test_an_acting_rule_that_was_never_fitted(tmp_path: Path) -> None:
    settings = RunSettings(
        file="packaged", species="fly", algo="soft-bc", steps=1, copies=1, baselines=False
    )
    pipeline.open_run(settings, tmp_path / "run", "test", load_packaged("fly"))
    with pytest.raises(
        InputError, match=r"no acting rule was chosen yet: .* give --acting"
    ) as said:
        Run(tmp_path / "run").acting("soft-bc")
    assert is_one_sentence(str(said.value))


@pytest.mark.parametrize("rule", ["boltzmann:1,2", "epsilon:2"])
def test_an_acting_rule_for_others(rule: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"2 numbers for 3 individuals|epsilon is 2") as said:
        settings = RunSettings(
            file="packaged", species="fly", algo="soft-bc", steps=1, copies=1, acting=rule
        )
        pipeline.open_run(settings, tmp_path / "run", "test", load_packaged("fly"))
    assert is_one_sentence(str(said.value)) and not (tmp_path / "run").exists()


def test_a_model_of_another_observation() -> None:
    model = SoftBC(env=SlotVecEnv("fly", 2), device="cpu", seed=0)
    paper = SlotVecEnv("fly", 2, observation="paper")
    with pytest.raises(InputError, match="shows 'own position x', which this"):
        model.set_env(paper)
    before = model.env
    with pytest.raises(InputError, match="is of the species newt, this learner of fly"):
        model.set_env(SlotVecEnv("newt", 2))
    assert model.env is before
    model.demonstrations = paper.offline_data()
    with pytest.raises(InputError, match="observation components, the environment") as said:
        model.learn(1)
    assert is_one_sentence(str(said.value)) and not model.offline_progress.epoch


@pytest.mark.parametrize(
    ("here", "word"),
    [
        ((), None),  # an environment, or an older file, that does not say
        (("fly", "speed", "place"), None),
        (("moth", "speed", "place"), "of the species moth, this learner of fly"),
        (("fly", "speed", "wall"), "shows 'wall', which this learner has not"),
        (("fly", "speed"), "does not show 'place', which this learner has"),
        (("fly", "place", "speed"), "in another order"),
    ],
)
def test_observations_are_compared_by_name_where_both_are_known(
    here: tuple[str, ...], word: str | None
) -> None:
    learned = ("fly", "speed", "place")
    if word is None:
        refuse_other_observation(learned, here)
        refuse_other_observation(here, learned)
        return
    with pytest.raises(InputError, match=word) as said:
        refuse_other_observation(learned, here)
    assert is_one_sentence(str(said.value))


def test_a_model_of_other_thrust_magnitudes() -> None:
    model = SoftBC(env=SlotVecEnv("fly", 2), device="cpu", seed=0)
    three = tuple(replace(own, magnitudes=(1.5, 1.0, 0.5)) for own in FLY.locomotion)
    richer = replace(FLY, locomotion=three)
    with pytest.raises(InputError, match=r"13 actions learned and 37 here: .*same thrust magn"):
        model.set_env(SlotVecEnv(richer, 2))
    model.demonstrations = SlotVecEnv(richer, 2).offline_data()
    with pytest.raises(InputError, match="the environment has 13") as said:
        model.learn(1)
    assert is_one_sentence(str(said.value)) and not model.offline_progress.epoch


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
    done = animarl("run", "few.npz", "--out", "run")
    said = done.stderr.strip()
    assert done.returncode == 2 and is_one_sentence(said)
    assert f"split 'test' holds no episode: {fix}" in said
    assert not (tmp_path / "run").exists()
