"""The page of a run: one file that loads nothing, with all sections, and hostile names harmless."""

import dataclasses
import re
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from html_page import Page
from refusals import refuses
from report_inputs import (
    HOSTILE,
    MADE,
    bare_inputs,
    make_demos,
    make_rollouts,
    rendered,
    report_inputs,
    report_page,
)
from small_runs import few

from animarl_algos.evaluation.statistics import interval
from animarl_algos.report import write_report
from animarl_algos.report.figures import Stage, path_panels
from animarl_algos.report.inputs import PageInputs
from animarl_algos.report.player import play
from animarl_algos.report.style import looks, new_figure, to_image
from animarl_algos.report.words import Words, with_interval
from animarl_envs.arena import Arena
from animarl_envs.fitting.custom_species import SMALLEST_CONTACT
from animarl_envs.species import SPECIES


def test_the_page_has_every_section() -> None:
    page = Page(report_page())
    assert not page.open
    for heading in (
        "A run", "Verdict", "Trajectories", "Speeds and distances", "Metrics",
        "How this was made",
    ):  # fmt: skip
        assert heading in page.headings
    for title in ("Path length: all episodes", "Duration: captures only", "Target reached: "):
        assert title in report_page()
    assert all(link.startswith("#") and link[1:] in page.ids for link in page.links)
    assert len(page.drawings) > 15 and all(page.drawings)


def test_what_made_the_run_is_on_the_page() -> None:
    for text in (
        "animarl run demos.npz --algo dqdil", "torch", "2.13.0", "online.alpha",
        report_inputs().demos.fingerprint(), "synthetic demonstrations", "made.seed", "2026-11-21",
        "Some processor", "2.5 min", "time_limit",
    ):  # fmt: skip
        assert text in report_page()


def test_the_page_says_the_range_over_repetitions() -> None:
    rows = report_inputs().evaluation.metrics.query("factual and method == 'dqdil'")
    means = 100 * rows.groupby(["seed", "repetition"])["captured"].mean()
    assert means.nunique() > 1
    low, high = (f"{end:.3g}" for end in (means.min(), means.max()))
    assert f"target reached {low} to {high} %" in report_page()
    demos = make_demos()
    once = make_rollouts(demos, "bc").select(np.arange(len(demos)))
    assert "Expect at least the range" not in rendered(bare_inputs(demos, {"bc": once}, **MADE))


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
    half = inputs.demos.select(condition=0)
    refuses("other demonstrations", dataclasses.replace, inputs, demos=half)
    refuses("no rollouts of 'dqn'", dataclasses.replace, inputs, learner="dqn")


def test_a_drawing_stands_in_a_page_and_alone() -> None:
    figure, panel = new_figure(2.0, 1.0)
    panel.plot([0, 1], [0, 1], color="#2b2b2f")
    image = to_image(figure, 'a "line" & more')
    drawing = image.drawing
    again, panel = new_figure(2.0, 1.0)
    panel.plot([0, 1], [1, 0], color="#2b2b2f")
    other = to_image(again, "another").drawing
    ids = [set(re.findall(r' id="([^"]+)"', one)) for one in (drawing, other)]
    assert ids[0] and ids[0].isdisjoint(ids[1])
    used = re.findall(r'(?:xlink:href="#|url\(#)([\w-]+)', drawing)
    assert used and set(used) == ids[0]
    assert "var(--text, #2b2b2f)" in image.themed and "<style" not in drawing
    assert "#2b2b2f" in drawing and "var(" not in drawing
    root = ElementTree.fromstring(drawing)
    assert root.get("aria-label") == 'a "line" & more'


def test_individuals_differ_in_more_than_colour() -> None:
    seen = looks(("pursuer",) * 3 + ("target",))
    for key in ("colour", "marker"):
        assert len({str(getattr(look, key)) for look in seen}) == 4
    assert len({str(look.dashes) for look in seen[:3]}) == 3


def test_a_player_explains_the_ring_of_contact_only_where_there_is_one() -> None:
    fly, demos = SPECIES["fly"], few("fly")
    assert "dotted ring" in play(PageInputs(demos=demos, species=fly), [], [], "").caption
    never = dataclasses.replace(fly, contact_radius=SMALLEST_CONTACT * fly.arena.size)
    without = PageInputs(demos=demos, species=never)
    assert without.stage.contact_radius is None
    assert "dotted ring" not in play(without, [], [], "").caption


def test_a_lost_searcher_does_not_hide_the_recording() -> None:
    recorded = np.linspace([0.3, 0.0], [0.02, 0.01], 30)[:, None]
    lost = np.linspace([0.3, 0.0], [-40.0, 9.0], 90)[:, None]
    for arena, path, role, least, most in (
        (Arena("open", size=0.35), lost, "searcher", (-1.0, 0.0), (0.3, 1.0)),
        (Arena("square"), np.full((4, 1, 2), 1.1), "pursuer", (-2.0, -1.0), (1.1, 2.0)),
    ):
        stage = Stage(arena, (role,), ("she",), Words())
        both = [("simulated", path), ("recorded", recorded)]
        for panel in path_panels(both, recorded, stage, below=True).axes:
            low, high = panel.get_xlim()
            assert least[0] < low < least[1] and most[0] < high < most[1]
