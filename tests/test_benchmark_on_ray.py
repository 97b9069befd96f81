"""The benchmark on a Ray cluster: same bytes as on this machine, also where a worker is lost."""

from __future__ import annotations

import os
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from test_benchmark import Told, bytes_of, run, tiny

from animarl_algos.benchmark import ray_engine
from animarl_algos.benchmark.leaderboard import write_leaderboard
from animarl_algos.benchmark.plan import claim_folder, plan
from animarl_envs.errors import InputError, MissingExtraError


def test_ray_is_an_extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(MissingExtraError, match=r"animarl\[ray\]"):
        ray_engine.perform_on_ray(plan(tiny()), tmp_path, Told())


def test_a_node_says_why_it_cannot_take_part(tmp_path: Path) -> None:
    versions = ray_engine.versions()
    assert "does not see" in ray_engine._unfit(tmp_path, versions)
    claim_folder(tmp_path)
    assert ray_engine._unfit(tmp_path, versions) == ""
    said = ray_engine._unfit(tmp_path, versions | {"torch": "0.1"})
    assert "has torch" in said and "this machine 0.1" in said


def test_nobody_at_an_address_is_told_soon() -> None:
    with pytest.raises(OSError):
        ray_engine._refuse_silence("127.0.0.1:1")


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
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(here.parent), str(here)]))
    matrix, alone, out = tiny(), tmp_path / "local", tmp_path / "ray"
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
    ray_engine.perform_on_ray(asked, out, told, cluster.address)
    killing.join(60)
    write_leaderboard(asked, out)
    assert lost and lost[0] > 0  # there was something left to do
    assert not told.errors and told.side_by_side == 2
    assert bytes_of(out) == bytes_of(alone)


@pytest.mark.slow
def test_ray_refuses_what_it_cannot_reach(tmp_path: Path) -> None:
    pytest.importorskip("ray")
    claim_folder(tmp_path)
    with pytest.raises(InputError, match=r"no Ray cluster can be reached at 127\.0\.0\.1:1 "):
        ray_engine.perform_on_ray(plan(tiny()), tmp_path, Told(), "127.0.0.1:1")


@pytest.mark.slow
def test_where_no_cluster_runs_ray_starts_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ray = pytest.importorskip("ray")
    here = Path(__file__).parent
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(here.parent), str(here)]))
    monkeypatch.delenv("RAY_ADDRESS", raising=False)
    asked, told = plan(tiny()), Told()
    claim_folder(tmp_path)
    ray_engine.perform_on_ray(asked, tmp_path, told)
    assert not told.errors and all(cell.finished(tmp_path) for cell in asked.cells)
    assert not ray.is_initialized()
