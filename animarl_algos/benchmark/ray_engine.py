"""Doing pieces of work on a Ray cluster: its tasks, its retries, its placement.

Every piece is one Ray task of one core that waits for the tasks it needs; Ray chooses the node, and
repeats what a lost node or process was at, which goes on from its checkpoints. Results lie in a
folder that all nodes share, so that they are the same to the byte as those of one machine.
"""

from __future__ import annotations

import os
import platform
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from animarl_algos.benchmark.pieces import Done, Piece, Watch, attempt, record_error
from animarl_algos.benchmark.plan import MARK, Plan
from animarl_algos.runs.run_folder import versions
from animarl_envs.errors import InputError, MissingExtraError

AUTO = "auto"  # $RAY_ADDRESS, or else this machine's cluster, which Ray starts if there is none
PATIENCE = 5.0  # [s]
RETRIES = 3  # of a piece whose node or process was lost


def perform_on_ray(plan: Plan, out: Path, watch: Watch, address: str = AUTO) -> None:
    """Do whatever is not finished; errors are recorded, and the rest goes on.

    Parameters
    ----------
    out
        A folder that every node of the cluster sees under this path.
    address
        Of a running cluster, as ``ray.init`` takes it; ``"auto"``: that of ``RAY_ADDRESS``, or
        else this machine's, which Ray starts for the time of the work if there is none.

    Raises
    ------
    InputError
        If nobody answers at the address, or a node sees no such folder or has other versions.
    MissingExtraError
        If Ray is not installed.
    """
    ray, out = _ray(), out.resolve()
    with _connected(ray, address):
        _refuse_other_nodes(ray, out)
        watch.at_once(max(1, int(ray.cluster_resources().get("CPU", 1))))
        task = ray.remote(num_cpus=1, max_retries=RETRIES)(_attempt_there)
        promised: dict[str, Any] = {}
        waiting: dict[Any, Piece] = {}
        for stage in plan.stages:
            for piece in stage:
                if not piece.finished(out):
                    first = [promised[name] for name in piece.needs if name in promised]
                    promised[piece.name] = task.remote(piece, out, *first)
                    waiting[promised[piece.name]] = piece
        while waiting:
            for ended in ray.wait(list(waiting), num_returns=1)[0]:
                piece = waiting.pop(ended)
                try:
                    done = ray.get(ended)
                except ray.exceptions.RayError as error:  # lost more often than it is repeated
                    said = f"Ray gave it up ({type(error).__name__}: {_last_line(error)})"
                    record_error(piece, out, said)
                    done = Done(piece.name, 0.0, said)
                watch.ended(piece, done)


def _attempt_there(piece: Piece, out: Path, *first: Done) -> Done:
    """On a node, after what comes ``first``."""
    if unfit := _unfit(out, versions()):
        return Done(piece.name, 0.0, unfit)
    return attempt(piece, out)


def _unfit(out: Path, wanted: dict[str, str]) -> str:
    """Why the node that this runs on cannot take part; empty if it can."""
    node, own = platform.node(), versions()
    if not (out / MARK).is_file():
        return f"node {node} does not see {out}: name an --out on a disk that all nodes share"
    if other := [name for name in wanted if own.get(name) != wanted[name]]:
        name = other[0]
        return (
            f"node {node} has {name} {own.get(name)} and this machine {wanted[name]}: install the "
            "same versions on all nodes"
        )
    return ""


def _refuse_other_nodes(ray: Any, out: Path) -> None:
    from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy

    asked = ray.remote(num_cpus=0)(_unfit)
    answers = [
        asked.options(
            scheduling_strategy=NodeAffinitySchedulingStrategy(node["NodeID"], soft=False)
        ).remote(out, versions())
        for node in ray.nodes()
        if node["Alive"] and node["Resources"].get("CPU")
    ]
    if not answers:
        raise InputError("the Ray cluster has no node with a processor: add one with 'ray start'")
    try:
        unfit = [said for said in ray.get(answers) if said]
    except ray.exceptions.RayError as error:
        raise InputError(
            "a node of the Ray cluster cannot run animarl "
            f"({_last_line(error)}): install it on all nodes"
        ) from error
    if unfit:
        raise InputError(unfit[0])


@contextmanager
def _connected(ray: Any, address: str) -> Iterator[None]:
    """While workers find the modules that are found here by ``PYTHONPATH``."""
    paths = os.environ.get("PYTHONPATH", "")
    found = os.pathsep.join(str(Path(p).resolve()) for p in paths.split(os.pathsep) if p)
    environment = {"env_vars": {"PYTHONPATH": found}} if found else {}
    named = os.environ.get("RAY_ADDRESS") if address == AUTO else address
    try:
        _refuse_silence(named or "")
        ray.init(named, runtime_env=environment, log_to_driver=False, logging_level="error")
    except (OSError, RuntimeError, ValueError) as error:
        raise InputError(
            f"no Ray cluster can be reached at {named or AUTO} ({_last_line(error)}): start one "
            "with 'ray start --head', or give another --address"
        ) from error
    try:
        yield
    finally:
        ray.shutdown()


def _refuse_silence(address: str) -> None:
    """Ray itself waits for minutes for an address where nobody answers.

    Raises
    ------
    OSError
        If nobody does, for ``PATIENCE`` seconds.
    """
    host, colon, port = address.removeprefix("ray://").rpartition(":")
    if colon and port.isdecimal():
        socket.create_connection((host, int(port)), timeout=PATIENCE).close()


def _last_line(error: Exception) -> str:
    lines = [line for line in str(error).splitlines() if line.strip()]
    return lines[-1].strip() if lines else type(error).__name__


def _ray() -> Any:
    try:
        import ray
    except ImportError as error:
        raise MissingExtraError("--engine ray", "ray") from error
    return ray
