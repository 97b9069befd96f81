"""Run a function on foreign data in a process of its own, with limits of memory and time.

A crash, an endless loop or a demand for gigabytes then becomes one sentence. The process is started
at the first call, a fresh Python without torch and its threads, and takes further calls until one
ends it. Results come back as plain values and arrays, never as a pickle.

Linux limits memory and processor time, macOS processor time alone. On Windows the function runs in
the calling process, without limits.
"""

import atexit
import contextlib
import json
import os
import pickle
import re
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from animarl_envs.errors import InputError, MissingExtraError, SeveralFaultsError, sentences_of

try:
    import resource
except ImportError:  # Windows
    resource = None  # type: ignore[assignment]

MEMORY = 2**30  # [bytes] that a call may take beyond what is loaded
SECONDS = 60  # of processor time
SPENT = 2**30  # [bytes] at most once in memory, after which a fresh process is started
PATTERN_SECONDS = 2  # of processor time; some regular expressions take longer than the universe
SETTINGS = {
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
    "ARROW_DEFAULT_MEMORY_POOL": "system",  # others reserve gigabytes of addresses
}
"""For the process, whose memory is limited."""
START = "import sys; sys.path[:] = {path}; from animarl_envs.wall import serve; serve({answer})"
RECORD = "record"  # among the arrays of an answer: what came of the call, as JSON
ARRAY = "number of the array"  # the one key of a dictionary that stands for an array
Groups = dict[str, str | None]  # by name and by number as text


def call(
    function: Callable[..., Any],
    *arguments: Any,
    what: str,
    memory: int = MEMORY,
    seconds: int = SECONDS,
    remedy: str = "it is damaged, or too large: cut it in parts",
    progress: Callable[[float], None] | None = None,
) -> Any:
    """Return ``function(*arguments)``, called in a limited process.

    Raises InputError as raised by the function, or if it crashes, takes too long or needs too much
    memory. Raises MissingExtraError as raised by the function.

    Parameters
    ----------
    function
        Of a module; it returns plain values, lists, dictionaries with text keys, and arrays.
    what
        Begins each sentence about a failure, such as the file's name; ``remedy`` ends that about
        the limit of time.
    progress
        If given, ``function`` has a keyword ``progress``, what it tells is passed on.
    """
    if resource is None:
        return function(*arguments, **({} if progress is None else {"progress": progress}))
    seconds = _allowed(resource.RLIMIT_CPU, seconds)
    request = (str(Path.cwd()), memory, seconds, function, arguments, progress is not None)
    with _lock:
        worker = _running_worker()
        try:
            status = worker.ask(request, progress)
            record = worker.read_answer() if status == 0 else {}
        except BaseException:
            worker.stop()
            raise
    if "missing" in record:
        raise MissingExtraError(record["missing"])
    if "refused" in record:
        raise SeveralFaultsError(record["refused"], record.get("more", 0))
    if "value" in record:
        return record["value"]
    if status == 0:
        problem = (
            "it needs more memory than a file of its size may ask for: its header is damaged, or "
            "cut it in parts"
        )
    elif status == -signal.SIGXCPU:
        problem = f"it takes more than {seconds} s of processor time: {remedy}"
    else:
        known = -status in signal.valid_signals()
        name = signal.Signals(-status).name if known else f"exit code {status}"
        problem = f"a library crashes over it ({name}): it is damaged, copy it again"
    raise InputError(f"{what}: {problem}")


def search_names(pattern: str, names: Sequence[str], place: str) -> list[Groups | None]:
    """Return the groups that ``pattern`` finds in each name, ``None`` where it does not fit.

    Raises InputError if it is no regular expression, or takes too long.
    """
    try:
        re.compile(pattern)
    except (re.error, OverflowError, RecursionError) as error:
        raise InputError(f"{place}: it is no regular expression ({error}): correct it") from None
    limit = {"seconds": PATTERN_SECONDS, "remedy": "simplify it"}
    return list(call(_search, pattern, list(names), what=place, **limit))  # type: ignore[arg-type]


def _search(pattern: str, names: list[str]) -> list[Groups | None]:
    matches = (re.search(pattern, name) for name in names)
    return [
        match
        and {str(i): text for i, text in enumerate(match.groups(), start=1)} | match.groupdict()
        for match in matches
    ]


class _Worker:
    def __init__(self) -> None:
        _open_standard_descriptors()
        self.owner, self.spent = os.getpid(), False
        self.answer = tempfile.TemporaryFile()  # noqa: SIM115 (as long as the process)
        number = self.answer.fileno()
        self.process = subprocess.Popen(
            [sys.executable, "-c", START.format(path=sys.path, answer=number)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            pass_fds=(number,),
            start_new_session=True,
            env=os.environ | SETTINGS,
        )

    def ask(self, request: Any, progress: Callable[[float], None] | None) -> int:
        """Send a call, pass on its progress, and return 0, or the exit code of the process."""
        assert self.process.stdin is not None and self.process.stdout is not None
        raw = pickle.dumps(request)
        self.process.stdin.write(len(raw).to_bytes(8, "little") + raw)
        self.process.stdin.flush()
        while line := self.process.stdout.readline():
            kind, _, value = line.decode(errors="replace").strip().partition(" ")
            if kind == "end":
                self.spent = bool(value)
                return 0
            with contextlib.suppress(ValueError):
                if kind == "progress" and progress is not None:
                    progress(float(value))
        return self.process.wait() or -signal.SIGABRT

    def read_answer(self) -> dict[str, Any]:
        """Return the record of the last call, with its arrays in their places."""
        self.answer.seek(0)
        with np.load(self.answer, allow_pickle=False) as stored:
            arrays = dict(stored)
        self.answer.truncate(0)
        if self.spent:
            self.stop()

        def with_array(record: dict[str, Any]) -> Any:
            stands_for_one = record.keys() == {ARRAY} and str(record[ARRAY]) in arrays
            return arrays[str(record[ARRAY])] if stands_for_one else record

        return dict(json.loads(str(arrays.pop(RECORD)), object_hook=with_array))

    def stop(self) -> None:
        """End it, if it has not ended."""
        if self.owner == os.getpid() and self.process.poll() is None:
            os.killpg(self.process.pid, signal.SIGKILL)
            self.process.communicate()
        self.answer.close()


def _open_standard_descriptors() -> None:
    """Open the null device as standard input, output or error where the caller has closed them.

    Else files and pipes of the worker would get these numbers, and be overwritten by what anybody
    prints.
    """
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # gets the lowest free number


_lock = threading.Lock()
_worker: _Worker | None = None


def _begin_anew() -> None:
    """Forget the worker in a process that was forked: it belongs to the parent."""
    global _lock, _worker
    _lock, _worker = threading.Lock(), None


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_begin_anew)


def _running_worker() -> _Worker:
    global _worker
    if _worker is None or _worker.process.poll() is not None:
        _stop()
        _worker = _Worker()
    return _worker


@atexit.register
def _stop() -> None:
    if _worker is not None:
        _worker.stop()


def serve(answer: int) -> None:
    """Answer calls until the other end of the standard input is closed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the caller ends this process
    channel = os.dup(1)
    os.dup2(2, 1)  # what libraries print
    while size := sys.stdin.buffer.read(8):
        # From the parent that started this process, never from a file: answers are JSON and arrays.
        request = pickle.loads(sys.stdin.buffer.read(int.from_bytes(size, "little")))
        arrays = _answer(request, channel)
        spent = _memory_used(1) > SPENT
        with os.fdopen(answer, "r+b", closefd=False) as file:
            file.seek(0)
            np.savez(file, allow_pickle=False, **arrays)  # type: ignore[arg-type]
        del request, arrays
        os.write(channel, b"end spent\n" if spent else b"end\n")


def _answer(request: Any, channel: int) -> dict[str, NDArray[Any]]:
    """Call a function within its limits; return a record of its result or error, and its arrays."""
    folder, memory, seconds, function, arguments, progressing = request
    arrays: dict[str, NDArray[Any]] = {}

    def progress(share: float) -> None:
        os.write(channel, f"progress {share:.4f}\n".encode())

    def put_aside(value: Any) -> Any:
        """Put an array beside the record, which has its number; make other values plain."""
        if isinstance(value, np.ndarray):
            arrays[str(len(arrays))] = value.astype(str) if value.dtype.hasobject else value
            return {ARRAY: len(arrays) - 1}
        return value.item() if isinstance(value, np.generic) else dict(value)

    try:
        os.chdir(folder)
        _limit(memory, seconds)
        value = function(*arguments, **({"progress": progress} if progressing else {}))
        record = json.dumps({"value": value}, default=put_aside)
    except MissingExtraError as error:
        record = json.dumps({"missing": str(error)})
    except InputError as error:
        more = getattr(error, "more", 0)
        record = json.dumps({"refused": sentences_of(error), "more": more})
    except MemoryError:
        record = "{}"
    except Exception as error:
        record = json.dumps({"refused": [f"{type(error).__name__}: {error}"]})
    return arrays | {RECORD: np.array(record)}


def _limit(memory: int, seconds: int) -> None:
    def limit(what: int, most: int) -> None:
        resource.setrlimit(what, (_allowed(what, most), resource.getrlimit(what)[1]))

    limit(resource.RLIMIT_CORE, 0)
    used = sum(resource.getrusage(resource.RUSAGE_SELF)[:2])
    limit(resource.RLIMIT_CPU, int(used) + 1 + seconds)
    if size := _memory_used(0):
        limit(resource.RLIMIT_AS, size + memory)


def _allowed(what: int, most: int) -> int:
    """Return ``most``, or less where the hard limit is lower (the soft one has to warn first)."""
    hard = resource.getrlimit(what)[1]
    return most if hard == resource.RLIM_INFINITY else min(most, max(hard - 1, 0))


def _memory_used(which: int) -> int:
    """Return the size (0) or the part of it in memory (1) [bytes]; 0 where it is unknown."""
    pages = Path("/proc/self/statm")
    if not pages.exists():
        return 0
    return int(pages.read_text().split()[which]) * resource.getpagesize()
