"""Settings that do not go together are refused; those that can be read are taken."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import pytest
import toys
from pair_learners import SETTINGS, demonstrations, make_pair_learner, weights

import animarl_envs
from animarl_algos.data.vec_env import SlotVecEnv
from animarl_algos.learner.algorithm import SequenceQLearning
from animarl_algos.recipes.registry import BC, DQDIL, DQN, QRDQN
from animarl_envs.errors import InputError
from animarl_envs.wrappers import DTWReward

assert animarl_envs  # registers the ids


def refused(kind: type[SequenceQLearning], policy: str, **more: Any) -> str:
    with pytest.raises(InputError) as caught:
        kind(policy, toys.Pair(2), **SETTINGS | more)
    assert len(str(caught.value).splitlines()) == 1
    return str(caught.value)


def test_a_memory_cannot_be_learned_from_single_steps() -> None:
    said = refused(DQN, "GruPolicy", sequence_length=1)
    assert "sequence_length is 1" in said and "MlpPolicy" in said
    assert "sequence_length" in refused(DQN, "GruPolicy", sequence_length=1, state_mode="zero")
    for policy, more in (
        ("MlpPolicy", {}),
        ("GruPolicy", {"state_mode": "stored"}),
        ("GruPolicy", {"sequence_length": 3, "burn_in": 2}),
    ):
        DQN(policy, toys.Pair(2), **SETTINGS | {"sequence_length": 1} | more).learn(20)


def test_updates_per_episode_are_not_given_as_gradient_steps() -> None:
    assert "updates_per_episode" in refused(DQN, "GruPolicy", gradient_steps=50)
    DQN("GruPolicy", toys.Pair(2), **SETTINGS, gradient_steps=50, train_freq=4)


@pytest.mark.parametrize(("kind", "count"), [(DQN, 5), (QRDQN, None)])
def test_quantiles_belong_to_the_learners_on_quantiles(
    kind: type[SequenceQLearning], count: int | None
) -> None:
    assert "n_quantiles" in refused(kind, "GruPolicy", policy_kwargs={"n_quantiles": count})


def test_only_a_policy_with_a_memory_sees_its_previous_action_unless_asked() -> None:
    for policy, more, sees in (
        ("GruPolicy", {}, True),
        ("MlpPolicy", {}, False),
        ("MlpPolicy", {"previous_action": True}, True),
    ):
        model = DQN(policy, toys.Pair(2), **SETTINGS | {"policy_kwargs": {"hidden": 8} | more})
        assert model.q_net.previous_action is sees


def test_whole_numbers_may_be_written_as_floats() -> None:
    asked = {"buffer_size": 2e3, "batch_size": 4.0, "seed": 3.0, "max_episode_steps": 20.0}
    pieces = {"sequence_length": 8.0, "burn_in": 2.0, "stats_window_size": 5.0}
    network = {"policy_kwargs": {"hidden": 8.0, "n_quantiles": 5.0}}
    memory = {"replay_buffer_kwargs": {"max_episodes": 1e2}}
    model = QRDQN("GruPolicy", toys.Pair(2), **SETTINGS | asked | pieces | network | memory)
    plain = {"max_episode_steps": 20, "sequence_length": 8, "burn_in": 2}
    fewer = {"policy_kwargs": {"hidden": 8, "n_quantiles": 5}}
    same = QRDQN("GruPolicy", toys.Pair(2), **SETTINGS | plain | fewer)
    assert (weights(model.learn(60)) == weights(same.learn(60))).all()


# -- the offline phase ----------------------------------------------------------------------------


def test_cloning_needs_epochs() -> None:
    model = BC("GruPolicy", toys.Pair(2), **SETTINGS)
    assert model.offline_epochs == BC.default_settings()["offline_epochs"] > 0
    assert "give offline_epochs" in refused(BC, "GruPolicy", offline_epochs=0)


def test_named_demonstrations_serve_an_environment_without_names() -> None:
    single = DTWReward(gym.make("AnimaRL/Agent-v0", focal="prey"))
    shown = SlotVecEnv("agent", 1, focal="prey").offline_data()
    model = DQDIL("GruPolicy", single, demonstrations=shown, offline_epochs=1, device="cpu")
    assert model.pretrain().done


def test_pretraining_again_changes_nothing() -> None:
    model = make_pair_learner("dqdil-pt")
    progress = model.pretrain()
    after = weights(model)
    assert model.pretrain() is progress and progress.epoch == len(progress.history) == 2
    assert (weights(model) == after).all()


def test_there_is_nothing_to_pretrain_without_epochs() -> None:
    with pytest.raises(InputError, match="give offline_epochs"):
        make_pair_learner("dqdil", demonstrations=demonstrations()).pretrain()
