"""Tables of the results pages agree with their CSV, links lead on, and scripts run."""

import csv
import os
import re
import runpy
import subprocess
import sys
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGES = [
    ROOT / "benchmarks" / "README.md",
    ROOT / "README.md",
    *sorted((ROOT / "docs").rglob("*.md")),
    *sorted((ROOT / "animarl_algos" / "pretrained").rglob("*.md")),
]
LIVING = ["moths", "termites", "fly-groups", "courtship"]


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


def test_every_cell_of_the_test_table_has_its_headline_on_the_page(tables: dict[str, Any]) -> None:
    cells = pd.read_csv(tables["TEST_TABLE"]).drop_duplicates(["set", "seed"])
    assert set(cells["set"]) == set(tables["TESTED"])
    lines = {line.split(" | ")[0].strip("| "): line for line in tables["verdicts"]().splitlines()}
    for cell in cells.itertuples():
        assert str(cell.overall) in lines[str(cell.set)]


def test_the_page_says_how_many_living_cells_have_a_fault(tables: dict[str, Any]) -> None:
    cells = pd.read_csv(tables["TEST_TABLE"]).drop_duplicates(["set", "seed"])
    living = cells[cells["set"].isin(LIVING)]
    without = ["moves like the recordings", "not distinguishable"]
    faulty = (~living["overall"].isin(without)).sum()
    page = (ROOT / "docs" / "results" / "README.md").read_text()
    assert f"{faulty} of {len(living)} cells have a fault" in page


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


FOLDER = Path(__file__).resolve().parents[2] / "benchmarks"


@pytest.mark.parametrize("name", ["baselines", "stated_coverage", "verdict_power", "whatif_truth"])
def test_a_benchmark_starts_as_a_script(name: str, tmp_path: Path) -> None:
    clean = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
    said = subprocess.run(
        [sys.executable, FOLDER / f"{name}.py", "--help"],
        capture_output=True, text=True, cwd=tmp_path, env=clean,
    )  # fmt: skip
    assert said.returncode == 0, said.stderr
    assert "--quick" in said.stdout or "--only" in said.stdout


@pytest.mark.slow
def test_a_team_learns_and_is_scored(tmp_path: Path) -> None:
    command = [FOLDER / "baselines.py", "--quick", "--task", "agent", "--out", tmp_path]
    learners = ["--learner", "PPO", "--learner", "DQN"]
    subprocess.run([sys.executable, "-W", "ignore", *command, *learners], check=True, cwd=tmp_path)
    with (tmp_path / "teams.csv").open(newline="") as file:
        rows = {row["policy"]: row for row in csv.DictReader(file)}
    assert list(rows) == ["random", "PPO", "DQN", "demonstrations (synthetic)"]
    assert [row["score"] for row in rows.values()][::3] == ["0.00", "1.00"]
    assert rows["DQN"]["steps"] == "16384" and -1.0 < float(rows["DQN"]["return"]) < 1.0
