"""Doing pieces of work: in this process, or in several of one thread each, on any machines.

Every piece writes into a folder of its own and depends on nothing that the others do meanwhile, so
the results are the same to the byte wherever they are made. Commands on several machines that share
a disk share the pieces: who finds one locked does another first. A process or machine that dies
(for want of memory, say) takes the pieces that were running with it: they are taken up again, from
their checkpoints.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import threading
import time
from collections import Counter
from collections.abc import Iterable
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from typing import Self

from animarl_algos.benchmark.methods import TERMINATED
from animarl_algos.benchmark.pieces import Done, Piece, attempt

PATIENCE = 5.0  # [s] until a worker is told to end again
ATTEMPTS = 2  # of a piece whose process died
LOOK_AGAIN = 1.0  # [s] until a piece that another command is at is asked for again


class Watch:
    """Is told what happens; this one says nothing."""

    def at_once(self, number: int) -> None:
        """So many pieces are done side by side."""

    def started(self, piece: Piece) -> None:
        pass

    def ended(self, piece: Piece, done: Done | None) -> None:
        """It is done, or None: another command is at it, and it is asked for again later."""


class Workers:
    """This process, or several that last over all pieces; new ones only after one of them died."""

    def __init__(self, processes: int = 1) -> None:
        self.number = processes  # side by side
        self._pool: ProcessPoolExecutor | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if self._pool is None:
            return
        self._pool.shutdown(wait=kind is None, cancel_futures=True)
        if kind is not None:  # Ctrl-C and signals: the workers end as this process does
            for child in multiprocessing.active_children():
                child.terminate()

    def submit(self, piece: Piece, out: Path) -> Future[Done | None]:
        """Promise the result of an attempt."""
        if self.number == 1:
            kept: Future[Done | None] = Future()
            kept.set_result(attempt(piece, out))
            return kept
        try:
            return self._started().submit(attempt, piece, out)
        except BrokenProcessPool:
            self._started().shutdown()
            self._pool = None
            return self._started().submit(attempt, piece, out)

    def _started(self) -> ProcessPoolExecutor:
        if self._pool is None:
            spawning = multiprocessing.get_context("spawn")
            self._pool = ProcessPoolExecutor(self.number, spawning, initializer=_end_politely)
        return self._pool


def perform_all(pieces: Iterable[Piece], out: Path, workers: Workers, watch: Watch) -> None:
    """Do whatever is not finished; errors are recorded, and the rest goes on.

    A piece begins after what it needs has ended, well or badly: it looks what is there. One that
    another command is at comes up again after ``LOOK_AGAIN`` seconds.
    """
    later = [piece for piece in pieces if not piece.finished(out)]
    left = {piece.name for piece in later}
    deaths: Counter[str] = Counter()
    not_before: dict[str, float] = {}
    running: dict[Future[Done | None], Piece] = {}
    watch.at_once(workers.number)
    while later or running:
        now = time.monotonic()
        ready = [
            piece
            for piece in later
            if left.isdisjoint(piece.needs) and not_before.get(piece.name, now) <= now
        ]
        for piece in ready[: workers.number - len(running)]:
            later = [other for other in later if other is not piece]
            watch.started(piece)
            running[workers.submit(piece, out)] = piece
        if not running:
            time.sleep(LOOK_AGAIN)
        for future in wait(running, LOOK_AGAIN, FIRST_COMPLETED).done:
            piece = running.pop(future)
            try:
                done = future.result()
            except BrokenProcessPool:
                deaths[piece.name] += 1
                if deaths[piece.name] < ATTEMPTS:
                    later.append(piece)
                    continue
                done = Done(
                    piece.name, 0.0, f"its process died {ATTEMPTS} times (see to the memory)"
                )
            if done is None:
                not_before[piece.name] = time.monotonic() + LOOK_AGAIN
                later.append(piece)
                watch.ended(piece, None)
                continue
            if done.error != piece.error(out):  # of a process that could not write it
                piece.record_error(out, done.error)
            left.remove(piece.name)
            watch.ended(piece, done)


def _end_politely() -> None:
    """A worker that is told to end leaves no half-written file behind, and none outlives us."""
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(TERMINATED))
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    """Told to end in a piece of work, a worker waits for the next one: so it is told again."""
    parent = multiprocessing.parent_process()
    assert parent is not None
    parent.join()
    while True:
        os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(PATIENCE)
