"""Cleaning, scaling and cutting: nothing moves in time, everything can be undone or is recorded."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from refusals import refuses

from animarl_algos.cli.describing import automatic_decisions
from animarl_algos.evaluation.prepared import censored
from animarl_algos.evaluation.rollouts import Rollouts
from animarl_envs.demos.episode import PURSUER_OUT, TARGET_OUT, UNFINISHED
from animarl_envs.demos.splits import Splitting
from animarl_envs.demos.summary import episode_table
from animarl_envs.fitting.custom_species import arena_of
from animarl_envs.importing.build import demonstrations_from_tracks
from animarl_envs.importing.cleaning import (
    Cleaning,
    Scaling,
    clean,
    find_jumps,
    resample,
    scale_of,
    smooth,
)
from animarl_envs.importing.cutting import (
    Cutting,
    cut_episodes,
    most_approached,
    pursued_individual,
)
from animarl_envs.importing.import_recipe import ImportRecipe
from animarl_envs.importing.tracks import Tracks
from tools.packaged_data import shoal

CHASE = ("pursuer", "target")


def tracks(bodies: NDArray[np.float64], **more: object) -> Tracks:
    names = tuple(f"animal_{i}" for i in range(bodies.shape[1]))
    values: dict[str, object] = {"recording": "r", "individuals": names, "frame_rate": 30.0}
    return Tracks(positions=bodies[:, :, None], **(values | more))  # type: ignore[arg-type]


def wave(frequency: float, rate: float, seconds: float = 20.0) -> NDArray[np.float64]:
    time = np.arange(int(seconds * rate)) / rate
    x, y = np.cos(2 * np.pi * frequency * time), np.sin(2 * np.pi * frequency * time)
    return np.stack([x, y], axis=1)[:, None]


@pytest.mark.parametrize("frequency", [0.1, 0.5, 2.0])
def test_smoothing_shifts_no_phase_and_has_the_filters_gain(frequency: float) -> None:
    path = wave(frequency, 30.0)
    smoothed = smooth(path, 2.0, 30.0)
    middle = slice(150, 450)
    pace = np.tan(np.pi * frequency / 30) / np.tan(np.pi * 2.0 / 30)  # bilinear transform
    gain = 1 / (1 + pace**2)  # |H|^2 of a first-order Butterworth, both passes
    np.testing.assert_allclose(smoothed[middle], gain * path[middle], atol=2e-3)


def test_smoothing_leaves_gaps_alone_and_does_not_cross_them() -> None:
    path = wave(0.2, 30.0)
    path[200:205] = np.nan
    smoothed = smooth(path, 2.0, 30.0)
    np.testing.assert_array_equal(np.isnan(smoothed), np.isnan(path))
    before = smooth(path[:200], 2.0, 30.0)
    np.testing.assert_allclose(smoothed[:200], before, atol=1e-12)
    refuses("needs more than 4 frames a second", smooth, path, 2.0, 4.0)


def test_identity_swaps_and_jumps_are_found() -> None:
    rng = np.random.default_rng(0)
    bodies = np.cumsum(rng.normal(0, 0.01, (500, 2, 2)), axis=0) + [[0, 0], [5, 5]]
    bodies[300:] = bodies[300:, ::-1]
    jumps, swaps = find_jumps(bodies)
    assert swaps.tolist() == [[300, 0, 1]]
    assert {frame for frame, _ in jumps.tolist()} == {300}
    _, done = clean(tracks(bodies), Cleaning())
    assert done["identity_swaps"] == 1 and done["first_swaps"] == [
        {"frame": 300, "time": 10.0, "individuals": ["animal_0", "animal_1"]}
    ]


def test_what_is_written_of_a_lost_animal_goes_with_its_jumps() -> None:
    bodies = np.cumsum(np.random.default_rng(0).normal(1, 0.1, (500, 2, 2)), axis=0) + 100
    bodies[200:230, 0] = 0.0
    kept, _ = clean(tracks(bodies), Cleaning(drop_jumps=True, max_gap=0.1))
    assert np.flatnonzero(np.isnan(kept.bodies[:, 0, 0])).tolist() == list(range(200, 231))


def test_confidence_and_centroid() -> None:
    positions = np.zeros((4, 1, 2, 2))
    positions[:, :, 1] = 2.0
    confidence = np.ones((4, 1, 2))
    confidence[1, 0, 1] = 0.1
    confidence[2] = 0.1
    given = Tracks(
        recording="r", individuals=("a",), keypoints=("head", "tail"), positions=positions,
        frame_rate=10.0, confidence=confidence,
    )  # fmt: skip
    cleaned, done = clean(given, Cleaning(min_confidence=0.5))
    np.testing.assert_array_equal(cleaned.bodies[:, 0, 0], [1.0, 0.0, np.nan, 1.0])
    assert done["below_confidence"] == 3 and done["untracked"] == 1
    head, _ = clean(given, Cleaning(keypoint="head", min_confidence=0))
    assert (head.bodies == 0).all()
    refuses("no keypoint 'nose'", clean, given, Cleaning(keypoint="nose"))


@pytest.mark.parametrize("shape", ["square", "disc", "open"])
@pytest.mark.parametrize("flip", [False, True])
def test_scaling_is_invertible_and_fills_the_arena(shape: str, flip: bool) -> None:
    bodies = np.random.default_rng(1).uniform(100, 900, (200, 2, 2))
    settings = Scaling(shape=shape, units_per_arena_unit=1000.0)  # type: ignore[arg-type]
    scale = scale_of([tracks(bodies, y_down=flip)], settings)
    scaled = scale.to_arena(bodies)
    back = scaled * [1.0, scale.y_sign] * scale.unit + scale.centre
    np.testing.assert_allclose(back, bodies, atol=1e-10)
    extent = {
        "square": np.abs(scaled).max(), "disc": np.linalg.norm(scaled, axis=2).max(), "open": 1.0,
    }  # fmt: skip
    assert extent[shape] == pytest.approx(1.0)
    up = np.corrcoef(scaled[..., 1].ravel(), bodies[..., 1].ravel())[0, 1]
    assert up == pytest.approx(-1.0 if flip else 1.0)


def approach_path() -> NDArray[np.float64]:
    """The pursuer's distance to a resting target: far, near, far, near."""
    knots = np.interp(np.arange(61), [0, 20, 40, 60], [1.0, 0.1, 0.8, 0.05])
    bodies = np.zeros((61, 2, 2))
    bodies[:, 0, 0] = knots
    return bodies


def test_approaches_are_cut_from_far_to_near() -> None:
    bodies = approach_path()
    distance = bodies[:, 0, 0]
    settings = Cutting(mode="approach", farther_than=0.5, closer_than=0.2)
    first, second = cut_episodes(bodies, CHASE, 10.0, settings)
    assert first.start == 0 and first.outcome == second.outcome == 1
    assert distance[first.stop - 1] < 0.2 <= distance[first.stop - 2]
    assert distance[second.start] > 0.5 >= distance[second.start - 1]
    close = Cutting(mode="approach", farther_than=0.5, closer_than=0.2, start="approach")
    cuts = cut_episodes(bodies, CHASE, 10.0, close)
    assert [cut.stop for cut in cuts] == [first.stop, second.stop]
    assert all(distance[c.start] > 0.5 >= distance[c.start + 1] for c in cuts)
    short = Cutting(mode="approach", farther_than=0.5, closer_than=0.2, keep_last=1.0)
    assert [cut.stop - cut.start for cut in cut_episodes(bodies, CHASE, 10.0, short)] == [11, 11]
    none = Cutting(mode="approach", farther_than=0.5, closer_than=0.2, longest=1.0)
    assert cut_episodes(bodies, CHASE, 10.0, none) == []


@pytest.mark.parametrize(
    ("ends", "outcome"),
    [("auto", UNFINISHED), ("film", UNFINISHED), ("contact", 1), ("left", PURSUER_OUT)],
)
def test_what_ends_mean_is_said_and_mere_ends_are_censored(ends: str, outcome: int) -> None:
    """Of two stretches of a recording the last one alone knows how the recording ended."""
    bodies = approach_path()[:56]  # 0.2 apart at the end
    bodies[30] = np.nan
    settings = Cutting(ends=ends)  # type: ignore[arg-type]
    cuts = cut_episodes(bodies, CHASE, 10.0, settings)
    assert [cut.outcome for cut in cuts] == [UNFINISHED, outcome]
    scaling = Scaling(width=4.0, centre=(0.0, 0.0))
    recipe = ImportRecipe(target="animal_1", cutting=settings, scaling=scaling)
    demos = demonstrations_from_tracks([tracks(bodies)], recipe)
    assert demos.outcome.tolist() == [UNFINISHED, outcome]
    known = "film" if ends == "auto" else ends
    assert demos.provenance["ends"] == known
    assert arena_of(demos).rebound == (ends != "left")  # who left must be able to leave
    ended = Rollouts.from_demonstrations(demos)
    longer = replace(
        ended, positions=np.concatenate([ended.positions, ended.positions[-1:]]),
        lengths=ended.lengths + [0, 1], outcome=np.zeros(2, dtype=np.int8),
    )  # fmt: skip
    stopped = censored(longer, demos)
    assert stopped.lengths[1] - demos.lengths[1] == (0 if known == "film" else 1)


def test_animals_that_end_recordings_by_leaving_are_found() -> None:
    """Of twenty chases six end where the target crosses 1.1, the others where it is touched."""
    rng, bodies = np.random.default_rng(0), []
    for number in range(20):
        target = np.cumsum(rng.normal(0, 0.01, (61, 2)), axis=0).clip(-0.6, 0.6)
        pursuer = target + np.array([0.5, 0.0]) * np.linspace(1, 0.1, 61)[:, None]
        if number < 6:
            target[:, 0] += np.linspace(0, 1.12 - target[-1, 0], 61)
            pursuer[:, 0] = target[:, 0] - 0.3
        bodies.append(np.stack([pursuer, target], axis=1))
    recordings = [tracks(each, recording=f"r{k:02d}") for k, each in enumerate(bodies)]
    scaling = Scaling(width=2.0, centre=(0.0, 0.0))
    recipe = ImportRecipe(target="animal_1", scaling=scaling)
    demos = demonstrations_from_tracks(recordings, recipe)
    assert sorted(demos.outcome.tolist()) == [TARGET_OUT] * 6 + [1] * 14
    assert demos.arena.boundary == pytest.approx(1.12, rel=1e-4) and not arena_of(demos).rebound
    assert demos.provenance["ends"] == "left" and demos.provenance["left_beyond"] > 1.1
    assert "6 recordings end where an animal is farther out than 1.12" in " ".join(
        automatic_decisions(demos)
    )
    unclear = demonstrations_from_tracks(recordings[:11], recipe)  # contact ends five of eleven
    assert sorted(unclear.outcome.tolist()) == [TARGET_OUT] * 6 + [1] * 5
    film = replace(recipe, cutting=Cutting(ends="film"))
    assert (demonstrations_from_tracks(recordings, film).outcome == UNFINISHED).all()
    stayed = demonstrations_from_tracks(recordings[4:], recipe)  # two that leave say nothing
    assert stayed.provenance["ends"] == "contact" and stayed.arena.boundary == 1.1


def test_the_target_that_left_is_told_and_ends_must_go_with_the_cut() -> None:
    bodies = approach_path()
    bodies[-1, 1, 0] = 3.0
    assert cut_episodes(bodies, CHASE, 10.0, Cutting(ends="left"))[0].outcome == TARGET_OUT
    apart = {"mode": "approach", "farther_than": 0.5, "closer_than": 0.2}
    refuses("leave --ends out", Cutting, **apart, ends="film")
    refuses("contact is 0.1 and ends 'left': give one", Cutting, contact=0.1, ends="left")
    lone = (wave(0.2, 30.0), ("pursuer",), 10.0, Cutting(ends="contact"), "r")
    refuses("r: its end is no contact without a target", cut_episodes, *lone)


def test_a_lone_long_recording_is_cut_in_pieces_without_losing_a_step() -> None:
    bodies = wave(0.1, 30.0, seconds=60.0)
    scaling = Scaling(width=2.0, centre=(0.0, 0.0))
    demos = demonstrations_from_tracks([tracks(bodies)], ImportRecipe(scaling=scaling))
    assert demos.num_episodes == 10 and set(demos.split) == {"train", "val", "test"}
    # Neighbours share a frame; the first frame of each only makes its first velocity.
    np.testing.assert_allclose(demos.positions, bodies[1:] / 1.0)
    fewer = ImportRecipe(scaling=scaling, decision_rate=10.0)
    thinned = demonstrations_from_tracks([tracks(bodies)], fewer)
    np.testing.assert_allclose(thinned.positions, bodies[3::3])
    np.testing.assert_allclose(thinned.initial_velocity[0, 0], (bodies[3, 0] - bodies[0, 0]) / 0.1)
    whole = ImportRecipe(scaling=scaling, cutting=Cutting(piece=np.inf))
    assert demonstrations_from_tracks([tracks(bodies)], whole).num_episodes == 1
    given = ImportRecipe(scaling=scaling, cutting=Cutting(piece=4.0))
    assert demonstrations_from_tracks([tracks(bodies)], given).num_episodes == 15


def test_event_tables(tmp_path: Path) -> None:
    table = tmp_path / "events.csv"
    table.write_text("recording,start,end,condition,outcome\nr,1,2,1,1\nother,0,9,,\nr,3,4,,\n")
    settings = Cutting(mode="events", events=str(table))
    first, second = cut_episodes(approach_path(), CHASE, 10.0, settings, "r")
    assert (first.start, first.stop, first.condition, first.outcome) == (10, 21, 1, 1)
    assert (second.start, second.outcome) == (30, UNFINISHED)
    near = replace(settings, contact=0.9)  # what happened at the cut, where the table is silent
    assert cut_episodes(approach_path(), CHASE, 10.0, near, "r")[1].outcome == 1
    for row, said in (
        ("r,1,99", r"events.csv: line 2 lies outside r \(0.000 to 6.100 s\)"),
        ("r,1", "events.csv: line 2 has 2 cells, the header 3"),
        ("r,1,2,,300", "line 2: condition is None and outcome 300: give 0 or 1, and -3 to 2"),
        ("r,1,2,256,1", "line 2: condition is 256 and outcome 1"),
    ):
        columns = ("recording", "start", "end", "condition", "outcome")
        table.write_text(f"{','.join(columns[: max(3, row.count(',') + 1)])}\n{row}\n")
        refuses(said, cut_episodes, approach_path(), CHASE, 10.0, settings, "r")


def test_events_of_unknown_recordings_are_warned_of_and_refused_alone(tmp_path: Path) -> None:
    table = tmp_path / "events.csv"
    recipe = ImportRecipe(cutting=Cutting(mode="events", events=str(table)))
    table.write_text("recording,start,end\n\nR,1,2\n")
    told, lone = r"events.csv: line 3 is of .* 'R' and no line .*\(r\): c", tracks(wave(0.2, 30.0))
    refuses(told, demonstrations_from_tracks, [lone], recipe)
    table.write_text("recording,start,end\nr,0,1\nR,1,2\n")
    with pytest.warns(UserWarning, match=r"1 of 2 events are of rec.* line 3 \('R'; imported: r\)"):
        assert len(demonstrations_from_tracks([lone], recipe)) == 1


@pytest.mark.parametrize(
    ("lost", "says"),
    [
        (np.s_[:, 1], "animal_1 is never tracked in recording r"),
        (np.s_[1::2, 0], "no two frames in a row have all individuals"),
        (np.s_[:0], "the cut leaves no episode"),
    ],
)
def test_why_there_is_no_episode_is_said(lost: tuple[slice, int] | slice, says: str) -> None:
    path = np.concatenate([wave(0.2, 30.0), wave(0.3, 30.0)], axis=1)
    path[lost] = np.nan
    recipe = ImportRecipe(cutting=Cutting(shortest=99.0))
    refuses(f"tracks: {says}", demonstrations_from_tracks, [tracks(path)], recipe)
    told = "its recordings have one frame each"
    refuses(told, demonstrations_from_tracks, [tracks(path[:1, :1])], recipe)


def test_the_one_who_is_approached_is_the_target() -> None:
    rng = np.random.default_rng(2)
    target = np.cumsum(rng.normal(0, 0.05, (400, 2)), axis=0)
    pursuers = [np.vstack([[[3.0 * (-1) ** i, 1.0]], np.zeros((399, 2))]) for i in range(2)]
    for pursuer in pursuers:
        for t in range(1, 400):
            pursuer[t] = pursuer[t - 1] + 0.05 * (target[t - 1] - pursuer[t - 1])
    bodies = np.stack([pursuers[0], target, pursuers[1]], axis=1)
    assert most_approached([bodies]) == 1
    recipe = ImportRecipe(target="auto", scaling=Scaling(width=20.0, centre=(0.0, 0.0)))
    demos = demonstrations_from_tracks([tracks(bodies)], recipe)
    assert demos.individuals == ("animal_0", "animal_2", "animal_1")
    assert demos.roles == ("pursuer", "pursuer", "target")
    np.testing.assert_allclose(demos.positions[:, 2], target[1:] / 10.0)


def test_nobody_of_a_shoal_nor_who_is_approached_now_and_then_is_a_target() -> None:
    paths = shoal.simulate(shoal.ZonalLaw(), 3, 7, 200, np.random.default_rng(0))
    shoals = [tracks(one, recording=f"shoal_{k}") for k, one in enumerate(paths)]
    demos = demonstrations_from_tracks(shoals, ImportRecipe(target="auto"))
    assert set(demos.roles) == {"pursuer"} and demos.is_group
    still, comes = np.zeros((200, 2)), np.linspace(5.0, 0.1, 200)[:, None] * [1.0, 0.0]
    one = np.stack([still, comes, -comes], axis=1)
    assert pursued_individual([one]) == 0
    assert pursued_individual([one, one[:, [1, 0, 2]]]) is None


def test_no_recording_lies_in_two_splits() -> None:
    bodies = approach_path()
    recordings = [tracks(bodies, recording=f"day{i // 2}_run{i}") for i in range(12)]
    cut = Cutting(mode="approach", farther_than=0.5, closer_than=0.2)
    scaling = Scaling(width=2.0, centre=(0.0, 0.0))
    recipe = ImportRecipe(target="animal_1", cutting=cut, scaling=scaling)
    demos = demonstrations_from_tracks(recordings, recipe)
    assert demos.num_episodes == 24
    for name in np.unique(demos.recording):
        assert len(np.unique(demos.split[demos.recording == name])) == 1


def test_recipes_survive_yaml_and_refuse_unknown_entries(tmp_path: Path) -> None:
    recipe = ImportRecipe(
        source="sleap", individuals=("a", "b"), rename={"a": "male"}, decision_rate=10.0,
        cleaning=Cleaning(max_gap=0.5, smoothing_cutoff=2.0), splitting=Splitting(seed=4),
        cutting=Cutting(mode="approach", farther_than=0.3, closer_than=0.2, longest=300.0),
    )  # fmt: skip
    assert ImportRecipe.load(recipe.save(tmp_path / "recipe.yaml")) == recipe
    (tmp_path / "list.yaml").write_text("- 1")
    told = "no recipe: give one that 'animarl import' wrote beside"
    refuses(told, ImportRecipe.load, tmp_path / "list.yaml")
    refuses(
        "cleaning: 'smothing' is unknown", ImportRecipe.from_dict, {"cleaning": {"smothing": 2}}
    )
    (tmp_path / "bad.yaml").write_text("a: [1\n")
    refuses("not valid YAML", ImportRecipe.load, tmp_path / "bad.yaml")


def test_filled_gaps_are_marked_in_the_episodes_and_their_table() -> None:
    bodies = np.concatenate([wave(0.1, 30.0), 0.5 * wave(0.1, 30.0)], axis=1)
    bodies[100:104, 1] = np.nan
    recipe = ImportRecipe(
        target="animal_0", cleaning=Cleaning(max_gap=0.2), cutting=Cutting(piece=np.inf),
        scaling=Scaling(width=2.0, centre=(0.0, 0.0)),
    )  # fmt: skip
    demos = demonstrations_from_tracks([tracks(bodies)], recipe)
    assert demos.individuals == ("animal_1", "animal_0")
    marked = np.argwhere(demos.signals["filled"])
    assert marked.tolist() == [[frame - 1, 0] for frame in range(100, 104)]
    (row,) = episode_table(demos)
    assert row["filled_frames_animal_1"] == 4 and row["filled_frames_animal_0"] == 0
    whole = demonstrations_from_tracks([tracks(wave(0.1, 30.0))], ImportRecipe())
    assert "filled" not in whole.signals


def test_straight_lines_between_frames_miss_by_the_stated_bound() -> None:
    """At most a / (8 rate^2) for a path of acceleration a (docs/data/cleaning.md)."""
    for frequency, rate in ((0.2, 30.0), (1.0, 24.0)):
        found = resample(wave(frequency, rate), rate, 7.0)
        exact = wave(frequency, 7.0)[: len(found)]
        bound = (2 * np.pi * frequency) ** 2 / (8 * rate**2)
        missed = np.linalg.norm(found - exact, axis=2).max()
        assert 0.5 * bound < missed < 1.001 * bound
