"""The environment pages agree with the specs, and what they show works."""

import ast
import importlib
import sys
from pathlib import Path
from types import ModuleType

import gymnasium as gym
import pytest
from refusals import refuses

import animarl_envs
from animarl_envs.scenario import make_scenario
from animarl_envs.species import SPECIES, ChaseSpecies

DOCS = Path(__file__).parents[2] / "docs"


@pytest.fixture(scope="module")
def generator() -> ModuleType:
    sys.path.insert(0, str(DOCS))
    try:
        return importlib.import_module("make_env_pages")
    finally:
        sys.path.remove(str(DOCS))


def test_pages_are_up_to_date(generator):
    written = {path.name: path.read_text() for path in (DOCS / "environments").glob("*.md")}
    expected = generator.pages()
    assert set(written) == set(expected)
    for name, text in expected.items():
        assert written[name] == text, f"run python docs/make_env_pages.py --text-only ({name})"


@pytest.mark.parametrize("name", SPECIES)
def test_options_of_the_page_are_those_that_are_accepted(generator, name):
    species = SPECIES[name]
    listed = set(generator.option_defaults(species))
    said = refuses("", make_scenario, species, no_such_option=1)
    known = set(said.rpartition("choose one of ")[2].split(", "))
    not_options = {"source", "title", "version_history", "drivers"}
    if not isinstance(species, ChaseSpecies):
        not_options |= {"num_pursuers", "num_targets"}
    elif species.free:
        not_options |= {"num_targets"}
    assert known - not_options <= listed


@pytest.mark.parametrize("name", SPECIES)
def test_defaults_of_the_page_make_the_same_world(generator, name):
    species, env_id = SPECIES[name], animarl_envs.environment_id(name)
    shown = generator.option_defaults(species)
    taken_apart = {"arena", "boundary", "locomotion", "num_pursuers", "num_targets", "render_mode"}
    given = {key: ast.literal_eval(text) for key, text in shown.items() if key not in taken_apart}
    plain, spelled = gym.make(env_id).unwrapped, gym.make(env_id, **given).unwrapped
    assert plain.scenario.species == spelled.scenario.species
    assert plain.scenario.start == spelled.scenario.start
    assert plain.scenario.drivers == spelled.scenario.drivers


@pytest.mark.parametrize("name", [*SPECIES, "custom"])
def test_page_has_a_light_picture(name):
    assert f"../images/{name}.png" in (DOCS / "environments" / f"{name}.md").read_text()
    assert 5_000 < (DOCS / "images" / f"{name}.png").stat().st_size < 100_000
