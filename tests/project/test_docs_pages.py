"""The environment pages agree with the specs, and what they show works."""

import ast
import importlib
import json
import re
import subprocess
import sys
from pathlib import Path
from types import ModuleType
from urllib.parse import unquote

import gymnasium as gym
import pytest
from browser import chromium
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


ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.slow
def test_docs_site_builds_without_a_warning(tmp_path: Path) -> None:
    pytest.importorskip("myst_nb", reason="the extra 'docs' is not installed")
    out = tmp_path / "html"
    built = subprocess.run(
        [
            *(sys.executable, "-m", "sphinx", "-W", "--keep-going", "-q", "-b", "html"),
            *("-d", tmp_path / "doctrees", ROOT / "docs", out),
        ],
        capture_output=True, text=True,
    )  # fmt: skip
    assert built.returncode == 0, built.stderr[-3000:]
    names = (ROOT / "tests" / "public_names.txt").read_text().splitlines()
    reference = (out / "_generated" / "api.html").read_text()
    learners = [
        name for name in names if name.startswith("animarl_algos.") and name.count(".") == 1
    ]
    assert all(f'id="{name}"' in reference for name in learners)
    for species in ("agent", "fly", "newt", "silkmoth"):
        page = (out / "live" / f"{species}.html").read_text()
        assert "<title>What if" in page and len(page) < 5_000_000
    assert re.search(r"steps/s", (out / "tutorials" / "environments.html").read_text())
    for page in out.rglob("*.html"):
        for link in re.findall(r'(?:href|src)="([^"#?]+)', page.read_text(encoding="utf-8")):
            if not re.match(r"\w+:|//", link):
                assert (page.parent / unquote(link)).exists(), f"{page.name} links to {link}"
    for name in ("own_tracks", "environments"):
        (file,) = out.glob(f"_downloads/*/{name}.ipynb")
        cells = [one for one in json.loads(file.read_text())["cells"] if one["cell_type"] == "code"]
        assert len(cells) >= 5 and all(one["execution_count"] for one in cells)
    with chromium() as browser:
        opened = browser.new_page(viewport={"width": 390, "height": 844})
        opened.goto((out / "search.html").as_uri() + "?q=shoal")
        opened.wait_for_selector("#search-results li a", timeout=60_000)
        for name in ("index", "gallery", "environments/agent", "learners", "statistics"):
            opened.goto((out / f"{name}.html").as_uri())
            assert opened.evaluate("document.documentElement.scrollWidth") <= 390, name


def test_docs_site_lists_every_page_once() -> None:
    index = (ROOT / "docs" / "index.md").read_text()
    listed = re.findall(r"^([\w/]+)$", index, re.MULTILINE)
    assert len(listed) == len(set(listed))
    for name in listed:
        assert name.startswith("_generated/") or (ROOT / "docs" / f"{name}.md").is_file(), name
    for page in (ROOT / "docs").glob("*.md"):
        assert page.stem in listed or page.name in ("index.md", "registry.md"), page.name
