"""``animarl paper``: records of tiny cells, tables, figures, refusals, and the same bytes again."""

import re
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pandas as pd
import pytest
from commands import animarl
from refusals import refuses
from scipy import stats

from animarl_algos.benchmark.departures import (
    ALONE,
    CROSS_ENTROPY,
    DEPARTURES,
    DISTANCE,
    PUBLISHED,
    RATES,
    SINGLE,
    TOGETHER,
    at_rate,
    setting_of,
)
from animarl_algos.benchmark.paper import LEARNERS, Record, Scope
from animarl_algos.benchmark.paper_figures import PRETRAINED, compared_learners
from animarl_algos.benchmark.paper_page import adapted_page, departures_page
from animarl_algos.benchmark.paper_tables import (
    DEFAULT,
    GAIN,
    REACHED_GAIN,
    Findings,
    kde_distance,
    kde_interval,
    published,
)
from animarl_algos.runs.run_settings import CHOSEN
from animarl_envs.demos.packaged import load_packaged

TRY = ["--quick", "--species", "silkmoth", "--only", "bc", "--only", "dqdil", "--setting", "onset"]
TABLES = {"table1", "figure3", "figure4", "figure5", "adapted", "departures", "costs"}
FIGURES = {"figure2", "figure3", "figure4", "figure4-joint", "figure5", "figure6", "text-s1"}


def contents(folder: Path) -> dict[str, bytes]:
    made = [folder / "paper.md", *(folder / "results" / "paper").iterdir()]
    return {file.name: file.read_bytes() for file in made}


@pytest.fixture(scope="module")
def first(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("paper") / "out"
    assert "0 of 2 cells are there" in animarl("paper", *TRY, "--out", out)
    return out


def test_paper_makes_every_table_and_figure_and_none_twice(first: Path) -> None:
    made = contents(first)
    expected = {f"{name}.csv" for name in TABLES} | {f"{name}.svg" for name in FIGURES}
    assert expected | {"paper.md", "adapted.svg", "departures.svg"} == set(made)
    online = "1,675 × 1e-05 = 0.017 | 1,675 × 1e-07 = 0.00017"
    for pages in (made, contents(Path(__file__).parents[3] / "docs")):
        assert max(map(len, pages.values())) < 200_000
        page = pages["paper.md"].decode()
        assert "not made" not in page and "$" not in page and "nan" not in page
        assert f"| silkmoths | 90 × 1e-05 = 0.0009 | {online} |" in page
    assert "2 of 2 cells are there" in animarl("paper", *TRY, "--out", first)
    assert contents(first) == made


def test_numbers_of_the_paper_page_are_rows_of_its_tables(first: Path) -> None:
    folder, page = first / "results" / "paper", (first / "paper.md").read_text()
    table = pd.read_csv(folder / "figure4.csv")
    assert set(table["measure"]) == {"reached", "duration", "path_length", "dtw"}
    line = next(one for one in page.splitlines() if one.startswith("| silkmoths | DQDIL | onset"))
    for value in table[table["learner"] == "dqdil"]["value"]:
        shown = [float(one.replace("−", "-")) for one in re.findall(r"−?\d+\.?\d*", line)]
        assert min(abs(one - value) for one in shown) <= 0.02 * abs(value) + 0.005
    fits = pd.read_csv(folder / "table1.csv").set_index("parameter").loc["damping"]
    assert fits["joint"] == pytest.approx(fits["true"], rel=1e-3)
    assert fits["onset"] > 1.5 * fits["true"]
    flips = pd.read_csv(folder / "figure5.csv")
    assert {"1 → 2", "2 → 1"} <= set(flips[flips["learner"] == "dqdil"]["measure"])


def test_departures_stand_beside_the_published_settings_and_the_default(tmp_path: Path) -> None:
    words = ["--only", "dqdil-pt", "--setting", "departed", "--setting", "adapted"]
    animarl("paper", "--quick", "--species", "silkmoth", *words, "--out", tmp_path)
    folder, page = tmp_path / "results" / "paper", (tmp_path / "paper.md").read_text()
    table = pd.read_csv(folder / "departures.csv")
    assert set(table["departure"]) == {PUBLISHED, TOGETHER[-1], DEFAULT}
    measures = {"reached", "duration", "path_length", "dtw", "realism"}
    assert set(table["measure"]) == measures and len(table) == 15
    rows = [line for line in page.splitlines() if line.startswith("| silkmoths | ")]
    for departure, own in table[table["measure"] == "realism"].groupby("departure"):
        line = next(one for one in rows if f"| {departure} | 1 |" in one)
        shown = float(line.strip("| ").rpartition("| ")[2])
        assert shown == pytest.approx(own["value"].item(), rel=0.01)
    clones = pd.read_csv(folder / "adapted.csv", index_col=["measure", "steps"])["value"]
    realism, gains = clones["realism"], clones[GAIN]
    assert 0 not in gains.index and len(gains) == len(realism) - 1 > 0
    assert gains.to_numpy() == pytest.approx(realism[gains.index] - realism[0], abs=1e-6)
    assert page.count("Of 17 questions") == len(realism)


def test_adapting_helps_where_the_interval_of_a_gain_excludes_zero() -> None:
    lows = {"dqaas": 0.001, "dqdil-pt": -0.001, "dqcil-pt": -0.03}
    table = pd.DataFrame({"learner": list(lows), "low": list(lows.values())})
    table = table.assign(value=table["low"] + 0.01, high=table["low"] + 0.02, species="silkmoth")
    table = table.assign(measure=GAIN, steps=5000, seeds=3, published="")
    reached = table.assign(measure=REACHED_GAIN, low=0.1, value=0.2, high=0.3)
    scope, table = SimpleNamespace(seeds=(0, 1, 2)), pd.concat([table, reached])
    findings = SimpleNamespace(adapted=table, scope=scope, of=lambda *_: [])
    sentence = adapted_page(cast(Findings, findings))["headline"]
    words = "of 3 adapted clones lie clearly above the clone"
    assert f"By realism 1 {words} (1 of silkmoths) and 1 below" in sentence
    assert f"the target 3 {words} (3 of silkmoths) and 0 below" in sentence
    assert "leaves that open" not in sentence
    findings.adapted = table.assign(seeds=2)
    assert "leaves that open" in adapted_page(cast(Findings, findings))["headline"]


def test_shares_of_the_gap_that_departures_close() -> None:
    values = {PUBLISHED: 0.1, SINGLE[1]: 0.2, SINGLE[2]: 0.05, TOGETHER[0]: 0.24, DEFAULT: 0.3}
    table = pd.DataFrame({"departure": list(values), "value": list(values.values())})
    table = table.assign(species="fly", seeds=1, measure="realism", low=np.nan, high=np.nan)
    words = departures_page(cast(Findings, SimpleNamespace(departures=table)))
    assert "closes 50% to 50% of the gap" in words["departures_lead"]
    assert "two or three 70% to 70%" in words["departures_lead"]
    assert f"'{SINGLE[1]}' (0.200) 50%, '{TOGETHER[0]}' (0.240) 70%" in words["departures_words"]
    fewer = SimpleNamespace(departures=table[table["departure"] != DEFAULT])
    without = departures_page(cast(Findings, fewer))  # a gap has two ends
    assert without["departures_lead"] == without["departures_words"] == ""


def test_a_departure_changes_what_its_name_says_and_nothing_else() -> None:
    scope = Scope(species=("silkmoth",), learners=("dqdil-pt",), settings=("departed",), seeds=(0,))
    settings = {one.setting: one.cell.settings for one in scope.cells if one.cell.settings}
    assert len(settings) == len(DEPARTURES)
    learners = {name: settings[setting_of(name)].learner().settings for name in DEPARTURES}
    published_ones = vars(learners[PUBLISHED])
    changes = {
        name: " ".join(sorted(k for k, v in vars(own).items() if v != published_ones[k]))
        for name, own in learners.items()
    }
    expected = {
        PUBLISHED: "",
        CROSS_ENTROPY: "offline_loss",
        "300 epochs": "offline_epochs",
        "penalties in units of their mean": "offline_alpha offline_scaled_penalties",
        "discount 0.9 offline": "offline_gamma",
        "rate 0.001 online": "learning_rate",
        "epsilon 0.05 online": "exploration_final_eps exploration_initial_eps",
        "reward by closeness": "",
        "chosen acting": "",
        TOGETHER[-1]: "offline_learning_rate offline_loss",
    }
    assert set(expected) >= set(ALONE)
    assert {name: changes[name] for name in expected} == expected
    assert settings[setting_of(TOGETHER[-1])].acting == CHOSEN
    assert settings[setting_of("chosen acting")].acting == CHOSEN
    labels = settings[setting_of(CROSS_ENTROPY)].learner().env_kwargs
    assert labels["labels"] == "tracking" and labels["observation"] == "paper"
    closeness = settings[setting_of("reward by closeness")].learner().env_kwargs
    assert closeness == settings[setting_of(PUBLISHED)].learner().env_kwargs | {"dtw": "closeness"}
    for rate in RATES:
        assert learners[at_rate(DISTANCE, rate)].offline_learning_rate == rate


def test_a_kept_paper_record_stands_for_its_cell(first: Path, tmp_path: Path) -> None:
    record = Record.load(next((first / "records").glob("silkmoth-dqdil-*.npz")))
    assert record.about["seed"] == 0 and record.about["steps"] == 400
    assert set(record.episodes["cue"]) == {0, 1} and len(record.paths) == 4
    whole = Scope(species=("silkmoth",), learners=("dqdil",), settings=("onset",), steps=400)
    cell = whole.cells[0]
    assert cell.find_record(tmp_path / "none", tmp_path) == (None, False)
    record.save(tmp_path / f"{cell.name}.npz")
    kept, was_kept = cell.find_record(tmp_path / "none", tmp_path)
    assert was_kept and kept is not None and kept.episodes.equals(record.episodes)
    other = Scope(species=("silkmoth",), learners=("dqdil",), settings=("onset",)).cells[0]
    assert other.find_record(tmp_path / "none", tmp_path) == (None, False)  # of other steps
    record.about["version"] = 0
    record.save(tmp_path / f"{cell.name}.npz")
    assert "remove it" in refuses("version 0", cell.find_record, tmp_path / "none", tmp_path)


def test_species_without_conditions_have_a_page_too(tmp_path: Path) -> None:
    animarl("paper", "--quick", "--page", "--species", "fly", "--only", "bc", "--out", tmp_path)
    page = (tmp_path / "paper.md").read_text()
    assert "0 of" in page and "nan" not in page


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["--species", "rat"], "--species rat: it is not in the paper: choose among agent, fly"),
        (["--only", "ppo"], "--only ppo: it is not in the paper"),
        (["--only", "dqcil", "--species", "fly"], "fly has one condition"),
        (["--kept", "none", "--hours", "0.1"], "--hours 0.1: the cells take about"),
        (["--processes", "0"], "processes is 0"),
    ],
)
def test_what_the_paper_does_not_have_is_refused(
    words: list[str], sentence: str, tmp_path: Path
) -> None:
    small = [] if "--species" in words else ["--species", "silkmoth"]
    refuses(re.escape(sentence), animarl, "paper", "--out", tmp_path / "out", *small, *words)


def test_a_folder_of_another_version_is_refused_by_paper(tmp_path: Path) -> None:
    (tmp_path / "benchmark.json").write_text('{"format": 1, "animarl": "0.0.9"}')
    refuses("of animarl 0.0.9", animarl, "paper", *TRY, "--out", tmp_path)


def test_published_rows_are_of_species_individuals_and_learners() -> None:
    for species, individual, _ in published("table1"):
        assert individual in load_packaged(species).individuals
    for part in ("figure4", "figure5", "cost"):
        assert {learner for _, learner, _ in published(part)} <= {*LEARNERS, "recorded"}
    for species, learner, _ in published("figure5"):
        either = {*compared_learners(species, True), *compared_learners(species, False)}
        assert species in PRETRAINED and learner in either | {"recorded"}


def textbook_kde_distance(first: np.ndarray, second: np.ndarray) -> float:
    grid = np.linspace(-30, 30, 20_001)
    densities = [stats.gaussian_kde(sample)(grid) for sample in (first, second)]
    return float(np.trapezoid(np.abs(densities[0] - densities[1]), grid))


def test_kde_distance_equals_scipys_densities_integrated() -> None:
    rng = np.random.default_rng(11)
    for shift in (0.0, 0.7, 3.0):
        first, second = rng.normal(size=25), rng.gamma(2.0, size=60) + shift
        expected = textbook_kde_distance(first, second)
        assert kde_distance(first, second) == pytest.approx(expected, abs=2e-3)
    few, some = np.array([0.0, 1.0]), np.array([2.0, 2.7, 4.0])
    assert kde_distance(few, some) == pytest.approx(textbook_kde_distance(few, some), abs=2e-3)
    # Without variance: every episode timed out, here and there.
    for one, other, expected in (([14.8] * 5, [14.8] * 9, 0.0), ([14.8], [3.0], 2.0)):
        assert kde_distance(np.array(one), np.array(other)) == pytest.approx(expected, abs=1e-3)
    assert 1.7 < kde_distance(np.full(50, 14.8), rng.uniform(0, 14.8, 50)) < 2.0


def test_the_interval_of_a_kde_distance_surrounds_a_large_one() -> None:
    rng = np.random.default_rng(17)
    demo, seed = np.tile(np.arange(30), 4), np.repeat([0, 1], 60)
    truth = pd.DataFrame({"demo": np.arange(30), "x": rng.normal(size=30)})
    drawn = truth["x"].to_numpy()[demo] + 2.0 + rng.normal(0, 0.2, len(demo))
    rows = pd.DataFrame({"seed": seed, "demo": demo, "x": drawn})
    found = kde_interval(rows, truth, "x")
    assert found.low < found.estimate < found.high < 2.0
    drawn = drawn - 1.0 - 2.0 * seed  # one seed on either side: pooled the distance is 0.23
    assert 0.4 < kde_interval(rows.assign(x=drawn), truth, "x").estimate < 0.7
