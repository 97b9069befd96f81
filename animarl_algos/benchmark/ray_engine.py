"""Doing pieces of work on a Ray cluster: its tasks, its retries, its placement.

Every piece is one Ray task of one core, handed over when what it needs has ended; Ray chooses the
node, and repeats what a lost node or process was at, which goes on from its checkpoints. Results
lie in a folder that all nodes share, so that they are the same to the byte as those of one machine.
"""

from __future__ import annotations

import os
import platform
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from animarl_algos.benchmark.pieces import (
    Done,
    Piece,
    Watch,
    attempt,
    record_error,
    recorded_error,
)
from animarl_algos.benchmark.plan import MARK, Plan
from animarl_algos.runs.run_files import versions
from animarl_envs.errors import InputError, MissingExtraError

AUTO = "auto"  # $RAY_ADDRESS, or else this machine's cluster, which Ray starts if there is none
PATIENCE = 5.0  # [s] until somebody answers at an address
ASKING = 30.0  # [s] until Ray does, most of which is to import it
RETRIES = 3  # of a piece whose node or process was lost
ASK = """
import sys
import ray
try:
    ray.init(sys.argv[1], log_to_driver=False, logging_level="error")
except Exception as error:
    print(error)
    sys.exit(1)
"""


def perform_on_ray(ray: Any, plan: Plan, out: Path, watch: Watch) -> None:
    """Do whatever is not finished; errors are recorded, and the rest goes on.

    Parameters
    ----------
    ray
        As :func:`connected` gives it.
    out
        A folder that every node of the cluster sees under this path.
    """
    out = out.resolve()
    watch.at_once(max(1, int(ray.cluster_resources().get("CPU", 1))))
    task = ray.remote(num_cpus=1, max_retries=RETRIES)(_attempt_there)
    later = [piece for stage in plan.stages for piece in stage if not piece.finished(out)]
    left = {piece.name for piece in later}
    begun: dict[Any, Piece] = {}
    while later or begun:
        # A piece begins after what it needs has ended, well or badly: it looks what is there.
        ready = [piece for piece in later if left.isdisjoint(piece.needs)]
        later = [piece for piece in later if piece not in ready]
        begun |= {task.remote(piece, out, versions()): piece for piece in ready}
        for ended in ray.wait(list(begun), num_returns=1)[0]:
            piece = begun.pop(ended)
            left.remove(piece.name)
            try:
                done = ray.get(ended)
            except ray.exceptions.RayError as error:  # lost more often than it is repeated
                said = f"Ray gave it up ({type(error).__name__}: {_last_line(str(error))})"
                done = Done(piece.name, 0.0, said)
            if done.error != recorded_error(piece, out):  # of a node that does not see the folder
                record_error(piece, out, done.error)
            watch.ended(piece, done)


def _attempt_there(piece: Piece, out: Path, wanted: dict[str, str]) -> Done:
    """On a node."""
    if unfit := _unfit(out, wanted):
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


def refuse_other_nodes(ray: Any, out: Path) -> None:
    """Ask every node of a cluster that is :func:`connected`.

    Raises
    ------
    InputError
        If one does not see the marked folder ``out``, or has other versions.
    """
    from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy

    out, asked = out.resolve(), ray.remote(num_cpus=0)(_unfit)
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
            f"({_last_line(str(error))}): install it on all nodes"
        ) from error
    if unfit:
        raise InputError(unfit[0])


@contextmanager
def connected(address: str = AUTO) -> Iterator[Any]:
    """The module ``ray``, connected to a cluster.

    Workers find the modules that are found here by ``PYTHONPATH``.

    Parameters
    ----------
    address
        Of a running cluster, as ``ray.init`` takes it; ``"auto"``: that of ``RAY_ADDRESS``, or
        else this machine's, which Ray starts for the time of the work if there is none.

    Raises
    ------
    InputError
        If nobody answers at the address, or no Ray does.
    MissingExtraError
        If Ray is not installed.
    """
    ray = _ray()
    paths = os.environ.get("PYTHONPATH", "")
    found = os.pathsep.join(str(Path(p).resolve()) for p in paths.split(os.pathsep) if p)
    environment = {"env_vars": {"PYTHONPATH": found}} if found else {}
    named = os.environ.get("RAY_ADDRESS") if address == AUTO else address
    try:
        if named and named not in (AUTO, "local"):
            _refuse_silence(named)
            _refuse_no_ray(named)
        ray.init(named, runtime_env=environment, log_to_driver=False, logging_level="error")
    except (OSError, RuntimeError, ValueError) as error:
        raise InputError(
            f"no Ray cluster can be reached at {named or AUTO} ({_last_line(str(error))}): start "
            "one with 'ray start --head', or give another --address"
        ) from error
    try:
        yield ray
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


def _refuse_no_ray(address: str) -> None:
    """Ray waits for minutes for an answer of something else, or ends the process: so a child asks.

    Raises
    ------
    OSError
        If Ray does not answer for ``ASKING`` seconds, or refuses.
    """
    asked = [sys.executable, "-c", ASK, address]
    try:
        told = subprocess.run(
            asked, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, timeout=ASKING
        )
    except subprocess.TimeoutExpired:
        raise OSError(f"what answers there is no Ray, or takes over {ASKING:g} s") from None
    if told.returncode:
        raise OSError(_last_line(told.stdout))


def _last_line(text: str) -> str:
    lines = [line for line in text.splitlines() if line.strip()]
    return lines[-1].strip() if lines else "it does not say why"


def _ray() -> Any:
    try:
        import ray
    except ImportError as error:
        raise MissingExtraError("--engine ray", "ray") from error
    return ray
