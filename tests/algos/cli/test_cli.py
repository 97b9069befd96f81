"""The command line: the whole road on tiny settings, and bad input in one sentence."""

import io
import json
import os
import re
import shutil
import signal
import sys
import time
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import typer
from commands import Done, refused, succeeded
from pages import python
from small_runs import few

from animarl_algos.cli.main import COMMANDS, app
from animarl_algos.cli.watch import prepare
from animarl_algos.evaluation.rollouts import Rollouts
from animarl_algos.learner import progress
from animarl_algos.learner.callbacks import ProgressBar, with_progress_bar
from animarl_algos.learner.checkpoint import steps_done
from animarl_algos.runs.run import Run
from animarl_algos.runs.run_set import joined_rollouts, number_of_folds, trained_folds
from animarl_envs.compiling import COMPILING, Compilations, CompilationWarning
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.packaged import load_packaged

TINY = ["--steps", "300", "--copies", "4", "--set", "offline_epochs=1"]


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Demonstrations of a few short episodes of both conditions in each split."""
    return few(train=4, val=2, test=2, skip=5).save(tmp_path_factory.mktemp("demos") / "small.npz")


@pytest.mark.slow
def test_from_a_file_to_a_report_and_again(
    animarl: Callable[..., Done], small: Path, tmp_path: Path
) -> None:
    command = ["run", small, "--species", "agent", "--algo", "dqdil-pt", *TINY, "--no-baselines"]
    command += ["--repetitions", "2", "--folds", "0", "--out", "run"]
    assert "run/report.html" in succeeded(animarl(*command))
    run = tmp_path / "run"
    html = (run / "report.html").read_text()
    assert "DQDIL-PT" in html and "predator_0" in html
    record = json.loads((run / "settings.json").read_text())
    assert record["settings"]["steps"] == 300 and record["versions"]["torch"]
    assert {path.stem for path in (run / "rollouts").glob("*.npz")} == {"DQDIL-PT"}
    weights = (run / "policies" / "dqdil-pt.pt").read_bytes()
    for again in (command, ["evaluate", "run"], ["report", "run"]):
        succeeded(animarl(*again))
    assert (run / "policies" / "dqdil-pt.pt").read_bytes() == weights
    refused(animarl(*command, "--seed", "1"), "holds another run")


@pytest.mark.slow
def test_the_verdict_of_few_test_recordings_is_cross_validated(
    animarl: Callable[..., Done], small: Path, tmp_path: Path
) -> None:
    """Each of sixteen recordings is tested once, by a simulator that was trained without it."""
    words = ["run", small, "--species", "agent", "--set", "offline_epochs=1", "--thrusts", "1"]
    words += ["--set", "offline_kwargs={updates_per_epoch: 3}", "--acting", "boltzmann:0.5"]
    words += ["--repetitions", "2", "--no-baselines"]
    said = succeeded(animarl(*words, "--out", "run"))
    assert "fewer than 20 recordings" in said and "16 demonstrations" in said
    run = Run(tmp_path / "run")
    folds = trained_folds(run)
    tested = [fold.demos.recording[fold.demos.split == "test"].tolist() for fold in folds]
    assert len(folds) == 3 and folds[0].path == run.path
    assert {file.name for file in (run.path / "folds").iterdir()} == {"2-of-3", "3-of-3"}
    assert sorted(name for names in tested for name in names) == sorted(run.demos.recording)
    for fold, names in zip(folds, tested):
        assert not set(names) & set(fold.learnable_demos.recording)
    rollouts = joined_rollouts(folds)["SOFT-BC"]
    assert np.bincount(rollouts.demo).tolist() == [2] * 16
    first = run.demos.positions[run.demos.offsets[:-1]]
    assert np.array_equal(rollouts.positions[rollouts.offsets[:-1]], first[rollouts.demo])
    assert "16 demonstrations, cross-validated in 3 folds" in (run.path / "report.html").read_text()

    assert "16 demonstrations" in succeeded(animarl("evaluate", "run", "--out", "both"))
    other = ["evaluate", "run", "--demos", small, "--out", "new"]
    assert ": 5 demonstrations are too few" in succeeded(
        animarl(*other)
    )  # the run's own test third alone
    refused(animarl(*words, "--folds", "4", "--out", "run"), "holds another run")


@pytest.mark.parametrize(
    ("test", "all_of_them", "asked", "folds"),
    [(19, 41, None, 3), (20, 41, None, 0), (3, 9, None, 0), (9, 30, 0, 0), (25, 30, 4, 4)],
)
def test_folds_are_dealt_where_they_make_a_verdict_possible(
    test: int, all_of_them: int, asked: int | None, folds: int
) -> None:
    demos = load_packaged("agent").select(episodes=np.arange(all_of_them))
    split = np.where(np.arange(all_of_them) < test, "test", "train")
    assert number_of_folds(replace(demos, split=split), asked) == folds


@pytest.mark.slow
def test_train_by_environment_and_preset_then_more(
    animarl: Callable[..., Done], small: Path, tmp_path: Path
) -> None:
    """As in the documentation, on few demonstrations: the paper's numbers but fewer steps."""
    words = ["train", small, "--algo", "qr-dqcil-pt", "--env", "AnimaRL/Agent-v0"]
    words += ["--preset", "paper", "--steps", "200", "--seed", "1", "--out", "out/run"]
    succeeded(animarl(*words, "--set", "offline_epochs=2", "--fit-method", "joint"))
    record = json.loads((tmp_path / "out" / "run" / "settings.json").read_text())
    assert record["settings"]["fit_method"] == "joint" and record["settings"]["seed"] == 1
    assert record["environment"] == {
        "dtw": "cumulative", "observation": "paper", "rebound": False
    }  # fmt: skip
    assert record["learner"]["offline_epochs"] == 2 and record["learner"]["learning_rate"] == 1e-6
    assert record["learner"]["policy_kwargs"] == {"n_quantiles": 20}
    assert record["baseline"]["offline_learning_rate"] == 1e-3  # BC's own
    succeeded(animarl("train", "--resume", "out/run", "--steps", "400"))
    assert steps_done(tmp_path / "out/run/checkpoints/qr-dqcil-pt/checkpoint.npz") == 400
    refused(animarl("train", "--resume", "out/run", "--steps", "100"), "has 400 steps already")


@pytest.mark.slow
@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_command_that_is_stopped_says_how_to_go_on(
    number: int,
    code: int,
    animarl: Callable[..., Done],
    small: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def interrupted(*_: object, **__: object) -> None:
        os.kill(os.getpid(), number)

    command = ("train", str(small), "--algo", "dqn", *TINY[:4], "--out", "run")
    before = signal.getsignal(signal.SIGTERM)
    with monkeypatch.context() as patched:
        patched.setattr("animarl_algos.runs.pipeline.learn", interrupted)
        done = animarl(*command)
    assert signal.getsignal(signal.SIGTERM) == before
    assert done.returncode == code and "the same command takes up" in done.stderr
    succeeded(animarl(*command))
    Path("blocked").mkdir()
    Path("blocked", "logs").write_text("a file in the way")
    blocked = animarl(*command[:-1], "blocked")
    refused(blocked, "blocked/logs", "cannot be read or written")


@pytest.mark.slow
def test_one_individual_learns_and_is_evaluated(
    animarl: Callable[..., Done], small: Path, tmp_path: Path
) -> None:
    """The others replay their recording in training and in evaluation alike."""
    words = ["run", small, "--algo", "dqn", "--steps", "200", "--focal", "prey", "--copies", "4"]
    words += ["--folds", "0", "--policy", "MlpPolicy", "--repetitions", "1", "--device", "cpu"]
    succeeded(animarl(*words, "--set", "offline_epochs=0", "--no-baselines"))
    run = Run(tmp_path / "runs" / "run")
    assert run.record["learner"]["policy"] == "MlpPolicy"
    rollouts = Rollouts.load(run.path / "rollouts" / "DQN.npz")
    demos = run.demos.select(split="test")
    moved = []
    for b in range(len(rollouts.lengths)):
        first = int(rollouts.lengths[:b].sum())
        recorded = demos.episode(int(rollouts.demo[b])).positions
        length = min(int(rollouts.lengths[b]), len(recorded))
        apart = np.abs(rollouts.positions[first : first + length] - recorded[:length]).max((0, 2))
        assert apart[:2].max() < 1e-9  # predators, as recorded
        moved.append(apart[2])
    assert max(moved) > 1e-3
    watch = ["watch", "AnimaRL/Agent-v0", "--model", run.path]
    succeeded(animarl(*watch, "--out", "prey.gif", "--steps", "3"))
    assert (tmp_path / "prey.gif").exists()
    world, actor = prepare("AnimaRL/Agent-v0", model=run.path)
    assert world.scenario.drivers == ("replay", "replay", "action")
    world.reset()
    assert actor(world, True)[0, :2].tolist() == [0, 0]
    refused(animarl(*watch, "--focal", "predator_0"), "prey alone learned")


@pytest.mark.slow
def test_ones_own_animals_need_no_species(
    animarl: Callable[..., Done], small: Path, tmp_path: Path
) -> None:
    """A file that names no species of the package trains as custom, by its own numbers."""
    demos = Demonstrations.load(small)
    names = ("cat_a", "cat_b", "mouse")
    replace(demos, species="custom", individuals=names).save(tmp_path / "cats.npz")
    succeeded(animarl("train", "cats.npz", *TINY, "--algo", "dqdil-pt", "--out", "run"))
    run = Run(tmp_path / "run")
    assert run.settings.species == "custom"
    fitted = run.species
    assert fitted.individuals == names and fitted.dt == demos.dt


@pytest.mark.slow
def test_a_damaged_checkpoint_or_folder_is_refused(
    animarl: Callable[..., Done], small: Path, tmp_path: Path
) -> None:
    succeeded(animarl("train", small, *TINY[:-2], "--algo", "dqn", "--out", "run"))
    (tmp_path / "run" / "policies" / "dqn.pt").write_text("text")
    watched = animarl("watch", "AnimaRL/Agent-v0", "--model", "run", "--out", "a.gif")
    refused(watched, "not a policy of this run")
    latest = tmp_path / "run" / "checkpoints" / "dqn" / "checkpoint.npz"
    latest.write_bytes(b"PK")
    refused(animarl("train", "--resume", "run", "--steps", "600"), "damaged")
    latest.unlink()
    refused(animarl("train", "--resume", "run", "--steps", "700"), "its checkpoints are gone")
    settings = tmp_path / "run" / "settings.json"
    for content, word in (("{", "damaged"), ("{}", "not of this version"), ("[]", "damaged")):
        settings.write_text(content)
        refused(animarl("train", "--resume", "run", "--steps", "600"), word)


@pytest.mark.parametrize("command", [["fit"], ["run", "--out", "never"]])
def test_bad_files_are_refused_in_one_sentence(
    animarl: Callable[..., Done], command: list[str], tmp_path: Path
) -> None:
    """What else no reader accepts is tested with the readers."""
    refused(animarl(*command, "bad.npz"), "bad.npz", "no such file")
    (tmp_path / "bad.npz").write_text("x,y\n1,2\n")
    refused(animarl(*command, "bad.npz"), "bad.npz")
    assert not (tmp_path / "never").exists()


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        (["run", "packaged", "--algo", "sarsa"], "sarsa"),
        (["run", "packaged", "--folds", "2"], "2 folds of 500"),
        (["run", "packaged", "--set", "learning_rat=1"], "learning_rat"),
        (["run", "packaged", "--set", "oops"], "KEY=VALUE"),
        (["evaluate", "nowhere"], "nowhere"),
        (["report", "nowhere"], "nowhere: it is not a run folder"),
        (["report", __file__], "it is not a run folder"),
        (["train", "--resume", "nowhere"], "nowhere"),
        (["train", "--resume", "nowhere", "--seed", "1"], "--seed does not go with --resume"),
        (["train", "--env", "AnimaRL/Fly-v0", "--species", "newt"], "contradict each other"),
        (["train", "--species", "custom"], "custom"),
        (["train", "--policy", "CnnPolicy"], "choose GruPolicy or MlpPolicy"),
        (["train", "--config", "nowhere.yml"], "nowhere.yml: there is no such configuration"),
        (["run", "--set", "env_kwargs={wind: 1}"], "'wind' is unknown"),
        (["train", "--set", "replay_buffer_kwargs={colour: red}"], "'colour'"),
        (["fit", "agent", "--seed", "-1"], "seed is -1: give a whole number of at least 0"),
        (["watch", "AnimaRL/Agent-v0", "--seed", "-1", "--out", "w.gif"], "seed is -1"),
        (["watch", "AnimaRL/Agent-v0", "--seed", "9" * 20, "--out", "w.gif"], "most 4294967295"),
        (["data", "split", "agent", "--seed", "-1", "--out", "y.npz"], "is -1: give zero or more"),
        (["fit", "agent", "--split", "foo"], "'foo': choose one of train, val, test, all"),
        (["watch", "AnimaRL/Fly-v0", "--split", "foo", "--out", "w.gif"], "train, val, test, all"),
        (["data", "check", "agent", "--out", "episodes.txt"], "ends in .csv"),
    ],
)
def test_bad_options_are_refused_in_one_sentence(
    animarl: Callable[..., Done], arguments: list[str], word: str, tmp_path: Path
) -> None:
    """One of each kind; the others are tested where a run's settings are made."""
    refused(animarl(*arguments), word)
    assert list(tmp_path.iterdir()) == []


def test_no_input_is_written_over(
    animarl: Callable[..., Done], small: Path, tmp_path: Path
) -> None:
    table = tmp_path / "table.csv"
    succeeded(animarl("data", "convert", small, "--out", table))
    before, copy = table.read_bytes(), Path(shutil.copy(small, tmp_path))
    for command in (["data", "check"], ["data", "convert"], ["fit"]):
        done = animarl(*command, table, "--out", "../" + tmp_path.name + "/table.csv")
        refused(done, "it is the file that is read")
    refused(animarl("data", "merge", copy, small, "--out", copy), "it is the file that is read")
    assert table.read_bytes() == before and copy.read_bytes() == small.read_bytes()
    said = succeeded(animarl("data", "check", small, "--out", "episodes.csv"))
    assert "Wrote episodes.csv" in said


@pytest.mark.parametrize(
    "command",
    [["fit"], ["run"], ["data", "show"], ["watch", "AnimaRL/Custom-v0", "--out=w.gif", "--demos"]],
)
def test_what_only_an_import_can_be_told_is_said_with_it(
    command: list[str], animarl: Callable[..., Done], tmp_path: Path
) -> None:
    table = tmp_path / "good tracks.csv"
    table.write_text("frame,id,x,y\n" + "".join(f"{f},a,{f}.0,1.0\n" for f in range(20)))
    suggested = f"'animarl import '{table.name}' --fps ... --out demos.npz'"
    refused(animarl(*command, table.name), f"animarl: {table.name}: ", suggested)
    assert list(tmp_path.iterdir()) == [table]
    (tmp_path / "tracks.xyz").write_text("1 2 3\n")
    shown, fitted = (animarl(*words, "tracks.xyz").stderr for words in (["data", "show"], ["fit"]))
    assert "name its --source" in fitted and "animarl import" not in fitted
    assert "'animarl import tracks.xyz --source ... --out demos.npz'" in shown


def test_warnings_are_sentences_on_the_command_line_only(
    animarl: Callable[..., Done], small: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def warned(*_: object) -> list[object]:
        warnings.warn("the clone of prey\nknows nothing", stacklevel=1)
        return []

    monkeypatch.setattr("animarl_algos.cli.describing.demonstrations_at_a_glance", warned)
    assert animarl("data", "show", str(small)).stderr == (
        "Warning: the clone of prey knows nothing\n"
    )
    with pytest.warns(UserWarning, match="the clone of prey"):
        warned()


@pytest.mark.parametrize("name", ["sources", "show", "check", "split", "convert", "plot"])
def test_examples_of_the_data_commands_run(
    name: str, animarl: Callable[..., Done], small: Path, tmp_path: Path
) -> None:
    shutil.copy(small, tmp_path / "demos.npz")
    own = "def axis_index(positions, dt, roles):\n    return positions[:, :, 0]\n"
    (tmp_path / "my_index.py").write_text(own)
    said = animarl("data", name, "--help").stdout
    examples = re.findall(rf"^ *animarl (data {name}\b.*?) *$", said, re.MULTILINE)
    assert examples
    for words in map(str.split, examples):
        succeeded(animarl(*words))
        assert "--out" not in words or (tmp_path / words[words.index("--out") + 1]).exists()


LEARNING = {"torch", "stable_baselines3", "sb3_contrib", "matplotlib"}
HEAVY = {"numba", "scipy", "pandas"}
ANIMARL = "from animarl_algos.cli.main import main; main()"


HELPS = """
import sys
from animarl_algos.cli.main import main
for name in sys.argv[1].split(","):
    sys.argv = ["animarl", *name.split(), "--help"]
    try:
        main()
    except SystemExit:
        print(name, *sorted(m for m in sys.modules if "." not in m), file=sys.stderr)
"""
SLOW_HELPS = ("benchmark", "paper")


def test_start_of_a_help_imports_no_learners() -> None:
    """That of the program before those of its commands, all but one in one process."""
    names = ["", *(name for name in COMMANDS if name not in SLOW_HELPS)]
    done = python(HELPS, ",".join(names))
    loaded = [set(line.split()) for line in done.stderr.splitlines()]
    assert len(loaded) == len(names)
    assert not loaded[0] & (LEARNING | HEAVY) and not loaded[-1] & LEARNING
    for name, place in COMMANDS.items():
        assert name in SLOW_HELPS or f"animarl {name}" in done.stdout
        assert name in done.stdout and place.summary()[:20] in done.stdout


@pytest.mark.parametrize("name", COMMANDS)
def test_start_of_a_command_is_as_listed(name: str) -> None:
    root: Any = typer.main.get_command(app)
    context = root.make_context("animarl", [name, "--help"])
    listed = root.get_command(context, name)
    found, command, rest = root.resolve_command(context, [name, "--help"])
    assert (found, rest) == (name, ["--help"])
    assert command.help.partition("\n")[0] == listed.help


@pytest.mark.parametrize(
    ("words", "said"), [("trian", "train"), ("report nowhere", "nowhere: it is not a run folder")]
)
def test_start_that_is_refused(words: str, said: str, tmp_path: Path) -> None:
    done = python(ANIMARL, *words.split(), check=False, cwd=tmp_path)
    assert done.returncode == 2 and said in done.stderr


class Terminal(io.StringIO):
    """A stream that says whether it is a terminal."""

    def __init__(self, there: bool) -> None:
        super().__init__()
        self.there = there

    def isatty(self) -> bool:
        return self.there


def test_progress_is_a_bar_on_a_terminal_and_lines_in_a_log(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    assert any(isinstance(callback, ProgressBar) for callback in with_progress_bar(None))
    monkeypatch.setattr(progress, "LOG_EVERY", 0.01)
    said = {}
    for there in (True, False):
        monkeypatch.setattr(sys, "stderr", Terminal(there))
        with progress.progress_display("offline", "epoch", 4) as bar:
            for _ in range(4):
                time.sleep(0.02)
                bar.update()
        said[there] = sys.stderr.getvalue()
    assert said[True].count("\r") > 1 and "offline: 100%" in said[True]
    assert "\r" not in said[False]
    lines = [line.rstrip() for line in said[False].splitlines() if line.strip()]
    assert lines[0].startswith("offline: 1 of 4 epochs after 00:00, about 00:0")
    assert lines[-1].startswith("offline: 4 of 4 epochs")


@pytest.mark.parametrize(("there", "warnings_are"), [(1, "always"), (0, "always"), (0, "error")])
def test_a_first_compilation_says_so_once(
    there: bool, warnings_are: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """On a terminal, as a warning elsewhere, and as text where warnings are errors."""
    stream = Terminal(there)
    monkeypatch.setattr(sys, "stderr", stream)
    listener = Compilations()
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter(warnings_are)
        for module in ("scipy.special", "animarl_envs.worlds.base", "animarl_envs.dtw"):
            function = SimpleNamespace(py_func=SimpleNamespace(__module__=module))
            begun = SimpleNamespace(data={"dispatcher": function})
            listener.on_start(begun)
            listener.on_end(begun)
    said = [str(one.message) for one in warned if one.category is CompilationWarning]
    as_warning = not there and warnings_are == "always"
    assert stream.getvalue().splitlines() == [COMPILING] * (not as_warning)
    assert said == [COMPILING] * as_warning
