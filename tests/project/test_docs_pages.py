"""Pages agree with the specs, results with their CSV; links lead on, benchmarks' scripts run."""

import ast
import csv
import importlib
import json
import os
import re
import runpy
import subprocess
import sys
from pathlib import Path
from types import ModuleType
from typing import Any
from urllib.parse import unquote

import gymnasium as gym
import pandas as pd
import pytest
from browser import chromium
from refusals import refuses
from slow import slowly

import animarl_envs
from animarl_envs.scenario import make_scenario
from animarl_envs.species import SPECIES, ChaseSpecies

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"


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


@pytest.mark.parametrize(("score", "word"), [("0.35", "met"), ("0.36", "missed")])
def test_the_aim_for_the_best_constant_action(generator, score, word):
    policies = {"random": "0.00", "constant 1 of 13": score, "PPO": "1.00"}
    rows = [["`Task`", policy, "", "1.0", "", earned, "1"] for policy, earned in policies.items()]
    returns = "(returns 1.0 of 1.0, random 1.0)"
    assert f"at most 0.35: {score} {returns}, {word}" in generator.bars(rows)[0]


@pytest.mark.parametrize("name", SPECIES)
def test_options_of_the_page_are_those_that_are_accepted(generator, name):
    species = SPECIES[name]
    listed = set(generator.option_defaults(species))
    said = refuses("", make_scenario, species, no_such_option=1)
    known = set(said.rpartition("choose one of ")[2].split(", "))
    not_options = {"source", "title", "version_history", "drivers"}
    if not isinstance(species, ChaseSpecies):
        not_options |= {"num_pursuers", "num_targets", "landmarks", "obstacles"}
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


def build_site(out: Path, builder: str, *more: str) -> None:
    """Build the site; a warning is an error."""
    command = [sys.executable, "-m", "sphinx", "-W", "--keep-going", "-q", "-b", builder, *more]
    places = ["-d", out.parent / "doctrees", ROOT / "docs", out]
    built = subprocess.run([*command, *places], capture_output=True, text=True)
    assert built.returncode == 0, built.stderr[-3000:]


def test_docs_site_builds_without_a_warning(tmp_path: Path) -> None:
    pytest.importorskip("myst_nb", reason="the extra 'docs' is not installed")
    build_site(tmp_path / "site", "dummy", "-t", "unexecuted")  # which reads all and writes nothing
    assert (tmp_path / "doctrees" / "tutorials" / "environments.doctree").exists()


@pytest.mark.slow
def test_docs_site_with_executed_notebooks(tmp_path: Path) -> None:
    pytest.importorskip("myst_nb", reason="the extra 'docs' is not installed")
    out = tmp_path / "html"
    build_site(out, "html")
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
        assert page.stem in listed or page.name in ("index.md", "package_index.md"), page.name


PAGES = [
    ROOT / "benchmarks" / "README.md", ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md")),
    *sorted((ROOT / "animarl_algos" / "pretrained").rglob("*.md")),
]  # fmt: skip
LATER = slowly("stated_coverage", "verdict_power", "whatif_truth")
LIVING = [
    *("moths", "termites", "fly-groups", "courtship"),
    *("termites_alone", "larvae", "bats_obstacles", "fish15", "locusts"),
]


@pytest.fixture(scope="module")
def tables() -> dict[str, Any]:
    return runpy.run_path(str(ROOT / "docs" / "make_results_tables.py"))


def test_the_tables_are_those_of_the_csv(tables: dict[str, Any]) -> None:
    """``python docs/make_results_tables.py`` writes them anew."""
    for page, makers in tables["PAGES"].items():
        text = page.read_text()
        for name, make in makers.items():
            begin, end = tables["marks"](name)
            assert text.count(begin) == text.count(end) == 1
            assert text.split(begin)[1].split(end)[0].strip() == make().strip(), (page, name)


def tested_cells() -> pd.DataFrame:
    return pd.read_csv(ROOT / "docs" / "results" / "test" / "verdicts.csv").fillna("")


def test_every_tested_cell_has_what_differs_and_how_many_questions_on_the_page(
    tables: dict[str, Any],
) -> None:
    cells = tested_cells()
    assert set(cells["set"]) <= set(tables["TESTED"])
    lines = {line.split(" | ")[0].strip("| "): line for line in tables["verdicts"]().splitlines()}
    for cell in cells.to_dict("records"):
        assert cell["complaints"] in lines[cell["set"]] and bool(cell["complaints"]) == (
            cell["differs"] > 0
        )
        assert sum(cell[word] for word in tables["WORDS"]) >= 16


def test_the_page_says_how_many_living_cells_have_a_fault() -> None:
    living = tested_cells().query("set in @LIVING")
    page = (ROOT / "docs" / "results" / "README.md").read_text()
    assert f"{(living['page'] == 'red').sum()} of {len(living)} cells have a fault" in page


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_between_pages_lead_somewhere(page: Path) -> None:
    text = re.sub(r"```.*?```", "", page.read_text(), flags=re.DOTALL)
    for target in re.findall(r"\]\(([^)\s]+)\)", text):
        path, _, anchor = target.partition("#")
        if "://" in target:
            continue
        file = (page.parent / path).resolve() if path else page
        assert file.exists(), target
        if anchor and file.suffix == ".md":
            assert anchor in anchors(file), target


def anchors(file: Path) -> set[str]:
    """Return the anchors of a page's headings, as GitHub makes them."""
    headings = re.findall(r"^#+ (.*)$", file.read_text(), flags=re.MULTILINE)
    plain = [re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", heading).lower() for heading in headings]
    return {re.sub(r"[^\w\- ]", "", heading).replace(" ", "-") for heading in plain}


@pytest.mark.parametrize("name", ["baselines", *LATER])
def test_a_benchmark_starts_as_a_script(name: str, tmp_path: Path) -> None:
    clean = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
    said = subprocess.run(
        [sys.executable, ROOT / "benchmarks" / f"{name}.py", "--help"],
        capture_output=True, text=True, cwd=tmp_path, env=clean,
    )  # fmt: skip
    assert said.returncode == 0, said.stderr
    assert "--quick" in said.stdout or "--only" in said.stdout


@pytest.mark.slow
def test_a_team_learns_and_is_scored(tmp_path: Path) -> None:
    command = [
        ROOT / "benchmarks" / "baselines.py", "--quick", "--task", "AgentTask", "--out", tmp_path,
    ]  # fmt: skip
    learners = ["--learner", "PPO", "--learner", "DQN"]
    subprocess.run([sys.executable, "-W", "ignore", *command, *learners], check=True, cwd=tmp_path)
    with (tmp_path / "teams.csv").open(newline="") as file:
        rows = {row["policy"]: row for row in csv.DictReader(file)}
    assert list(rows) == ["random", "PPO", "DQN", "demonstrations (synthetic)"]
    assert [row["score"] for row in rows.values()][::3] == ["0.00", "1.00"]
    assert rows["DQN"]["steps"] == "16384" and -1.0 < float(rows["DQN"]["return"]) < 1.0
