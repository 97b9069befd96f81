"""The page for contributors: its five examples run as they stand, and name files that are there."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs" / "contributing.md").read_text()
MOST_FILES = {"species": 2, "reader": 2, "recipe": 2, "metric": 1, "world": 2}


def sections() -> dict[str, str]:
    """Text below each "A species: 2 files", by its first words."""
    parts = re.split(r"^## (.*)$", PAGE, flags=re.MULTILINE)
    return dict(zip(parts[1::2], parts[2::2], strict=True))


def test_the_examples_of_the_page_run(tmp_path: Path) -> None:
    blocks = re.findall(r"^```python\n(.*?)^```", PAGE, re.DOTALL | re.MULTILINE)
    assert len(blocks) == 8
    kept = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
    done = subprocess.run(
        [sys.executable, "-W", "error::DeprecationWarning:__main__", "-c", "\n".join(blocks)],
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
    "animarl_envs/importing/readers/published.py",
}
