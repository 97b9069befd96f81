"""``animarl import``, ``animarl data`` and ``animarl fit``: from file to file, all or nothing."""

from __future__ import annotations

import csv
import glob
import itertools
import json
from pathlib import Path

import numpy as np
import pytest
import typer
from tracker_files import write_agents, write_long, write_native, write_slp, write_trex
from typer.testing import CliRunner

from animarl_algos.commands import data
from animarl_algos.commands.fit import fit_command
from animarl_algos.commands.importing import import_command
from animarl_envs.demos import Demonstrations
from animarl_envs.demos.following import follow
from animarl_envs.demos.readers import default_recipe, get_reader, read
from animarl_envs.demos.recipe import Recipe
from animarl_envs.errors import InputError
from animarl_envs.fitting import LocomotionFit, fit_locomotion

APP = typer.Typer()
APP.command("import")(import_command)
APP.command("fit")(fit_command)
APP.add_typer(data.app, name="data")


def animarl(*words: object) -> str:
    """Run a command in this process; what it raises is raised."""
    result = CliRunner().invoke(APP, [str(word) for word in words], catch_exceptions=False)
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    assert result.exit_code == 0, result.output
    return result.output


def test_import_writes_demonstrations_and_a_recipe_that_repeats_them(tmp_path: Path) -> None:
    table, out = write_long(tmp_path), tmp_path / "out" / "demos.npz"
    animarl(
        "import", table, "--fps", 20, "--target", "female", "--decision-rate", 10,
        "--individuals", "male=he,female=female", "--arena", "square", "--out", out,
    )  # fmt: skip
    demos = Demonstrations.load(out)
    assert demos.individuals == ("he", "female") and demos.dt == pytest.approx(0.1)
    assert demos.roles == ("pursuer", "target")
    again = tmp_path / "again.npz"
    animarl("import", table, "--recipe", tmp_path / "out" / "demos.recipe.yaml", "--out", again)
    assert Demonstrations.load(again).fingerprint() == demos.fingerprint()


def test_dry_import_says_what_it_understood_and_writes_nothing(tmp_path: Path) -> None:
    clip = write_slp(tmp_path)
    before = sorted(tmp_path.iterdir())
    said = animarl("import", clip, "--source", "sleap", "--fps", 25, "--dry-run")
    assert "male (pursuer), female (pursuer)" in said and "nothing was written" in said
    assert sorted(tmp_path.iterdir()) == before


def test_import_of_several_files_of_one_recording(tmp_path: Path) -> None:
    write_trex(tmp_path)
    files = sorted(tmp_path.glob("video_fish*.npz"))
    animarl("import", *files, "--target", "auto", "--out", tmp_path / "fish.npz")
    assert Demonstrations.load(tmp_path / "fish.npz").num_individuals == 2


def test_failed_imports_leave_nothing_behind(tmp_path: Path) -> None:
    table, out = write_long(tmp_path), tmp_path / "demos.npz"
    for words, message in (
        (("--out", out), "give it with --fps"),
        (("--fps", 20, "--out", tmp_path / "demos.txt"), "end in .npz"),
        (("--fps", 20), "name --out"),
        (("--fps", 20, "--target", "nobody", "--out", out), "no target 'nobody'"),
        (("--fps", 20, "--keypoint", "nose", "--out", out), "no keypoint 'nose'"),
        (("--fps", 20, "--option", "nonsense=1", "--out", out), "no option 'nonsense'"),
        (("--fps", 0, "--out", out), "must be a positive number"),
        (("--fps", 20, "--decision-rate", 40, "--out", out), "no higher than that"),
        (("--fps", 20, "--farther-than", 1, "--out", out), "give both"),
    ):
        with pytest.raises(InputError, match=message):
            animarl("import", table, *words)
    assert not out.exists() and not list(tmp_path.glob(".demos*"))


def test_interrupted_saves_leave_nothing_behind(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    demos = read(write_native(tmp_path))

    def interrupt(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(np, "savez_compressed", interrupt)
    with pytest.raises(KeyboardInterrupt):
        demos.save(tmp_path / "new.npz")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["demos.npz"]


def test_data_commands(tmp_path: Path) -> None:
    path = write_agents(tmp_path)
    demos = read(path)
    assert "predator_0 (pursuer)" in animarl("data", "show", path)
    assert "3 episodes, all valid" in animarl("data", "check", path, "--out", tmp_path / "t.csv")
    rows = list(csv.DictReader((tmp_path / "t.csv").open()))
    assert [float(row["duration"]) for row in rows] == pytest.approx([0.5, 0.3, 0.9])
    step = np.linalg.norm(np.diff(demos.episode(0).positions[:, 2], axis=0), axis=1)
    assert float(rows[0]["path_length_prey"]) == pytest.approx(step.sum())
    animarl("data", "split", path, "--by", "episode", "--seed", 1, "--out", tmp_path / "s.npz")
    assert sorted(Demonstrations.load(tmp_path / "s.npz").split.tolist()) == [
        "test",
        "train",
        "val",
    ]
    animarl("data", "plot", path, "--out", tmp_path / "figure.png")
    assert (tmp_path / "figure.png").read_bytes().startswith(b"\x89PNG")
    animarl("data", "convert", path, "--out", tmp_path / "minari-v0")
    back = read(tmp_path / "minari-v0" / "data" / "main_data.hdf5")
    assert back.fingerprint() == demos.fingerprint()
    animarl("data", "convert", path, "--out", tmp_path / "table.csv")
    with (tmp_path / "table.csv").open() as file:
        first = next(csv.DictReader(file))
    assert float(first["x"]) == demos.positions[0, 0, 0]
    assert "long-table" in animarl("data", "sources")


def test_fit_command_saves_what_it_prints(tmp_path: Path) -> None:
    path = write_native(tmp_path)
    out = tmp_path / "fit.json"
    said = animarl("fit", path, "--split", "all", "--bootstrap", 20, "--out", out)
    fit = LocomotionFit.load(out)
    assert f"{fit.individuals[0].damping:.3f}" in said
    animarl("fit", path, "--split", "all", "--bootstrap", 0, "--out", tmp_path / "fit.csv")
    rows = list(csv.DictReader((tmp_path / "fit.csv").open()))
    assert [row["individual"] for row in rows] == ["male", "female"]
    assert float(rows[0]["d"]) == fit.individuals[0].damping
    with pytest.raises(InputError, match=r"use \.csv or \.json"):
        animarl("fit", path, "--out", tmp_path / "fit.txt")


def test_imports_read_a_large_table_in_pieces(tmp_path: Path) -> None:
    """Memory above the start stays below six times the table's size (1 GB within 4 GB: docs)."""
    import subprocess
    import sys

    rng = np.random.default_rng(0)
    path = tmp_path / "large.csv"
    with path.open("w") as file:
        file.write("frame,id,x,y\n")
        steps = np.cumsum(rng.normal(0, 1e-3, (100_000, 2, 2)), axis=0)
        for t, bodies in enumerate(steps.tolist()):
            for name, (x, y) in zip("ab", bodies, strict=True):
                file.write(f"{t},{name},{x:.12f},{y:.12f}\n")
    script = (
        "import resource, sys\n"
        "from pathlib import Path\n"
        "import pandas, scipy.signal\n"
        "from animarl_envs.demos.readers import default_recipe, get_reader\n"
        "from animarl_envs.demos.following import follow\n"
        "peak = lambda: resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024\n"
        "before, told = peak(), []\n"
        "recipe = default_recipe(get_reader('long-table'), frame_rate=100.0, decision_rate=10.0)\n"
        "demos = follow(recipe, [Path(sys.argv[1])], told.append)\n"
        "assert demos.lengths.sum() == 9999 and told and told[-1] == 1.0 == max(told)\n"
        "print((peak() - before) / Path(sys.argv[1]).stat().st_size)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", script, str(path)], capture_output=True, text=True, check=True
    )
    assert float(done.stdout) < 6.0


# -- the recordings at hand ----------------------------------------------------------------------


@pytest.fixture(scope="module")
def moths(data_dir: Path) -> Demonstrations:
    files = sorted((data_dir / "silkmoth_mothvr" / "raw").glob("*.csv"))
    return follow(default_recipe(get_reader("mothvr")), files)


@pytest.mark.realdata
def test_import_of_silkmoth_runs(moths: Demonstrations) -> None:
    assert moths.num_episodes == 24
    assert (moths.outcome == 1).sum() == 22 and (moths.outcome == 0).sum() == 2
    assert np.linalg.norm(moths.positions, axis=2).max() < 0.5  # metres
    last = moths.positions[moths.offsets[1:] - 1, 0]
    assert np.linalg.norm(last[moths.outcome == 1], axis=1).max() < 0.0512
    assert not (moths.lengths > 601).any()


@pytest.mark.realdata
def test_onset_fit_of_silkmoth_runs_is_near_the_published_reanalysis(moths: Demonstrations) -> None:
    (fit,) = fit_locomotion(moths, "onset", split=None).individuals
    assert fit.damping == pytest.approx(0.341, abs=0.005)
    assert fit.thrust == pytest.approx(0.0171, abs=0.0002)


@pytest.mark.realdata
def test_import_of_termite_pairs_cut_from_three_to_one_body_length(data_dir: Path) -> None:
    path = data_dir / "termite_tandem" / "tracks_30fps_int16.npz"
    counts = {}
    for kind, body in (("Cf", 8.89), ("Rs", 5.5)):
        recipe = default_recipe(get_reader("termites"), options={"kind": kind}).to_dict()
        radius = 72.5  # of the dish [mm]
        recipe["scaling"] |= {"width": 2 * radius, "boundary": 1.3}
        recipe["cutting"] |= {
            "mode": "approach", "farther_than": 3 * body / radius, "closer_than": body / radius,
        }  # fmt: skip
        demos = follow(Recipe.from_dict(recipe), [path])
        counts[kind] = demos.num_episodes
        assert demos.roles == ("pursuer", "target") and demos.individuals == ("male", "female")
    assert counts == {"Cf": 75, "Rs": 57}


def _pooled(fit: LocomotionFit) -> float:
    return float(np.sqrt(np.mean([one.velocity_rmse**2 for one in fit.individuals])))


@pytest.mark.realdata
def test_joint_fit_rmse_is_below_onset_fit_rmse(moths: Demonstrations, data_dir: Path) -> None:
    sleap = read(
        data_dir / "fly_courtship_sleapclip" / "clip.2node.slp", frame_rate=25.0, target="female"
    )
    flies = read(
        data_dir / "fly_groups12" / "tracks_24fps_int16.npz",
        individuals=["fly_1", "fly_2", "fly_3"],
    )
    for demos in (moths, sleap, flies):
        split = "train" if demos.num_episodes > 1 else None
        joint = fit_locomotion(demos, "joint", split=split, bootstrap=0)
        onset = fit_locomotion(demos, "onset", split=split, bootstrap=0)
        assert _pooled(joint) < _pooled(onset)


@pytest.mark.realdata
@pytest.mark.slow
def test_joint_fit_rmse_is_below_onset_fit_rmse_on_termites(data_dir: Path) -> None:
    path = data_dir / "termite_tandem" / "tracks_30fps_int16.npz"
    for kind in ("Cf", "Rs"):
        demos = read(path, kind=kind, scaling={"shape": "disc", "width": 145.0, "boundary": 1.3})
        joint = fit_locomotion(demos, "joint", bootstrap=0)
        onset = fit_locomotion(demos, "onset", bootstrap=0)
        for one, other in zip(joint.individuals, onset.individuals, strict=True):
            assert one.velocity_rmse < other.velocity_rmse


@pytest.mark.realdata
def test_import_of_the_sleap_clip_agrees_with_its_plain_array(data_dir: Path) -> None:
    from animarl_envs.demos.readers import read_tracks

    folder = data_dir / "fly_courtship_sleapclip"
    (tracks,) = read_tracks(folder / "clip.2node.slp")
    with np.load(folder / "clip_2node_tracks.npz") as plain:
        np.testing.assert_array_equal(tracks.positions, plain["xy"].astype(np.float64))
        assert list(tracks.individuals) == plain["tracks"].tolist()


DOCS = Path(__file__).resolve().parents[1] / "docs" / "data"


@pytest.mark.realdata
@pytest.mark.parametrize("number", range(4))
def test_worked_examples_of_the_data_pages(
    number: int, data_dir: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    text = (DOCS / "examples.md").read_text()
    blocks = [part.split("```")[0] for part in text.split("```console\n")[1:]]
    assert len(blocks) == 4
    for line in blocks[number].splitlines():
        words = line.removeprefix("$ animarl ").replace("$DATA", str(data_dir)).split()
        said = animarl(*itertools.chain.from_iterable(map(_expanded, words)))
        assert said.strip()
    assert len(list(tmp_path.glob("*.png"))) == len(list(tmp_path.glob("*.recipe.yaml"))) == 1


def _expanded(word: str) -> list[str]:
    return sorted(glob.glob(word)) if "*" in word else [word]  # noqa: PTH207 (absolute pattern)


def test_python_of_the_data_pages_runs() -> None:
    for page in ("cleaning.md", "readers.md"):
        for part in (DOCS / page).read_text().split("```python\n")[1:]:
            exec(compile(part.split("```")[0], page, "exec"), {"__name__": page})
    from animarl_envs.demos.readers import registry

    assert "two-columns" in {reader.name for reader in registry.available_readers()}
    registry._READERS.pop("two-columns")


def test_recipes_are_plain_json(tmp_path: Path) -> None:
    demos = follow(
        default_recipe(get_reader("long-table"), frame_rate=20.0), [write_long(tmp_path)]
    )
    recipe = json.loads(json.dumps(dict(demos.provenance)))["recipe"]
    assert Recipe.from_dict(recipe) == default_recipe(get_reader("long-table"), frame_rate=20.0)
