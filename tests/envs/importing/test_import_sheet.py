"""What an import ends with: six lines, a picture, the next command; splits and the arena."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from commands import animarl
from recordings import episodes_along
from refusals import refuses

from animarl_algos.cli.describing import describe_ground
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.splits import Splitting, cross_validated, deal, split_recordings
from animarl_envs.fitting.custom_species import arena_of
from animarl_envs.importing.cleaning import Scaling, scales_of
from animarl_envs.importing.readers import read
from animarl_envs.importing.tracks import Tracks

SIX = ["animals", "rate", "unit", "arena", "conditions", "split"]


def walkers(folder: Path, count: int = 8) -> tuple[list[Path], Path]:
    """Tables of two animals each, and a table of their conditions: every fourth is sham."""
    rng, files, rows = np.random.default_rng(0), [], []
    for number in range(count):
        steps = rng.normal(0, 1.0, (60, 2, 2)).cumsum(axis=0)
        table = [
            {"frame": frame, "id": name, "x": x, "y": y}
            for frame, places in enumerate(steps.tolist())
            for name, (x, y) in zip("ab", places, strict=True)
        ]
        files.append(folder / f"r{number}.csv")
        pd.DataFrame(table).to_csv(files[-1], index=False)
        rows.append({"recording": f"r{number}", "condition": "drug" if number % 2 else "sham"})
    pd.DataFrame(rows).to_csv(folder / "sessions.csv", index=False)
    return files, folder / "sessions.csv"


def test_an_import_sheet_has_six_lines_a_picture_and_the_next_command(tmp_path: Path) -> None:
    files, sessions = walkers(tmp_path)
    out = tmp_path / "mine.npz"
    words = ("--fps", 10, "--target", "none", "--metadata", sessions, "--out", out)
    shown = animarl("import", *files, *words, drawn=True)
    lines = [line.split() for line in shown.splitlines() if line.startswith("  ")]
    assert [line[0] for line in lines if line and line[0] in SIX] == SIX
    assert "8 recordings" in shown and "sham" in shown and "guessed: --arena" in shown
    assert f"Next: animarl run {out}" in shown
    assert out.with_suffix(".png").read_bytes().startswith(b"\x89PNG")
    demos = Demonstrations.load(out)
    for split in ("train", "val", "test"):
        assert set(demos.condition[demos.split == split].tolist()) == {0, 1}
    assert not (tmp_path / "dry.png").exists()
    animarl("import", *files, *words[:-1], tmp_path / "dry.npz", "--dry-run")
    assert not (tmp_path / "dry.png").exists()


def test_an_import_sheet_of_two_files_names_the_pattern_of_conditions(tmp_path: Path) -> None:
    for name in ("fed", "starved"):
        table = "".join(
            f"{n},{t},{t}.{n},{n}\n" for n in range(3) for t in range(20 * n, 20 * n + 20)
        )
        (tmp_path / f"{name}.csv").write_text("larva,frame,x,y\n" + table)
    words = ("import", *sorted(tmp_path.glob("*.csv")), "--fps", 10, "--dry-run")
    shown = " ".join(animarl(*words).split())
    pattern = "(?P<condition>fed|starved)"
    assert f"--name-pattern '{pattern}' states two" in shown and "guessed: --target" not in shown
    assert "(starved): 3 recordings" in " ".join(animarl(*words, "--name-pattern", pattern).split())
    refuses("named nothing: write one of condition", animarl, *words, "--name-pattern", "fed")


def test_splits_have_every_condition_and_keep_an_animal_together() -> None:
    names = np.array([f"r{i:02d}" for i in range(36)])
    condition = (np.arange(36) >= 27).astype(np.int8)
    splitting = Splitting(by="recording")
    for seed in range(20):
        dealt = split_recordings(names, replace(splitting, seed=seed), condition)
        for split in ("train", "val", "test"):
            assert set(condition[dealt == split].tolist()) == {0, 1}
    animals = {name: f"animal {i // 3}" for i, name in enumerate(names.tolist())}
    dealt = split_recordings(names, splitting, condition, animals)
    assert all(len(set(dealt[3 * i : 3 * i + 3])) == 1 for i in range(12))
    few = split_recordings(names[:4], splitting, np.array([0, 0, 0, 1]))
    np.testing.assert_array_equal(few, split_recordings(names[:4], splitting))


def test_named_animals_stay_together_in_an_import_and_after(tmp_path: Path) -> None:
    files, sessions = walkers(tmp_path)
    table = pd.read_csv(sessions).drop(columns="condition")
    table.assign(animal=np.arange(8) // 2).to_csv(sessions, index=False)
    out = tmp_path / "mine.npz"
    words = ("--fps", 10, "--target", "none", "--metadata", sessions, "--out", out)
    assert "2 animals" in " ".join(animarl("import", *files, *words).split())
    demos = Demonstrations.load(out)
    every = [deal(demos, Splitting(seed=3)), *cross_validated(demos, 3)]
    for dealt in (demos, *every):
        splits = dict(zip(dealt.recording.tolist(), dealt.split.tolist(), strict=True))
        assert all(splits[f"r{2 * i}"] == splits[f"r{2 * i + 1}"] for i in range(4))


@pytest.mark.parametrize("shape", ["square", "disc"])
def test_one_outlier_does_not_make_the_arena(shape: str) -> None:
    points = np.random.default_rng(0).uniform(-10, 10, (500, 1, 1, 2))
    names = {"individuals": ("a",), "keypoints": ("b",), "recording": "c"}
    plain = scales_of([Tracks(positions=points, **names)], Scaling(shape=shape))[0]
    off = points.copy()
    off[7] = 5693.0
    robust = scales_of([Tracks(positions=off, **names)], Scaling(shape=shape))[0]
    assert robust.unit == pytest.approx(plain.unit, rel=0.02)
    moved = [Tracks(positions=points + shift, **names) for shift in (0.0, 100.0)]
    own = scales_of(moved, Scaling(shape=shape, centre_each=True))
    assert own[0].unit == own[1].unit == pytest.approx(plain.unit)
    assert np.subtract(own[1].centre, own[0].centre) == pytest.approx([100.0, 100.0])


def test_a_moved_camera_is_noticed() -> None:
    rng = np.random.default_rng(0)
    paths = [rng.uniform(-0.3, 0.3, (400, 1, 2)) + [shift, 0] for shift in (-0.4, 0.0, 0.4)]
    made = episodes_along(paths, individuals=("a",), roles=("pursuer",), species="custom")
    (told,) = describe_ground(replace(made, recording=np.array(["r0", "r1", "r2"])))
    assert "--centre-each" in told


def test_a_corridor_and_a_ring_are_noticed() -> None:
    rng = np.random.default_rng(0)
    angle, radius = rng.uniform(0, 2 * np.pi, 4000), rng.uniform(0.8, 1.0, 4000)
    ring = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)
    box = rng.uniform(-1, 1, (4000, 2))
    disc = box[np.linalg.norm(box, axis=1) < 1.0]
    corridor = box * [1.0, 0.1]
    for points, word in (
        (ring, "--arena ring=0.8"),
        (corridor, "corridor"),
        (box, ""),
        (box * [1.0, 0.5], "--arena rectangle=0.5"),
        (box * [0.8, 1.0], "--arena rectangle=1.25"),
        (disc, "--arena disc"),
    ):
        found = describe_ground(
            episodes_along(
                [points[:, None]], individuals=("a",), roles=("pursuer",), species="custom"
            )
        )
        assert len(found) == bool(word) and all(word in line for line in found)


@pytest.mark.realdata
def test_fish_that_cross_the_middle_are_in_no_ring(tmp_path: Path) -> None:
    fish = Path(__file__).parents[4] / "shared" / "data" / "fish_shoals" / "fish15.csv"
    out = tmp_path / "fish.npz"
    words = ("--fps", "32", "--target", "none", "--arena", "ring=0.2")
    printed = " ".join(animarl("import", fish, *words, "--out", out).split())
    assert "obstacles (x,y,radius) 0,0,0.2" in printed
    assert "otherwise give a smaller obstacle" in printed
    demos = read(out)
    assert demos.arena.obstacles == ((0.0, 0.0, 0.2),) and not arena_of(demos).rebound
    assert describe_ground(replace(demos, arena=replace(demos.arena, obstacles=()))) == []
