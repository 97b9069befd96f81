"""A learner made in Python without settings has those of preset ``default``, for its species."""

from __future__ import annotations

import pydoc
from functools import cache
from typing import Any

import gymnasium as gym
import pytest
import toys
import yaml
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.utils import LinearSchedule
from stable_baselines3.common.vec_env import DummyVecEnv, VecMonitor

from animarl_algos.data.vec_env import SlotVecEnv
from animarl_algos.learner.algorithm import SequenceQLearning
from animarl_algos.learner.presets import CONFIGS, constructed, learner_preset, section_of
from animarl_algos.learner.settings import LearnerSettings, default_settings
from animarl_algos.recipes.registry import DQDIL, DQN, RECIPES
from animarl_envs import SPECIES, environment_id
from animarl_envs.errors import InputError

FOREIGN = "MountainCar-v0"
CARTPOLE = "CartPole-v1"


@cache
def slots(species: str) -> SlotVecEnv:
    return SlotVecEnv(species, 1, condition_flag=None)


def in_use(model: SequenceQLearning, name: str) -> Any:
    """A setting of a learner, as a file would say it."""
    if name == "policy":
        return model.policy_class.__name__
    value = getattr(model, "_stats_window_size" if name == "stats_window_size" else name)
    if name == "train_freq":
        value = (value.frequency, value.unit.value)
    if isinstance(value, LinearSchedule):
        return f"lin_{value.start:g}"
    return list(value) if isinstance(value, tuple) else value


def expected(algo: str, env_id: str) -> dict[str, Any]:
    """Of the files."""
    return tables_filled(default_settings() | learner_preset(algo, env_id, "default").arguments)


def tables_filled(settings: dict[str, Any]) -> dict[str, Any]:
    """An absent table is an empty one."""
    return {k: {} if k.endswith("kwargs") and v is None else v for k, v in settings.items()}


def make(algo: str, env: Any) -> SequenceQLearning:
    """The learner of that name, told nothing but the epochs that its ``-pt`` stands for."""
    if not algo.endswith("-pt"):
        return RECIPES[algo].algorithm(env=env, device="cpu")
    epochs = expected(algo, section_of(env))["offline_epochs"]
    return RECIPES[algo].algorithm(env=env, device="cpu", offline_epochs=epochs)


@pytest.mark.parametrize("species", SPECIES)
@pytest.mark.parametrize("algo", RECIPES)
def test_a_learner_without_settings_has_the_presets(algo: str, species: str) -> None:
    model = make(algo, slots(species))
    settings = expected(algo, environment_id(species))
    if species == "shoal":  # animals that are alike have one network
        settings["policy_kwargs"] = settings["policy_kwargs"] | {"shared": True}
    assert {name: in_use(model, name) for name in settings} == settings


@pytest.mark.parametrize("algo", ["dqn", "dqdil-pt", "qr-bc"])
def test_a_learner_of_the_paper_takes_nothing_from_the_default(algo: str) -> None:
    moth = environment_id("silkmoth")  # whose defaults are the furthest from the paper's
    paper = learner_preset(algo, moth, "paper").arguments
    model = RECIPES[algo].algorithm(env=slots("silkmoth"), device="cpu", **constructed(paper))
    settings = tables_filled(default_settings() | paper)
    assert {name: in_use(model, name) for name in settings} == settings


@pytest.mark.parametrize("algo", ["dqn", "bc", "qr-dqaas", "dqcil-pt"])
def test_in_a_foreign_environment_the_common_ones(algo: str) -> None:
    model = make(algo, FOREIGN)
    settings = expected(algo, FOREIGN)
    assert {name: in_use(model, name) for name in settings} == settings
    assert settings == expected(algo, "Another-v0")


def test_every_way_to_name_a_species_is_understood() -> None:
    moth = environment_id("silkmoth")
    environments = [
        moth,
        gym.make(moth),
        slots("silkmoth"),
        VecMonitor(SlotVecEnv("silkmoth", 1)),
        DummyVecEnv([lambda: gym.make(moth)]),
    ]
    assert {section_of(env) for env in environments} == {moth}
    rate = expected("dqn", moth)["learning_rate"]
    assert rate != expected("dqn", FOREIGN)["learning_rate"]
    for env in environments[1:]:
        assert DQN(env=env, device="cpu").learning_rate == rate
    assert section_of(None) == section_of(toys.Pair(2)) == ""


@pytest.mark.parametrize("task", [CARTPOLE, "Acrobot-v1"])
def test_an_ordinary_task_has_a_section_however_it_is_given(task: str) -> None:
    settings = expected("dqn", task)
    assert settings != expected("dqn", FOREIGN)
    for env in (task, gym.make(task), DummyVecEnv([lambda: gym.make(task)]), make_vec_env(task, 2)):
        assert section_of(env) == task
        model = DQN(env=env, device="cpu")
        assert {name: in_use(model, name) for name in settings} == settings


def test_what_is_given_goes_over_the_preset_and_tables_key_by_key() -> None:
    model = RECIPES["qr-dqn"].algorithm(
        "MlpPolicy", slots("agent"), gamma=0.5, policy_kwargs={"hidden": 8}, device="cpu"
    )
    network = {"hidden": 8, "n_quantiles": 20}
    changed = {"policy": "MlpPolicy", "gamma": 0.5, "policy_kwargs": network}
    for name, value in (expected("qr-dqn", environment_id("agent")) | changed).items():
        assert in_use(model, name) == value


def test_none_empties_a_table_of_the_preset() -> None:
    assert RECIPES["bc"].algorithm(env=slots("agent"), device="cpu").offline_kwargs
    emptied = RECIPES["bc"].algorithm(env=slots("agent"), device="cpu", offline_kwargs=None)
    assert emptied.offline_kwargs == {}


def test_a_misspelt_setting_is_refused() -> None:
    with pytest.raises(
        InputError, match=r"'learning_rat' is unknown: choose among .*learning_rate"
    ):
        DQN(env=slots("agent"), learning_rat=1e-3)  # type: ignore[call-arg]


def test_the_settings_are_listed_and_explained_once() -> None:
    named = {"policy", "learning_rate"}
    assert set(LearnerSettings.__annotations__) | named == set(default_settings())
    shown = pydoc.render_doc(DQDIL, renderer=pydoc.plaintext)
    entries = {name for line in shown.splitlines() for name in line.strip(" |").split(", ")}
    assert set(default_settings()) <= entries
    assert "zoo_configs" in shown and "demonstrations" in entries


def test_the_settings_of_a_recipe_can_be_looked_up() -> None:
    plain = DQDIL.default_settings(environment_id("agent"))
    pretrained = DQDIL.default_settings(pretrained=True)
    assert plain["offline_epochs"] == 0 < pretrained["offline_epochs"]
    assert not plain["offline_scaled_penalties"] and pretrained["offline_scaled_penalties"]


def test_every_file_of_a_learner_is_a_recipes() -> None:
    others = {"pipeline", "pretraining", "cloning"}
    files = {f.name.removesuffix(".yml") for f in CONFIGS.iterdir() if f.name.endswith(".yml")}
    assert files - others == set(RECIPES)
    classes = {named.algorithm for named in RECIPES.values()}
    names = {n for c in classes for n in (c.preset, c.pretrained_preset) if n is not None}
    assert names == set(RECIPES)
    for name, named in RECIPES.items():
        content = yaml.safe_load((CONFIGS / f"{name}.yml").read_text())
        assert content and name in (named.algorithm.preset, named.algorithm.pretrained_preset)
