"""What a learner saves of itself, and how it goes on from there in an environment."""

import io
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import torch
import toys
from gymnasium.envs.classic_control import CartPoleEnv
from pair_learners import SETTINGS, FlaggedPair, demonstrations, make_pair_learner, weights
from refusals import refuses

import animarl_algos.learner.pretraining
from animarl_algos.data.vec_env import SlotVecEnv
from animarl_algos.networks.acting_rule import Acting
from animarl_algos.recipes.registry import DQDIL, DQN


@pytest.fixture(scope="module")
def saved(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A learner after forty steps, told how to act."""
    file = tmp_path_factory.mktemp("saved") / "model"
    model = make_pair_learner("dqn").learn(40)
    model.policy.acting = Acting.boltzmann(0.5)
    model.save(file)
    return file


@pytest.mark.parametrize("copies", [2, 3])
def test_a_loaded_learner_goes_on_in_the_environment_it_is_given(copies: int, saved: Path) -> None:
    loaded = DQN.load(saved, device="cpu")
    refuses("call set_env first", loaded.learn, 10)
    assert loaded.policy.acting == Acting.boltzmann(0.5)
    before = weights(loaded)
    loaded.set_env(toys.Pair(copies))
    loaded.learn(60)
    assert loaded.layout.num_copies == copies and loaded.num_timesteps == 60
    assert not torch.equal(before, weights(loaded))


class Strangers(toys.Pair):
    individuals = ("owl", "mouse")


class Narrow(toys.Pair):
    num_actions = 2


@pytest.mark.parametrize(
    ("other", "words"),
    [
        (lambda: Strangers(2), "the individuals owl, mouse and no condition flag"),
        (lambda: FlaggedPair(2), "a condition flag"),
        (lambda: Narrow(3), "3 actions learned and 2 here"),
        (lambda: toys.Recall(4), "the individuals agent"),
    ],
)
def test_an_environment_that_does_not_fit_is_refused_and_changes_nothing(
    other: Callable[[], Any], words: str, saved: Path
) -> None:
    for model in (DQN.load(saved, device="cpu"), make_pair_learner("dqn")):
        before = (model.n_envs, model.layout)
        refuses(words, model.set_env, other())
        assert (model.n_envs, model.layout) == before


def test_an_environment_that_does_not_fit_is_refused_by_load_too(
    saved: Path, tmp_path: Path
) -> None:
    """Nor is an individual taken for another: networks of a predator and the prey are as large."""
    words = "the individuals owl, mouse and no condition flag"
    refuses(words, DQN.load, saved, env=Strangers(2), device="cpu")
    words = r"Observation spaces do not match.*: give the environment it was"
    refuses(words, DQN.load, saved, env=FlaggedPair(2), device="cpu")
    predator, again, prey = (
        SlotVecEnv("agent", copies, focal=focal)
        for copies, focal in ((2, "predator_1"), (3, "predator_1"), (2, "prey"))
    )
    DQN("MlpPolicy", predator, device="cpu").save(tmp_path / "m")
    words = "individuals prey .*, this learner .*predator_1"
    refuses(words, DQN.load, tmp_path / "m", env=prey, device="cpu")
    assert DQN.load(tmp_path / "m", env=again, device="cpu").layout.num_copies == 3


class Patient(toys.Pair):
    time_limit = 1000


def test_a_replay_memory_keeps_its_copies_and_its_longest_episode() -> None:
    model = make_pair_learner("dqn")
    refuses("does not suit this learner", model.set_env, toys.Pair(4))
    refuses("episodes last up to 1000 steps", model.set_env, Patient(2))
    # One that names no limit is taken where there is a memory.
    model = DQN("MlpPolicy", gym.make("CartPole-v1"), **SETTINGS)
    model.set_env(CartPoleEnv())
    assert model.learn(20).num_timesteps == 20


def test_saved_settings_are_taken_as_they_were(tmp_path: Path) -> None:
    """What a new learner is refused for did nothing, and does nothing."""
    model = make_pair_learner("dqn").learn(40)
    model.gradient_steps = 8
    model.save(tmp_path / "model")
    assert DQN.load(tmp_path / "model", env=toys.Pair(2), device="cpu").learn(20).gradient_steps


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"gradient_steps": 0}, "gradient_steps is 0"),
        ({"gradient_steps": 3}, "train_freq counts episodes"),
        ({"sequence_length": 4, "n_steps": 5}, "n_steps is 5"),
        ({"offline_epochs": 2}, "learns without demonstrations"),
        ({"gama": 0.5}, "setting 'gama' is unknown"),
    ],
)
def test_settings_given_anew_are_checked_as_those_of_a_new_learner(
    given: dict[str, Any], words: str, saved: Path
) -> None:
    refuses(words, DQN.load, saved, env=toys.Pair(2), device="cpu", **given)
    more = {"seed": 1, "verbose": 0, "tensorboard_log": None, "demonstrations": None}
    assert DQN.load(saved, env=toys.Pair(2), device="cpu", gamma=0.5, **more).gamma == 0.5


class Stop(Exception):
    pass


def test_a_learner_saved_in_mid_pretraining_keeps_its_best_epoch(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Here the first epoch, which none of the later ones beats."""
    settings = {"offline_epochs": 4, "offline_learning_rate": 1e-2}
    model = make_pair_learner("dqdil-pt", **settings)
    figures = iter([1.0, 2.0, 3.0, 4.0])

    def scored(*_: Any) -> dict[str, float]:
        if model.offline_progress.epoch == 2 and loaded is None:
            raise Stop
        figure = next(figures)
        return {f"val/{model.recipe.selection}/{who}": figure for who in toys.Pair.individuals}

    loaded = None
    monkeypatch.setattr(animarl_algos.learner.pretraining, "validation_figures", scored)
    with pytest.raises(Stop):
        model.pretrain()
    best = model.offline_progress.best_weights
    assert best is not None and model.offline_progress.best_epoch == 1
    model.save(tmp_path / "model")
    loaded = DQDIL.load(tmp_path / "model", env=toys.Pair(2), device="cpu")
    loaded.demonstrations = demonstrations()
    assert loaded.pretrain().best_epoch == 1 and loaded.offline_progress.epoch == 4
    for name, value in loaded.policy.q_net.state_dict().items():
        assert torch.equal(value, best[name])


def test_the_replay_memory_is_saved_and_loaded_without_pickle(tmp_path: Path) -> None:
    model = make_pair_learner("dqn").learn(60)
    model.save_replay_buffer(tmp_path / "memory.pkl")  # as SB3's callbacks call it
    model.save_replay_buffer(archive := io.BytesIO())
    archive.seek(0)
    assert model.replay_buffer is not None
    expected = model.replay_buffer.sample(8)
    for place in (tmp_path / "memory.pkl", archive):
        other = make_pair_learner("dqn", seed=99)
        other.load_replay_buffer(place)
        assert other.replay_buffer is not None
        assert other.replay_buffer.num_steps == model.replay_buffer.num_steps
        assert torch.equal(other.replay_buffer.sample(8).observations, expected.observations)
        assert other.learn(20, reset_num_timesteps=False).num_timesteps == 20
    more = DQN("GruPolicy", toys.Pair(5), **SETTINGS)
    more.load_replay_buffer(tmp_path / "memory.pkl")
    assert more.replay_buffer is not None
    assert more.replay_buffer.num_episodes == model.replay_buffer.num_episodes > 0
    assert more.learn(50).num_timesteps == 50


def test_a_memory_that_cannot_be_written_leaves_the_last_one(tmp_path: Path, monkeypatch) -> None:
    model = make_pair_learner("dqn").learn(60)
    model.save_replay_buffer(tmp_path / "memory")
    before = (tmp_path / "memory.npz").read_bytes()

    def run_out_of_room(file: io.BufferedIOBase, **arrays: np.ndarray) -> None:
        file.write(b"half")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(np, "savez", run_out_of_room)
    words = r"memory\.npz: it cannot be written \(No space left"
    refuses(words, model.save_replay_buffer, tmp_path / "memory")
    assert [file.name for file in tmp_path.iterdir()] == ["memory.npz"]
    assert (tmp_path / "memory.npz").read_bytes() == before


def test_what_is_no_replay_memory_is_refused(saved: Path, tmp_path: Path) -> None:
    model = make_pair_learner("dqn")
    (tmp_path / "pickle.pkl").write_bytes(pickle.dumps({"rows": 3}))
    np.save(tmp_path / "array.npy", np.zeros(3))
    np.savez(tmp_path / "arrays.npz", rows=np.zeros(3))
    for name in ("pickle.pkl", "array.npy", "arrays.npz", "missing.npz"):
        refuses(name, model.load_replay_buffer, tmp_path / name)
    loaded = DQN.load(saved, device="cpu")
    refuses("call set_env first", loaded.save_replay_buffer, tmp_path / "memory")
