"""Headings of imports: from keypoints or a table's column, turned, filled and thinned with care."""

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import animarl
from numpy.typing import NDArray
from refusals import refuses

from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.importing.build import demonstrations_from_tracks
from animarl_envs.importing.cleaning import Cleaning, Scaling, clean, fill_gaps, resample
from animarl_envs.importing.cutting import Cutting
from animarl_envs.importing.import_recipe import ImportRecipe
from animarl_envs.importing.readers import follow
from animarl_envs.importing.tracks import Tracks, merge
from animarl_envs.locomotion import shorter_turn
from tools.fuzz.layouts import POSE, write_analysis, write_dlc_csv, write_slp

RATE, FRAMES = 20.0, 200


def same(one: Any, two: Any, within: float = 1e-9) -> bool:
    """Whether angles are the same directions."""
    return bool(np.abs(np.exp(1j * np.asarray(one)) - np.exp(1j * np.asarray(two))).max() < within)


def pair(angle: NDArray[np.float64], **more: Any) -> Tracks:
    """Two animals on circles, a thorax and a head 5 px apart at ``angle`` ``(frames, 2)``."""
    phase = 2 * np.pi * np.arange(len(angle))[:, None] / 100 + [0.0, 2.0]
    thorax = 100.0 * np.stack([np.cos(phase), np.sin(phase)], axis=-1) * [[[1.0], [0.5]]] + 300.0
    head = thorax + 5.0 * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    return Tracks(**{
        "recording": "r", "individuals": ("male", "female"), "keypoints": ("head", "thorax"),
        "positions": np.stack([head, thorax], axis=2), "frame_rate": RATE, **more,
    })  # fmt: skip


def spinning(frames: int = FRAMES) -> NDArray[np.float64]:
    """One animal turns left for rounds, the other right."""
    return np.arange(frames)[:, None] * [0.13, -0.21] + [0.4, 3.0]


def recipe(**more: Any) -> ImportRecipe:
    """Of the thorax, which points to the head; one episode."""
    cleaning = Cleaning(keypoint="thorax", heading=("thorax", "head"), **more.pop("clean", {}))
    return ImportRecipe(**{"target": "female", "cleaning": cleaning,
                           "cutting": Cutting(piece=math.inf), **more})  # fmt: skip


@pytest.mark.parametrize("y_down", [False, True])
@pytest.mark.parametrize("target", ["male", "female"])
def test_headings_count_counter_clockwise_and_follow_their_individuals(
    y_down: bool, target: str
) -> None:
    angle = spinning()
    demos = demonstrations_from_tracks([pair(angle, y_down=y_down)], recipe(target=target))
    scaling = Scaling(width=900.0, centre=(250.0, 310.0), px_per_cm=3.0)
    scaled = demonstrations_from_tracks(
        [pair(angle, y_down=y_down)], recipe(target=target, scaling=scaling)
    )
    assert same(scaled.headings(), demos.headings())
    order = [1, 0] if target == "male" else [0, 1]
    wanted = (-angle if y_down else angle)[1:, order]
    assert same(demos.headings(), wanted)
    assert demos.provenance["cleaning"]["r"]["heading"] == ["thorax", "head"]


@pytest.mark.parametrize("rate", [10.0, 8.0])
def test_thinning_goes_the_shorter_way_round(rate: float) -> None:
    demos = demonstrations_from_tracks([pair(spinning())], recipe(decision_rate=rate))
    times = np.arange(1, len(demos.positions) + 1) * RATE / rate
    assert same(demos.headings(), times[:, None] * [0.13, -0.21] + [0.4, 3.0])
    past = np.array([[3.1], [-3.1]])
    half = resample(past, 1.0, 2.0, shorter_turn)[:, 0]
    assert same(half, [3.1, np.pi, -3.1])


def test_short_gaps_are_turned_through_and_longer_ones_cut_the_recording() -> None:
    tracks = pair(spinning())
    positions = tracks.positions.copy()
    positions[50:53, 0, 0] = np.nan  # a head, the thorax is seen
    positions[120:140, 1, 0] = np.nan
    gappy = replace(tracks, positions=positions)
    demos = demonstrations_from_tracks([gappy], recipe(clean={"max_gap": 0.3}))
    assert demos.lengths.tolist() == [119, 59]
    assert same(demos.headings(), np.delete(spinning(), [0, *range(120, 141)], axis=0))
    assert demos.provenance["cleaning"]["r"]["heading_unknown"] == 20
    over = np.array([[3.0], [np.nan], [np.nan], [-3.0]])
    assert same(fill_gaps(over, 2, shorter_turn)[0][:, 0], np.linspace(3.0, 2 * np.pi - 3.0, 4))
    assert np.isnan(fill_gaps(over, 1, shorter_turn)[0][1:3]).all()


def test_smoothing_knows_no_seam_and_jumps_take_their_heading_along() -> None:
    wobble = np.pi + 0.3 * np.sin(2 * np.pi * np.arange(FRAMES) / 5)[:, None] * [1.0, 1.0]
    cleaned, _ = clean(pair(wobble), recipe(clean={"smoothing_cutoff": 0.5}).cleaning)
    inner = cleaned.signals["heading"][20:-20]
    assert same(inner, np.pi, within=0.05) and np.abs(np.cos(inner) + 1).max() < 0.01
    tracks = pair(spinning())
    positions = tracks.positions.copy()
    positions[80, 0] = [[900.0, 905.0], [900.0, 900.0]]
    jumped = replace(tracks, positions=positions)
    dropped, _ = clean(jumped, recipe(clean={"drop_jumps": True, "max_gap": 0.2}).cleaning)
    assert same(dropped.signals["heading"][80:82], spinning()[80:82])


def test_files_of_one_animal_each_keep_their_headings() -> None:
    bodies = np.cumsum(np.ones((6, 1, 1, 2)), axis=0)
    parts = [
        Tracks(
            recording="v", individuals=(name,), positions=bodies[: 6 - late], frame_rate=10.0,
            start_time=0.1 * late, signals={"heading": np.full((6 - late, 1), angle)},
        )
        for name, angle, late in (("a", 1.0, 0), ("b", 2.0, 2))
    ]  # fmt: skip
    (merged,) = merge(parts)
    heading = merged.signals["heading"]
    assert (heading[:, 0] == 1.0).all() and (heading[2:, 1] == 2.0).all()
    assert np.isnan(heading[:2, 1]).all()
    assert np.array_equal(merged.choose(["b"]).signals["heading"][2:], heading[2:, 1:])


@pytest.mark.parametrize("write", [write_slp, write_analysis, write_dlc_csv])
def test_headings_from_keypoints_of_a_file_and_its_recipe(write: Any, tmp_path: Path) -> None:
    out = tmp_path / "demos.npz"
    said = animarl(
        "import", write(tmp_path), "--fps", 25, "--target", "female", "--keypoint", "thorax",
        "--heading", "thorax,head", "--out", out,
    )  # fmt: skip
    assert "heading" in said
    demos = Demonstrations.load(out)
    ahead = POSE[0, 0, 0] - POSE[0, 0, 1]
    wanted = -math.atan2(ahead[1], ahead[0])  # images have y downwards
    assert same(demos.headings(), np.full(demos.positions.shape[:2], wanted), within=1e-5)
    again = tmp_path / "again.npz"
    animarl("import", write(tmp_path), "--recipe", tmp_path / "demos.recipe.yaml", "--out", again)
    assert Demonstrations.load(again).fingerprint() == demos.fingerprint()
    plan = ImportRecipe.load(tmp_path / "demos.recipe.yaml")
    assert plan.cleaning.heading == ("thorax", "head")
    assert follow(plan, [write(tmp_path)]).fingerprint() == demos.fingerprint()
    dry = ("--fps", 25, "--heading", "thorax,head", "--dry-run")
    assert "heading thorax, head" in animarl("import", write(tmp_path), *dry)


@pytest.mark.parametrize(
    ("asked", "says"),
    [
        ("thorax,nose", "clip, heading: there is no keypoint 'nose': choose .* head, thorax"),
        ("thorax", "name two keypoints, the rear one first, such as thorax,head"),
        ("head,head", "name two keypoints"),
        ("a,b,c", "name two keypoints"),
    ],
)
def test_keypoints_that_make_no_heading_are_refused(asked: str, says: str, tmp_path: Path) -> None:
    words = ("import", write_slp(tmp_path), "--fps", 25, "--heading", asked, "--dry-run")
    refuses(says, animarl, *words)
