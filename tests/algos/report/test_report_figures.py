"""The figures of a report: what they hold, what they are called, what they refuse."""

import re
from xml.etree import ElementTree

import numpy as np
import pandas as pd

from animarl_algos.evaluation.decisions import Decisions
from animarl_algos.report.figures import chosen_curves, shared_bins
from animarl_algos.report.path_figures import (
    Stage,
    bar_length,
    path_panels,
    value_map,
    values_along_path,
)
from animarl_algos.report.style import looks, new_figure, to_image
from animarl_algos.report.words import Words
from animarl_envs.arena import Arena
from animarl_envs.demos.summary import Unit

MM = Unit("mm", 4.0)


def test_bins_are_shared_and_hold_everything() -> None:
    rng = np.random.default_rng(0)
    first, second = rng.exponential(size=500), rng.exponential(2.0, size=90)
    edges = shared_bins(first, second)
    assert edges[0] == 0.0 and edges[-1] == max(first.max(), second.max())
    assert len(shared_bins(np.zeros(5), np.zeros(3))) == 51
    assert np.histogram(first, edges)[0].sum() == 500


def test_learning_curves_are_chosen_and_named() -> None:
    logged = [
        ("bc", "offline/val/top_1"), ("bc", "offline/val/top_1/prey"),
        ("dqdil", "offline/val/top_1"), ("dqdil", "offline/train/td"),
        ("dqdil", "offline/train/td/prey"), ("dqdil", "offline/train/td/predator_0"),
        ("dqdil", "offline/train/l2"), ("dqdil", "offline/odd_one"),
    ]  # fmt: skip
    rows = [(method, 0, step, name, 1.0) for method, name in logged for step in range(3)]
    curves = pd.DataFrame(rows, columns=["method", "seed", "step", "quantity", "value"])
    chosen = chosen_curves(curves, "DQDIL")
    shown = {title: sorted(rows["method"].unique()) for title, rows in chosen.items()}
    assert shown == {
        "Demonstrated action first (share)": ["bc", "dqdil"],
        "Temporal-difference loss": ["predator_0", "prey"],
        "odd_one": ["dqdil"],
    }
    assert list(shown)[-1] == "odd_one"
    assert [len(rows) for rows in chosen.values()][:2] == [6, 6]


def test_values_are_drawn_along_a_path_and_over_the_arena() -> None:
    rng = np.random.default_rng(0)
    decisions = Decisions(
        individual="predator", demo=0, q=rng.normal(size=(30, 13)),
        actions=rng.integers(-1, 13, 30), moment=15, x=np.linspace(-1, 1, 20),
        y=np.linspace(-1, 1, 15), map_q=rng.normal(size=(15, 20, 13)),
        focus=np.tile([1.0, 0.0], (15, 20, 1)), others=np.array([[0.5, 0.5], [0.0, 0.0]]),
    )  # fmt: skip
    assert "Advantage" in to_image(values_along_path(decisions, 0.1), "values").drawing
    roles, names = ("pursuer", "pursuer", "target"), ("predator", "other", "prey")
    stage = Stage(Arena("disc"), roles, names, Words(unit=MM))
    drawn = to_image(value_map(decisions, stage, 0.1), "map").drawing
    assert drawn.startswith("<svg") and "x (mm)" in drawn


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


def test_a_scale_bar_is_round_and_fits() -> None:
    for half in (0.013, 0.35, 1.0, 7.0):
        length = bar_length(half, MM)
        assert half * MM.per_arena_unit / 8 < length <= half * MM.per_arena_unit / 2
        assert f"{length:.0e}"[0] in "125"


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
