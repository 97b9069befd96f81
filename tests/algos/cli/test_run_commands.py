"""``animarl evaluate``: many runs in, tables and a page out."""

import hashlib
import json
import resource
import shutil
import signal
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from commands import Done, refused, succeeded
from html_page import Page
from small_runs import few, made

from animarl_algos.cli.shared import track_rows, write_csv
from animarl_algos.evaluation import Rollouts
from animarl_algos.evaluation.comparison import TABLES
from animarl_algos.evaluation.prepared import path_lengths
from animarl_algos.runs.pretrained import model_folder
from animarl_algos.runs.run import Run
from animarl_envs.demos.summary import Unit
from animarl_envs.importing.readers.registry import read_tracks

METHODS = ("dqcil-pt", "dqdil-pt")


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Two methods times two seeds."""
    folder = tmp_path_factory.mktemp("runs")
    return [made(folder, algo, seed).path for algo in METHODS for seed in (0, 1)]


@pytest.fixture(scope="module")
def untouched(runs: list[Path]) -> Iterator[None]:
    """Whatever is asked of runs, their folders stay as they are."""
    before = [contents(run) for run in runs]
    yield
    assert [contents(run) for run in runs] == before


def contents(folder: Path) -> dict[str, str]:
    """Digest of every file below a folder, by its name."""
    return {
        str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


def whole(folder: Path, tables: set[str]) -> None:
    """Every table in both formats with the same numbers and its reasons, and figures."""
    assert {path.stem for path in folder.glob("*.parquet")} == tables
    for name in tables:
        plain = pd.read_csv(folder / f"{name}.csv", keep_default_na=False)
        stored = pd.read_parquet(folder / f"{name}.parquet")
        assert list(plain) == list(stored) and len(plain) == len(stored)
        undefined = stored.select_dtypes("number").isna().any(axis=1)
        assert (stored.loc[undefined, "reason"] != "").all(), name
    assert {path.suffix for path in (folder / "figures").iterdir()} == {".svg"}
    page = (folder / "report.html").read_text()
    assert page.startswith("<!DOCTYPE html>") and "None" not in page.split("provenance")[0]
    for told in ("commit", "processor", "wall time, training", "licence"):
        assert told in page, told
    assert "older version" not in page


@pytest.mark.slow
def test_methods_times_seeds_twice_the_same(
    animarl: Callable[..., Done], runs: list[Path], untouched: None, tmp_path: Path
) -> None:
    for out in ("first", "second"):
        said = succeeded(animarl("evaluate", *runs, "--out", out))
    assert "train it with 'animarl run few.npz --algo bc --out RUN'" in said
    assert "no untrained network to compare with" in said
    whole(tmp_path / "first", {*TABLES, "verdict"})
    comparison = pd.read_csv(tmp_path / "first" / "comparison.csv")
    seeds = comparison.set_index("method")["seeds"]
    assert set(seeds[["DQCIL-PT", "DQDIL-PT"]]) == {2}
    metrics = pd.read_csv(tmp_path / "first" / "metrics.csv")
    lengths = metrics[(metrics["method"] == "DQDIL-PT") & (metrics["seed"] == 1)]["path_length"]
    own = Rollouts.load(runs[3] / "rollouts" / "DQDIL-PT.npz")
    assert np.allclose(lengths, path_lengths(own)[:, :2].mean(axis=1))
    assert contents(tmp_path / "first") == contents(tmp_path / "second")


@pytest.mark.slow
def test_one_run_is_rolled_out_again_in_its_own_folder(
    animarl: Callable[..., Done], runs: list[Path], tmp_path: Path
) -> None:
    copy = tmp_path / "copy"
    shutil.copytree(runs[2], copy)
    shutil.rmtree(copy / "rollouts")
    assert "report.html" in succeeded(animarl("evaluate", copy, "--acting", "greedy"))
    assert (copy / "rollouts" / "DQDIL-PT.npz").exists() and (copy / "evaluation").is_dir()
    told = Page((copy / "report.html").read_text()).texts
    assert told[told.index("run.acting") + 1] == "greedy"
    assert contents(copy / "policies") == contents(runs[2] / "policies")  # nothing was trained
    for run, rule in ((runs[2], "boltzmann:0.5"), (copy, "greedy")):
        succeeded(animarl("evaluate", run, "--out", "page"))
        told = Page((tmp_path / "page" / "report.html").read_text()).texts
        assert told[told.index("DQDIL-PT acting.seed 0") + 1] == rule


@pytest.mark.slow
def test_what_a_run_lacks_is_said_with_the_command_that_adds_it(
    animarl: Callable[..., Done], tmp_path: Path
) -> None:
    tracked = replace(few(), provenance={**few().provenance, "synthetic": False})
    run = made(tmp_path, "dqdil-pt", demos=tracked, baselines=True)
    policies = contents(run.path / "policies")
    said = succeeded(animarl("evaluate", run.path, "--out", "eval", "--details"))
    assert "no trained BC to compare with" in said
    assert "Simulated against recorded" in said and "demonstrat" not in said
    assert f"animarl run few.npz --algo dqdil-pt --seed 0 --out {run.path}" in said
    assert contents(run.path / "policies") == policies
    methods = set(pd.read_csv(tmp_path / "eval" / "comparison.csv")["method"])
    assert methods == {"recorded", "DQDIL-PT", "untrained", "random"}


def test_runs_that_differ_are_refused_by_what_differs(
    animarl: Callable[..., Done], runs: list[Path], tmp_path: Path
) -> None:
    demos = few()
    moved = np.array(demos.split)
    here, there = np.flatnonzero(moved == "train")[0], np.flatnonzero(moved == "val")[0]
    moved[[here, there]] = moved[[there, here]]
    other = {
        "split": made(tmp_path / "s", demos=replace(demos, split=moved), rolled_out=False),
        "recordings": made(tmp_path / "r", demos=few(test=2), rolled_out=False),
        "contact radius": made(tmp_path / "w", env_kwargs={"contact_radius": 0.2}),
        "seed 0: name each training once": Run(runs[0]),
    }
    for word, run in other.items():
        refused(animarl("evaluate", runs[0], run.path, "--out", "never"), word, str(runs[0]))
    unlike = made(tmp_path / "x", seed=5)
    file = unlike.path / "settings.json"
    record = json.loads(file.read_text())
    record["learner"]["gamma"] = 0.5
    file.write_text(json.dumps(record))
    refused(animarl("evaluate", runs[0], unlike.path, "--out", "never"), "gamma", "0.5")
    moth = made(tmp_path / "m", species="silkmoth", rolled_out=False)
    done = animarl("evaluate", runs[0], moth.path, "--out", "never")
    refused(done, "species: silkmoth and agent")
    assert not (tmp_path / "never").exists()


def test_bad_input_is_one_sentence(
    animarl: Callable[..., Done], runs: list[Path], tmp_path: Path
) -> None:
    empty = tmp_path / "empty"
    empty.mkdir()
    refused(animarl("evaluate", "nowhere", "--out", "o"), "nowhere", "not a run folder")
    refused(animarl("evaluate", empty, "--out", "o"), "not a run folder")
    copy = tmp_path / "copy"
    shutil.copytree(runs[0], copy)
    shutil.rmtree(copy / "rollouts")
    refused(animarl("evaluate", copy, "--out", "o"), "no rollouts", "animarl evaluate")
    (tmp_path / "file").write_text("in the way")
    refused(animarl("evaluate", runs[0], "--out", "file"), "it is a file")
    refused(animarl("evaluate", runs[0], "--out", runs[1]), "it is a run folder")
    spoilt = tmp_path / "spoilt"
    shutil.copytree(runs[0], spoilt)
    (table,) = (spoilt / "logs").rglob("progress.csv")
    table.write_bytes(b'"a,b\n1,2,3\n\xff\xfe')
    refused(animarl("evaluate", spoilt, "--out", "o"), "progress.csv", "cannot be read")
    refused(animarl("evaluate", *runs, "--acting", "greedy", "--out", "o"), "--acting")
    refused(animarl("evaluate", *runs), "--out")
    (spoilt / "rollouts" / "DQCIL-PT.npz").write_bytes(b"PK\x03\x04 cut")
    refused(animarl("evaluate", spoilt, "--out", "o"), "DQCIL-PT.npz", "damaged")
    assert not (tmp_path / "o").exists()


def test_trained_runs_are_judged_on_new_recordings(
    animarl: Callable[..., Done], runs: list[Path], untouched: None, tmp_path: Path
) -> None:
    known = Run(runs[0]).demos
    later = replace(known.select(episodes=np.arange(6)), split=np.full(6, "train"))
    later.save(tmp_path / "later.npz")
    succeeded(animarl("evaluate", runs[0], "--demos", "later.npz", "--out", "new"))
    metrics = pd.read_csv(tmp_path / "new" / "metrics.csv")
    assert set(metrics.loc[metrics["method"] == "DQCIL-PT", "demo"]) == set(range(6))
    replace(later, dt=2 * later.dt).save(tmp_path / "slower.npz")
    judge = ("evaluate", runs[0], "--demos")
    refused(animarl(*judge, "slower.npz", "--out", "o"), "time step", "differs")
    refused(animarl(*judge, "fly", "--out", "o"), "individuals")
    refused(animarl(*judge, "later.npz"), "--out")
    assert not (tmp_path / "o").exists()


@pytest.mark.slow
def test_a_full_disk_leaves_earlier_results(
    animarl: Callable[..., Done], runs: list[Path], tmp_path: Path
) -> None:
    command = ("evaluate", runs[0], "--out", "out")
    succeeded(animarl(*command))
    before = contents(tmp_path / "out")
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    unlimited = (resource.RLIM_INFINITY,) * 2
    resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, resource.RLIM_INFINITY))
    try:
        done = animarl("evaluate", runs[1], "--out", "out")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, unlimited)
    refused(done, "cannot be written", "make room")
    assert contents(tmp_path / "out") == before
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_simulated_tracks_are_written_as_import_reads_them(
    animarl: Callable[..., Done], tmp_path: Path
) -> None:
    succeeded(animarl("simulate", "fly", "--repetitions", 2, "--out", "tracks.csv"))
    succeeded(animarl("simulate", "fly", "--repetitions", 2, "--out", "tracks.parquet"))
    table = pd.read_csv("tracks.csv", dtype={"condition": str})
    pd.testing.assert_frame_equal(table, pd.read_parquet("tracks.parquet"))
    rollouts = Run(model_folder("fly")).simulate(repetitions=2)
    assert len(table) == rollouts.positions[..., 0].size
    np.testing.assert_allclose(table[["x", "y"]], rollouts.positions.reshape(-1, 2), atol=1e-6)
    heads = [{"recording": str(number)} for number in range(len(rollouts))]
    write_csv(tmp_path / "cm.csv", track_rows(rollouts, heads, Unit("cm", 40.0)))
    for file, unit, size in (("tracks.csv", "px", 1.0), ("cm.csv", "cm", 40.0)):
        tracks = read_tracks(tmp_path / file)
        assert {(one.frame_rate, one.unit) for one in tracks} == {(10.0, unit)}
        first = str(pd.read_csv(file)["recording"][0])
        (track,) = (one for one in tracks if one.recording == first)
        order = [track.individuals.index(name) for name in rollouts.individuals]
        place = track.positions[0, order, 0] / size
        np.testing.assert_allclose(place, rollouts.path(0)[0], atol=1e-6)
    refused(animarl("simulate", "fly", "--out", "a.txt"), "choose .csv, .parquet, .nc, .nwb")
