"""The command line: the whole road on tiny settings, and bad input in one sentence."""

from __future__ import annotations

import json
import pickle
import sys
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from animarl_algos.cli import main
from animarl_envs.demos.packaged import load_packaged

TINY = ["--steps", "300", "--copies", "4", "--set", "offline_epochs=1"]


@dataclass(frozen=True)
class Done:
    """How a command ended."""

    returncode: int
    stdout: str
    stderr: str


@pytest.fixture
def animarl(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> Callable[..., Done]:
    """The command line in this process, in a folder of its own."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "120")

    def call(*arguments: str) -> Done:
        monkeypatch.setattr(sys, "argv", ["animarl", *arguments])
        capsys.readouterr()
        with pytest.raises(SystemExit) as ended:
            main()
        said = capsys.readouterr()
        return Done(int(ended.value.code or 0), said.out, said.err)

    return call


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Demonstrations of a few short episodes in each split."""
    demos = load_packaged("agent")
    chosen = []
    for split, count in (("train", 8), ("val", 4), ("test", 4)):
        found = np.flatnonzero((demos.split == split) & (demos.condition == 1))
        chosen.extend(found[np.argsort(demos.lengths[found])][5 : 5 + count].tolist())
    path = tmp_path_factory.mktemp("demos") / "small.npz"
    return demos.select(episodes=chosen).save(path)


def test_from_a_file_to_a_report_and_again(
    animarl: Callable[..., Done], small: Path, tmp_path: Path
) -> None:
    command = [
        "run",
        str(small),
        "--species",
        "agent",
        *TINY,
        "--repetitions",
        "2",
        "--no-baselines",
    ]
    done = animarl(*command, "--out", "run")
    assert done.returncode == 0, done.stderr
    assert "run/report.html" in done.stdout
    run = tmp_path / "run"
    html = (run / "report.html").read_text()
    assert "DQDIL-PT" in html and "predator_0" in html
    record = json.loads((run / "settings.json").read_text())
    assert record["settings"]["steps"] == 300 and record["versions"]["torch"]
    methods = {path.stem for path in (run / "rollouts").glob("*.npz")}
    assert methods == {"DQDIL-PT", "decisions"}
    weights = (run / "policies" / "dqdil-pt.pt").read_bytes()

    again = animarl(*command, "--out", "run")
    assert again.returncode == 0, again.stderr
    assert (run / "policies" / "dqdil-pt.pt").read_bytes() == weights

    other = animarl(*command, "--seed", "1", "--out", "run")
    assert other.returncode == 2
    assert "holds another run" in other.stderr

    for name in ("evaluate", "report"):
        assert animarl(name, "run").returncode == 0


def test_train_goes_on_to_more_steps(
    animarl: Callable[..., Done], small: Path, tmp_path: Path
) -> None:
    tiny = TINY[:-2]
    first = animarl("train", str(small), *tiny, "--algo", "dqdil", "--out", "run")
    assert first.returncode == 0, first.stderr
    more = animarl("train", "--resume", "run", "--steps", "600")
    assert more.returncode == 0, more.stderr
    latest = max((tmp_path / "run" / "checkpoints" / "dqdil").glob("checkpoint_*"))
    assert '"num_timesteps": 6' in (latest / "state.json").read_text()
    fewer = animarl("train", "--resume", "run", "--steps", "100")
    assert fewer.returncode == 2


def bad_files(folder: Path) -> dict[str, tuple[Path, str]]:
    """Files that no reader may accept, each with a word of the sentence that refuses it."""
    files: dict[str, tuple[Path, str]] = {}
    text = folder / "text.npz"
    text.write_text("x,y\n1,2\n")
    files["text"] = (text, "npz")
    whole = folder / "whole.npz"
    np.savez(whole, positions=np.zeros((10, 3, 2)))
    cut = folder / "cut.npz"
    cut.write_bytes(whole.read_bytes()[:-200])
    files["truncated"] = (cut, "")
    pickled = folder / "pickle.npz"
    np.savez(pickled, positions=np.array([{"a": 1}], dtype=object))
    files["pickle"] = (pickled, "")
    raw = folder / "raw.npz"
    raw.write_bytes(pickle.dumps({"positions": 1}))
    files["bare pickle"] = (raw, "")
    with zipfile.ZipFile(folder / "empty.npz", "w"):
        pass
    files["empty archive"] = (folder / "empty.npz", "")
    files["missing"] = (folder / "nowhere.npz", "no such file")
    return files


@pytest.mark.parametrize(
    "kind", ["text", "truncated", "pickle", "bare pickle", "empty archive", "missing"]
)
@pytest.mark.parametrize("command", ["fit", "run"])
def test_bad_files_are_refused_in_one_sentence(
    animarl: Callable[..., Done], kind: str, command: str, tmp_path: Path
) -> None:
    path, word = bad_files(tmp_path)[kind]
    out = ["--out", "never"] if command == "run" else []
    done = animarl(command, str(path), *out)
    assert done.returncode == 2
    assert "Traceback" not in done.stderr
    assert path.name in done.stderr and word in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
    assert not (tmp_path / "never").exists()


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        (["run", "packaged", "--algo", "sarsa"], "sarsa"),
        (["run", "packaged", "--species", "dodo"], "dodo"),
        (["run", "packaged", "--steps", "0"], "steps"),
        (["run", "packaged", "--set", "learning_rat=1"], "learning_rat"),
        (["run", "packaged", "--set", "oops"], "KEY=VALUE"),
        (["evaluate", "nowhere"], "nowhere"),
        (["report", "nowhere"], "nowhere"),
        (["train", "--resume", "nowhere"], "nowhere"),
    ],
)
def test_bad_options_are_refused_in_one_sentence(
    animarl: Callable[..., Done], arguments: list[str], word: str, tmp_path: Path
) -> None:
    done = animarl(*arguments)
    assert done.returncode == 2
    assert word in done.stderr and "Traceback" not in done.stderr
    assert list(tmp_path.iterdir()) == []


def test_help_teaches_by_example(animarl: Callable[..., Done]) -> None:
    for name in ("fit", "run", "train", "evaluate", "report"):
        done = animarl(name, "--help")
        assert done.returncode == 0
        assert f"animarl {name}" in done.stdout
