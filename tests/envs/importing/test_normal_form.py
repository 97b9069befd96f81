"""One normal form before anything is judged: where frames begin, who is alone, who was lost."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from animarl_envs.importing.build import demonstrations_from_tracks
from animarl_envs.importing.import_recipe import ImportRecipe
from animarl_envs.importing.lost_animals import HELD, default_confidence, mark_lost
from animarl_envs.importing.readers import read_tracks
from animarl_envs.importing.tracks import TOGETHER_AT_MOST, TRACKS, Tracks, merge, trim

RECIPE = ImportRecipe(target=None, frame_rate=25.0)


def walk(frames: int = 300, animals: int = 2, seed: int = 0) -> np.ndarray:
    """Return random walks ``(frames, animals, 1, 2)`` some way from the origin."""
    rng = np.random.default_rng(seed)
    return 300 + 50 * np.arange(animals)[:, None, None] + np.cumsum(
        rng.normal(0, 1, (frames, animals, 1, 2)), axis=0
    )  # fmt: skip


def tracks(positions: np.ndarray, name: str = "r", **more) -> Tracks:
    names = tuple(f"a{k}" for k in range(positions.shape[1]))
    known = {"recording": name, "individuals": names, "frame_rate": 25.0} | more
    return Tracks(positions=positions, **known)


@pytest.mark.parametrize("late", [0, 5000, 7000])
def test_normal_form_does_not_depend_on_the_first_frame_number(late: int, tmp_path: Path) -> None:
    bodies = walk(animals=4)[:, :, 0]
    rows = [
        f"{late + t},f{k},{x:.3f},{y:.3f}\n"
        for t, animals in enumerate(bodies)
        for k, (x, y) in enumerate(animals)
    ]
    path = tmp_path / "r.csv"
    path.write_text("frame,id,x,y\n" + "".join(rows))
    (found,) = read_tracks(path)
    assert (found.start, len(found)) == (late, 300)
    padded = np.concatenate([np.full((late, *found.positions.shape[1:]), np.nan), found.positions])
    assert trim(replace(found, positions=padded, start=0)).start == late
    demos = demonstrations_from_tracks([found], RECIPE)
    assert (demos.num_individuals, len(demos)) == (4, 10)


def test_normal_form_of_files_of_one_recording_that_begin_late() -> None:
    one = tracks(walk(100, 1), individuals=("a",), start=5000)
    other = tracks(walk(100, 1, seed=1), individuals=("b",), start=5020)
    (joined,) = merge([one, other])
    assert (joined.start, len(joined)) == (5000, 120)
    np.testing.assert_array_equal(joined.positions[20:, 1], other.positions[:, 0])


def test_normal_form_of_sparse_frames_takes_little_memory(tmp_path: Path) -> None:
    path = tmp_path / "bats.csv"
    rows = [
        f"{1000 * bat + t},bat{bat},{t + bat / 7:.3f},{t / 3:.3f}\n"
        for bat in range(120)
        for t in range(40)
    ]
    path.write_text("frame,id,x,y\n" + "".join(rows))
    found = read_tracks(path)
    assert len(found) == 120 and {len(one) for one in found} == {40}
    assert {one.recording: one.start for one in found}["bats/bat5"] == 5000
    assert found[0].provenance[TRACKS] == 120
    assert found[0].provenance[TOGETHER_AT_MOST] == 1


def test_normal_form_of_lone_animals_and_of_dishes() -> None:
    for count, names in ((1, ("individual_0",)), (2, ("animal_0", "animal_1"))):
        recordings = [
            tracks(walk(60, count, seed), f"r{seed}",
                   individuals=tuple(f"rat{seed}_{k}" for k in range(count)))
            for seed in range(3)
        ]  # fmt: skip
        demos = demonstrations_from_tracks(recordings, RECIPE)
        assert demos.individuals == names and len(np.unique(demos.recording)) == 3


@pytest.mark.parametrize("place", [(0.0, 0.0), (-1.0, -1.0), (9999.0, 9999.0), (5.0, 7.0)])
def test_normal_form_has_gaps_where_animals_were_lost(place: tuple[float, float]) -> None:
    own, other = walk(), walk(seed=1)
    own[100:120, 1, 0] = place
    other[10, 0, 0] = place  # known from the other recording
    found, counts = mark_lost([tracks(own, "r"), tracks(other, "s")])
    assert np.isnan(found[0].positions[100:120, 1]).all()
    assert np.isfinite(found[0].positions).sum() == own.size - 40
    assert np.isnan(found[1].positions).sum() == 2
    assert counts == [{f"({place[0]:g}, {place[1]:g})": n} for n in (20, 1)]


def test_normal_form_has_a_gap_where_a_tracker_holds_the_last_place() -> None:
    bodies = walk()
    bodies[100:160, 0] = bodies[99, 0]
    bodies[160:, 0] += 40.0
    (found,), (count,) = mark_lost([tracks(bodies)])
    assert count == {HELD: 60} and np.isnan(found.positions[100:160, 0]).all()


@pytest.mark.parametrize("kind", ["still", "rests", "from the origin", "at the origin"])
def test_normal_form_keeps_animals_at_rest(kind: str) -> None:
    bodies = walk()
    if kind == "still":
        bodies[:, 0] = bodies[0, 0]
    elif kind == "rests":  # coarse tracks, whose animals stop and start
        bodies = np.round(bodies / 4) * 4
    elif kind == "from the origin":
        bodies -= bodies[:1]
    else:
        bodies[:, 0] = 0.0
    (found,), (count,) = mark_lost([tracks(bodies)])
    assert not count
    np.testing.assert_array_equal(found.positions, bodies)


@pytest.mark.parametrize(
    ("scores", "limit"),
    [([0.9, 1.02], 0.6), ([0.9, -1.0], 0.6), ([90.0, 20.0], None), ([np.nan, np.nan], None)],
)
def test_normal_form_judges_likelihoods_over_all_recordings(scores, limit) -> None:
    values = np.full((300, 2, 1), 0.8)
    values[0] = np.array(scores)[:, None]
    if limit is None:
        values[:] = np.array(scores)[:, None]
    given = [tracks(walk(), confidence=values), tracks(walk(), "s", confidence=values.clip(0, 1))]
    assert default_confidence(given[: 2 if limit else 1]) == limit
