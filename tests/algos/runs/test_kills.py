"""SIGKILL at random moments, a few: ``benchmarks/kills.py`` does a thousand."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from pages import load_script

KILLS = Path(__file__).parents[3] / "benchmarks" / "kills.py"


def killed(folder: Path, kills: int, *options: str) -> dict[str, dict[str, int]]:
    """The counts of so many kills, by command."""
    asked = [sys.executable, str(KILLS), "--kills", str(kills), "--counts", str(folder), *options]
    run = subprocess.run(asked, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stdout + run.stderr
    return {path.stem: json.loads(path.read_text()) for path in sorted(folder.iterdir())}


def whole(counts: dict[str, dict[str, int]]) -> bool:
    return all(t["equal"] + t["refused"] == t["chains"] > 0 for t in counts.values())


@pytest.mark.slow
def test_import_and_training_survive_kills(tmp_path: Path) -> None:
    counts = killed(tmp_path, 3, "--only", "import", "--only", "train", "--seed", "7")
    assert counts["import-7"]["kills"] == 2
    assert counts["train-7"]["kills"] == 1
    assert whole(counts)


@pytest.mark.slow
def test_every_command_survives_kills(tmp_path: Path) -> None:
    counts = killed(tmp_path, 48, "--seed", "8")
    assert len(counts) == 6
    assert sum(t["kills"] for t in counts.values()) >= 48
    assert whole(counts)


@pytest.mark.parametrize("suffix", [".npz", ".json", ".html", ".gif"])
def test_a_half_written_file_is_noticed(tmp_path: Path, suffix: str) -> None:
    kills = load_script(KILLS)
    path = tmp_path / f"file{suffix}"
    if suffix == ".npz":
        np.savez(path, x=np.arange(9))
    text = {".json": '{"a": 1}', ".html": "<html></html>\n", ".gif": "GIF89a;"}.get(suffix)
    if text is not None:
        path.write_text(text)
    assert not kills.broken(path)
    path.write_bytes(path.read_bytes()[:-3])
    assert kills.broken(path)
    path.replace(tmp_path / f".file{suffix}")  # a temporary one may be half
    assert not kills.broken(tmp_path / f".file{suffix}")
