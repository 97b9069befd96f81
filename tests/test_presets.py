"""The YAML settings build every learner, and nothing in them is misspelt."""

from __future__ import annotations

import pytest

from animarl_algos.presets import learner_settings, read_section
from animarl_algos.recipes import RECIPES, named_recipe
from animarl_algos.vec_env import SlotVecEnv
from animarl_envs import SPECIES
from animarl_envs.errors import InputError


@pytest.mark.parametrize("algo", RECIPES)
def test_every_recipe_can_be_made_from_its_settings(algo: str) -> None:
    env = SlotVecEnv("agent", 2, condition_flag=True)
    settings = learner_settings(algo, "agent", {"buffer_size": 2000})
    model = named_recipe(algo).algorithm(env=env, seed=0, **settings)
    assert (model.offline_epochs > 0) == named_recipe(algo).pretrained


@pytest.mark.parametrize("species", SPECIES)
@pytest.mark.parametrize("algo", RECIPES)
def test_every_species_has_settings(algo: str, species: str) -> None:
    assert learner_settings(algo, species, {})


def test_a_misspelt_key_is_refused_by_name() -> None:
    with pytest.raises(InputError, match="learning_rat"):
        learner_settings("dqn", "agent", {"learning_rat": 1.0})


def test_an_unknown_file_is_refused() -> None:
    with pytest.raises(InputError, match="nowhere"):
        read_section("nowhere", "agent")
