"""The benchmark on a Ray cluster: same bytes as on this machine, also where a worker is lost."""

from __future__ import annotations

import json
import os
import re
import socket
import sys
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from test_benchmark import TINY, Told, bytes_of, run, said_by, tiny
from test_benchmark_clones import alike

from animarl_algos.benchmark import engine
from animarl_algos.benchmark.engine import RayWorkers, perform_all
from animarl_algos.benchmark.leaderboard import write_leaderboard
from animarl_algos.benchmark.matrix import MARK, claim_folder, plan
from animarl_algos.benchmark.pieces import Done, Piece
from animarl_envs.errors import InputError, MissingExtraError


def test_ray_is_an_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(MissingExtraError, match=r"animarl\[ray\]"):
        RayWorkers()


def test_who_answers_and_is_no_ray_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    pytest.importorskip("ray")
    monkeypatch.setattr(engine, "ASKING", 2.0)
    file, out = tmp_path / "tiny.yml", tmp_path / "out"
    file.write_text(json.dumps(TINY | {"recipes": [], "settings": {}}))
    with socket.create_server(("127.0.0.1", 0)) as dumb:
        place = f"127.0.0.1:{dumb.getsockname()[1]}"
        asked = ["--config", str(file), "--engine", "ray", "--address", place, "--out", str(out)]
        refused = said_by(asked, monkeypatch, capsys)
    assert refused.returncode == 2 and refused.stderr.count("\n") == 1
    assert f"no Ray cluster can be reached at {place} (" in refused.stderr
    assert refused.stdout == "" and not out.exists()


@pytest.fixture
def cluster() -> Iterator[Any]:
    """A head without work and two workers of one core, as processes of this machine."""
    pytest.importorskip("ray")
    from ray.cluster_utils import Cluster

    made = Cluster(initialize_head=True, head_node_args={"num_cpus": 0})
    made.workers = [made.add_node(num_cpus=1) for _ in range(2)]
    yield made
    made.shutdown()


@pytest.mark.slow
def test_ray_gives_the_same_bytes_when_a_worker_is_lost(
    cluster: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    here = Path(__file__).parent
    monkeypatch.setenv(
        "PYTHONPATH", os.pathsep.join(map(str, (here.parents[2], here.parents[1], here)))
    )
    matrix = alike(("soft-bc", "dqaas")).changed(seeds=(0, 1))
    alone, out = tmp_path / "local", tmp_path / "ray"
    assert not run(matrix, alone).errors
    asked, told, lost = plan(matrix), Told(), []
    claim_folder(out)

    def lose_a_worker() -> None:
        """As soon as a cell is finished: others are in the middle of theirs."""
        while not list(out.glob("cells/*/cost.json")):
            time.sleep(0.05)
        cluster.remove_node(cluster.workers[0], allow_graceful=False)
        lost.append(len([cell for cell in asked.cells if not cell.finished(out)]))

    killing = threading.Thread(target=lose_a_worker, daemon=True)
    killing.start()
    with RayWorkers(cluster.address) as workers:
        perform_all(asked.pieces, out, workers, told)
    killing.join(60)
    write_leaderboard(asked, out)
    assert lost and lost[0] > 0  # there was something left to do
    assert not told.errors and told.side_by_side == 2
    assert len(asked.clones) == 2 and all(one.cost(out) for one in asked.clones)
    assert bytes_of(out) == bytes_of(alone)


def test_ray_refuses_what_it_cannot_reach() -> None:
    pytest.importorskip("ray")
    said = r"no Ray cluster can be reached at 127\.0\.0\.1:1 "
    with pytest.raises(InputError, match=said):
        RayWorkers("127.0.0.1:1")


@pytest.mark.slow
def test_where_no_cluster_runs_ray_starts_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ray = pytest.importorskip("ray")
    here = Path(__file__).parent
    monkeypatch.setenv(
        "PYTHONPATH", os.pathsep.join(map(str, (here.parents[2], here.parents[1], here)))
    )
    monkeypatch.delenv("RAY_ADDRESS", raising=False)
    asked, told = plan(tiny()), Told()
    claim_folder(tmp_path)
    with RayWorkers() as workers:
        perform_all(asked.pieces, tmp_path, workers, told)
    assert not told.errors and all(cell.finished(tmp_path) for cell in asked.cells)
    assert not ray.is_initialized()


class OneNode:
    """In Ray's place: does each piece when it is asked for, and loses whatever ``lost`` says."""

    exceptions = SimpleNamespace(RayError=RuntimeError)

    def __init__(self, lost: Callable[[Piece], bool], **versions: str) -> None:
        self._lost, self._versions = lost, versions

    def cluster_resources(self) -> dict[str, float]:
        return {"CPU": 1.0}

    def remote(self, **_: Any) -> Callable[..., Any]:
        def task(function: Callable[..., Done]) -> Any:
            return SimpleNamespace(remote=partial(self._promise, function))

        return task

    def _promise(
        self, function: Callable[..., Done], piece: Piece, out: Path, wanted: dict[str, str]
    ) -> Any:
        promise: Future[Done] = Future()
        if self._lost(piece):
            promise.set_exception(RuntimeError("its worker died"))
        else:
            promise.set_result(function(piece, out, wanted | self._versions))
        return SimpleNamespace(future=lambda: promise)


def on(node: OneNode) -> RayWorkers:
    """Workers of that node, which need no Ray."""
    workers = RayWorkers.__new__(RayWorkers)
    workers.use(node)
    return workers


def test_cells_whose_clone_ray_lost_train_by_themselves(tmp_path: Path) -> None:
    matrix = alike(("soft-bc", "dqaas"))
    asked, told, out = plan(matrix), Told(), tmp_path / "ray"
    claim_folder(out)
    lossy = on(OneNode(lambda piece: "/clone/" in piece.name))
    perform_all(asked.pieces, out, lossy, told)
    assert list(told.errors) == [one.name for one in asked.clones]
    assert "Ray gave it up (RuntimeError: its worker died)" in str(told.errors)
    write_leaderboard(asked, out)
    assert not run(matrix, tmp_path / "alone").errors
    assert bytes_of(out) == bytes_of(tmp_path / "alone")


def test_a_node_found_unfit_later_is_named_in_the_leaderboard(tmp_path: Path) -> None:
    asked = plan(tiny(recipes=[], references=["still"]))
    for mark, said in ((MARK, r"has torch .* and this machine 0\.1"), ("moved", "does not see")):
        folder = tmp_path / mark
        claim_folder(folder)
        (folder / MARK).rename(folder / mark)
        perform_all(asked.pieces, folder, on(OneNode(lambda _: False, torch="0.1")), Told())
        write_leaderboard(asked, folder)
        [row] = json.loads((folder / "leaderboard.json").read_text())["missing"]
        assert re.search(said, row["why"])
