"""What is known of recordings beside their tracks, merged files, and the container of episodes."""

import copy
import pickle
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from commands import animarl
from numpy.typing import NDArray
from recordings import write_tracks
from refusals import refuses

from animarl_algos.cli.data import merged
from animarl_algos.cli.describing import hints
from animarl_envs.arena import Arena
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.episode import UNFINISHED
from animarl_envs.demos.joining import join
from animarl_envs.demos.summary import unit_of
from animarl_envs.errors import InputError
from animarl_envs.importing.cutting import Cutting, cut_episodes, find_contact_distance
from animarl_envs.importing.readers import read
from animarl_envs.importing.sessions import read_sessions, sessions_by_name
from tools.fuzz.layouts import write_native

CHASE = ("pursuer", "target")
NAMES = tuple(f"{word}_{i}" for i in range(6) for word in ("sham", "drug"))


def chase(number: int, frames: int = 40, apart: float = 100.0) -> NDArray[np.float64]:
    """``(frames, 2, 2)`` [px]: a hunter who comes nearer to a hare until it touches it."""
    rng = np.random.default_rng(number)
    hare = 300.0 + np.cumsum(rng.normal(0, 2.0, (frames, 2)), axis=0)
    direction = rng.uniform(0, 2 * np.pi)
    gap = np.linspace(apart, 8.0, frames)[:, None]
    return np.stack([hare + gap * [np.cos(direction), np.sin(direction)], hare], axis=1)


@pytest.fixture
def files(tmp_path: Path) -> list[Path]:
    """Twelve recordings of hunter and hare, six of each condition."""
    return [
        write_tracks(tmp_path / f"{name}.csv", chase(i), ("hunter", "hare"))
        for i, name in enumerate(NAMES)
    ]


CUTS = {
    "whole": (), "approach": ("--farther-than", 0.2, "--closer-than", 0.1),
    "pieces": ("--piece", 1.0), "events": ("--cut", "events", "--events", "EVENTS"),
}  # fmt: skip


@pytest.mark.parametrize("cut", CUTS)
def test_metadata_gives_conditions_and_splits_with_every_cut(
    cut: str, files: list[Path], tmp_path: Path
) -> None:
    splits = ["train", "val", "test", "train", "", "train"] * 2
    table = pd.DataFrame({
        "recording": [f"{name}.csv" for name in NAMES], "condition": [name[:4] for name in NAMES],
        "split": splits, "weight": np.arange(12),
    })  # fmt: skip
    table.to_csv(tmp_path / "sessions.csv", index=False, sep=";")
    events = tmp_path / "events.csv"
    events.write_text("recording,start,end\n" + "".join(f"{name},0,3.9\n" for name in NAMES))
    words = [str(events) if word == "EVENTS" else word for word in CUTS[cut]]
    out = tmp_path / "out.npz"
    said = animarl(
        "import", *files, "--fps", 10, "--target", "hare", *words,
        "--metadata", tmp_path / "sessions.csv", "--out", out,
    )  # fmt: skip
    demos = Demonstrations.load(out)
    assert "not used: weight" in said
    assert demos.provenance["conditions"] == ["sham", "drug"]
    stated = dict(zip(NAMES, splits, strict=True))
    assert set(demos.recording.tolist()) == set(NAMES)
    for one in demos:
        assert one.condition == one.recording.startswith("drug")
        assert one.split == (stated[one.recording] or one.split)
    again = tmp_path / "again.npz"
    animarl("import", *files, "--recipe", out.with_suffix(".recipe.yaml"), "--out", again)
    assert Demonstrations.load(again).fingerprint() == demos.fingerprint()


def test_metadata_of_recordings_with_points_in_their_names(tmp_path: Path) -> None:
    path = tmp_path / "sessions.csv"
    for ending in ("", ".csv"):
        path.write_text(f"recording,condition\nm1.pre{ending},sham\nm1.post{ending},drug\n")
        sessions = read_sessions(path, ["m1.pre", "m1.post"])
        assert [sessions.of(name).condition for name in ("m1.pre", "m1.post")] == ["sham", "drug"]


def test_metadata_from_names_of_recordings(files: list[Path], tmp_path: Path) -> None:
    out = tmp_path / "out.npz"
    pattern = "(?P<condition>sham|drug)_"
    animarl("import", *files, "--fps", 10, "--name-pattern", pattern, "--out", out)
    demos = Demonstrations.load(out)
    assert all(one.condition == one.recording.startswith("drug") for one in demos)
    for wrong, message in (
        ("(", "no regular expression"),
        ("(sham)", "groups are named nothing"),
        ("(?P<age>sham)", "groups are named age"),
        ("(?P<condition>sham)", "does not fit recording 'drug_0'"),
        ("_(?P<condition>.)", "6 conditions"),
        ("(?P<split>sham|drug)", "split 'sham' is unknown"),
    ):
        refuses(message, sessions_by_name, wrong, NAMES)


def test_metadata_names_the_animals_of_each_recording(tmp_path: Path) -> None:
    """Different animals under different names, in either order: roles are their names."""
    first = write_tracks(tmp_path / "one.csv", chase(0), ("anna", "bert"))
    second = write_tracks(tmp_path / "two.csv", chase(1), ("zoe", "carl"))
    (tmp_path / "s.csv").write_text(
        "Recording,individual,role,condition\none,anna,pursuer,0\none,bert,target,0\n"
        "two,carl,target,1\ntwo,zoe,pursuer,1\n"
    )
    out = tmp_path / "out.npz"
    words = ("import", first, second, "--fps", 10, "--arena-width", 600, "--centre", "300,300")
    animarl(*words, "--metadata", tmp_path / "s.csv", "--out", out)
    demos = Demonstrations.load(out)
    assert demos.individuals == ("pursuer_0", "target") and demos.roles == CHASE
    for number, one in enumerate(demos):
        np.testing.assert_allclose(one.positions, (chase(number)[1:] - 300) / 300)
        assert one.condition == number
    (tmp_path / "t.csv").write_text("recording,target\none,bert\ntwo,carl\n")
    short = tmp_path / "short.npz"
    animarl(*words, "--metadata", tmp_path / "t.csv", "--out", short)
    np.testing.assert_array_equal(Demonstrations.load(short).positions, demos.positions)


WRONG = {
    "name,condition\nr,0\n": "lacks the column recording",
    "recording,condition\nr,0,1\n": "line 2 has 3 cells",
    "recording,condition\nr,0\nr,1\n": "line 3 .r.: the recording has two rows",
    "recording,condition\n,0\n": "line 2 names no recording",
    "recording,condition\na,x\nb,y\nc,z\n": "3 conditions, x, y, z",
    "recording,split\nr,tes\n": "line 2: split 'tes' is unknown",
    "recording,px_per_cm\nr,-1\n": "px_per_cm is '-1'",
    "recording,individual,role\nr,a,leader\n": "has the role 'leader'",
    "recording,individual,role\nr,a,target\nr,b,target\nr,c,pursuer\nr,d,pursuer\n": "several",
    "recording,condition\nr,0": "last line has no line ending",
}  # fmt: skip


@pytest.mark.parametrize("text", WRONG)
def test_metadata_that_is_wrong_is_refused_by_line(text: str, tmp_path: Path) -> None:
    path = tmp_path / "m.csv"
    path.write_text(text)
    refuses(WRONG[text], read_sessions, path)


def test_metadata_without_a_recording_or_of_nobody_is_refused(
    files: list[Path], tmp_path: Path
) -> None:
    table, out = tmp_path / "m.csv", tmp_path / "out.npz"
    words = ("import", *files[:2], "--fps", 10, "--metadata", table, "--out", out)
    for text, message in (
        ("recording,condition\nsham_0,0\n", "nothing is said of recording 'drug_0'"),
        ("recording,target\nsham_0,hare\ndrug_0,\n", "no target is named for drug_0"),
        ("recording,target\nsham_0,hare\ndrug_0,dog\n", "no individual 'dog'"),
        ("recording,px_per_cm\nsham_0,10\ndrug_0,\n", "give px_per_cm of all recordings"),
    ):
        table.write_text(text)
        refuses(message, animarl, *words)
    assert not out.exists()


def test_metadata_of_scale_brings_recordings_of_several_cameras_together(tmp_path: Path) -> None:
    """The same chase through a lens of half the size is the same chase."""
    near = write_tracks(tmp_path / "near.csv", chase(0), ("hunter", "hare"))
    far = write_tracks(tmp_path / "far.csv", chase(0) / 2, ("hunter", "hare"))
    (tmp_path / "m.csv").write_text("recording,px_per_cm\nnear,20\nfar,10\n")
    out = tmp_path / "out.npz"
    said = animarl("import", near, far, "--fps", 10, "--metadata", tmp_path / "m.csv", "--out", out)
    demos = Demonstrations.load(out)
    np.testing.assert_allclose(demos.episode(0).positions, demos.episode(1).positions)
    assert "SCALES DIFFER" not in said and "cm/s" in said
    assert unit_of(demos).name == "cm"
    step = np.linalg.norm(np.diff(chase(0)[1:], axis=0), axis=2) / 20  # [cm]
    told = np.linalg.norm(np.diff(demos.episode(0).positions, axis=0), axis=2)
    np.testing.assert_allclose(told * unit_of(demos).per_arena_unit, step)


def test_copies_of_other_sizes_keep_their_speeds_unless_each_is_scaled(tmp_path: Path) -> None:
    factors = (1.0, 0.5, 0.25, 1.0)
    files = [
        write_tracks(tmp_path / f"r{i}.csv", chase(0) * factor, ("hunter", "hare"))
        for i, factor in enumerate(factors)
    ]
    out = tmp_path / "out.npz"
    words = ("import", *files, "--fps", 10, "--target", "hare", "--out", out)

    def speeds() -> list[float]:
        steps = [np.diff(one.positions, axis=0) for one in Demonstrations.load(out)]
        return [float(np.median(np.linalg.norm(step, axis=2))) for step in steps]

    assert "SCALES DIFFER" not in animarl(*words)
    np.testing.assert_allclose(np.array(speeds()) / speeds()[0], factors)
    assert "SCALES DIFFER" in animarl(*words, "--scale-each")
    np.testing.assert_allclose(np.array(speeds()) / speeds()[0], 1.0)


@pytest.mark.parametrize("unit", [1.0, 0.1, 1 / 3, 1e3 / 7])
def test_ties_of_contact_do_not_depend_on_the_unit(unit: float) -> None:
    """Two pursuers as far from the target, and one just at the limit."""
    bodies = np.zeros((6, 3, 2))
    bodies[:, 0, 0] = bodies[:, 1, 1] = [0.9, 0.7, 0.5, 0.3, 0.3, 0.1]
    bodies[:, 1, 1] *= -1
    bodies = (bodies + 0.7) * unit
    roles = ("pursuer", "pursuer", "target")
    (cut,) = cut_episodes(bodies, roles, 10.0, Cutting(contact=0.3 * unit))
    assert (cut.stop, cut.outcome) == (6, 1)
    near = Cutting(mode="approach", farther_than=0.8 * unit, closer_than=0.3 * unit)
    assert cut_episodes(bodies, roles, 10.0, near) == [cut]


def test_contact_is_found_where_it_ends_recordings_and_only_there() -> None:
    rng = np.random.default_rng(0)
    ended = [np.append(rng.uniform(0.2, 1.0, 30), rng.uniform(0.05, 0.1)) for _ in range(20)]
    farthest = max(one[-1] for one in ended)
    assert find_contact_distance(ended) == pytest.approx(farthest, rel=1e-5)
    stopped = [*ended, *(rng.uniform(0.5, 1.0, 30) for _ in range(5))]  # by the clock
    assert find_contact_distance(stopped) == pytest.approx(farthest, rel=1e-5)
    assert find_contact_distance([one[::-1] for one in ended]) is None
    assert find_contact_distance([rng.uniform(0, 1, 30) for _ in range(20)]) is None
    assert find_contact_distance(ended[:4]) is None  # too few to say
    assert find_contact_distance([np.full(30, np.inf)] * 9) is None  # nobody is the target


def test_target_and_contact_are_found_and_told_or_stated(files: list[Path], tmp_path: Path) -> None:
    out = tmp_path / "out.npz"
    words = ("import", *files, "--fps", 10, "--out", out)
    said = animarl(*words)
    demos = Demonstrations.load(out)
    assert demos.individuals == ("hunter", "hare") and (demos.outcome == 1).all()
    assert "hare is taken for the target" in said and "(8 px)" in said
    said = animarl(*words, "--contact", 0, "--target", "none")
    demos = Demonstrations.load(out)
    assert set(demos.roles) == {"pursuer"} and (demos.outcome == UNFINISHED).all()
    assert "taken for the target" not in said


def test_merged_metadata_of_two_files(files: list[Path], tmp_path: Path) -> None:
    sham, drug = tmp_path / "sham.npz", tmp_path / "drug.npz"
    width = ("--fps", 10, "--target", "hare", "--arena-width", 600, "--centre", "300,300")
    animarl("import", *files[::2], *width, "--out", sham)
    animarl("import", *files[1::2], *width, "--out", drug)
    both = tmp_path / "both.npz"
    animarl("data", "merge", sham, drug, "--conditions", "sham,drug", "--out", both)
    found = Demonstrations.load(both)
    assert found.num_episodes == 12 and found.provenance["conditions"] == ["sham", "drug"]
    assert all(one.condition == one.recording.startswith("drug") for one in found)
    assert set(found.provenance["scales"]) == set(NAMES)
    assert not any("SCALES" in hint for hint in hints(found))
    assert join([read(sham), read(drug)]).num_episodes == 12
    refuses("nothing to merge it with", merged, (sham,))
    refuses("the same episodes", merged, (sham, sham))
    for conditions in ("0", "0,"):
        refuses("one for each", merged, [sham, drug], conditions)


def test_merged_metadata_tells_recordings_of_one_name_apart(tmp_path: Path) -> None:
    sets = []
    for i in range(2):
        file = write_tracks(tmp_path / "trial.csv", chase(i), ("hunter", "hare"))
        out = tmp_path / f"day{i}.npz"
        animarl("import", file, "--fps", 10, "--target", "hare", "--arena-width", 900 + i,
                "--out", out)  # fmt: skip
        sets.append(Demonstrations.load(out))
    found = join(sets)
    assert set(found.recording.tolist()) == {"day0/trial", "day1/trial"}
    units = {name: scale["unit"] for name, scale in found.provenance["scales"].items()}
    assert units == {"day0/trial": 450.0, "day1/trial": 450.5}
    other = replace(sets[1], provenance={**sets[1].provenance, "unit": "cm"})
    refuses("is in cm", join, [sets[0], other])


def test_splits_without_a_condition_are_named(files: list[Path], tmp_path: Path) -> None:
    splits = ["train"] * 8 + ["val", "val", "test", "train"]
    rows = [f"{n},{n[:4]},{s}" for n, s in zip(NAMES, splits, strict=True)]
    (tmp_path / "m.csv").write_text("recording,condition,split\n" + "\n".join(rows) + "\n")
    said = animarl("import", *files, "--fps", 10, "--metadata", tmp_path / "m.csv", "--dry-run")
    assert "split test has no episode of condition 1" in said
    assert "split test has 1 episode, fewer than 5" in said


def test_conditions_of_finished_demonstrations_are_set_as_well(tmp_path: Path) -> None:
    native, out = write_native(tmp_path), tmp_path / "one.npz"
    animarl("import", native, "--condition", 1, "--dry-run", "--out", out)
    assert not out.exists()
    animarl("import", native, "--condition", 1, "--out", out)
    assert (Demonstrations.load(out).condition == 1).all()
    refuses("must be 0 or 1", animarl, "import", native, "--condition", 2, "--out", out)


LENGTHS = (4, 2, 6)


def content(**changes: Any) -> dict[str, Any]:
    """Three short episodes of two individuals, with ``changes``."""
    frames = sum(LENGTHS)
    random = np.random.default_rng(0)
    values: dict[str, Any] = {
        "species": "custom", "individuals": ("hunter_0", "prey"), "roles": ("pursuer", "target"),
        "dt": 0.1, "arena": Arena("square", 1.0, 1.1),
        "positions": random.uniform(-1, 1, (frames, 2, 2)), "lengths": np.array(LENGTHS),
        "initial_velocity": random.uniform(-1, 1, (3, 2, 2)), "condition": np.array([0, 1, 1]),
        "outcome": np.array([0, 1, -1]), "split": np.array(["train", "val", "train"]),
        "recording": np.array(["a", "b", "b"]),
        "signals": {"actions": np.zeros((frames, 2), dtype=np.int8)},
        "provenance": {"source": "drawn at random", "licence": "MIT", "synthetic": True},
        "name": "tracks.npz",
    }  # fmt: skip
    return values | changes


def edited(key: str, place: Any, value: Any) -> dict[str, Any]:
    """The same with one entry of an array replaced."""
    array = np.array(content()[key])
    array[place] = value
    return {key: array}


REFUSED: list[tuple[dict[str, Any], str]] = [
    (edited("positions", (5, 1, 0), np.nan), "episode 1, frame 1, prey"),
    (edited("positions", (7, 0, 1), 3.0), "outside the arena"),
    (edited("initial_velocity", (0, 0, 0), np.inf), "initial_velocity"),
    ({"lengths": np.array([4, 2, 7])}, "add up"), ({"lengths": np.array([5, 1, 6])}, "1 frame:"),
    ({"lengths": np.array([6, 0, 6])}, "0 frames"),
    ({"lengths": np.array([2**62, 2**62, 12])}, "4611686018427387904 frames"),
    ({"lengths": np.array([4, 2, 2**64 - 1], dtype=np.uint64)}, "lengths: 18446744073709551615"),
    ({"lengths": np.array([4.0, 2.7, 6.0])}, "lengths: 2.7 is no whole number"),
    ({"lengths": np.array(["4", "2", "6"])}, "lengths: it is of kind"),
    ({"condition": np.array([0, 256, 1])}, "condition: 256 is no"),
    ({"outcome": np.array([257, 0, 0])}, "outcome: 257 is no"),
    ({"positions": np.zeros((12, 2, 2), dtype=complex)}, "positions: it is of kind complex128"),
    ({"positions": np.zeros((12, 3, 2))}, "not (frames, 2, 2)"), ({"dt": 0.0}, "dt"),
    ({"dt": -0.1}, "dt"), ({"dt": float("nan")}, "dt"),
    ({"individuals": ("prey", "prey")}, "appears twice"),
    ({"positions": content()["positions"][:, [0, 0]]}, "same track"),
    ({"roles": ("target", "target")}, "comes last"), ({"roles": ("pursuer", "bystander")}, "roles"),
    ({"condition": np.array([0, 2, 1])}, "condition"),
    ({"condition": np.array([0, 1])}, "2 entries for 3 episodes"),
    ({"outcome": np.array([0, 9, 0])}, "outcome"),
    ({"split": np.array(["train", "dev", "test"])}, "dev"),
    ({"signals": {"odour": np.zeros(5)}}, "odour"),
    ({"provenance": {"source": "x", "synthetic": True}}, "licence"),
    ({"individuals": (), "roles": ()}, "no individuals"),
]  # fmt: skip


@pytest.mark.parametrize(("changes", "words"), REFUSED, ids=[w for _, w in REFUSED])
def test_bad_content_is_refused_with_file_and_place(changes: dict[str, Any], words: str) -> None:
    sentence = refuses("", Demonstrations, **content(**changes))
    assert words in sentence
    assert sentence.startswith("tracks.npz: ")
    assert "\n" not in sentence


def test_saving_and_loading_changes_nothing(tmp_path: Path) -> None:
    ragged = np.array([None] * sum(LENGTHS), dtype=object)
    refuses("Python objects", Demonstrations, **content(signals={"notes": ragged}))
    demos = Demonstrations(**content())
    again = Demonstrations.load(demos.save(tmp_path / "tracks.npz"))
    assert again.fingerprint() == demos.fingerprint()
    assert again.individuals == demos.individuals
    assert again.arena == demos.arena
    assert dict(again.provenance) == dict(demos.provenance)
    np.testing.assert_array_equal(again.positions, demos.positions)
    np.testing.assert_array_equal(again.signals["actions"], demos.signals["actions"])
    assert [p.name for p in tmp_path.iterdir()] == ["tracks.npz"]


@pytest.mark.parametrize("fault", [OSError("no space left"), KeyboardInterrupt()])
def test_an_interrupted_save_leaves_the_old_file(
    fault: BaseException, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = Demonstrations(**content()).save(tmp_path / "tracks.npz")
    before = path.read_bytes()

    def interrupted(file: Any, **arrays: Any) -> None:
        file.write(b"half")
        raise fault

    monkeypatch.setattr(np, "savez_compressed", interrupted)
    stopped = (KeyboardInterrupt, InputError)
    with pytest.raises(stopped, match=r"tracks\.npz: it cannot be written \(no space left|^$"):
        Demonstrations(**content(dt=0.2)).save(path)
    assert path.read_bytes() == before and [*tmp_path.iterdir()] == [path]


def test_a_spoilt_file_is_refused_by_name(tmp_path: Path) -> None:
    path = tmp_path / "spoilt.npz"
    refuses(r"spoilt\.npz: .*no such file", Demonstrations.load, path)
    np.savez(path, pos=np.zeros(3))
    refuses(r"spoilt\.npz: .*", Demonstrations.load, path)
    Demonstrations(**content()).save(path)
    path.write_bytes(path.read_bytes()[:300])
    refuses(r"spoilt\.npz: .*", Demonstrations.load, path)


def test_a_file_is_opened_in_another_process(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = Demonstrations(**content()).save(tmp_path / "tracks.npz")
    monkeypatch.setattr("animarl_envs.files.load_npy", None)  # of this process
    assert len(Demonstrations.load(path)) == 3


def test_selection_keeps_episodes_whole() -> None:
    demos = Demonstrations(**content())
    chosen = demos.select(split="train", condition=1)
    assert len(chosen) == 1
    np.testing.assert_array_equal(chosen.positions, demos.episode(2).positions)
    np.testing.assert_array_equal(chosen.episode(0).velocities, demos.episode(2).velocities)
    turned = demos.select(episodes=[2, 0])
    np.testing.assert_array_equal(turned.lengths, [6, 4])
    np.testing.assert_array_equal(turned.episode(1).positions, demos.episode(0).positions)
    refuses("holds no episode", demos.select, split="test")
    refuses("'dev' is unknown", demos.select, split="dev")


def test_velocity_belongs_to_the_position_it_led_to() -> None:
    demos = Demonstrations(**content())
    for i, episode in enumerate(demos):
        np.testing.assert_array_equal(episode.velocities[0], demos.initial_velocity[i])
        rebuilt = episode.positions[:-1] + episode.velocities[1:] * demos.dt
        np.testing.assert_allclose(rebuilt, episode.positions[1:], atol=1e-12)
        begin, end = demos.offsets[i : i + 2]
        np.testing.assert_allclose(demos.velocities()[begin:end], episode.velocities, atol=1e-12)


def test_the_content_cannot_be_changed() -> None:
    given = content()
    demos = Demonstrations(**given)
    mark = demos.fingerprint()
    given["positions"][...] = 0.0
    with pytest.raises(ValueError, match="read-only"):
        demos.positions[0] = 0.0
    with pytest.raises(ValueError, match="read-only"):
        demos.episode(0).positions[0] = 0.0
    with pytest.raises(TypeError):
        demos.signals["actions"] = np.zeros(12)  # type: ignore[index]
    assert demos.fingerprint() == mark
    assert copy.deepcopy(demos).fingerprint() == mark
    assert pickle.loads(pickle.dumps(demos)).fingerprint() == mark


def test_the_fingerprint_changes_with_the_content_and_not_with_provenance() -> None:
    told = {"source": "elsewhere", "licence": "MIT", "synthetic": True}
    before = Demonstrations(**content()).fingerprint()
    assert Demonstrations(**content(provenance=told)).fingerprint() == before
    other = edited("positions", (0, 0, 0), 0.5), edited("condition", 0, 1)
    for changes in ({"dt": 0.2}, *other):
        assert Demonstrations(**content(**changes)).fingerprint() != before
