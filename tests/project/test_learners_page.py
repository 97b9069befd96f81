"""docs/learners.md: its programs run one after the other, its YAML is valid."""

import re
import runpy
from pathlib import Path

import pytest
import yaml

from animarl_algos.learner.presets import learner_preset
from animarl_algos.recipes.registry import RECIPES, named_recipe

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "learners.md").read_text()


def blocks(kind: str) -> list[str]:
    """Contents of the fenced blocks of a kind, in their order."""
    fenced = re.findall(r"^```(\w*)\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL)
    return [content for found, content in fenced if found == kind]


def test_the_programs_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    for program in blocks("python"):
        exec(compile(program, "docs/learners.md", "exec"), names)
    assert (tmp_path / "model.zip").exists()
    assert names["model"].num_timesteps >= 500  # type: ignore[attr-defined]


def test_the_yaml_is_read(tmp_path: Path) -> None:
    (text,) = blocks("yaml")
    assert yaml.safe_load(text)["base"] == "dqdil"
    (tmp_path / "mine.yml").write_text(text)
    found = learner_preset("dqdil", "AnimaRL/Agent-v0", config=tmp_path / "mine.yml")
    assert (found.n_envs, found.arguments["alpha"]) == (8, 0.5)
    assert found.env_kwargs == {"dtw": "closeness", "contact_radius": 0.15}


def test_the_table_names_every_learner() -> None:
    for name in RECIPES:
        assert f"`{name.removeprefix('qr-')}`" in PAGE
        assert f".{named_recipe(name).algorithm.__name__}`" in PAGE


def test_the_defaults_are_those_of_the_files() -> None:
    """``python docs/make_defaults_table.py`` writes them anew."""
    make = runpy.run_path(str(ROOT / "docs" / "make_defaults_table.py"))
    for begin, table in (("BEGIN", "table"), ("BEGIN_OFFLINE", "offline_table")):
        _, shown = PAGE.split(make[begin])
        assert shown.split(make["END"])[0].strip() == make[table]().strip()
