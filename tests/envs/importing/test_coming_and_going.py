"""Animals that come and go, packed tables and clocks that tick unevenly."""

import gzip
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import animarl
from recordings import write_tracks
from refusals import refused, refuses

from animarl_algos.cli.describing import automatic_decisions
from animarl_envs.fitting.custom_species import species_of
from animarl_envs.importing.readers import default_recipe, follow, get_reader, read_tracks
from animarl_envs.locomotion import Locomotion
from animarl_envs.species import ChaseSpecies
from animarl_envs.species.options import with_options

HZ = 12.5
TEN_HERTZ = default_recipe(get_reader("long-table"), frame_rate=10.0)


def larvae(folder: Path, name: str, *, uneven: float, count: int = 6) -> Path:
    """Write larvae that crawl straight at 1 mm/s, one after the other, in one packed table."""
    rng, lines = np.random.default_rng(0), ["larva,time_s,x_mm,y_mm"]
    for larva in range(count):
        when = 20.0 * larva + 0.24 + np.arange(250) / HZ
        when += rng.uniform(-uneven, uneven, len(when)) / HZ
        lines += [f"{larva},{t:.4f},{10 + t - 20.0 * larva:.4f},{larva + 1}" for t in when]
    path = folder / f"{name}.csv.gz"
    path.write_bytes(gzip.compress("\n".join(lines).encode() + b"\n"))
    return path


def test_each_animal_that_comes_and_goes_is_a_recording(tmp_path: Path) -> None:
    files = [larvae(tmp_path, name, uneven=0.4) for name in ("fed", "deprived")]
    pattern = "(?P<condition>fed|deprived)"
    demos = follow(default_recipe(get_reader("long-table"), name_pattern=pattern), files)
    assert len(demos) == 12 and demos.individuals == ("individual_0",)
    assert sorted(set(demos.recording.tolist()))[:2] == ["deprived/0", "deprived/1"]
    fed = np.char.startswith(demos.recording.astype(str), "fed/")
    assert len(set(demos.condition[fed])) == len(set(demos.condition[~fed])) == 1
    assert demos.dt == pytest.approx(1 / HZ) and demos.lengths.min() > 240
    unsaid = follow(default_recipe(get_reader("long-table"), target="auto"), files)
    assert len(unsaid) == 12 and unsaid.roles == ("pursuer",)
    # On the even clock the larvae crawl as they did: 1 mm/s, to the rounding of the file.
    (tracks,) = read_tracks(files[0])
    x = tracks.positions[:, 0, 0, 0]
    x = x[np.isfinite(x)]
    assert np.diff(x) * HZ == pytest.approx(1.0, abs=0.01)
    assert "irregular clock resampled to 12.5 Hz" in str(tracks.provenance["read_as"])
    (even,) = read_tracks(larvae(tmp_path, "even", uneven=0.0))
    assert even.frame_rate == HZ and "resampled" not in str(even.provenance["read_as"])


def table(folder: Path, name: str, rows: list[str]) -> Path:
    """Write rows of animal, frame, x and y."""
    path = folder / f"{name}.csv"
    path.write_text("\n".join(["id,frame,x,y", *rows]) + "\n")
    return path


def school(folder: Path, name: str, count: int, gap: int, frames: int = 120) -> Path:
    """Write a group in which animals are missing for ``gap`` frames, one after the other."""
    rows = [
        f"{name}_{who},{f},{who % 5 + f / 100},{who // 5 + f % 7 / 50}"
        for f in range(frames)
        for who in range(count)
        if not (gap and 7 * who <= f < 7 * who + gap)
    ]
    return table(folder, name, rows)


def test_of_a_group_that_comes_and_goes_pieces_have_those_who_stay(tmp_path: Path) -> None:
    """Somebody is always missing: each piece holds as many as were there throughout."""
    demos = follow(TEN_HERTZ, [school(tmp_path, "pond", 16, 7)])
    assert demos.individuals == tuple(f"animal_{k}" for k in range(demos.num_individuals))
    assert 12 <= demos.num_individuals < 16 and demos.is_group
    assert len(demos) >= 8 and set(demos.recording.tolist()) == {"pond"}
    assert np.isfinite(demos.positions).all() and (demos.lengths == 11).all()
    # Those who are there move as they were recorded: .1 to the right each second.
    step = np.diff(demos.path(0)[..., 0], axis=0)
    assert np.ptp(step) < 1e-9
    # How much of what was tracked is used is known, and said.
    used = len(demos) * 12 * demos.num_individuals / (16 * (120 - 7))
    assert demos.provenance["share_used"] == pytest.approx(used)
    said = " ".join(automatic_decisions(demos))
    assert f"nothing is seen of the others ({100 * used:.0f} % of what was tracked is used)" in said


def test_animals_that_are_seen_together_stay_one_recording_whatever_their_number(
    tmp_path: Path,
) -> None:
    rows = [f"{who},{f},{who + f / 10},{f % 7}" for f in range(100) for who in range(3)]
    demos = follow(TEN_HERTZ, [table(tmp_path, "shoal", rows)])
    assert demos.num_individuals == 3
    files = [school(tmp_path, "pond", 9, 0), school(tmp_path, "lake", 6, 0)]
    demos = follow(TEN_HERTZ, files)
    assert demos.num_individuals == 6
    assert set(demos.recording.tolist()) == {"pond", "lake"}


def test_tracks_that_are_too_short_are_said(tmp_path: Path) -> None:
    """Of one animal with gaps, what lies between two of them may be no episode."""
    rows = [f"0,{f},{f / 10},{f % 7}" for f in range(200) if f < 100 or f % 3]
    demos = follow(TEN_HERTZ, [table(tmp_path, "blinking", rows)])
    assert demos.provenance["share_used"] == pytest.approx(100 / len(rows), abs=0.02)
    assert "of what was tracked is used, as recordings are cut" in " ".join(
        automatic_decisions(demos)
    )


def test_of_a_group_one_animal_is_described_for_all(tmp_path: Path) -> None:
    """What is printed does not grow with the group: its animals are alike."""
    steps = np.cumsum(np.random.default_rng(0).normal(0.0, 0.01, (120, 40, 2)), axis=0)
    file = write_tracks(tmp_path / "pond.csv", np.cumsum(steps, axis=0), [*map(str, range(40))])
    demos_file = tmp_path / "pond.npz"
    said = animarl("import", file, "--fps", 10, "--target", "none", "--out", demos_file)
    assert "40 that are alike, 0 to 39" in said and said.count("(each of 40)") == 1
    said = animarl("fit", demos_file, "--bootstrap", 0)
    assert said.count("each of 40") >= 1 and len(said.splitlines()) < 20


@pytest.mark.parametrize(
    ("count", "given", "said"),
    [
        (4, {"target": "pike"}, "there is no target 'pike': choose among pond_0"),
        (4, {"neighbours": 4}, "neighbours is 4 but each sees 3 others at most"),
        (4, {"neighbours": 2, "target": "pond_0"}, "each sees all others, as one is pursued"),
        (1, {"target": "pond_0"}, "pond_0 is recorded alone, so nobody pursues it"),
    ],
)
def test_a_group_that_is_none_is_refused(
    tmp_path: Path, count: int, given: dict[str, Any], said: str
) -> None:
    recipe = default_recipe(get_reader("long-table"), frame_rate=10.0, **given)
    refuses(said, follow, recipe, [school(tmp_path, "pond", count, 0)])
    rows = [f"{w},{f},{w},{f % 3}" for f in range(60) for w in range(4) if (f + w) % 4]
    path = table(tmp_path, "blinking", rows)
    refuses("no three animals are there throughout", follow, TEN_HERTZ, [path])


def test_how_many_neighbours_are_seen_is_said_at_import(tmp_path: Path) -> None:
    recipe = default_recipe(get_reader("long-table"), frame_rate=10.0, neighbours=2)
    demos = follow(recipe, [school(tmp_path, "pond", 5, 0)])
    species = species_of(demos, [Locomotion(0.5, 1.0)] * 5)
    assert isinstance(species, ChaseSpecies) and species.num_seen == 2
    refuses("neighbours is 5 but there are 5 animals", with_options, species, neighbours=5)


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"no gzip", "cannot be read as long-table"),
        (gzip.compress(b"frame,id,x,y\n" + b"0,a,1,1\n" * 50)[:40], "cannot be read as long-table"),
        (gzip.compress(b"0" * 2**26), "unpacks to more than"),
    ],
    ids=["no gzip", "cut short", "bomb"],  # packed bytes hold the time of day
)
def test_a_damaged_or_absurd_packed_table_is_refused(
    tmp_path: Path, content: bytes, said: str
) -> None:
    path = tmp_path / "fed.csv.gz"
    path.write_bytes(content)
    refuses(said, read_tracks, path, source="long-table")


@pytest.mark.parametrize("digits", [2, 3, 4])
@pytest.mark.parametrize("rate", [25.0, 29.97, 30.0, 60.0, 120.0])
def test_the_rate_of_rounded_times_is_that_of_all_frames(
    rate: float, digits: int, tmp_path: Path
) -> None:
    """Steps of rounded times are too long or too short; without frame numbers they may not tell."""
    times = [f"{t / rate:.{digits}f}" for t in range(600)]
    path = tmp_path / "t.csv"
    path.write_text(
        "frame,time_s,x_a,y_a\n" + "".join(f"{t},{when},{t},0\n" for t, when in enumerate(times))
    )
    (tracks,) = read_tracks(path)
    assert tracks.frame_rate == (rate if rate % 1 == 0 else pytest.approx(rate, rel=5e-4))
    path.write_text("time_s,x_a,y_a\n" + "".join(f"{when},{when},0\n" for when in times))
    if digits > 2 or rate == 25:
        assert read_tracks(path)[0].frame_rate == pytest.approx(rate, rel=5e-4)
    else:
        assert ("rounded to 0.01 s, too coarsely" if rate < 100 else "two rows") in refused(path)


def test_a_paused_camera_does_not_slow_the_frame_rate(tmp_path: Path) -> None:
    rows = [f"{t},{t / 60 + 7 * (t > 40):.3f},{t},0\n" for t in range(100)]
    (tmp_path / "t.csv").write_text("frame,time_s,x_a,y_a\n" + "".join(rows))
    assert read_tracks(tmp_path / "t.csv")[0].frame_rate == 60.0
