"""The page of a run: words that follow from numbers, the player's paths, what readers may need."""

import base64
import dataclasses
import hashlib
import itertools
import json
import re
from functools import cache

import numpy as np
import pandas as pd
import pytest
from html_page import Page
from report_inputs import (
    bare_inputs,
    make_demos,
    make_rollouts,
    rendered,
    report_inputs,
    report_page,
)

from animarl_algos.evaluation.metrics import METRICS
from animarl_algos.evaluation.statistics import Interval
from animarl_algos.evaluation.verdict import Verdict
from animarl_algos.evaluation.verdict_rows import ALIKE, DIFFERS, UNKNOWN, Row
from animarl_algos.evaluation.verdict_rows import COLOURS as WORD_COLOURS
from animarl_algos.report import player as playing
from animarl_algos.report.page import SCRIPTS, TEMPLATES, Player, as_data
from animarl_algos.report.player import LEVELS, at_ranks, examples, factual_rollouts, run_player
from animarl_algos.report.style import COLOURS, FLOOR, PAGE, PURSUERS, RAISED, TARGET, TEXTS, Image
from animarl_algos.report.verdict_section import verdict_as_table, verdict_lead, verdict_sentence
from animarl_algos.report.words import Words, cautions, number, with_interval
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.packaged import load_packaged
from animarl_envs.drawing.palette import RGB
from animarl_envs.species import AGENT


def comparison() -> pd.DataFrame:
    """A table of one method."""
    row = {"method": "bc", "measure": "dtw", "counting": "all", "rollouts": 5, "seeds": 1}
    return pd.DataFrame([row])


def test_cautions_say_what_limits_the_conclusions() -> None:
    table = comparison()
    one = cautions(table, "bc", synthetic=True)
    assert "synthetic" in one[0] and "One training seed" in one[1]
    assert cautions(table.assign(seeds=3), "bc", synthetic=False)[0].startswith("Only 3")
    assert cautions(table.assign(seeds=5), "bc", synthetic=False) == []


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (Interval(1.2345, 1.0, 1.5), "1.23 [1.00, 1.50]"),
        (Interval(-12.34, -15.0, -9.0), "\u221212.3 [\u221215.0, \u22129.0]"),
        (Interval(112.3, 92.0, 133.0), "112 [92, 133]"),
        (Interval(-0.2, -20.0, 18.0), "0 [\u221220, 18]"),
        (Interval(0.25, 0.25, 0.25), "0.250 [0.250, 0.250]"),
        (Interval(0.5, float("nan"), float("nan")), "0.500"),
        (Interval(float("nan"), 0.0, 0.0), "\u2013"),
    ],
)
def test_numbers_have_the_digits_their_interval_allows(value: Interval, text: str) -> None:
    assert with_interval(value) == text
    assert [number(v) for v in (0.0, 1234.5, -0.5, 3e-7, float("nan"))] == [
        "0", "1234", "\u22120.500", "3e\u221207", "\u2013",
    ]  # fmt: skip


def measured(synthetic: bool) -> Demonstrations:
    """Demonstrations of which the scale is known: an arena unit is 4 mm."""
    demos = make_demos()
    scales = {name: {"unit": 4.0} for name in demos.recording.tolist()}
    provenance = {
        "source": "somebody", "licence": "not stated", "synthetic": synthetic, "unit": "mm",
        "scales": scales, "camera": None,
    }  # fmt: skip
    return dataclasses.replace(demos, provenance=provenance)


@cache
def page_of(synthetic: bool) -> Page:
    demos = measured(synthetic)
    rollouts = {name: make_rollouts(demos, name) for name in ("bc", "random")}
    return Page(rendered(bare_inputs(demos, rollouts)))


@pytest.mark.slow
def test_only_recordings_are_called_recorded() -> None:
    generated = "\n".join([*page_of(True).texts, *map(str, page_of(True).drawings)])
    said = re.findall(r"[^\n]*\brecord(?:ed|ings?)\b[^\n]*", generated, re.IGNORECASE)
    assert [line for line in said if "not recorded from animals" not in line] == []
    assert "Demonstrated" in generated and "demonstrated" in generated
    recorded = "\n".join(page_of(False).texts)
    assert "Demonstrated" not in recorded and "Recorded" in recorded
    assert "Differs: it excludes zero" in recorded


@pytest.mark.slow
@pytest.mark.parametrize("synthetic", [True, False])
def test_lengths_are_told_in_the_unit_of_the_recordings(synthetic: bool) -> None:
    texts = page_of(synthetic).texts
    whole = "\n".join(texts)
    assert "arena unit" not in whole
    for told in ("Path length (mm)", "Speed (mm/s)", "Distance (mm)", "2 mm"):
        assert told in whole
    assert "None" not in whole and "not stated" in texts


def test_numbers_are_told_in_that_unit_too() -> None:
    metric = METRICS[1]  # path length
    row = {"value": 2.0, "low": 1.0, "high": 3.0, "reason": ""}
    words = Words.of(measured(False))
    assert with_interval(words.interval(row, metric)) == "8.0 [4.0, 12.0]"
    assert (words.unit_of(metric), words.axis(metric)) == ("mm", "Path length (mm)")
    assert with_interval(Words().interval(row, metric)) == "2.0 [1.0, 3.0]"
    assert Words().unit_of(METRICS[2]) == "s" and words.factor(METRICS[2]) == 1.0
    assert Words.of(load_packaged("silkmoth")).unit.name == "m"
    assert Words.of(load_packaged("agent")).unit.name == "arena units"


def judged(judgement: str) -> Verdict:
    """A verdict of one row and a classifier."""
    row = Row(
        measure="path_length", label="Path length", unit="mm", recorded=3.0, simulated=2.0,
        value=-1.0, low=-1.5, high=-0.5, tolerance=0.3, judgement=judgement,
        colour=WORD_COLOURS[judgement], verdict="paths too short: 2.0 for 3.0 mm", needed=40.0,
        detectable=0.6,
    )  # fmt: skip
    area = Row(
        measure="auc", label="Classifier", recorded=0.5, simulated=0.8, value=0.8, low=0.7,
        high=0.9, tolerance=0.1, judgement=ALIKE, verdict=ALIKE,
    )  # fmt: skip
    return Verdict(
        table=pd.DataFrame([row, area]), learner="bc", recordings=5, starts=5, rollouts=10,
        importance={},
    )  # fmt: skip


def test_every_verdict_carries_its_interval_and_its_values() -> None:
    found = judged(DIFFERS)
    sentence = verdict_sentence(found, Words())
    assert sentence.startswith(
        "BC: of 2 questions 1 is alike, 1 differs (paths too short: 2.0 for 3.0 mm)."
    )
    assert "in 20 of 100 pairs (50: chance)" in sentence
    table = verdict_as_table(found, Words())
    assert "\u22121.0 [\u22121.5, \u22120.5]" in table.groups[0].rows[0].cells
    assert "\u00b10.300" in table.groups[0].rows[0].cells
    lead = verdict_lead(found, Words())
    assert lead.colour == "red" and "1 differs" in lead.headline


def test_what_is_not_known_is_not_called_alike() -> None:
    found = judged(UNKNOWN)
    for words, name in ((Words(), "recordings"), (Words(synthetic=True), "demonstrations")):
        for text in (verdict_sentence(found, words), verdict_lead(found, words).headline):
            assert f"1 is not known: 5 {name} are too few; about 40 would tell" in text
    assert verdict_lead(found, Words()).colour == "grey"


def unpacked(scene: dict, kind: str, individuals: int = 3) -> np.ndarray:
    """As the page's script reads it."""
    x, y, step = scene["box"]
    levels = np.frombuffer(base64.b64decode(scene["tracks"][kind]["path"]), "<u2")
    return np.array([x, y]) + step * levels.reshape(-1, individuals, 2)


@pytest.fixture(scope="module")
def player() -> Player:
    return run_player(report_inputs())


def test_examples_are_of_different_starts_and_in_order() -> None:
    values = np.repeat([1.0, 2.0, 3.0, 4.0], 3)
    starts = np.repeat([7, 8, 9, 7], 3)
    chosen = at_ranks(values, starts, (0.0, 0.1, 0.5, 0.9, 1.0))
    assert sorted(starts[chosen].tolist()) == [7, 8, 9]
    assert (np.diff(values[chosen]) >= 0).all() and values[chosen][0] == 1.0
    assert at_ranks([3.0, 1.0, 2.0], [0, 1, 2], (0.5,)).tolist() == [2]


def test_trajectories_and_scenes_never_show_a_start_twice(player: Player) -> None:
    rollouts, _ = factual_rollouts(report_inputs())
    for _, chosen in examples(report_inputs(), (0.1, 0.3, 0.5, 0.7, 0.9)):
        starts = rollouts.demo[chosen].tolist()
        assert len(starts) == 5 and len(set(starts)) == 5
    titles = [scene["title"] for scene in player.data["scenes"]]
    assert len(set(titles)) == len(titles) == 12


def test_paths_come_back_as_they_were(player: Player) -> None:
    inputs = report_inputs()
    scene = player.data["scenes"][0]
    start = int(scene["title"].split(",")[0].removeprefix("Start "))
    recorded = inputs.demos.episode(start).positions
    assert unpacked(scene, "recorded") == pytest.approx(recorded, abs=scene["box"][2])
    assert scene["box"][2] < 3 / LEVELS
    simulated = unpacked(scene, "simulated")
    mine = inputs.rollouts["dqdil"]
    of_start = [mine.path(i) for i in np.flatnonzero(mine.demo == start)]
    assert any(len(p) == len(simulated) and np.allclose(p, simulated, atol=1e-4) for p in of_start)


def test_a_run_has_one_view() -> None:
    demos = make_demos()
    bare = bare_inputs(demos, {"bc": make_rollouts(demos, "bc")})
    data = run_player(bare).data
    assert [view["key"] for view in data["views"]] == ["simulated"]
    assert data["contact"] is None
    assert {kind for scene in data["scenes"] for kind in scene["tracks"]} == {
        "recorded", "simulated",
    }  # fmt: skip


def test_long_paths_are_thinned_to_the_budget(monkeypatch: pytest.MonkeyPatch) -> None:
    whole = run_player(report_inputs()).data
    size = sum(len(t["path"]) for s in whole["scenes"] for t in s["tracks"].values())
    monkeypatch.setattr(playing, "BUDGET", size // 3)
    thin = run_player(report_inputs()).data
    less = sum(len(t["path"]) for s in thin["scenes"] for t in s["tracks"].values())
    assert less < size / 2
    assert thin["dt"] == pytest.approx(round(thin["dt"] / whole["dt"]) * whole["dt"])
    assert thin["dt"] > whole["dt"]


def test_walls_and_names_are_told() -> None:
    inputs = report_inputs()
    walled = dataclasses.replace(AGENT, arena=dataclasses.replace(AGENT.arena, rebound=True))
    player = run_player(dataclasses.replace(inputs, species=walled))  # the recordings know of none
    assert player.data["arena"]["walls"] and "a wall" in player.caption
    assert not run_player(inputs).data["arena"]["walls"]
    individuals = player.data["individuals"]
    assert [one["name"] for one in individuals] == list(inputs.demos.individuals)
    assert len({one["mark"] for one in individuals}) == 3
    assert len({one["colour"] for one in individuals}) == 3


def test_data_cannot_end_the_element_it_stands_in() -> None:
    text = as_data({"name": "</script><b>&"})
    assert "<" not in text and json.loads(text) == {"name": "</script><b>&"}


MOST = 6_000_000  # bytes of a page
GROUNDS = (PAGE, RAISED, FLOOR)


@pytest.fixture(scope="module")
def page() -> Page:
    return Page(report_page())


def sheet() -> str:
    found = re.search(r"<style>(.*?)</style>", report_page(), re.DOTALL)
    assert found is not None
    return found[1]


def variables(selector: str) -> dict[str, RGB]:
    """Colours that the style sheet gives to a selector, by name."""
    block = re.search(re.escape(selector) + r"\s*\{(.*?)\}", sheet(), re.DOTALL)
    assert block is not None
    return {
        name: (int(code[:2], 16), int(code[2:4], 16), int(code[4:], 16))
        for name, code in re.findall(r"--([\w-]+): #([0-9a-f]{6});", block[1])
    }


def test_the_page_loads_nothing(page: Page) -> None:
    assert page.loads == []
    tags = {tag for tag, _ in page.elements}
    assert not tags & {"link", "iframe", "object", "embed", "img", "base", "form"}
    assert "url(" not in sheet() and "@import" not in sheet()
    references = [
        str(given[key])
        for _, given in page.elements
        for key in ("href", "xlink:href")
        if key in given
    ]
    assert references
    assert all(one.startswith(("#", "data:image/png;base64,")) for one in references)
    assert len(report_page().encode()) < MOST


def test_the_browser_is_told_to_run_this_script_alone(page: Page) -> None:
    (script,) = page.scripts
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    policies = [
        str(given["content"])
        for tag, given in page.elements
        if tag == "meta" and given.get("http-equiv") == "Content-Security-Policy"
    ]
    assert len(policies) == 1
    assert policies[0].startswith("default-src 'none'")
    assert f"script-src 'sha256-{digest}'" in policies[0]
    assert "http" not in policies[0]
    assert "innerHTML" not in script and "eval(" not in script  # names stay text
    assert not any(key.startswith("on") for _, given in page.elements for key in given)


def test_every_script_and_sheet_is_short_and_used() -> None:
    texts = {path.name: path.read_text(encoding="utf-8") for path in TEMPLATES.iterdir()}
    assert {name for name in texts if name.endswith(".js")} == set(SCRIPTS)
    templates = "\n".join(text for name, text in texts.items() if name.endswith(".j2"))
    for name, text in texts.items():
        assert len(text.splitlines()) <= 300
        if name.endswith(".css"):
            assert f'"{name}"' in templates


def test_ids_are_unique_and_references_find_them(page: Page) -> None:
    assert len(page.ids) == len(set(page.ids))
    assert all(link.startswith("#") and link[1:] in page.ids for link in page.links)
    for tag, given in page.elements:
        if "for" in given:
            assert given["for"] in page.ids, tag
    used = re.findall(r"getElementById\(\"(\w+)\"\)|this\.find\(\"(\w+)\"\)", page.scripts[0])
    assert used and all((first or second) in page.ids for first, second in used)


def test_controls_figures_and_regions_have_names(page: Page) -> None:
    for tag, given in page.elements:
        if tag in ("input", "section") and "id" not in given:
            assert given.get("aria-label"), tag
        if tag == "svg" or given.get("role") in ("region", "group", "img"):
            assert given.get("aria-label"), tag
    levels = [int(tag[1]) for tag, _ in page.elements if re.fullmatch(r"h\d", tag)]
    assert levels[0] == 1 and levels.count(1) == 1
    assert all(after <= before + 1 for before, after in itertools.pairwise(levels))


def linear(colour: RGB) -> np.ndarray:
    part = np.array(colour) / 255
    return np.where(part <= 0.04045, part / 12.92, ((part + 0.055) / 1.055) ** 2.4)


def contrast(first: RGB, second: RGB) -> float:
    """Contrast ratio, 1 to 21 (WCAG 2.2)."""
    dark, light = sorted(linear(one) @ [0.2126, 0.7152, 0.0722] for one in (first, second))
    return (light + 0.05) / (dark + 0.05)


@pytest.mark.parametrize(
    "selector",
    [':root, :root[data-theme="light"]', ':root[data-theme="dark"]', ":root:not([data-theme])"],
)
def test_texts_and_marks_stand_out_from_every_ground(selector: str) -> None:
    told = variables(selector)
    assert set(told) == {colour.name for colour in COLOURS}
    for ground in GROUNDS:
        for text in TEXTS:
            assert contrast(told[text.name], told[ground.name]) >= 4.5, (text, ground)
        for mark in (*PURSUERS, TARGET):
            assert contrast(told[mark.name], told[ground.name]) >= 3.0, (mark, ground)


DEFICIENCIES = {  # Machado, Oliveira and Fernandes (2009), severity 1, on linear RGB
    "protanopia": [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216],
                   [-0.003882, -0.048116, 1.051998]],
    "deuteranopia": [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413],
                     [-0.011820, 0.042940, 0.968881]],
    "tritanopia": [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602],
                   [0.004733, 0.691367, 0.303900]],
}  # fmt: skip


def lab(colour: RGB, deficiency: str) -> np.ndarray:
    """CIE L*a*b* (D65) of a colour as somebody with the deficiency sees it."""
    seen = np.clip(np.array(DEFICIENCIES[deficiency]) @ linear(colour), 0, 1)
    matrix = [[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]
    xyz = np.array(matrix) @ seen / np.array([0.9505, 1.0, 1.089])
    f = np.where(xyz > 0.008856, np.cbrt(xyz), 7.787 * xyz + 16 / 116)
    return np.array([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])


@pytest.mark.parametrize("deficiency", DEFICIENCIES)
def test_individuals_are_told_apart_by_colour_blind_readers(deficiency: str) -> None:
    for theme in ("light", "dark"):
        seen = [lab(getattr(c, theme), deficiency) for c in (*PURSUERS[:3], TARGET)]
        gaps = [np.linalg.norm(a - b) for a, b in itertools.combinations(seen, 2)]
        assert min(gaps) > 10, (theme, gaps)  # 2.3 is just noticed


def test_colours_stand_in_one_table() -> None:
    """Style sheets and scripts name variables; no figure has a colour that both themes share."""
    for path in TEMPLATES.iterdir():
        if path.suffix in (".css", ".js"):
            assert not re.search(r"#[0-9a-f]{3,8}\b(?![\w-]*\s*\{)", path.read_text()), path.name
    drawings = "".join(re.findall(r"<svg.*?</svg>", report_page(), re.DOTALL))
    assert not re.findall(r"(?<!, )#[0-9a-f]{6}\b", drawings)


def test_a_drawing_takes_the_pages_colours() -> None:
    assert Image("fill: #2b2b2f; stroke: #123456", "").themed == (
        "fill: var(--text, #2b2b2f); stroke: #123456"
    )


def test_nothing_is_printed_as_none_or_nan(page: Page) -> None:
    for text in page.texts:
        assert not re.search(r"\b(None|nan|NaN|inf|undefined)\b", text), text
    assert "not set" in page.texts  # an option that is absent
