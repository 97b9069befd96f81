"""SIGKILL at random moments: is every resume the same to the bit, and is nothing half-written?

    python benchmarks/kills.py --kills 60
    python benchmarks/kills.py --kills 1000 --counts out/kills    # called again, it goes on

Each of the commands import, train, run, evaluate, watch and zoo is run once in peace. Then it is
begun in a new folder and killed at a random moment, begun there again, up to five times, and at
last left to end. Moments are uniform over the processor time that the undisturbed one took,
whatever else the machine does; one that ends before its moment counts as no kill.
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
import shutil
import signal
import sys
import tempfile
import time
import zipfile
from collections.abc import Callable
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import torch
import typer
from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from animarl_algos.cli.main import main as animarl
from animarl_algos.runs import pipeline
from animarl_algos.runs.run import Run
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
    chains: int = 0  # folders that were begun, killed up to five times, and let end
    equal: int = 0  # ends that equal the undisturbed one
    refused: int = 0
    failures: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class Command:
    """``work(folder)`` is run in a process of its own; ``left(folder)`` tells what it left."""

    work: Callable[[Path], None]
    left: Callable[[Path], dict[str, str]]
    prepare: Callable[[Path], None] = lambda folder: None
    share: int = 1  # of all kills: fewer of the long ones


def main(
    kills: Annotated[int, typer.Option(help="Of all commands together.")] = 60,
    only: Annotated[list[str] | None, typer.Option(help="These commands; repeatable.")] = None,
    seed: Annotated[int, typer.Option(help="Of the moments.")] = 0,
    counts: Annotated[Path | None, typer.Option(help="Keep counts here and go on.")] = None,
) -> None:
    """Kill, resume, compare, count."""
    torch.set_num_threads(1)
    with tempfile.TemporaryDirectory() as place:
        commands = all_commands(Path(place))
        for name in only or ():
            if name not in commands:
                raise typer.BadParameter(f"{name} is none of {', '.join(commands)}")
        chosen = [name for name in commands if not only or name in only]
        kept = {name: counts / f"{name}-{seed}.json" for name in chosen} if counts else {}
        tallies = {name: earlier(kept.get(name)) for name in chosen}
        parts = sum(commands[name].share for name in chosen)
        for name, t in tallies.items():
            share = -(-kills * commands[name].share // parts)
            kill(name, commands[name], t, share, Path(place), seed, kept.get(name))
    table = Table(title=f"{sum(t.kills for t in tallies.values())} kills, seed {seed}")
    for heading in ("command", "kills", "folders", "ends as in peace", "refused", "failures"):
        table.add_column(heading)
    for name, t in tallies.items():
        cells = (t.kills, t.chains, t.equal, t.refused, len(t.failures))
        table.add_row(name, *(str(cell) for cell in cells))
    console = Console()
    console.print(table)
    for name, t in tallies.items():
        for failure in t.failures:
            console.print(f"{name}: {failure}", markup=False)
    raise typer.Exit(int(any(t.failures for t in tallies.values())))


def earlier(kept: Path | None) -> Tally:
    """The counts of an earlier call."""
    return Tally(**json.loads(kept.read_text())) if kept and kept.exists() else Tally()


def kill(
    name: str, command: Command, tally: Tally, kills: int, place: Path, seed: int, kept: Path | None
) -> None:
    """Kill ``command`` until ``tally`` counts so many kills."""
    if tally.kills >= kills:
        return
    warm(command, place / name / "warm")
    peace = place / name / "peace"
    command.prepare(peace)
    lasts, process = 0.0, begun(command.work, peace)
    while process.is_alive():
        lasts = max(lasts, used(process))
        process.join(0.005)
    code, said = ended(process, peace)
    if code:
        raise RuntimeError(f"{name} fails undisturbed with {code}: {said}")
    expected = command.left(peace)
    with Progress() as progress:
        bar = progress.add_task(f"{name}, {lasts:.1f} s each", total=kills, completed=tally.kills)
        while tally.kills < kills:
            rng = np.random.default_rng([seed, tally.chains])
            folder = place / name / f"killed-{tally.chains}"
            one_chain(
                command, folder, min(MOST_KILLS, kills - tally.kills), lasts, expected, rng, tally
            )
            shutil.rmtree(folder)
            progress.update(bar, completed=tally.kills)
            if kept:
                kept.parent.mkdir(parents=True, exist_ok=True)
                kept.write_text(json.dumps(asdict(tally)))


def one_chain(
    command: Command,
    folder: Path,
    most: int,
    lasts: float,
    expected: dict[str, str],
    rng: np.random.Generator,
    tally: Tally,
) -> None:
    """Begin, kill after a random share of ``lasts`` [s], begin again, until it is let end."""
    command.prepare(folder)
    tally.chains += 1
    for turn in range(most + 1):
        process = begun(command.work, folder)
        moment = rng.uniform(0.0, lasts) if turn < most else np.inf
        while process.is_alive() and (left := moment - used(process)) > 0.0:
            process.join(left if turn < most else None)
        if process.is_alive():
            os.kill(process.pid, signal.SIGKILL)
        code, said = ended(process, folder)
        if code != -signal.SIGKILL:
            break
        tally.kills += 1
        tally.failures += [f"{path.name} is damaged" for path in folder.rglob("*") if broken(path)]
    if code == 2 and "Traceback" not in said and said.strip():
        tally.refused += 1
        return
    left = command.left(folder) if not code else {}
    if code or left != expected:
        differs = sorted(k for k in expected.keys() | left.keys() if left.get(k) != expected.get(k))
        tally.failures.append(f"exit {code}, differs in {differs}: {said[-300:]}")
    else:
        tally.equal += 1


def used(process: Any) -> float:
    """Processor time of a process so far [s]; none of one that has just ended."""
    with contextlib.suppress(OSError):
        return time.clock_gettime(
            (~process.pid << 3) | 2
        )  # CPUCLOCK_SCHED, see clock_getcpuclockid
    return 0.0


def warm(command: Command, folder: Path) -> None:
    """Import and compile here what the forked processes would each anew."""
    folder.parent.mkdir(parents=True)
    command.prepare(folder)
    with (
        folder.with_suffix(".txt").open("w") as said,
        contextlib.redirect_stdout(said),
        contextlib.redirect_stderr(said),
    ):
        try:
            command.work(folder)
        except SystemExit as end:
            if end.code:
                raise


def settings_of(file: Path, baselines: bool) -> RunSettings:
    """A training of seconds."""
    return RunSettings(
        file=str(file), species="agent", algo=ALGO, steps=STEPS, seed=1, copies=4,
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
    """Whether a file that bears its final name is not whole.

    Temporary names begin with a dot; a checkpoint's folder is ``.part`` until it is whole.
    """
    temporary = any(p.startswith(".") or p.endswith(".part") for p in path.parts[-3:])
    if temporary or not path.is_file():
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
        pipeline.evaluate_run(Run(folder))

    def trained(folder: Path) -> None:
        if not (place / "trained").exists():
            train(place / "trained")
        shutil.copytree(place / "trained", folder)

    def made(folder: Path) -> None:
        folder.mkdir(parents=True)

    def import_(folder: Path) -> None:
        call(
            "import", str(table), "--target", "prey", "--fps", "10",
            "--out", str(folder / "made.npz"),
        )  # fmt: skip

    def watch(folder: Path) -> None:
        call(
            "watch", "AnimaRL/Agent-v0", "--seed", "3", "--steps", "40", "--size", "200",
            "--out", str(folder / "clip.gif"),
        )  # fmt: skip

    results = ("evaluation/*.csv", "rollouts/*")
    return {
        "import": Command(
            import_, lambda folder: {"made.npz": array_digest(folder / "made.npz")}, made, 6
        ),
        "train": Command(
            train, lambda folder: digests(folder, "policies/*", "locomotion.json"), share=3
        ),
        "run": Command(run, lambda folder: digests(folder, "policies/*", *results)),
        "evaluate": Command(evaluate, lambda folder: digests(folder, *results), trained, 2),
        "watch": Command(watch, lambda folder: digests(folder, "clip.gif"), made, 6),
        "zoo": Command(zoo, zoo_weights, share=6),
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
