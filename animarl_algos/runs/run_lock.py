"""One process at a time in a run folder."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import wraps
from pathlib import Path
from typing import Concatenate, ParamSpec, TypeVar

from filelock import FileLock, Timeout

from animarl_algos.runs.run import Run
from animarl_envs.errors import InputError

P = ParamSpec("P")
R = TypeVar("R")


@contextmanager
def run_lock(folder: Path) -> Iterator[None]:
    """Hold the folder; within a process it may be held again, and a dead process holds nothing.

    Raises
    ------
    InputError
        If another process holds it.
    """
    try:
        with FileLock(folder / ".lock", timeout=0, is_singleton=True):
            yield
    except Timeout:
        raise InputError(
            f"{folder}: another process is at work in this run: wait for it, or name another folder"
        ) from None


def locked(
    stage: Callable[Concatenate[Run, P], R],
) -> Callable[Concatenate[Run, P], R]:
    """Decorator: let a stage of a run hold its folder while it works."""

    @wraps(stage)
    def stage_alone(run: Run, *args: P.args, **kwargs: P.kwargs) -> R:
        if not run.path.is_dir():
            return stage(run, *args, **kwargs)  # which says so
        with run_lock(run.path):
            return stage(run, *args, **kwargs)

    return stage_alone  # type: ignore[return-value]
