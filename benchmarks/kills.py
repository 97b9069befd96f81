"""SIGKILL at random moments: is every resume the same to the bit, and is nothing half-written?

    python benchmarks/kills.py --kills 60
    python benchmarks/kills.py --kills 1000 --only train --only run

Each of the commands import, train, run, evaluate, watch and zoo is run once in peace. Then it is
begun in a new folder and killed after a random time, up to five times, and at last left to end.
What it leaves must be what the undisturbed one left, to the bit; times and paths are not compared.
While it is killed, every file that bears its final name must be whole. The zoo, which is rl_zoo3's,
starts anew: its model must come out the same, or it refuses in a sentence.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import json
import multiprocessing
import os
import signal
import sys
import tempfile
import time
import zipfile
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import torch
import typer
from rich.console import Console
from rich.progress import track as progress
from rich.table import Table

from animarl_algos.cli.main import main as animarl
from animarl_algos.runs import pipeline
from animarl_algos.runs.run_folder import RunFolder
from animarl_algos.runs.run_settings import RunSettings
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.packaged import load_packaged
from animarl_envs.files import read_npz

ALGO, EPISODES, STEPS, EVERY = "dqdil-pt", 24, 700, 100
MOST_KILLS = 5  # of one folder, before it may end
SMALL = {
    "offline_epochs": 2, "policy": "MlpPolicy", "policy_kwargs": {"hidden": 16}, "batch_size": 8,
    "buffer_size": 4000,
}  # fmt: skip


@dataclass
class Tally:
    """What became of the kills of one command."""

    kills: int = 0
    too_late: int = 0  # it had ended before
    equal: int = 0  # ends that equal the undisturbed one
    refused: int = 0
    failures: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class Command:
    """``work(folder)`` is run in a process of its own; ``left(folder)`` tells what it left."""

    work: Callable[[Path], None]
    left: Callable[[Path], dict[str, str]]
    prepare: Callable[[Path], None] = lambda folder: None


def main(
    kills: Annotated[int, typer.Option(help="Of all commands together.")] = 60,
    only: Annotated[list[str] | None, typer.Option(help="These commands; repeatable.")] = None,
    seed: Annotated[int, typer.Option(help="Of the moments.")] = 0,
) -> None:
    """Kill, resume, compare, count."""
    torch.set_num_threads(1)
    rng = np.random.default_rng(seed)
    with tempfile.TemporaryDirectory() as place:
        warm(Path(place) / "warm")
        commands = {k: c for k, c in all_commands(Path(place)).items() if not only or k in only}
        shares = {k: kills // len(commands) for k in commands}
        tallies = {k: killed(k, c, shares[k], Path(place), rng) for k, c in commands.items()}
    table = Table(title=f"{sum(t.kills for t in tallies.values())} kills, seed {seed}")
    for heading in ("command", "killed", "had ended", "ends as in peace", "refused", "failures"):
        table.add_column(heading)
    for name, t in tallies.items():
        cells = (t.kills, t.too_late, t.equal, t.refused, len(t.failures))
        table.add_row(name, *(str(cell) for cell in cells))
    console = Console()
    console.print(table)
    for name, t in tallies.items():
        for failure in t.failures:
            console.print(f"{name}: {failure}", markup=False)
    raise typer.Exit(int(any(t.failures for t in tallies.values())))


def killed(name: str, command: Command, kills: int, place: Path, rng: np.random.Generator) -> Tally:
    """Kill ``command`` so many times."""
    peace, tally = place / name / "peace", Tally()
    command.prepare(peace)
    began = time.perf_counter()
    code, said = ended(begun(command.work, peace), peace)
    if code:
        raise RuntimeError(f"{name} fails undisturbed with {code}: {said}")
    lasts, expected = time.perf_counter() - began, command.left(peace)
    folder, here = place / name / "killed-0", 0
    command.prepare(folder)
    for k in progress(range(kills), f"{name}, {lasts:.1f} s each"):
        process = begun(command.work, folder)
        process.join(rng.uniform(0.0, lasts))
        if process.is_alive():
            os.kill(process.pid or 0, signal.SIGKILL)
            tally.kills += 1
        else:
            tally.too_late += 1
        ended(process, folder)
        here += 1
        tally.failures += [f"{path.name} is damaged" for path in folder.rglob("*") if broken(path)]
        if here < MOST_KILLS and k < kills - 1:
            continue
        code, said = ended(begun(command.work, folder), folder)
        if code == 2 and "Traceback" not in said and said.strip():
            tally.refused += 1
        elif code or command.left(folder) != expected:
            differs = sorted(k for k, v in expected.items() if command.left(folder).get(k) != v)
            tally.failures.append(f"exit {code}, differs in {differs}: {said[-300:]}")
        else:
            tally.equal += 1
        folder, here = place / name / f"killed-{k + 1}", 0
        command.prepare(folder)
    return tally


def warm(folder: Path) -> None:
    """Import and compile here what the forked processes would each anew."""
    few = load_packaged("agent").select(episodes=np.arange(6))
    file = replace(few, split=np.resize(["train", "val", "test"], 6)).save(folder / "chases.npz")
    begin = pipeline.open_run(settings_of(file, True, steps=EVERY), folder / "run", "kills")
    pipeline.learn_all(begin, progress_bar=False)
    pipeline.evaluate_run(begin)
    pipeline.report(begin)


def settings_of(file: Path, baselines: bool, steps: int = STEPS) -> RunSettings:
    """A training of seconds."""
    return RunSettings(
        file=str(file), species="agent", algo=ALGO, steps=steps, seed=1, copies=4,
        checkpoint_every=EVERY, baselines=baselines, repetitions=1, thrusts="1",
        acting="greedy", overrides=SMALL,
    )  # fmt: skip


def begun(work: Callable[[Path], None], folder: Path) -> Any:
    """A process that does ``work``; forked, so that nothing is imported or compiled anew."""
    process = multiprocessing.get_context("fork").Process(target=_quiet, args=(work, folder))
    process.start()
    return process


def _quiet(work: Callable[[Path], None], folder: Path) -> None:
    """Run with what it says kept beside the folder."""
    folder.parent.mkdir(parents=True, exist_ok=True)
    said = folder.with_suffix(".txt").open("w", buffering=1)
    os.dup2(said.fileno(), 1)
    os.dup2(said.fileno(), 2)
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
        work(folder)


def ended(process: Any, folder: Path) -> tuple[int, str]:
    """Exit code and what it said."""
    process.join()
    said = folder.with_suffix(".txt")
    return process.exitcode, said.read_text() if said.exists() else ""


def broken(path: Path) -> bool:
    """Whether a file that bears its final name is not whole; temporary ones begin with a dot."""
    if not path.is_file() or any(part.startswith(".") for part in path.parts[-3:]):
        return False
    if path.suffix in {".npz", ".zip"}:
        with path.open("rb") as file:
            return not zipfile.is_zipfile(file)
    if path.suffix == ".json":
        try:
            json.loads(path.read_text())
        except ValueError:
            return True
    if path.suffix == ".html":
        return not path.read_text().rstrip().endswith("</html>")
    return path.suffix == ".gif" and not path.read_bytes().endswith(b";")


# -- the commands ---------------------------------------------------------------------------------


def all_commands(place: Path) -> dict[str, Command]:
    """Each on a few packaged (synthetic) chases."""
    few = load_packaged("agent").select(episodes=np.arange(EPISODES))
    spread = np.resize(["train", "train", "train", "val", "test"], EPISODES)
    file = replace(few, split=spread).save(place / "chases.npz")
    table = place / "chases.csv"
    write_table(few, table)

    def train(folder: Path) -> None:
        pipeline.learn(
            pipeline.open_run(settings_of(file, False), folder, "kills"), ALGO, progress_bar=False
        )

    def run(folder: Path) -> None:
        opened = pipeline.open_run(settings_of(file, True), folder, "kills")
        pipeline.learn_all(opened, progress_bar=False)
        pipeline.evaluate_run(opened)
        pipeline.report(opened)

    def evaluate(folder: Path) -> None:
        pipeline.evaluate_run(RunFolder(folder))

    return {
        "import": Command(
            lambda folder: call(
                "import",
                str(table),
                "--target",
                "prey",
                "--fps",
                "10",
                "--out",
                str(folder / "made.npz"),
            ),
            lambda folder: {"made.npz": array_digest(folder / "made.npz")},
            lambda folder: folder.mkdir(parents=True),
        ),
        "train": Command(train, lambda folder: digests(folder, "policies/*", "locomotion.json")),
        "run": Command(
            run, lambda folder: digests(folder, "policies/*", "evaluation/*.csv", "rollouts/*")
        ),
        "evaluate": Command(
            evaluate, lambda folder: digests(folder, "evaluation/*.csv", "rollouts/*"), train
        ),
        "watch": Command(
            lambda folder: call(
                "watch",
                "AnimaRL/Agent-v0",
                "--seed",
                "3",
                "--steps",
                "40",
                "--size",
                "200",
                "--out",
                str(folder / "clip.gif"),
            ),
            lambda folder: digests(folder, "clip.gif"),
            lambda folder: folder.mkdir(parents=True),
        ),
        "zoo": Command(zoo, lambda folder: zoo_weights(folder)),
    }


def call(*arguments: str) -> None:
    """``animarl`` with these arguments."""
    sys.argv = ["animarl", *arguments]
    animarl()


def zoo(folder: Path) -> None:
    """A tiny training through rl_zoo3."""
    from animarl_algos.zoo.__main__ import main as zoo_main

    sys.argv = [
        "zoo", "train", "--algo", "dqn", "--env", "AnimaRL/Fly-v0", "--n-timesteps", "400",
        "--seed", "1", "--log-folder", str(folder), "--eval-freq", "-1", "-params", "n_envs:2",
    ]  # fmt: skip
    zoo_main()


def zoo_weights(folder: Path) -> dict[str, str]:
    """Of the last model: rl_zoo3 numbers its folders."""
    last = sorted(folder.rglob("AnimaRL-Fly-v0.zip"), key=lambda path: path.stat().st_mtime)[-1]
    with zipfile.ZipFile(last) as archive:
        state = torch.load(io.BytesIO(archive.read("policy.pth")), weights_only=True)
    parts = [value.numpy().tobytes() for value in state.values() if hasattr(value, "numpy")]
    return {"weights": hashlib.sha256(b"".join(parts)).hexdigest()}


def digests(folder: Path, *patterns: str) -> dict[str, str]:
    """Of all files that fit: arrays by content, others by bytes."""
    found = [path for pattern in patterns for path in sorted(folder.glob(pattern))]
    return {
        str(path.relative_to(folder)): array_digest(path)
        if path.suffix == ".npz"
        else hashlib.sha256(path.read_bytes()).hexdigest()
        for path in found
    }


def array_digest(path: Path) -> str:
    digest = hashlib.sha256()
    for key, value in sorted(read_npz(path).items()):
        if key != "meta":  # it names the file that was read
            digest.update(key.encode() + np.ascontiguousarray(value).tobytes())
    return digest.hexdigest()


def write_table(demos: Demonstrations, path: Path) -> None:
    """A long table of the longest episode."""
    longest = demos.episode(int(demos.lengths.argmax()))
    lines = ["frame,id,x,y"]
    for t, frame in enumerate(longest.positions.tolist()):
        for name, (x, y) in zip(demos.individuals, frame, strict=True):
            lines.append(f"{t},{name},{x:.6f},{y:.6f}")
    path.write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    typer.run(main)
