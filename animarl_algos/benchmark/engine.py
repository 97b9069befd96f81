"""Doing pieces of work: in this process, in several of one thread each, or on a Ray cluster.

Every piece writes into a folder of its own and depends on nothing that the others do meanwhile, so
the results are the same to the byte wherever they are made. A process or node that dies (for want
of memory, say) takes the pieces that were running with it: they are taken up again, from their
checkpoints.
"""

from __future__ import annotations

import multiprocessing
import os
import platform
import signal
import socket
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import Iterable
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from typing import Any, Self

from animarl_algos.benchmark.matrix import MARK
from animarl_algos.benchmark.methods import TERMINATED
from animarl_algos.benchmark.pieces import Done, Piece, attempt
from animarl_algos.runs.run_files import versions
from animarl_envs.errors import InputError, MissingExtraError

PATIENCE = 5.0  # [s] until a worker is told to end again, or somebody answers at an address
ASKING = 30.0  # [s] until Ray answers, most of which is to import it
AUTO = "auto"  # $RAY_ADDRESS, or else this machine's cluster, which Ray starts if there is none
ASK = """
import sys
import ray
try:
    ray.init(sys.argv[1], log_to_driver=False, logging_level="error")
except Exception as error:
    print(error)
    sys.exit(1)
"""


class Watch:
    """Is told what happens; this one says nothing."""

    def at_once(self, number: int) -> None:
        """So many pieces are done side by side."""

    def started(self, piece: Piece) -> None:
        pass

    def ended(self, piece: Piece, done: Done) -> None:
        pass


class Workers:
    """This process, or several that last over all pieces; new ones only after one of them died."""

    lost: type[Exception] = BrokenProcessPool  # what a promise raises whose process died
    attempts = 2  # of a piece whose process died
    gave_up = "its process died 2 times (see to the memory)"

    def __init__(self, processes: int = 1) -> None:
        self.number = self.waiting = processes  # side by side; of those that are handed over
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

    def submit(self, piece: Piece, out: Path) -> Future[Done]:
        """Promise the result of an attempt."""
        if self.number == 1:
            kept: Future[Done] = Future()
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

    A piece begins after what it needs has ended, well or badly: it looks what is there.
    """
    later = [piece for piece in pieces if not piece.finished(out)]
    left = {piece.name for piece in later}
    deaths: Counter[str] = Counter()
    running: dict[Future[Done], Piece] = {}
    watch.at_once(workers.number)
    while later or running:
        ready = [piece for piece in later if left.isdisjoint(piece.needs)]
        for piece in ready[: workers.waiting - len(running)]:
            later = [other for other in later if other is not piece]
            watch.started(piece)
            running[workers.submit(piece, out)] = piece
        for future in wait(running, return_when=FIRST_COMPLETED).done:
            piece = running.pop(future)
            try:
                done = future.result()
            except workers.lost as error:
                deaths[piece.name] += 1
                if deaths[piece.name] < workers.attempts:
                    later.append(piece)
                    continue
                reason = f"{type(error).__name__}: {_last_line(str(error))}"
                done = Done(piece.name, 0.0, workers.gave_up.format(reason))
            if done.error != piece.error(out):  # of a process or node that could not write it
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


# -- a Ray cluster --------------------------------------------------------------------------------


class RayWorkers(Workers):
    """A Ray cluster: every piece is one task of one core; Ray places and repeats them.

    Workers find the modules that are found here by ``PYTHONPATH``. ``address`` is that of a running
    cluster, as ``ray.init`` takes it; ``"auto"``: that of ``RAY_ADDRESS``, or else this machine's,
    which Ray starts for the time of the work if there is none. Where nobody answers, InputError.
    """

    attempts = 1  # Ray has repeated it
    retries = 3
    gave_up = "Ray gave it up ({})"
    waiting = sys.maxsize

    def __init__(self, address: str = AUTO) -> None:
        try:
            import ray
        except ImportError as error:
            raise MissingExtraError("--engine ray", "ray") from error
        paths = os.environ.get("PYTHONPATH", "")
        found = os.pathsep.join(str(Path(p).resolve()) for p in paths.split(os.pathsep) if p)
        environment = {"env_vars": {"PYTHONPATH": found}} if found else {}
        named = os.environ.get("RAY_ADDRESS") if address == AUTO else address
        try:
            if named and named not in (AUTO, "local"):
                _refuse_silence(named)
            quiet: Any = {"log_to_driver": False, "logging_level": "error"}
            ray.init(named, runtime_env=environment, **quiet)
        except (OSError, RuntimeError, ValueError) as error:
            raise InputError(
                f"no Ray cluster can be reached at {named or AUTO} ({_last_line(str(error))}): "
                "start one with 'ray start --head', or give another --address"
            ) from error
        self.use(ray)

    def use(self, ray: Any) -> None:
        """Hand work to a module ``ray`` that is connected to a cluster."""
        self._ray, self.lost = ray, ray.exceptions.RayError
        self.number = max(1, int(ray.cluster_resources().get("CPU", 1)))
        self._task = ray.remote(num_cpus=1, max_retries=self.retries)(_attempt_there)

    def __exit__(self, *_: object) -> None:
        self._ray.shutdown()

    def submit(self, piece: Piece, out: Path) -> Future[Done]:
        promise: Future[Done] = self._task.remote(piece, out.resolve(), versions()).future()
        return promise


def _attempt_there(piece: Piece, out: Path, wanted: dict[str, str]) -> Done:
    """On a node."""
    unfit = _unfit(out, wanted)
    return Done(piece.name, 0.0, unfit) if unfit else attempt(piece, out)


def _unfit(out: Path, wanted: dict[str, str]) -> str:
    """Why the node that this runs on cannot take part; empty if it can."""
    node, own = platform.node(), versions()
    if not (out / MARK).is_file():
        return f"node {node} does not see {out}: name an --out on a disk that all nodes share"
    for name in (name for name in wanted if own.get(name) != wanted[name]):
        return (
            f"node {node} has {name} {own.get(name)} and this machine {wanted[name]}: install the "
            "same versions on all nodes"
        )
    return ""


def _refuse_silence(address: str) -> None:
    """Ray waits for minutes for an answer, or ends the process: so a child asks, and not for long.

    OSError if nobody is there, or Ray does not answer for ``ASKING`` seconds, or refuses.
    """
    host, colon, port = address.removeprefix("ray://").rpartition(":")
    if colon and port.isdecimal():
        socket.create_connection((host, int(port)), timeout=PATIENCE).close()
    try:
        told = subprocess.run(
            [sys.executable, "-c", ASK, address],
            stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, timeout=ASKING,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        raise OSError(f"what answers there is no Ray, or takes over {ASKING:g} s") from None
    if told.returncode:
        raise OSError(_last_line(told.stdout))


def _last_line(text: str) -> str:
    lines = [line for line in text.splitlines() if line.strip()]
    return lines[-1].strip() if lines else "it does not say why"
