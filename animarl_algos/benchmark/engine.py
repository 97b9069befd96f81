"""Doing pieces of work on this machine: in this process, or in several of one thread each.

Every piece writes into a folder of its own and depends on nothing that the others do meanwhile, so
the results are the same to the byte however many processes there are. A process that dies (for want
of memory, say) takes the pieces that were running with it: they are taken up once more, from their
checkpoints.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import threading
import time
from collections import Counter, deque
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path

from animarl_algos.benchmark.pieces import (
    TERMINATED,
    Done,
    Piece,
    Watch,
    attempt,
    record_error,
)
from animarl_algos.benchmark.plan import Plan

PATIENCE = 5.0  # [s]
ATTEMPTS = 2  # of a piece whose process died


def perform_all(plan: Plan, out: Path, processes: int, watch: Watch) -> None:
    """Do whatever is not finished; errors are recorded, and the rest goes on."""
    watch.at_once(processes)
    with Workers(processes) as workers:
        for stage in plan.stages:
            todo = deque(piece for piece in stage if not piece.finished(out))
            if processes > 1:
                workers.perform(todo, out, watch)
                continue
            for piece in todo:
                watch.started(piece)
                watch.ended(piece, attempt(piece, out))


class Workers:
    """Processes that last over all stages; new ones only after one of them died.

    Parameters
    ----------
    number
        So many, started when there is something to do.
    """

    def __init__(self, number: int) -> None:
        self._number = number
        self._pool: ProcessPoolExecutor | None = None

    def __enter__(self) -> Workers:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if self._pool is None:
            return
        self._pool.shutdown(wait=kind is None, cancel_futures=True)
        if kind is not None:  # Ctrl-C and signals: the workers end as this process does
            for child in multiprocessing.active_children():
                child.terminate()

    def perform(self, todo: deque[Piece], out: Path, watch: Watch) -> None:
        """Do these pieces, those whose process died once more."""
        deaths: Counter[str] = Counter()
        while todo:
            running: dict[Future[Done], Piece] = {}
            try:
                while todo or running:
                    while todo and len(running) < self._number:
                        piece = todo.popleft()
                        running[self._started().submit(attempt, piece, out)] = piece
                        watch.started(piece)
                    for future in wait(running, return_when=FIRST_COMPLETED).done:
                        done = future.result()
                        watch.ended(running.pop(future), done)
            except BrokenProcessPool:
                self._started().shutdown()
                self._pool = None
                for piece in running.values():
                    deaths[piece.name] += 1
                    if deaths[piece.name] < ATTEMPTS:
                        todo.append(piece)
                    else:
                        said = f"its process died {ATTEMPTS} times (see to the memory)"
                        record_error(piece, out, said)
                        watch.ended(piece, Done(piece.name, 0.0, said))

    def _started(self) -> ProcessPoolExecutor:
        if self._pool is None:
            spawning = multiprocessing.get_context("spawn")
            self._pool = ProcessPoolExecutor(self._number, spawning, initializer=_end_politely)
        return self._pool


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
