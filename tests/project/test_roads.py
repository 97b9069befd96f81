"""Roads of docs/architecture.md: short, each step called by one above it, no file opened twice."""

import ast
import re
from itertools import groupby
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs" / "architecture.md").read_text()
SECTION = PAGE.partition("\n## Roads\n")[2].partition("\n## ")[0]
STEP = re.compile(r"^\| `([\w.]+)` \| \[`[\w/.]+`\]\(\.\./([\w/]+\.py)\) \|", re.MULTILINE)
ROADS = {
    title: STEP.findall(text)
    for title, _, text in (part.partition("\n") for part in SECTION.split("\n### ")[1:])
}
LONGEST, MOST_FILES = 8, 4


def find_function(name: str, file: str) -> ast.AST:
    """Return a function, a class or, as Class.method, a method of a file."""
    body = ast.parse((ROOT / file).read_text()).body
    for part in name.split("."):
        found = [one for one in body if getattr(one, "name", None) == part]
        assert found, f"{file} has no {name}: correct the road in docs/architecture.md"
        body = found[0].body  # type: ignore[attr-defined]
    return found[0]


def names_used(function: ast.AST) -> set[str]:
    """Return all names and attributes that occur in the body of a function."""
    return {
        getattr(node, "id", getattr(node, "attr", ""))
        for statement in function.body  # type: ignore[attr-defined]
        for node in ast.walk(statement)
        if isinstance(node, ast.Name | ast.Attribute)
    }


def faults_of(steps: list[tuple[str, str]]) -> list[str]:
    """Return what is wrong with a road."""
    files = [file for file, _ in groupby(file for _, file in steps)]
    faults = [f"{file} is opened twice" for file in set(files) if files.count(file) > 1]
    if not 1 < len(steps) <= LONGEST or len(files) > MOST_FILES:
        faults.append(f"{len(steps)} functions in {len(files)} files")
    used: set[str] = set()
    for number, (name, file) in enumerate(steps):
        if number and name.split(".")[-1] not in used:
            faults.append(f"{name} is called by no function above it")
        used |= names_used(find_function(name, file))
    return faults


def test_the_page_has_its_roads() -> None:
    assert len(ROADS) == 4


@pytest.mark.parametrize("title", ROADS)
def test_a_road_is_short_and_goes_down(title: str) -> None:
    assert faults_of(ROADS[title]) == []


def test_a_broken_road_would_be_seen() -> None:
    steps = next(iter(ROADS.values()))
    stranger = ("dtw_distance", "animarl_envs/dtw.py")
    assert "dtw_distance is called by no function above it" in faults_of([*steps[:2], stranger])
    assert f"{steps[0][1]} is opened twice" in faults_of([*steps, steps[0]])
    assert "9 functions in 1 files" in faults_of(steps[:1] * 9)
    with pytest.raises(AssertionError, match="has no"):
        faults_of([("no_such_function", "animarl_envs/dtw.py")])
