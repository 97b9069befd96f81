"""README.md, the tutorial, pages for contributors and of learners: they run as they stand."""

import os
import re
import runpy
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
import yaml
from commands import animarl
from pages import ROOT, blocks, python, run_programs

from animarl_algos.learner.presets import learner_preset
from animarl_algos.recipes.registry import RECIPES, named_recipe


def test_the_readme_and_its_moving_picture_are_small() -> None:
    assert len((ROOT / "README.md").read_text().splitlines()) <= 120
    assert 50_000 < (ROOT / "docs" / "images" / "demo.gif").stat().st_size < 2_000_000


def test_the_programs_of_the_readme_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Each in the environment of the last installation above it: all extras, or the core alone."""
    monkeypatch.chdir(tmp_path)
    readme, environments = (ROOT / "README.md").read_text(), []
    for program in blocks("README.md"):
        statements = [line for line in program.splitlines() if line and "import " not in line]
        assert len(statements) <= 10
        above = readme[: readme.index(program)]
        environments.append(re.findall(r"pip install '?(\.[^'\s`]*)", above)[-1])
        if environments[-1] == ".":
            python(CORE_ALONE + program, cwd=tmp_path)
        else:
            exec(compile(program, "README.md", "exec"), {})
    assert environments == [".[all]", ".", ".[all]"]
    assert capsys.readouterr().out.count("caught in") == 2
    assert Path("model.zip").exists()


# Refuses what only the extras install, and the package that needs it.
CORE_ALONE = """
import importlib.metadata, re, sys
core, to_add = set(), ["gymnasium", "numpy", "numba", "pettingzoo", "pydantic"]
while to_add:
    name = to_add.pop()
    if name in core:
        continue
    core.add(name)
    for one in importlib.metadata.requires(name) or ():
        if "extra ==" not in one:
            to_add.append(re.match(r"[\\w.-]+", one)[0].lower().replace("-", "_"))

absent = {"animarl_algos"}
for module, packages in importlib.metadata.packages_distributions().items():
    names = {one.lower().replace("-", "_") for one in packages}
    absent |= set() if names & (core | {"animarl"}) else {module}

class CoreAlone:
    def __init__(self, finder):
        self.finder = finder

    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] not in absent:
            return self.finder.find_spec(name, path, target)

sys.meta_path[:] = map(CoreAlone, sys.meta_path)
"""

CONTRIBUTING = (ROOT / "docs" / "contributing.md").read_text()
MOST_FILES = {"species": 2, "reader": 2, "recipe": 2, "metric": 1, "world": 2}


def sections() -> dict[str, str]:
    """Text below each "A species: 2 files", by its first words."""
    parts = re.split(r"^## (.*)$", CONTRIBUTING, flags=re.MULTILINE)
    return dict(zip(parts[1::2], parts[2::2], strict=True))


@pytest.mark.slow
def test_the_examples_of_the_page_for_contributors_run(tmp_path: Path) -> None:
    programs = blocks("docs/contributing.md")
    assert len(programs) == 8
    kept = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
    done = subprocess.run(
        [sys.executable, "-W", "error::DeprecationWarning:__main__", "-c", "\n".join(programs)],
        cwd=tmp_path, env=kept | {"PYTHONPATH": str(ROOT)}, capture_output=True, text=True,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("kind", MOST_FILES)
def test_an_addition_touches_few_files(kind: str) -> None:
    """As many as the heading says; those that are not new are there, and know the others' names."""
    title = next(title for title in sections() if title.startswith(f"A {kind}: "))
    text = sections()[title].partition("```")[0]
    named = re.findall(r"`((?:animarl_envs|animarl_algos|zoo_configs)/[\w/.-]+)`( \(new\))?", text)
    count = int(title.split()[2])
    assert count <= MOST_FILES[kind]
    places = [path for path, _ in named if path not in BESIDE]
    assert len(places) == count
    for path, new in named:
        assert (ROOT / path).exists() != bool(new), path


# Files that the page speaks of and an addition does not change.
BESIDE = {"animarl_envs/worlds/base.py", "animarl_algos/losses/terms.py"}


def test_a_species_in_the_list_has_its_environment() -> None:
    """That the second file is enough: nothing else names the species."""
    import animarl_envs

    for name in animarl_envs.SPECIES:
        elsewhere = [
            str(path.relative_to(ROOT))
            for path in (ROOT / "animarl_envs").rglob("*.py")
            if f'"{name}"' in path.read_text() and path.parent.name != "species"
        ]
        assert set(elsewhere) <= NAMES_A_SPECIES, name


# "agent" is also a default and an example; the authors' files say which species they are of.
NAMES_A_SPECIES = {
    "animarl_envs/drawing/palette.py",  # shapes of bodies, named after animals
    "animarl_envs/__init__.py",
    "animarl_envs/importing/readers/authors.py",
}


LEARNERS = (ROOT / "docs" / "learners.md").read_text()


@pytest.mark.slow
def test_the_programs_of_the_page_of_learners_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert run_programs("docs/learners.md")["model"].num_timesteps >= 500
    assert (tmp_path / "model.zip").exists()


def test_the_yaml_is_read(tmp_path: Path) -> None:
    (text,) = blocks("docs/learners.md", "yaml")
    assert yaml.safe_load(text)["base"] == "dqdil"
    (tmp_path / "mine.yml").write_text(text)
    found = learner_preset("dqdil", "AnimaRL/Agent-v0", config=tmp_path / "mine.yml")
    assert (found.n_envs, found.arguments["alpha"]) == (8, 0.5)
    assert found.env_kwargs == {"dtw": "closeness", "contact_radius": 0.15}


def test_the_table_names_every_learner() -> None:
    for name in RECIPES:
        assert f"`{name.removeprefix('qr-')}`" in LEARNERS
        assert f".{named_recipe(name).algorithm.__name__}`" in LEARNERS


def test_the_defaults_are_those_of_the_files() -> None:
    """``python docs/make_defaults_table.py`` writes them anew."""
    make = runpy.run_path(str(ROOT / "docs" / "make_defaults_table.py"))
    for begin, table in (("BEGIN", "table"), ("BEGIN_OFFLINE", "offline_table")):
        _, shown = LEARNERS.split(make[begin])
        assert shown.split(make["END"])[0].strip() == make[table]().strip()


def commands() -> list[list[str]]:
    return [
        shlex.split(line) for block in blocks("docs/tutorial.md", "") for line in block.splitlines()
    ]


def test_every_command_is_shown() -> None:
    names = [words[1] for words in commands()]
    assert names == ["data", "run", "run", "run", "run", "evaluate", "whatif"]
    assert all(words[0] == "animarl" for words in commands())


@pytest.mark.slow
def test_the_tutorial_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for words in commands():
        animarl(*words[1:])
        if "--out" in words:
            assert (Path(words[words.index("--out") + 1]) / "report.html").exists()
    assert len(run_programs("docs/tutorial.md")["table"]) > 0
