"""What a report says in words follows from its numbers, and the numbers have their digits."""

import dataclasses
import re
from functools import cache

import pandas as pd
import pytest
from html_page import Page
from report_inputs import bare_inputs, make_demos, make_rollouts, rendered

from animarl_algos.evaluation.metrics import METRICS
from animarl_algos.evaluation.statistics import Interval
from animarl_algos.evaluation.verdict import Verdict
from animarl_algos.evaluation.verdict_rows import DIFFERS, SAME
from animarl_algos.report.verdict_section import verdict_lead, verdict_sentence
from animarl_algos.report.words import Words, cautions, number, with_interval
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.packaged import load_packaged


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


def test_numbers_alone_have_three_digits() -> None:
    assert [number(v) for v in (0.0, 1234.5, -0.5, 3e-7, float("nan"))] == [
        "0", "1234", "\u22120.500", "3e\u221207", "\u2013",
    ]  # fmt: skip


# -- recorded or demonstrated, and in which unit --------------------------------------------------


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


def test_only_recordings_are_called_recorded() -> None:
    generated = "\n".join([*page_of(True).texts, *map(str, page_of(True).drawings)])
    said = re.findall(r"[^\n]*\brecord(?:ed|ings?)\b[^\n]*", generated, re.IGNORECASE)
    assert [line for line in said if "not recorded from animals" not in line] == []
    assert "Demonstrated" in generated and "demonstrated" in generated
    recorded = "\n".join(page_of(False).texts)
    assert "Demonstrated" not in recorded and "Recorded" in recorded
    assert "if the recorded episode of each start is exchanged" in recorded


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


def test_the_arena_unit_of_moths_is_the_metre() -> None:
    moths = load_packaged("silkmoth")
    assert Words.of(moths).unit.name == "m"
    assert Words.of(load_packaged("agent")).unit.name == "arena units"


def judged(words: tuple[str, ...], **row: float) -> Verdict:
    """A verdict of one row."""
    numbers = {"recorded": 3.0, "simulated": 2.0, "value": -1.0, "low": -1.5, "high": -0.5,
               "reason": "", "distance": 1.0, "null": 0.4}  # fmt: skip
    told = {"measure": "path_length", "label": "Path length", "unit": "mm", "verdict": words[0]}
    told |= {"judgement": SAME if words == (SAME,) else DIFFERS}
    judge = {"measure": "auc", "label": "AUC", "unit": "", "verdict": SAME, "judgement": SAME,
             "simulated": 0.8, "value": 0.8, "low": 0.7, "high": 0.9,
             "reason": ""}  # fmt: skip
    table = pd.DataFrame([told | numbers | row, judge])
    return Verdict(
        table=table, words=words, learner="bc", starts=5, rollouts=10, importance={},
    )  # fmt: skip


def test_every_verdict_carries_its_interval() -> None:
    sentence = verdict_sentence(judged(("paths too short",)), Words())
    assert sentence.startswith(
        "BC differs from the recordings (10 rollouts from 5 starts): paths too short (difference "
        "\u22121.0 [\u22121.5, \u22120.5] mm)"
    )
    assert "80 [70, 90] % of pairs" in sentence
    spread = judged(("path lengths too much alike",), low=-1.5, high=0.5)
    told = "[\u22121.5, 0.5] mm; distance 1.00, by chance up to 0.400 mm)"
    assert told in verdict_sentence(spread, Words())
    lead = verdict_lead(judged(("paths too short",)), Words())
    assert lead.colour == "red" and "BC differs from the recordings" in lead.headline
    assert lead.details[0].startswith("Paths too short (difference")


def test_what_is_not_told_apart_is_not_called_equal() -> None:
    found = judged((SAME,))
    for words, name in ((Words(), "recordings"), (Words(synthetic=True), "demonstrations")):
        for text in (verdict_sentence(found, words), verdict_lead(found, words).headline):
            assert f"is not distinguishable from the {name} at this sample size" in text
            assert "equal" not in text
