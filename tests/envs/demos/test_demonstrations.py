"""The container for recorded episodes: what it refuses, what it keeps, what it writes."""

import copy
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from refusals import refuses

from animarl_envs.arena import Arena
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.errors import InputError

LENGTHS = (4, 2, 6)


def content(**changes: Any) -> dict[str, Any]:
    """Three short episodes of two individuals, with ``changes``."""
    frames = sum(LENGTHS)
    random = np.random.default_rng(0)
    values: dict[str, Any] = {
        "species": "custom",
        "individuals": ("hunter_0", "prey"),
        "roles": ("pursuer", "target"),
        "dt": 0.1,
        "arena": Arena("square", 1.0, 1.1),
        "positions": random.uniform(-1, 1, (frames, 2, 2)),
        "lengths": np.array(LENGTHS),
        "initial_velocity": random.uniform(-1, 1, (3, 2, 2)),
        "condition": np.array([0, 1, 1]),
        "outcome": np.array([0, 1, -1]),
        "split": np.array(["train", "val", "train"]),
        "recording": np.array(["a", "b", "b"]),
        "signals": {"actions": np.zeros((frames, 2), dtype=np.int8)},
        "provenance": {"source": "drawn at random", "licence": "MIT", "synthetic": True},
        "name": "tracks.npz",
    }
    return values | changes


def edited(key: str, place: Any, value: Any) -> dict[str, Any]:
    """The same with one entry of an array replaced."""
    array = np.array(content()[key])
    array[place] = value
    return {key: array}


def same_tracks() -> dict[str, Any]:
    positions = content()["positions"].copy()
    positions[:, 1] = positions[:, 0]
    return {"positions": positions}


REFUSED: list[tuple[dict[str, Any], str]] = [
    (edited("positions", (5, 1, 0), np.nan), "episode 1, frame 1, prey"),
    (edited("positions", (7, 0, 1), 3.0), "outside the arena"),
    (edited("initial_velocity", (0, 0, 0), np.inf), "initial_velocity"),
    ({"lengths": np.array([4, 2, 7])}, "add up"),
    ({"lengths": np.array([5, 1, 6])}, "1 frame:"),
    ({"lengths": np.array([6, 0, 6])}, "0 frames"),
    ({"positions": np.zeros((12, 3, 2))}, "not (frames, 2, 2)"),
    ({"dt": 0.0}, "dt"),
    ({"dt": -0.1}, "dt"),
    ({"dt": float("nan")}, "dt"),
    ({"individuals": ("prey", "prey")}, "appears twice"),
    (same_tracks(), "same track"),
    ({"roles": ("target", "target")}, "comes last"),
    ({"roles": ("pursuer", "bystander")}, "roles"),
    ({"condition": np.array([0, 2, 1])}, "condition"),
    ({"condition": np.array([0, 1])}, "2 entries for 3 episodes"),
    ({"outcome": np.array([0, 9, 0])}, "outcome"),
    ({"split": np.array(["train", "dev", "test"])}, "dev"),
    ({"signals": {"odour": np.zeros(5)}}, "odour"),
    ({"provenance": {"source": "x", "synthetic": True}}, "licence"),
    ({"individuals": (), "roles": ()}, "no individuals"),
]


@pytest.mark.parametrize(("changes", "words"), REFUSED, ids=[w for _, w in REFUSED])
def test_bad_content_is_refused_with_file_and_place(changes: dict[str, Any], words: str) -> None:
    sentence = refuses("", Demonstrations, **content(**changes))
    assert words in sentence
    assert sentence.startswith("tracks.npz: ")
    assert "\n" not in sentence


def test_python_objects_are_refused() -> None:
    ragged = np.array([None] * sum(LENGTHS), dtype=object)
    refuses("Python objects", Demonstrations, **content(signals={"notes": ragged}))


def test_saving_and_loading_changes_nothing(tmp_path: Path) -> None:
    demos = Demonstrations(**content())
    again = Demonstrations.load(demos.save(tmp_path / "tracks.npz"))
    assert again.fingerprint() == demos.fingerprint()
    assert again.individuals == demos.individuals
    assert again.arena == demos.arena
    assert dict(again.provenance) == dict(demos.provenance)
    np.testing.assert_array_equal(again.positions, demos.positions)
    np.testing.assert_array_equal(again.signals["actions"], demos.signals["actions"])
    assert [p.name for p in tmp_path.iterdir()] == ["tracks.npz"]


@pytest.mark.parametrize("fault", [OSError("no space left"), KeyboardInterrupt()])
def test_an_interrupted_save_leaves_the_old_file(
    fault: BaseException, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = Demonstrations(**content()).save(tmp_path / "tracks.npz")
    before = path.read_bytes()

    def interrupted(file: Any, **arrays: Any) -> None:
        file.write(b"half")
        raise fault

    monkeypatch.setattr(np, "savez_compressed", interrupted)
    stopped = (KeyboardInterrupt, InputError)
    with pytest.raises(stopped, match=r"tracks\.npz: it cannot be written \(no space left|^$"):
        Demonstrations(**content(dt=0.2)).save(path)
    assert path.read_bytes() == before and [*tmp_path.iterdir()] == [path]


def test_a_spoilt_file_is_refused_by_name(tmp_path: Path) -> None:
    path = tmp_path / "spoilt.npz"
    refuses(r"spoilt\.npz: .*no such file", Demonstrations.load, path)
    np.savez(path, pos=np.zeros(3))
    refuses(r"spoilt\.npz: .*", Demonstrations.load, path)
    Demonstrations(**content()).save(path)
    path.write_bytes(path.read_bytes()[:300])
    refuses(r"spoilt\.npz: .*", Demonstrations.load, path)


def test_selection_keeps_episodes_whole() -> None:
    demos = Demonstrations(**content())
    chosen = demos.select(split="train", condition=1)
    assert len(chosen) == 1
    np.testing.assert_array_equal(chosen.positions, demos.episode(2).positions)
    np.testing.assert_array_equal(chosen.episode(0).velocities, demos.episode(2).velocities)
    turned = demos.select(episodes=[2, 0])
    np.testing.assert_array_equal(turned.lengths, [6, 4])
    np.testing.assert_array_equal(turned.episode(1).positions, demos.episode(0).positions)
    refuses("holds no episode", demos.select, split="test")
    refuses("'dev' is unknown", demos.select, split="dev")


def test_velocity_belongs_to_the_position_it_led_to() -> None:
    demos = Demonstrations(**content())
    for i, episode in enumerate(demos):
        np.testing.assert_array_equal(episode.velocities[0], demos.initial_velocity[i])
        rebuilt = episode.positions[:-1] + episode.velocities[1:] * demos.dt
        np.testing.assert_allclose(rebuilt, episode.positions[1:], atol=1e-12)
        begin, end = demos.offsets[i : i + 2]
        np.testing.assert_allclose(demos.velocities()[begin:end], episode.velocities, atol=1e-12)


def test_the_content_cannot_be_changed() -> None:
    given = content()
    demos = Demonstrations(**given)
    mark = demos.fingerprint()
    given["positions"][...] = 0.0
    with pytest.raises(ValueError, match="read-only"):
        demos.positions[0] = 0.0
    with pytest.raises(ValueError, match="read-only"):
        demos.episode(0).positions[0] = 0.0
    with pytest.raises(TypeError):
        demos.signals["actions"] = np.zeros(12)  # type: ignore[index]
    assert demos.fingerprint() == mark
    assert copy.deepcopy(demos).fingerprint() == mark
    assert pickle.loads(pickle.dumps(demos)).fingerprint() == mark


@pytest.mark.parametrize(
    "changes",
    [{"dt": 0.2}, edited("positions", (0, 0, 0), 0.5), edited("condition", 0, 1)],
    ids=["dt", "position", "condition"],
)
def test_the_fingerprint_changes_with_the_content(changes: dict[str, Any]) -> None:
    before = Demonstrations(**content()).fingerprint()
    assert Demonstrations(**content(**changes)).fingerprint() != before


def test_the_fingerprint_does_not_depend_on_provenance() -> None:
    told = {"source": "elsewhere", "licence": "MIT", "synthetic": True}
    before = Demonstrations(**content()).fingerprint()
    assert Demonstrations(**content(provenance=told)).fingerprint() == before
