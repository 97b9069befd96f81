"""Run a function on foreign data in a process of its own, with limits of memory and time.

A crash, an endless loop or a demand for gigabytes then becomes one sentence. A server is started at
the first call: a fresh Python, without torch and its threads. It forks a process for each call and
says how that ended. Results come back as plain values and arrays, never as a pickle.

Linux limits memory and processor time, macOS processor time alone. Windows cannot fork: there the
function runs in the calling process, without limits.
"""

from __future__ import annotations

import atexit
import contextlib
import importlib
import json
import os
import pickle
import re
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from animarl_envs.errors import InputError, MissingExtraError

MEMORY = 2**30  # [bytes] that a call may take beyond what is loaded
SECONDS = 60  # of processor time
PATTERN_SECONDS = 2  # of processor time; some regular expressions take longer than the universe
SETTINGS = {
    "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1",
    "ARROW_DEFAULT_MEMORY_POOL": "system",  # others reserve gigabytes of addresses
}  # fmt: skip
"""For the server, which is forked and whose memory is limited."""
START = "import sys; sys.path[:] = {path}; from animarl_envs.wall import serve; serve({answer})"
ARRAY = "number of the array"  # the one key of a dictionary that stands for an array
Groups = dict[str, str | None]  # by name and by number as text


def call(
    function: Callable[..., Any],
    *arguments: Any,
    what: str,
    memory: int = MEMORY,
    seconds: int = SECONDS,
    remedy: str = "it is damaged, or too large: cut it in parts",
    modules: Sequence[str] = (),
    progress: Callable[[float], None] | None = None,
) -> Any:
    """Return ``function(*arguments)``, called in a limited process.

    Parameters
    ----------
    function
        Of a module; it returns plain values, lists, dictionaries with text keys, and arrays.
    what
        Begins each sentence about a failure, such as the file's name; ``remedy`` ends that about
        the limit of time.
    modules
        Loaded by the server once, before it forks.
    progress
        If given, ``function`` has a keyword ``progress``, what it tells is passed on.

    Raises
    ------
    InputError
        As raised by the function, or if it crashes, takes too long or needs too much memory.
    MissingExtraError
        As raised by the function.
    """
    if not hasattr(os, "fork"):
        return function(*arguments, **({} if progress is None else {"progress": progress}))
    request = (str(Path.cwd()), memory, seconds, modules, function, arguments, progress is not None)
    with _lock:
        server = _running_server()
        try:
            status = server.ask(request, progress)
            record, arrays = server.answer_read() if status == 0 else ({}, [])
        except BaseException:
            server.stop()
            raise
    if "missing" in record:
        raise MissingExtraError(record["missing"])
    if "refused" in record:
        raise InputError(record["refused"])
    if "value" in record:
        return _unpacked(record["value"], arrays)
    if status == 0:
        problem = (
            "it needs more memory than a file of its size may ask for: its header is damaged, or "
            "cut it in parts"
        )
    elif status in (-signal.SIGXCPU, -signal.SIGKILL):
        problem = f"it takes more than {seconds} s of processor time: {remedy}"
    else:
        known = -status in signal.valid_signals()
        name = signal.Signals(-status).name if known else f"exit code {status}"
        problem = f"a library crashes over it ({name}): it is damaged, copy it again"
    raise InputError(f"{what}: {problem}")


def search_names(pattern: str, names: Sequence[str], place: str) -> list[Groups | None]:
    """Return the groups that ``pattern`` finds in each name, ``None`` where it does not fit.

    Raises
    ------
    InputError
        If it is no regular expression, or takes too long.
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


class _Server:
    """The process that forks one for each call."""

    def __init__(self) -> None:
        self.owner = os.getpid()
        self.answer = tempfile.TemporaryFile()  # noqa: SIM115 (as long as the server)
        number = self.answer.fileno()
        self.process = subprocess.Popen(
            [sys.executable, "-c", START.format(path=sys.path, answer=number)],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
            pass_fds=(number,), start_new_session=True,
            env=os.environ | SETTINGS,
        )  # fmt: skip

    def ask(self, request: Any, progress: Callable[[float], None] | None) -> int:
        """Send a call, pass on its progress, and return the exit code of its process."""
        assert self.process.stdin is not None and self.process.stdout is not None
        raw = pickle.dumps(request)
        self.process.stdin.write(len(raw).to_bytes(8, "little") + raw)
        self.process.stdin.flush()
        while line := self.process.stdout.readline():
            kind, _, value = line.decode(errors="replace").partition(" ")
            if kind == "end":
                return int(value)
            with contextlib.suppress(ValueError):
                if kind == "progress" and progress is not None:
                    progress(float(value))
        return -signal.SIGABRT  # the server itself is gone

    def answer_read(self) -> tuple[dict[str, Any], list[NDArray[Any]]]:
        """What the process of the last call wrote."""
        self.answer.seek(0)
        record = json.loads(str(np.load(self.answer, allow_pickle=False)))
        arrays = [np.load(self.answer, allow_pickle=False) for _ in range(record["arrays"])]
        self.answer.truncate(0)
        return record, arrays

    def stop(self) -> None:
        """End it and whatever it forked."""
        if self.owner == os.getpid():
            with contextlib.suppress(ProcessLookupError, PermissionError):
                os.killpg(self.process.pid, signal.SIGKILL)
            self.process.communicate()
            self.answer.close()


_lock = threading.Lock()
_server: _Server | None = None


def _begin_anew() -> None:
    """In a process that was forked from the caller: the server is that one's."""
    global _lock, _server
    _lock, _server = threading.Lock(), None


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_begin_anew)


def _running_server() -> _Server:
    global _server
    if _server is None or _server.process.poll() is not None:
        _server = _Server()
        atexit.register(_server.stop)
    return _server


def serve(answer: int) -> None:
    """Answer calls until the other end of the standard input is closed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the caller ends this process
    told = os.dup(1)
    os.dup2(2, 1)  # what libraries print
    while size := sys.stdin.buffer.read(8):
        request = pickle.loads(sys.stdin.buffer.read(int.from_bytes(size, "little")))
        for name in request[3]:
            with contextlib.suppress(Exception):
                importlib.import_module(name)
        pid = os.fork()
        if pid == 0:
            _answer(request, answer, told)
        _, status = os.waitpid(pid, 0)
        os.write(told, f"end {os.waitstatus_to_exitcode(status)}\n".encode())


def _answer(request: Any, answer: int, told: int) -> NoReturn:
    """In the forked process: call the function within its limits and write what it returns."""
    folder, memory, seconds, _, function, arguments, progressing = request

    def progress(share: float) -> None:
        os.write(told, f"progress {share:.4f}\n".encode())

    status = 1
    try:
        os.chdir(folder)
        _limit(memory, seconds)
        arrays: list[NDArray[Any]] = []
        record: dict[str, Any]
        try:
            value = function(*arguments, **({"progress": progress} if progressing else {}))
            record = {"value": _packed(value, arrays)}
            json.dumps(record)
        except MissingExtraError as error:
            record = {"missing": str(error)}
        except InputError as error:
            record = {"refused": str(error)}
        except MemoryError:
            record = {}
        except Exception as error:
            record = {"refused": f"{type(error).__name__}: {error}"}
        arrays = arrays if "value" in record else []
        with os.fdopen(answer, "r+b", closefd=False) as file:
            file.seek(0)
            for array in (np.array(json.dumps(record | {"arrays": len(arrays)})), *arrays):
                np.save(file, array, allow_pickle=False)
        status = 0
    finally:
        os._exit(status)


def _limit(memory: int, seconds: int) -> None:
    import resource

    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    used = int(sum(resource.getrusage(resource.RUSAGE_SELF)[:2]))
    resource.setrlimit(resource.RLIMIT_CPU, (used + seconds, used + seconds + 5))
    size = Path("/proc/self/statm")
    if size.exists():
        most = int(size.read_text().split()[0]) * resource.getpagesize() + memory
        resource.setrlimit(resource.RLIMIT_AS, (most, most))


def _packed(value: Any, arrays: list[NDArray[Any]]) -> Any:
    """Plain values for JSON; arrays are put aside, their number stands for them."""
    if isinstance(value, np.ndarray):
        arrays.append(value.astype(str) if value.dtype.hasobject else value)
        return {ARRAY: len(arrays) - 1}
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, Mapping):
        return {str(key): _packed(entry, arrays) for key, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [_packed(entry, arrays) for entry in value]
    return value


def _unpacked(value: Any, arrays: list[NDArray[Any]]) -> Any:
    if isinstance(value, dict):
        if value.keys() == {ARRAY}:
            return arrays[value[ARRAY]]
        return {key: _unpacked(entry, arrays) for key, entry in value.items()}
    if isinstance(value, list):
        return [_unpacked(entry, arrays) for entry in value]
    return value
