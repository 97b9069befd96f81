"""The names that ``animarl_algos`` gives at its front door, and that they cost nothing unasked."""

import json
import re
from functools import cache
from importlib import import_module
from pathlib import Path

import pytest
from commands import animarl
from pages import python
from public_names_list import public_names

import animarl_algos
from animarl_algos.recipes import registry
from animarl_algos.recipes.registry import RECIPES

LOADED = """
import json, sys
import animarl_algos
dir(animarl_algos)
heavy = {"torch", "numba", "numpy", "gymnasium", "pandas", "stable_baselines3", "animarl_envs"}
print(json.dumps(sorted(heavy & set(sys.modules))))
"""


def test_importing_the_learners_loads_nothing() -> None:
    assert json.loads(python(LOADED).stdout) == []


@pytest.mark.parametrize("name", animarl_algos.__all__)
def test_every_public_name_is_there_and_called_so(name: str) -> None:
    value = getattr(animarl_algos, name)
    assert value.__name__ == name
    assert value is getattr(animarl_algos, name)
    assert name in dir(animarl_algos)


def test_every_learner_has_a_public_name() -> None:
    classes = {named.algorithm for named in RECIPES.values()}
    public = {getattr(animarl_algos, name) for name in animarl_algos.__all__}
    assert classes <= public


def test_type_checkers_see_every_learner() -> None:
    """They follow the registry's own list."""
    classes = {named.algorithm.__name__ for named in RECIPES.values()}
    assert set(registry.__all__) == classes | {"RECIPES", "NamedRecipe", "named_recipe"}


def test_an_unknown_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="no attribute 'DQNN'"):
        _ = animarl_algos.DQNN
    with pytest.raises(ImportError):
        exec("from animarl_algos import DQNN")


LISTED = (Path(__file__).resolve().parents[1] / "public_names.txt").read_text().splitlines()


@cache
def help_of(command: str) -> str:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("COLUMNS", "200")
        patch.setenv("TERMINAL_WIDTH", "200")
        return animarl(*command.split()[1:], "--help")


def test_public_names_are_all_listed() -> None:
    missing = sorted(set(public_names()) - set(LISTED))
    assert missing == [], "add them to public_names.txt, or change the page that uses them"


@pytest.mark.parametrize("name", [name for name in LISTED if "." in name])
def test_public_names_can_be_imported(name: str) -> None:
    module, _, attribute = name.rpartition(".")
    assert hasattr(import_module(module), attribute)


@pytest.mark.parametrize("line", [line for line in LISTED if line.startswith("animarl ")])
def test_public_names_of_commands_and_options(line: str) -> None:
    command, _, option = line.partition(" --")
    assert re.search(rf"--{option}\b" if option else r"Usage|usage", help_of(command))
