"""Minari export and import round-trip exactly."""

import json
import socket
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from refusals import refuses

from animarl_envs.arena import Arena
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.packaged import load_packaged, packaged_names
from animarl_envs.importing.minari_io import export_minari, export_packaged, import_minari
from animarl_envs.importing.readers import read

minari = pytest.importorskip("minari")


def demonstrations(*, actions: bool, individuals: int = 3) -> Demonstrations:
    rng = np.random.default_rng(individuals)
    lengths = np.array([7, 2, 30, 11])
    frames = int(lengths.sum())
    signals = {
        "odour": rng.random(frames) > 0.5,
        "heading": rng.normal(size=(frames, individuals)),
        "wind": rng.integers(4, size=frames).astype(np.int8),
    }
    if actions:
        taken = rng.integers(13, size=(frames, individuals)).astype(np.int8)
        taken[np.cumsum(lengths) - 1] = -1
        signals = {"actions": taken} | signals
    return Demonstrations(
        species="agent", individuals=tuple(f"animal {i}" for i in range(individuals)),
        roles=("pursuer",) * (individuals - 1) + ("target",), dt=0.1, arena=Arena("open"),
        positions=rng.uniform(-1, 1, (frames, individuals, 2)), lengths=lengths,
        initial_velocity=rng.normal(size=(4, individuals, 2)),
        condition=np.array([0, 1, 1, 0], np.int8), outcome=np.array([1, 0, -1, -3], np.int8),
        split=np.array(["train", "val", "test", "train"]),
        recording=np.array(["α", "b/1", "b/1", "c"]), signals=signals,
        provenance={"source": "test", "licence": "CC-BY-4.0", "synthetic": True, "n": [1, 2.5]},
    )  # fmt: skip


@pytest.mark.parametrize("actions", [True, False])
@pytest.mark.parametrize("individuals", [2, 3])
def test_minari_round_trip_is_exact_and_opens_no_connection(
    actions: bool, individuals: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for opener in ("socket", "create_connection"):
        monkeypatch.setattr(socket, opener, lambda *_, **__: pytest.fail("a connection was opened"))
    demos = demonstrations(actions=actions, individuals=individuals)
    back = import_minari(export_minari(demos, tmp_path / "set-v0"))
    assert back.fingerprint() == demos.fingerprint()
    assert dict(back.provenance) == dict(demos.provenance)
    assert list(back.signals) == list(demos.signals)
    for key, value in demos.signals.items():
        assert back.signals[key].dtype == value.dtype
        np.testing.assert_array_equal(back.signals[key], value)
    again = read(tmp_path / "set-v0" / "data" / "main_data.hdf5")
    assert again.fingerprint() == demos.fingerprint()


def test_minari_itself_finds_the_dataset(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    demos = demonstrations(actions=True)
    export_minari(demos, tmp_path / "set-v0")
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    dataset = minari.load_dataset("set-v0")
    assert dataset.total_episodes == 4
    for one, episode in zip(demos, dataset.iterate_episodes(), strict=True):
        assert len(episode.rewards) == one.num_steps
        for i, name in enumerate(demos.individuals):
            assert len(episode.observations[name]) == one.num_steps + 1
            assert len(episode.actions[name]) == one.num_steps
            np.testing.assert_array_equal(episode.observations[name][:, :2], one.positions[:, i])
        assert episode.terminations[-1] == (one.outcome in (1, -1))
        assert episode.truncations[-1] == (one.outcome in (0, -3))
    assert json.loads(dataset.storage.metadata["animarl"])["licence"] == "CC-BY-4.0"


@pytest.mark.slow
def test_minari_finds_all_packaged_sets_under_stable_ids(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert export_packaged(tmp_path) == [f"animarl/{n}/demonstrations-v0" for n in packaged_names()]
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    assert len(minari.list_local_datasets()) == len(packaged_names())
    newt, demos = minari.load_dataset("animarl/newt/demonstrations-v0"), load_packaged("newt")
    assert newt.total_episodes == len(demos)
    assert demos.provenance["licence"] in newt.storage.metadata["description"]
    assert newt.recover_environment().spec.id == "AnimaRL/Newt-v0"
    refuses("exists already", export_packaged, tmp_path)


def test_the_environment_of_animals_of_ones_own_starts_from_the_dataset(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    demos = replace(demonstrations(actions=True), species="custom")
    export_minari(demos, tmp_path / "set-v0")
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    env = minari.load_dataset("set-v0").recover_environment().unwrapped
    assert env.scenario.names == demos.individuals
    np.testing.assert_array_equal(env.scenario.demos.positions, demos.positions)


def test_minari_refuses_what_it_cannot_do(tmp_path: Path) -> None:
    demos = demonstrations(actions=True)
    folder = export_minari(demos, tmp_path / "set-v0")
    refuses("exists already", export_minari, demos, folder)
    refuses(r"holds no data/main_data\.hdf5", import_minari, tmp_path / "absent")
    metadata = folder / "data" / "metadata.json"
    record = json.loads(metadata.read_text())
    del record["animarl"]
    metadata.write_text(json.dumps(record))
    refuses("another project", import_minari, folder)
