"""The page of a run: one file that loads nothing, with all sections, and hostile names harmless."""

import dataclasses
import re
from pathlib import Path

import numpy as np
import pytest
from html_page import Page
from report_inputs import (
    HOSTILE,
    bare_inputs,
    make_demos,
    make_rollouts,
    rendered,
    report_inputs,
    report_page,
)

from animarl_algos.evaluation.statistics import interval
from animarl_algos.report import write_report
from animarl_algos.report.words import with_interval
from animarl_envs.errors import InputError


def test_the_page_has_every_section() -> None:
    page = Page(report_page())
    assert not page.open
    for heading in (
        "A run", "Verdict", "Trajectories", "Speeds and distances", "Metrics",
        "Target reached", "Path length", "Duration", "DTW distance",
        "How this was made",
    ):  # fmt: skip
        assert heading in page.headings
    assert all(link.startswith("#") and link[1:] in page.ids for link in page.links)
    assert len(page.drawings) > 15 and all(page.drawings)


def test_what_made_the_run_is_on_the_page() -> None:
    for text in (
        "animarl run demos.npz --algo dqdil", "torch", "2.13.0", "online.alpha",
        report_inputs().demos.fingerprint(), "synthetic demonstrations", "made.seed", "2026-11-21",
        "Some processor", "2.5 min", "time_limit",
    ):  # fmt: skip
        assert text in report_page()


def test_numbers_on_the_page_are_those_of_the_tables() -> None:
    table = report_inputs().evaluation.comparison
    row = table[
        (table["method"] == "dqdil") & (table["measure"] == "dtw") & (table["counting"] == "all")
    ].iloc[0]
    text = with_interval(interval(row))
    assert text in report_page()


def test_hostile_names_are_harmless() -> None:
    demos = make_demos((HOSTILE, "predator_1", "prey"))
    html = rendered(
        bare_inputs(
            demos, {HOSTILE: make_rollouts(demos, HOSTILE)}, title=HOSTILE, command=HOSTILE,
            settings={HOSTILE: HOSTILE},
        )
    )  # fmt: skip
    page = Page(html)
    assert "<script>alert" not in html and page.scripts == Page(report_page()).scripts
    assert "&lt;script&gt;alert" in html and "\\u003cscript\\u003ealert" in html


def test_a_bare_run_without_captures_leaves_out_what_it_lacks(tmp_path: Path) -> None:
    demos = make_demos()
    never = dataclasses.replace(make_rollouts(demos, "bc"), outcome=np.zeros(48))
    path = write_report(bare_inputs(demos, {"bc": never}), tmp_path / "deep" / "report.html")
    assert [p.name for p in path.parent.iterdir()] == ["report.html"]
    html = path.read_text(encoding="utf-8")
    assert re.search(r">0 \[0, \d+\]<", html)  # none of so few starts is not never
    headings = Page(html).headings
    assert "Metrics" in headings


def test_where_nobody_is_pursued_nothing_is_reached() -> None:
    demos = make_demos()
    free = dataclasses.replace(
        demos, roles=("pursuer",) * demos.num_individuals, outcome=np.zeros(len(demos))
    )
    rollouts = {
        name: dataclasses.replace(make_rollouts(free, name), outcome=np.zeros(48))
        for name in ("bc", "random")
    }
    said = "\n".join(Page(rendered(bare_inputs(free, rollouts, species=None))).texts)
    assert "Path length per episode, mean over the animals." in said
    words = r"[^\n]*\b(?:targets?|captures?|pursuers?|reach\w*|endings)\b[^\n]*"
    assert re.findall(words, said, re.IGNORECASE) == []


def test_inputs_that_do_not_belong_together_are_refused() -> None:
    inputs = report_inputs()
    with pytest.raises(InputError, match="other demonstrations"):
        dataclasses.replace(inputs, demos=inputs.demos.select(condition=0))
    with pytest.raises(InputError, match="no rollouts of 'dqn'"):
        dataclasses.replace(inputs, learner="dqn")
