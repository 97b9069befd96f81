"""What the player plays: the right paths of different starts, packed with little loss."""

import base64
import dataclasses
import json

import numpy as np
import pytest
from report_inputs import bare_inputs, make_demos, make_rollouts, report_inputs

from animarl_algos.report import player as playing
from animarl_algos.report.page import Player, as_data
from animarl_algos.report.player import LEVELS, at_ranks, examples, factual_rollouts, run_player


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
    player = run_player(dataclasses.replace(inputs, environment={"rebound": True}))
    assert player.data["arena"]["walls"] and "a wall" in player.caption
    assert not run_player(inputs).data["arena"]["walls"]
    individuals = player.data["individuals"]
    assert [one["name"] for one in individuals] == list(inputs.demos.individuals)
    assert len({one["mark"] for one in individuals}) == 3
    assert len({one["colour"] for one in individuals}) == 3


def test_data_cannot_end_the_element_it_stands_in() -> None:
    text = as_data({"name": "</script><b>&"})
    assert "<" not in text and json.loads(text) == {"name": "</script><b>&"}
