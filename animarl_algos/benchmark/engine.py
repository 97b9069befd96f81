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
from typing import Protocol

from animarl_algos.benchmark.pieces import Done, Piece, attempt, record_error
from animarl_algos.benchmark.plan import Plan

TERMINATED = 143
PATIENCE = 5.0  # [s]
ATTEMPTS = 2  # of a piece whose process died


class Watch(Protocol):
    """Is told what happens."""

    def started(self, piece: Piece) -> None: ...

    def ended(self, piece: Piece, done: Done) -> None: ...


def perform_all(plan: Plan, out: Path, processes: int, watch: Watch) -> None:
    """Do whatever is not finished; errors are recorded, and the rest goes on."""
    for stage in plan.stages:
        todo: deque[Piece] = deque()
        for piece in stage:
            if piece.finished(out):
                continue
            if lacking := piece.lacks(out):
                record_error(piece, out, lacking)
                watch.ended(piece, Done(piece.name, 0.0, lacking))
            else:
                todo.append(piece)
        if processes == 1:
            for piece in todo:
                watch.started(piece)
                watch.ended(piece, attempt(piece, out))
        elif todo:
            _in_processes(todo, out, processes, watch)


def _in_processes(todo: deque[Piece], out: Path, processes: int, watch: Watch) -> None:
    deaths: Counter[str] = Counter()
    while todo:
        running: dict[Future[Done], Piece] = {}
        spawning = multiprocessing.get_context("spawn")
        with ProcessPoolExecutor(processes, spawning, initializer=_end_politely) as pool:
            try:
                while todo or running:
                    while todo and len(running) < processes:
                        piece = todo.popleft()
                        running[pool.submit(attempt, piece, out)] = piece
                        watch.started(piece)
                    for future in wait(running, return_when=FIRST_COMPLETED).done:
                        done = future.result()
                        watch.ended(running.pop(future), done)
            except BrokenProcessPool:
                for piece in running.values():
                    deaths[piece.name] += 1
                    if deaths[piece.name] < ATTEMPTS:
                        todo.append(piece)
                    else:
                        said = f"its process died {ATTEMPTS} times (see to the memory)"
                        record_error(piece, out, said)
                        watch.ended(piece, Done(piece.name, 0.0, said))
            except BaseException:  # Ctrl-C and signals: the workers end as this process does
                pool.shutdown(wait=False, cancel_futures=True)
                for child in multiprocessing.active_children():
                    child.terminate()
                raise


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
