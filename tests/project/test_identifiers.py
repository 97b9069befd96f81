"""Names say what they hold: no participle or pronoun where rooms are clean; one home a class."""

import ast
from collections import Counter
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
VAGUE = {"told", "said", "asked", "found", "shown", "who", "whom", "whose"}
CLEAN = ("animarl_envs", "animarl_algos")
HOMONYMS = {"Row", "Table"}  # of a page and of what it shows


def modules(folder: str) -> list[Path]:
    """Return the modules of a folder."""
    return sorted((ROOT / folder).rglob("*.py"))


def vague_names(text: str) -> list[str]:
    """Return names of a module's variables, parameters, functions and classes that say nothing."""
    names = []
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Name | ast.Attribute) and isinstance(node.ctx, ast.Store):
            names.append(node.id if isinstance(node, ast.Name) else node.attr)
        elif isinstance(node, ast.arg):
            names.append(node.arg)
        elif isinstance(node, ast.FunctionDef | ast.ClassDef):
            names.append(node.name)
    return [name for name in names if set(name.lower().split("_")) & VAGUE]


@pytest.mark.parametrize("folder", CLEAN)
def test_identifiers_say_what_they_hold(folder: str) -> None:
    paths = {path.relative_to(ROOT).as_posix(): path for path in modules(folder)}
    vague = {name: vague_names(path.read_text()) for name, path in paths.items()}
    assert {name: names for name, names in vague.items() if names} == {}


def test_vague_identifiers_would_be_seen() -> None:
    text = "def told(who, by):\n    self.said = found_it = by\n    return asked\nclass Shown: pass"
    assert sorted(vague_names(text)) == ["Shown", "found_it", "said", "told", "who"]


def test_a_class_has_one_home() -> None:
    homes = Counter(
        node.name
        for package in ("animarl_envs", "animarl_algos")
        for path in modules(package)
        for node in ast.parse(path.read_text()).body
        if isinstance(node, ast.ClassDef)
    )
    assert {name for name, count in homes.items() if count > 1} <= HOMONYMS
