"""The figures of a report: what they hold, what they are called, what they refuse."""

import re
from xml.etree import ElementTree

import numpy as np

from animarl_algos.report.figures import Stage, path_panels
from animarl_algos.report.style import looks, new_figure, to_image
from animarl_algos.report.words import Words
from animarl_algos.runs.inspecting import Decisions, values_along_path
from animarl_envs.arena import Arena


def test_values_are_drawn_along_a_path() -> None:
    rng = np.random.default_rng(0)
    decisions = Decisions("predator", 0, rng.normal(size=(30, 13)), rng.integers(-1, 13, 30))
    assert "Advantage" in to_image(values_along_path(decisions, 0.1), "values").drawing


def test_a_drawing_stands_in_a_page_and_alone() -> None:
    figure, panel = new_figure(2.0, 1.0)
    panel.plot([0, 1], [0, 1], color="#2b2b2f")
    drawing = to_image(figure, 'a "line" & more').drawing
    again, panel = new_figure(2.0, 1.0)
    panel.plot([0, 1], [1, 0], color="#2b2b2f")
    other = to_image(again, "another").drawing
    ids = [set(re.findall(r' id="([^"]+)"', one)) for one in (drawing, other)]
    assert ids[0] and ids[0].isdisjoint(ids[1])
    used = re.findall(r'(?:xlink:href="#|url\(#)([\w-]+)', drawing)
    assert used and set(used) == ids[0]
    assert "var(--text, #2b2b2f)" in drawing and "<style" not in drawing
    root = ElementTree.fromstring(drawing)
    assert root.get("aria-label") == 'a "line" & more'


def test_individuals_differ_in_more_than_colour() -> None:
    seen = looks(("pursuer",) * 3 + ("target",))
    for key in ("colour", "marker"):
        assert len({str(getattr(look, key)) for look in seen}) == 4
    assert len({str(look.dashes) for look in seen[:3]}) == 3


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
