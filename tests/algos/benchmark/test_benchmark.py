"""The benchmark as a whole, on tiny trainings: same bytes however it is run, errors recorded."""

import json
import os
import re
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pandas as pd
import pytest
from commands import Done as Ended
from commands import refused, succeeded
from filelock import FileLock
from refusals import refuses

from animarl_algos.benchmark import pieces
from animarl_algos.benchmark.leaderboard import write_leaderboard
from animarl_algos.benchmark.matrix import (
    Matrix,
    Plan,
    claim_folder,
    matrix_names,
    plan,
    read_matrix,
)
from animarl_algos.benchmark.pieces import LOCK, attempt, perform_all
from animarl_algos.evaluation.metrics import METRICS
from animarl_envs.errors import InputError
from animarl_envs.files import write_then_rename

BYTES = ("leaderboard.md", "leaderboard.csv")
TINY: dict[str, Any] = {
    "species": ["agent"],
    "recipes": ["soft-bc"],
    "seeds": [0, 1],
    "references": ["recordings", "still"],
    "episodes": {"train": 8, "val": 3, "test": 4},
    "repetitions": 2,
    "resamples": 20,
    "thrusts": "1",
    "acting": "boltzmann:1",
    "settings": {
        "soft-bc": {"offline_epochs": 1, "offline_kwargs": {"updates_per_epoch": 2, "warm_up": 1}}
    },
}


class Done:
    """Names of the pieces that ended, and errors by name."""

    def __init__(self, asked: Plan, out: Path, processes: int = 1) -> None:
        ended = list(perform_all(asked.stages, out, processes))
        self.names = [piece.name for piece, _ in ended]
        self.errors = {piece.name: error for piece, error in ended if error}


def tiny(**changed: Any) -> Matrix:
    asked = TINY | changed
    if "recipes" in changed and "settings" not in changed:
        asked["settings"] = {}
    return Matrix(**asked)


def run(matrix: Matrix, out: Path, *, processes: int = 1, only: Sequence[str] = ()) -> Done:
    return run_plan(plan(matrix).only(only), out, processes)


def run_plan(asked: Plan, out: Path, processes: int = 1) -> Done:
    claim_folder(out)
    done = Done(asked, out, processes)
    write_leaderboard(asked, out)
    return done


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The tiny matrix, made by one process."""
    out = tmp_path_factory.mktemp("benchmark") / "one"
    assert not run(tiny(), out).errors
    return out


def bytes_of(out: Path) -> list[bytes]:
    return [(out / name).read_bytes() for name in BYTES]


def rows_of(out: Path) -> dict[str, pd.DataFrame]:
    """Measures by name, of every method of the table."""
    table = pd.read_csv(out / "leaderboard.csv")
    return {str(name): some.set_index("measure") for name, some in table.groupby("method")}


def test_benchmark_holds_every_row_with_nulls_and_intervals(finished: Path) -> None:
    rows = rows_of(finished)
    assert set(rows) == {"soft-bc", "recordings", "still"}
    own = rows["soft-bc"]
    assert set(own["seeds"]) == {"0 1"} and set(own["rollouts"]) == {2 * 4 * 2}
    assert own["covers"].str.contains("training runs").all()
    assert own.index[0] == "realism" and {"energy", "duration", "dtw_per_step"} <= set(own.index)
    some = own.loc[["energy", "dtw_per_step"]]
    assert (some["low"] <= some["value"]).all() and (some["value"] <= some["high"]).all()
    assert some["null"].notna().all()
    assert rows["still"].loc["path_length", "value"] < 0  # it goes nowhere
    assert rows["recordings"]["rank"].isna().all() and own["rank"].notna().all()
    costs = (finished / "costs.csv").read_text()
    assert "processor_seconds" in costs
    assert not any("processor_seconds" in (finished / name).read_text() for name in BYTES)


def test_benchmark_runs_nothing_twice(finished: Path) -> None:
    before = bytes_of(finished)
    assert run(tiny(), finished).names == []
    assert bytes_of(finished) == before


def test_benchmark_runs_again_what_a_setting_touches(finished: Path) -> None:
    first, other = plan(tiny()), plan(tiny(settings={"soft-bc": {"offline_epochs": 2}}))
    changed = {a.name for a, b in zip(first.cells, other.cells) if a.key != b.key}
    assert changed == {"agent/soft-bc/0", "agent/soft-bc/1"}
    fewer = plan(tiny(episodes={"train": 7, "val": 3, "test": 4}))
    assert not {cell.key for cell in fewer.cells} & {cell.key for cell in first.cells}
    scores = plan(tiny(resamples=21))
    assert [c.key for c in scores.cells] == [c.key for c in first.cells]
    assert scores.scorings[0].key != first.scorings[0].key


SCRIPT = """
import sys
from pathlib import Path
from test_benchmark import run, tiny
if __name__ == "__main__":
    run(tiny(), Path(sys.argv[1]), processes=2)
"""


def begun(script: str, out: Path, sign: str) -> subprocess.Popen[bytes]:
    """A benchmark in a process of its own, as soon as ``out`` holds a file of this pattern."""
    file, here = out.with_suffix(".py"), Path(__file__).parent
    file.write_text(script)
    paths = os.pathsep.join(map(str, (here.parents[2], here.parents[1], here)))
    child = subprocess.Popen(
        [sys.executable, str(file), str(out)], env={**os.environ, "PYTHONPATH": paths}
    )
    began = time.monotonic()
    while not list(out.glob(sign)) and child.poll() is None:
        assert time.monotonic() - began < 240
        time.sleep(0.05)
    return child


@pytest.mark.slow
def test_benchmark_goes_on_after_an_interruption(finished: Path, tmp_path: Path) -> None:
    """Whatever is finished is kept, and the same command comes to the same bytes."""
    out = tmp_path / "killed"
    child = begun(SCRIPT, out, "cells/*/cost.json")
    child.send_signal(signal.SIGINT)
    assert child.wait(60) != 0
    kept = {file: file.stat().st_mtime_ns for file in out.glob("cells/*/cost.json")}
    assert kept
    run(tiny(), out)
    assert all(file.stat().st_mtime_ns == time for file, time in kept.items())
    assert bytes_of(out) == bytes_of(finished)


def test_the_cost_of_a_cell_counts_attempts_that_were_interrupted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = plan(tiny(recipes=[], references=["still"], seeds=[0]))
    world, cell = asked.worlds[0], asked.cells[0]
    assert attempt(world, tmp_path) == ""
    spent, roll_out = 0.0, pieces.Cell._roll_out
    monkeypatch.setattr(pieces.time, "process_time", lambda: spent)

    def taking_four_seconds(own: pieces.Cell, out: Path) -> Any:
        nonlocal spent
        spent += 4.0
        if spent < 8.0:
            raise KeyboardInterrupt
        return roll_out(own, out)

    monkeypatch.setattr(pieces.Cell, "_roll_out", taking_four_seconds)
    with pytest.raises(KeyboardInterrupt):
        attempt(cell, tmp_path)
    assert not cell.finished(tmp_path) and not cell.cost(tmp_path)
    assert attempt(cell, tmp_path) == ""
    assert cell.cost(tmp_path)["processor_seconds"] == 8.0


@pytest.mark.slow
def test_benchmark_says_that_a_process_died(tmp_path: Path) -> None:
    asked = plan(
        tiny(recipes=[], references=["still"], seeds=[0]),
        {"dying": "test_benchmark_methods:make_dying"},
    )
    refuses("a process died, .* give fewer --processes", run_plan, asked, tmp_path, 2)
    assert asked.worlds[0].finished(tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("processes", [1, 2])
def test_benchmark_goes_on_where_somebody_elses_code_ends_it(
    processes: int, tmp_path: Path
) -> None:
    methods = {
        name: f"test_benchmark_methods:make_{name}" for name in ("raising", "ending", "nothing")
    }
    out = tmp_path / "out"
    done = run_plan(
        plan(tiny(recipes=[], references=["still"], seeds=[0]), methods), out, processes
    )
    assert "predict raised ZeroDivisionError" in done.errors["agent/raising/0"]
    assert "method ending: its predict raised SystemExit (0)" in done.errors["agent/ending/0"]
    said = done.errors["agent/nothing/0"]
    assert "method nothing: its factory raised ValueError (bad ## fly2 second): fix it" in said
    assert set(rows_of(out)) == {"still"}
    text = (out / "leaderboard.md").read_text()
    assert "## Not there" in text and "\n## fly2" not in text
    assert all(f"- agent/{name}: " in text for name in methods)
    assert "its factory raised ValueError" in text


def test_benchmark_does_not_hide_a_world_that_fails(tmp_path: Path) -> None:
    asked = plan(tiny(recipes=[]))
    folder = asked.worlds[0].folder(tmp_path)
    folder.mkdir(parents=True)
    (folder / "settings.json").write_text("{")
    assert "damaged" in attempt(asked.worlds[0], tmp_path)
    assert "damaged" in asked.worlds[0].error(tmp_path)
    done = Done(asked, tmp_path)
    assert list(done.errors) == ["agent/world"]  # its cells are not tried
    write_leaderboard(asked, tmp_path)
    text = (tmp_path / "leaderboard.md").read_text()
    assert "- agent/still: agent/world: " in text and "damaged" in text


def test_benchmark_only_takes_rows_and_cells() -> None:
    asked = plan(tiny())
    assert [c.name for c in asked.only(["agent/still"]).cells] == ["agent/still/0"]
    one = asked.only(["*/soft-bc/1"])
    assert [c.name for c in one.cells] == ["agent/soft-bc/1"] and not one.scorings
    refuses("no cell is called so", asked.only, ["fly/still"])


def test_benchmark_presets_can_be_read() -> None:
    assert matrix_names() == ["paper", "short", "smoke"]
    for name in matrix_names():
        assert read_matrix(name).species == ("agent", "fly", "newt", "silkmoth")
    paper = read_matrix("paper")
    settings = paper.run_settings("agent", paper.recorded()["agent"][0], "dqn", 4)
    assert settings.steps == 1_005_000 and len(paper.seeds) == 5


@pytest.mark.slow
def test_benchmark_smoke_is_the_whole_matrix(tmp_path: Path) -> None:
    """Every recipe and reference on every packaged species finishes, and has its score."""
    asked, out = plan(read_matrix("smoke")), tmp_path / "smoke"
    done = run_plan(asked, out, 2)
    assert done.errors == {}
    assert all(piece.finished(out) for stage in asked.stages for piece in stage)
    headings = re.findall(r"^## (.+)$", (out / "leaderboard.md").read_text(), re.MULTILINE)
    assert set(asked.matrix.species) == set(headings)


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"species": ["cat"]}, "species names 'cat': choose among agent"),
        ({"species": []}, "species is empty"),
        ({"recipes": ["dqnn"]}, "algorithm 'dqnn' is unknown"),
        ({"recipes": "dqn"}, "recipes is 'dqn': give a list"), ({"seeds": [0, 0]}, "names 0 twice"),
        ({"seeds": [-1]}, "one of seeds is -1: give a whole number of at least 0"),
        ({"references": ["dead"]}, "references names 'dead'"),
        ({"episodes": {"dev": 1}}, "episodes names 'dev'"), ({"repetitions": 0}, "at least 1"),
        ({"settings": {"bcc": {}}}, "algorithm 'bcc' is unknown"),
        ({"preset": "best"}, "preset is 'best': choose paper or default"),
        ({"settings": {"bc": 3}}, "settings of bc is 3"),
        ({"settings": {"dqn": {"learning_speed": 3}}}, "'dqn', which is not among the recipes"),
        ({"settings": [1]}, "give a table"), ({"files": {"agent": "x.npz"}}, "no packaged species"),
        ({"files": {"mine": 3}}, "files of mine is 3"), ({"acting": 0.5}, "acting is 0.5"),
        ({"folds": {"mice": 6}}, "folds names 'mice': choose among agent"),
        ({"folds": {"agent": 6}}, "folds need all episodes"),
        ({"folds": {"agent": "six"}, "episodes": {}}, "folds of agent is 'six'"),
    ],
)  # fmt: skip
def test_benchmark_refuses_a_wrong_matrix(changed: dict[str, Any], said: str) -> None:
    refuses(said, tiny, **changed)


def test_benchmark_refuses_unknown_keys_and_settings(tmp_path: Path) -> None:
    file = tmp_path / "own.yml"
    file.write_text("species: [agent]\nlearners: [dqn]\n")
    refuses("'learners' is unknown", read_matrix, "smoke", file)
    refuses("preset 'huge' is unknown", read_matrix, "huge")
    refuses("setting 'learning_speed'", plan, tiny(settings={"soft-bc": {"learning_speed": 1}}))
    with pytest.raises(InputError, match="needs two experimental conditions"):
        plan(tiny(species=["fly"], recipes=["dqcil"], settings={}))
    refuses("nothing to do: name recipes or references", plan, tiny(recipes=[], references=[]))
    nothing = plan(tiny(recipes=[], references=[]), {"bad": "test_benchmark_methods:make_raising"})
    assert [cell.name for cell in nothing.cells] == ["agent/bad/0", "agent/bad/1"]


def test_benchmark_names_the_file_of_refused_settings(
    animarl: Callable[..., Ended], tmp_path: Path
) -> None:
    file = tmp_path / "own.yml"
    for text, said in (
        ("recipes: [bc]\nsettings: {bc: {learning_speed: 3}}", "bc: setting 'learning_speed'"),
        ("recipes: [bc]\nsettings: {dqn: {}}", "settings are given for 'dqn'"),
        ("recipes: []\nreferences: []", "there is nothing to do"),
        ("recipes: [bc]\nfolds: {agent: 1}", ""),
        ("recipes: [bc]\nfiles: {mine: none.npz}", ""),
        ("recipes: [bc]\nseeds: [0]\nrecipes: [dqn]", "line 4: key 'recipes' was given in line 2"),
    ):
        file.write_text(f"species: [agent]\n{text}\n")
        refused(animarl("benchmark", "--config", file, "--list"), f"{file}: {said}")


def test_benchmark_says_each_cause_once_and_that_it_failed(
    animarl: Callable[..., Ended], tmp_path: Path
) -> None:
    file, out = tmp_path / "tiny.yml", tmp_path / "out"
    few = {"recipes": [], "settings": {}, "references": ["still"], "seeds": [0]}
    file.write_text(json.dumps(TINY | few))
    bad = ("--method", "bad=test_benchmark_methods:make_raising")
    ended = animarl("benchmark", "--config", file, "--out", out, *bad)
    assert ended.returncode == 1 and ended.stderr == ""
    assert ended.stdout.count(" failed: ") == 1 and "agent/bad/0 failed: method" in ended.stdout
    assert set(rows_of(out)) == {"still"}


def test_benchmark_refuses_other_results(tmp_path: Path) -> None:
    (tmp_path / "benchmark.json").write_text('{"format": 0, "animarl": "0.0.1"}')
    refuses(r"results are of animarl 0\.0\.1", claim_folder, tmp_path)
    begun = tmp_path / "begun"  # by another command, which is about to mark it
    with write_then_rename(begun / "benchmark.json"):
        claim_folder(begun)
    other = tmp_path / "thesis"
    other.mkdir()
    (other / "chapter.txt").write_text("1")
    refuses("no benchmark", claim_folder, other)


def test_benchmark_scores_own_measures_anew_where_their_file_changed(tmp_path: Path) -> None:
    file, out, known = tmp_path / "my_index.py", tmp_path / "out", list(METRICS)
    code = "def first_x(positions, dt, roles):\n    return positions[:, 0, 0] + {}\n"
    asked = tiny(references=["recordings"], recipes=[], measures=[f"{file}:first_x"])
    values = []
    try:
        for number in (1, 2):
            file.write_text(code.format(number))
            done = run(asked, out, processes=2)
            assert not done.errors and [name.endswith("score") for name in done.names].count(True)
            values.append(float(rows_of(out)["recordings"].loc["first_x", "null"]))
            assert ("first x" in (out / "leaderboard.md").read_text()) and number
        assert len(done.names) == 1  # nothing is rolled out again
    finally:
        METRICS[:] = known


def test_benchmark_keys_do_not_depend_on_where_things_lie() -> None:
    cell = plan(tiny()).cells[0]
    assert cell.settings is not None
    moved = replace(cell, settings=cell.settings.changed(file="elsewhere"))
    assert moved.key == cell.key


@pytest.mark.slow
def test_commands_share_the_pieces(
    finished: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A piece that another command works on is left to it, and looked for again."""
    monkeypatch.setattr(pieces, "LOOK_AGAIN", 0.05)
    asked = plan(tiny())
    claim_folder(tmp_path)
    first = asked.cells[0]
    first.folder(tmp_path).mkdir(parents=True)
    other = FileLock(first.folder(tmp_path) / LOCK, thread_local=False)  # released by a thread
    other.acquire()

    def release() -> None:
        while not all(cell.finished(tmp_path) for cell in asked.cells[1:]):
            time.sleep(0.05)
        other.release()

    waiting = threading.Thread(target=release, daemon=True)
    waiting.start()
    done = Done(asked, tmp_path)
    waiting.join(60)
    cells = [name for name in done.names if name in {cell.name for cell in asked.cells}]
    assert cells.index(first.name) == len(cells) - 1
    write_leaderboard(asked, tmp_path)
    assert not done.errors and bytes_of(tmp_path) == bytes_of(finished)


@pytest.mark.slow
def test_benchmark_runs_on_a_ray_cluster(finished: Path, tmp_path: Path) -> None:
    pytest.importorskip("ray").init(num_cpus=2, include_dashboard=False)
    asked = plan(tiny())
    claim_folder(tmp_path)
    ended = list(perform_all(asked.stages, tmp_path, 2, "ray"))
    assert len(ended) == 1 + 4 + 3 and not any(error for _, error in ended)
    write_leaderboard(asked, tmp_path)
    assert bytes_of(tmp_path) == bytes_of(finished)


def test_benchmark_command_lists_and_refuses(
    animarl: Callable[..., Ended], finished: Path, tmp_path: Path
) -> None:
    file = tmp_path / "tiny.yml"
    file.write_text(json.dumps(TINY))  # JSON is YAML
    asked = ("benchmark", "--config", file, "--out", finished)
    assert succeeded(animarl(*asked, "--list")).count("finished") == 4
    before = bytes_of(finished)
    assert "leaderboard.md" in succeeded(animarl(*asked, "--processes", 2))
    assert bytes_of(finished) == before
    succeeded(animarl(*asked, "--only", "agent/soft-bc/1"))
    assert bytes_of(finished) == before  # the table is of the whole matrix
    other = tmp_path / "other"
    other.mkdir()
    (other / "benchmark.json").write_text('{"format": 0, "animarl": "0.0.1"}')
    refused(animarl(*asked, "--out", other, "--list"), "are of animarl 0.0.1")
    new = tmp_path / "new"
    succeeded(animarl(*asked, "--out", new, "--list"))
    assert not new.exists() and [f.name for f in other.iterdir()] == ["benchmark.json"]
    for *wrong, sentence in (
        ("--processes", "0", "at least 1"),
        ("--backend", "dask", "choose loky or ray"),
        ("--species", "fly", "it is not in the matrix"),
        ("--only", "agent/x", "no cell is called so"),
        ("--method", "soft-bc=test_benchmark_methods:make_raising", "a row of that name"),
        ("--method", "mine=nowhere:f", "cannot be imported"),
    ):
        ended = animarl(*asked, "--out", new, *wrong)
        refused(ended, sentence)
        assert ended.stdout == "" and not new.exists()
    refused(animarl("benchmark", "score", "none.npz", "--species", "fly"), "none.npz: ")
