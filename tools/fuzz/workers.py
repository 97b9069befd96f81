"""Processes that read damaged files, and the one that watches them.

A worker is forked when everything is imported. It tells what it is doing in shared memory, so that
nothing is lost when a file ends it: the watcher counts the crash and forks another, which goes on
behind the file.
"""

from __future__ import annotations

import mmap
import os
import resource
import shutil
import signal
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from animarl_envs.errors import InputError
from tools.fuzz.mutations import Damage
from tools.fuzz.targets import MARKER, TARGETS

OUTCOMES = ("refused", "equal", "different", "unexplained", "traceback", "slow", "ran", "crash")
SLOW = 2.0  # processor time that a file may take [s]
HUNG = 60.0  # after which the watcher ends a worker [s]
MEMORY = 2 * 2**30  # [bytes] beyond what the libraries take, for all that a file asks for
RUNNING = (
    "pickle.find_class", "os.system", "os.exec", "os.posix_spawn", "subprocess.Popen",
    "socket.connect", "os.remove", "shutil.rmtree",
)  # fmt: skip
"""Audit events that no reading of a file gives rise to."""


@dataclass
class Result:
    """Counts by outcome, and a line for each file that should not be."""

    counts: dict[str, int] = field(default_factory=lambda: dict.fromkeys(OUTCOMES, 0))
    findings: list[str] = field(default_factory=list)
    slowest: float = 0.0

    @property
    def total(self) -> int:
        """Every file ends in one of these; a slow one is counted by what became of it as well."""
        of_all = ("refused", "equal", "different", "unexplained", "traceback", "crash")
        return sum(self.counts[name] for name in of_all)


class _Board:
    """Shared memory: counts, the present file and when it was begun, of each worker."""

    def __init__(self, workers: int) -> None:
        columns = len(OUTCOMES) + 3
        block = mmap.mmap(-1, workers * columns * 8)
        table = np.frombuffer(block, dtype=np.float64).reshape(workers, columns)
        self.counts, self.present = table[:, :-3], table[:, -3]
        self.begun, self.slowest = table[:, -2], table[:, -1]


def damage_number(number: int, seed: int, raw: bytes, name: str) -> Damage:
    """The damage that a seed and a number stand for."""
    return TARGETS[name].make(raw, np.random.default_rng([seed, number]))


def fuzz(count: int, workers: int, seed: int, names: Sequence[str], memory: int = MEMORY) -> Result:
    """Read ``count`` damaged files, those of each name in turn."""
    place = Path("/dev/shm") if Path("/dev/shm").is_dir() else None
    with tempfile.TemporaryDirectory(dir=place) as folder:
        return _watch(count, workers, seed, names, Path(folder), memory)


def _watch(
    count: int, workers: int, seed: int, names: Sequence[str], folder: Path, memory: int
) -> Result:
    board, result = _Board(workers), Result()
    board.present[:] = np.arange(workers) - workers
    log = folder / "findings"
    log.touch()

    def start(which: int) -> int:
        board.begun[which] = time.monotonic() + HUNG  # time to read the clean files
        first = int(board.present[which]) + workers
        sys.stdout.flush()
        pid = os.fork()
        if pid == 0:
            status = 1
            try:
                work = _Worker(which, seed, names, folder / str(which), board, log, memory)
                for number in range(first, count, workers):
                    work.read(number)
                status = 0
            finally:
                os._exit(status)
        return pid

    running = {start(which): which for which in range(workers)}
    while running:
        time.sleep(0.02)
        for pid, which in list(running.items()):
            ended, status = os.waitpid(pid, os.WNOHANG)
            if not ended:
                if time.monotonic() - board.begun[which] > HUNG:
                    board.counts[which, OUTCOMES.index("slow")] += 1
                    os.kill(pid, signal.SIGKILL)
                continue
            del running[pid]
            if status:
                number = int(board.present[which])
                if number < 0:
                    raise RuntimeError("a worker could not even read the clean files")
                board.counts[which, OUTCOMES.index("crash")] += 1
                result.findings.append(f"crash: {_label(number, names)}, status {status}")
                running[start(which)] = which
    for name, total in zip(OUTCOMES, board.counts.sum(axis=0).astype(int).tolist(), strict=True):
        result.counts[name] = total
    result.slowest = float(board.slowest.max())
    result.findings += log.read_text().splitlines()
    return result


def _label(number: int, names: Sequence[str]) -> str:
    return f"{names[number % len(names)]} number {number}"


class _Worker:
    def __init__(
        self, which: int, seed: int, names: Sequence[str], folder: Path, board: _Board,
        log: Path, memory: int,
    ) -> None:  # fmt: skip
        self.which, self.seed, self.names, self.board = which, seed, names, board
        self.log, self.event, self.ready = log, "", False
        shutil.rmtree(folder, ignore_errors=True)
        self.files: dict[str, tuple[Path, dict[Path, bytes], Any]] = {}
        for name in names:
            target, own = TARGETS[name], folder / name
            own.mkdir(parents=True)
            path = target.write(own)
            whole = {p: p.read_bytes() for p in (path, *(path.with_name(b) for b in target.beside))}
            try:
                clean = target.read(path)
            except InputError:  # what is planted is refused from the start
                clean = {}
            self.files[name] = path, whole, clean
        sys.addaudithook(self._audit)
        size = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (size + memory, size + memory))
        self.ready = True

    def _audit(self, event: str, _: tuple[Any, ...]) -> None:
        if event in RUNNING and self.ready:
            self.event = event

    def read(self, number: int) -> None:
        """Damage one file, read it, put it right again, and count what became of it."""
        name = self.names[number % len(self.names)]
        path, whole, clean = self.files[name]
        paths = list(whole)
        aim = paths[(number // len(self.names)) % len(paths)] if number % 4 == 3 else path
        damage = damage_number(number, self.seed, whole[aim], name)
        aim.write_bytes(damage.data)
        self.board.begun[self.which] = time.monotonic()
        self.board.present[self.which] = number
        self.event, began = "", time.process_time()
        outcome, said = self._outcome(name, path, aim, clean, damage)
        taken = time.process_time() - began
        self.board.slowest[self.which] = max(self.board.slowest[self.which], taken)
        self._count(outcome, number, said)
        if taken > SLOW:
            self._count("slow", number, f"{taken:.1f} s")
        if self.event or (path.parent / MARKER).exists():
            self._count("ran", number, self.event)
            (path.parent / MARKER).unlink(missing_ok=True)
        aim.write_bytes(whole[aim])

    def _outcome(
        self, name: str, path: Path, aim: Path, clean: Any, damage: Damage
    ) -> tuple[str, str]:
        target = TARGETS[name]
        try:
            found = target.read(path)
        except InputError as error:
            one_line = str(error) and "\n" not in str(error)
            return ("refused", "") if one_line else ("traceback", "not a sentence")
        except BaseException as error:  # the very thing that is looked for
            return "traceback", f"{type(error).__name__}: {error}"
        if aim != path:
            return "different", ""  # a scale or a name beside the tracks
        try:
            target.judge(path, found, clean, damage)
        except AssertionError as error:
            return "unexplained", str(error).splitlines()[0]
        except Exception as error:
            return "unexplained", f"{type(error).__name__}: {error}"
        equal = repr(found) == repr(clean) if not _arrays(found) else _same(found, clean)
        return ("equal" if equal else "different"), ""

    def _count(self, outcome: str, number: int, said: str) -> None:
        self.board.counts[self.which, OUTCOMES.index(outcome)] += 1
        if outcome in ("unexplained", "traceback", "slow", "ran"):
            with self.log.open("a") as file:
                file.write(f"{outcome}: {_label(number, self.names)}: {said!r:.200}\n")


def _arrays(found: Any) -> bool:
    return isinstance(found, dict) and all(isinstance(v, np.ndarray) for v in found.values())


def _same(found: Any, clean: Any) -> bool:
    return bool(
        found.keys() == clean.keys()
        and all(np.array_equal(found[key], clean[key], equal_nan=True) for key in found)
    )
