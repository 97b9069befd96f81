"""The README's road for people who have animals, from tables to a clip, with fewer updates."""

import re
import shlex
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from commands import animarl
from numpy.typing import NDArray
from recordings import write_tracks

README = Path(__file__).resolve().parents[2] / "README.md"
FAST = ("--set", "offline_epochs=2", "--set", "offline_kwargs={updates_per_epoch: 40}")
COUNTS = {"solitary": 1, "pair": 2, "shoal": 5}


def road() -> list[list[str]]:
    """Return the commands of the README's block for people who have animals."""
    block = re.search(r"```\n(animarl import .*?)```", README.read_text(), re.DOTALL)
    assert block
    return [shlex.split(line, comments=True)[1:] for line in block[1].splitlines()]


def walks(rng: np.random.Generator, count: int, frames: int = 600) -> NDArray[np.float64]:
    """Return ``(frames, count, 2)`` walks in a dish; each animal drifts towards the next one."""
    position, course = rng.uniform(-40, 40, (count, 2)), rng.uniform(0, 2 * np.pi, count)
    speed, path = 20.0 * rng.uniform(0.8, 1.2), []
    for _ in range(frames):
        course += rng.normal(0.0, 0.25, count)
        heading = np.stack([np.cos(course), np.sin(course)], axis=1)
        pull = 0.01 * (np.roll(position, 1, axis=0) - position)
        position = position + speed / 30.0 * heading + pull
        far = np.linalg.norm(position, axis=1) > 80.0
        position[far] *= 0.99
        course[far] += np.pi / 3
        path.append(position)
    return np.round(np.stack(path), 3)


def write_recordings(folder: Path, animals: str) -> list[str]:
    """Write six tables of one animal, a pair (``chaser``, ``prey``) or a shoal."""
    rng, files = np.random.default_rng(3), []
    for number in range(6):
        count = COUNTS[animals]
        names: Sequence[str] = ("chaser", "prey") if count == 2 else [f"a{n}" for n in range(count)]
        names = [f"rat{number}"] if count == 1 else names
        files.append(write_tracks(folder / f"rec{number}.csv", walks(rng, count), names).name)
    return files


def test_the_road_is_the_one_that_is_walked() -> None:
    walked = "import run run evaluate whatif page watch"
    assert " ".join(words[0] for words in road()) == walked


@pytest.mark.slow
@pytest.mark.parametrize("animals", COUNTS)
def test_readme_road(animals: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    free = animals != "pair"
    for words in road():
        if words[0] == "import":
            at = words.index("tracks.csv")
            words[at : at + 1] = write_recordings(tmp_path, animals)
            words[words.index("--target") + 1] = "none" if free else "prey"
            words += ["--px-per-cm", "10"]
        if words[0] == "run":
            words += FAST
            if "dqdil-pt" in words:
                words += ["--steps", "2000"]
        if words[0] == "whatif" and free:  # a shoal's clone of so few updates misses some speeds
            change = "speed=+20%" if animals == "solitary" else "thrust=+20%"
            words[words.index("--change") + 1] = change
        animarl(*words)
    assert Path("runs/first/report.html").exists() and Path("runs/adapted/report.html").exists()
    assert (tmp_path / "out/eval/report.html").exists() and (tmp_path / "out/wi").is_dir()
    assert Path("what-if.html").stat().st_size > 10_000 and Path("first.gif").stat().st_size > 1_000
