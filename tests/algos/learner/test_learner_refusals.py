"""What does not fit together is refused in one sentence, before any training starts."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import torch
import toys
from gymnasium.wrappers import FlattenObservation
from pair_learners import SETTINGS, FlaggedPair, Split, demonstrations, make_pair_learner, weights
from refusals import refuses
from stable_baselines3.common.vec_env import DummyVecEnv, SubprocVecEnv

import animarl_envs
from animarl_algos.data.dataset import OfflineDataset
from animarl_algos.data.vec_env import SlotVecEnv
from animarl_algos.learner.algorithm import SequenceQLearning
from animarl_algos.learner.pretraining import Pretraining
from animarl_algos.recipes.registry import BC, DQAAS, DQCIL, DQDIL, DQN, QRDQN
from animarl_algos.runs.run_settings import RunSettings, checked_species
from animarl_envs.demos.packaged import load_packaged
from animarl_envs.wrappers import DTWReward

assert animarl_envs  # registers the ids


def five_frames(actions: list[int], num_actions: int, **more: Any) -> OfflineDataset:
    """An episode of the pair, in which both take one action all the time."""
    observations = np.random.default_rng(0).normal(size=(5, 2, 4))
    taken = np.array([actions] * 4 + [[-1, -1]])
    return OfflineDataset(observations, taken, np.array([5]), num_actions, **more)


class Nothing:
    """A dataset of no episode."""

    def batches(self, *_: Any) -> Iterator[Any]:
        return iter(())


def other_actions() -> Split:
    """Demonstrations with more actions than the pair has."""
    made = five_frames([7, 1], 9, action_penalties=np.random.default_rng(1).random((5, 2, 9)))
    return Split(made, made)


@dataclass(frozen=True)
class Case:
    """A learner that cannot learn, and words of the sentence that says why."""

    words: str
    learner: Callable[..., Any]
    env: Callable[[], Any]
    more: Callable[[], dict[str, Any]] = dict


def offline(data: Callable[[], Split]) -> Callable[[], dict[str, Any]]:
    return lambda: {"demonstrations": data(), "offline_epochs": 1}


CASES = {
    "no distance": Case("'dtw_penalty'", DQDIL, lambda: toys.Recall(2)),
    "no distance, any environment": Case("'dtw_penalty'", DQDIL, lambda: gym.make("CartPole-v1")),
    "no distance, with pretraining": Case(
        "'dtw_penalty'",
        DQDIL,
        lambda: SlotVecEnv("agent", 2, dtw=None),
        lambda: {"offline_epochs": 1},
    ),
    "no alignment, no distance": Case("'aligned_action'", DQAAS, lambda: toys.Recall(2)),
    "no alignment": Case("'aligned_action'", DQAAS, lambda: toys.Lock(2)),
    "no alignment in a single environment": Case(
        "'aligned_action'", DQAAS, lambda: DTWReward(gym.make("AnimaRL/Agent-v0"))
    ),
    "no condition": Case("condition flag", DQCIL, lambda: toys.Pair(2)),
    "no condition in a world": Case("condition flag", DQCIL, lambda: SlotVecEnv("agent", 2)),
    "no demonstrations": Case(
        "was given demonstrations", DQDIL, lambda: toys.Pair(2), lambda: {"offline_epochs": 1}
    ),
    "no demonstrations in a world": Case(
        "was given demonstrations", BC, lambda: SlotVecEnv("agent", 2, demos=None)
    ),
    "other individuals": Case(
        "2 individuals with 4", DQDIL, lambda: toys.Lock(2), offline(demonstrations)
    ),
    "individuals of other names": Case(
        "of predator_0, predator_1, prey, the environment's individuals are male_0",
        BC,
        lambda: SlotVecEnv("fly", 2, observation="paper"),
        offline(  # with the flag as many components as the flies'
            lambda: SlotVecEnv("agent", 2, condition_flag=True, observation="paper").offline_data()
        ),
    ),
    "no episode": Case(
        "the training split holds no demonstrated episode",
        DQDIL,
        lambda: toys.Pair(2),
        offline(lambda: Split(Nothing(), demonstrations().val)),
    ),
    "other observations": Case(
        "with 4 observation components, the environment 2 with 5",
        DQDIL,
        lambda: FlaggedPair(2),
        offline(demonstrations),
    ),
    "other actions": Case(
        "hold action 8, the environment has 3", DQDIL, lambda: toys.Pair(2), offline(other_actions)
    ),
    "no scored actions": Case(
        "no penalties of all actions",
        DQDIL,
        lambda: toys.Pair(2),
        offline(lambda: Split(five_frames([0, 1], 3), demonstrations().val)),
    ),
    "no offline phase": Case(
        "learns without demonstrations", DQN, lambda: toys.Pair(2), lambda: {"offline_epochs": 1}
    ),
    "continuous actions": Case("does not suit", DQN, lambda: gym.make("Pendulum-v1")),
    "continuous actions, quantiles": Case("does not suit", QRDQN, lambda: gym.make("Pendulum-v1")),
    "observations that are no vector": Case(
        "Discrete .*FlattenObs", DQN, lambda: gym.make("Taxi-v4"), lambda: {"max_episode_steps": 5}
    ),
    "episodes without end": Case(
        "give max_episode_steps", DQN, lambda: FlattenObservation(gym.make("Blackjack-v1"))
    ),
    "unknown policy": Case(
        "policy is 'CnnPolicy': choose GruPolicy or MlpPolicy",
        lambda _, *env, **more: DQN("CnnPolicy", *env, **more),
        lambda: toys.Pair(2),
    ),
}


@pytest.mark.parametrize("name", CASES)
def test_recipes_that_cannot_learn_say_so_before_they_start(name: str) -> None:
    case, updates = CASES[name], []

    def learn() -> None:
        model = case.learner("GruPolicy", case.env(), **SETTINGS | case.more())
        model.policy.optimizer.step = lambda *_: updates.append(1)
        model.learn(20)

    refuses(case.words, learn)
    assert not updates


NAN = float("nan")
WRONG: list[tuple[str, Any]] = [
    *(("learning_rate", value) for value in (-1.0, 0.0, NAN, lambda _: -1.0)),
    *(("offline_learning_rate", value) for value in (-1.0, 0.0, NAN)),
    *((name, value) for name in ("gamma", "offline_gamma") for value in (-0.1, 1.5, NAN)),
    *((name, -1.0) for name in ("alpha", "offline_alpha", "lambda1", "lambda2", "lambda3")),
    *(("tau", value) for value in (-1.0, 0.0, 3.0, NAN)),
    *(("max_grad_norm", value) for value in (-1.0, 0.0, NAN)),
    *(("offline_max_grad_norm", value) for value in (-1.0, 0.0)),
    *(("exploration_initial_eps", value) for value in (-0.1, 1.1)),
    *(("exploration_final_eps", value) for value in (-0.1, 2.0, NAN)),
    *(("exploration_fraction", value) for value in (-1.0, 0.0, 7.0, {})),
    *(("exploration", value) for value in ("greedy", "")),
    *(("offline_loss", value) for value in ("bc", "")),
    *(("exploration_steps", value) for value in (-1, 2.5)),
    *(("offline_patience", value) for value in (-1, 0, 1.5, [])),
    *((name, 0) for name in ("batch_size", "offline_batch_size", "buffer_size")),
    *(("gradient_steps", value) for value in (0, -2)),
    *((name, -1) for name in ("learning_starts", "offline_epochs", "burn_in", "seed")),
    *(("updates_per_episode", value) for value in (-1.0, NAN, float("inf"))),
    *((name, 0) for name in ("max_episode_steps", "sequence_length", "stats_window_size")),
    *(("train_freq", value) for value in ((1, "game"), (0, "step"), (1,), NAN, None, {})),
    *(("target_update_interval", value) for value in (0, (NAN, "episode"), ("x", "step"))),
    *(("policy_kwargs", {"hiden": 4}), ("policy_kwargs", {"seed": 4})),
    *(("policy_kwargs", {"hidden": value}) for value in (0, 2.5, "x")),
    *(("policy_kwargs", {"optimizer_kwargs": value}) for value in ({"lrr": 1}, {"eps": -1.0}, 3)),
    *(("replay_buffer_kwargs", {"alhpa": 1}), ("replay_buffer_kwargs", {"alpha": -1.0})),
    ("replay_buffer_kwargs", {"max_episodes": 0}),
]


@pytest.mark.parametrize(("name", "value"), [("gamma", 1.1), ("alpha", -1.0), ("lambda2", -1.0)])
def test_a_setting_given_to_load_is_checked_as_in_the_constructor(
    name: str, value: float, tmp_path: Path
) -> None:
    DQN("MlpPolicy", toys.Pair(2), **SETTINGS).save(tmp_path / "model.zip")
    assert DQN.load(tmp_path / "model.zip", gamma=0.5).gamma == 0.5
    refuses(f"^{name} is", DQN.load, tmp_path / "model.zip", **{name: value})


@pytest.mark.parametrize(("name", "value"), WRONG)
def test_a_setting_that_no_learner_can_use_is_named(name: str, value: Any) -> None:
    named = next(iter(value)) if name.endswith("kwargs") else name
    refuses(named, DQN, "GruPolicy", toys.Pair(2), **SETTINGS | {name: value})


def test_ends_of_the_ranges_belong_to_them() -> None:
    ends = {"tau": 1.0, "gamma": 1.0, "exploration_fraction": 1.0, "max_grad_norm": None}
    zeros = ("alpha", "exploration_steps", "exploration_initial_eps", "updates_per_episode")
    DQN("GruPolicy", toys.Pair(2), **SETTINGS | ends | dict.fromkeys(zeros, 0))


@pytest.mark.slow
@pytest.mark.parametrize("kind", [DummyVecEnv, SubprocVecEnv])
def test_the_wrapper_is_seen_through_a_vector_of_environments(kind: type) -> None:
    """The DTW reward around a single environment is enough for DQDIL, also in a subprocess."""
    env = kind([wrapped_agent])
    model = DQDIL("GruPolicy", env, **SETTINGS | {"batch_size": 1}).learn(30)
    assert model.num_timesteps == 30
    env.close()


def wrapped_agent() -> gym.Env[Any, Any]:
    return DTWReward(gym.make("animarl_envs:AnimaRL/Agent-v0"))


@pytest.mark.parametrize("prioritized", [False, True])
def test_diverged_training_is_refused(prioritized: bool) -> None:
    diverging = {"learning_rate": 1e30, "max_grad_norm": None, "prioritized": prioritized}
    model = make_pair_learner("dqn", **diverging)
    refuses("online training diverged .* lower learning_rate", model.learn, 120)
    assert torch.isfinite(weights(model)).all()


def test_an_epoch_without_finite_values_is_never_the_best(monkeypatch: pytest.MonkeyPatch) -> None:
    """Chosen by rank, in which values that are not numbers are neither higher nor equal."""

    train_epoch = Pretraining.train_epoch

    def broken_in_the_second(phase: Pretraining, data: Any) -> Any:
        row = train_epoch(phase, data)
        if phase.progress.epoch == 1:
            q_net = phase.policy.q_net
            q_net.load_state_dict({name: w * np.nan for name, w in q_net.state_dict().items()})
        return row

    monkeypatch.setattr(Pretraining, "train_epoch", broken_in_the_second)
    model = make_pair_learner("dqdil-pt", offline_epochs=3)
    refuses("diverged in epoch 2 .* lower offline_learning_rate", model.pretrain)
    assert model.offline_progress.best_epoch == 1
    best = model.offline_progress.best_weights
    assert best is not None and not any(w.isnan().any() for w in best.values())


def settings(**more: Any) -> RunSettings:
    asked = {"file": "packaged", "species": "agent", "algo": "dqdil", "steps": 1}
    return RunSettings(**asked | more)


def test_what_a_run_is_compared_with_gets_its_policy_without_quantiles() -> None:
    network = {"n_quantiles": 10, "hidden": 8}
    asked = settings(algo="qr-dqn", overrides={"policy_kwargs": network})
    assert asked.learner().arguments["policy_kwargs"] == network
    assert asked.learner("bc").arguments["policy_kwargs"] == {"hidden": 8}


@pytest.mark.parametrize(
    ("asked", "demos", "words"),
    [
        ({"species": "fly"}, "agent", "not of fly: give --species agent or another file"),
        ({"species": "silkmoth"}, "agent", "demonstrations of agent, not of silkmoth"),
        ({"species": "fly", "algo": "dqcil"}, "fly", "needs two experimental conditions and fly"),
        ({"algo": "qr-dqcil-pt"}, "agent alone", "all are of condition 1: choose qr-dqdil-pt"),
        ({"focal": "wolf"}, "agent", "focal is 'wolf': choose one of predator_0"),
        ({"device": "abacus"}, "", "'abacus' is unknown: choose cpu or cuda"),
        ({"device": "meta"}, "", "'meta' is unknown: choose cpu or cuda"),
        ({"preset": "fast"}, "", "preset is 'fast': choose paper or default"),
        ({"fit_method": "guess"}, "", "'guess': choose joint, onset or species"),
        ({"fit_method": "onset", "thrusts": "3"}, "", "fit_method onset fits one thrust: choose 1"),
        ({"seed": -1}, "", "seed is -1"),
        ({"copies": 0}, "", "copies is 0"),
        ({"acting": "wild"}, "", "acting"),
        ({"algo": "sarsa"}, "", "'sarsa' is unknown"),
        ({"species": "dodo"}, "", "'dodo' is unknown"),
    ],
)
def test_bad_run_settings_by_themselves_or_with_demonstrations(
    asked: dict[str, Any], demos: str, words: str
) -> None:
    if not demos:
        refuses(words, settings, **asked)
        return
    given = load_packaged(demos.removesuffix(" alone"))
    given = given.select(condition=1) if demos.endswith("alone") else given
    refuses(words, checked_species, settings(**asked), given)


def refused(kind: type[SequenceQLearning], policy: str, **more: Any) -> str:
    return refuses("", kind, policy, toys.Pair(2), **SETTINGS | more)


def test_settings_that_do_not_go_together_are_refused() -> None:
    said = refused(DQN, "GruPolicy", sequence_length=1)
    assert "sequence_length is 1" in said and "MlpPolicy" in said
    assert "sequence_length" in refused(DQN, "GruPolicy", sequence_length=1, state_mode="zero")
    for policy, more in (
        ("MlpPolicy", {}),
        ("GruPolicy", {"state_mode": "stored"}),
        ("GruPolicy", {"sequence_length": 3, "burn_in": 2}),
    ):
        DQN(policy, toys.Pair(2), **SETTINGS | {"sequence_length": 1} | more).learn(20)
    assert "updates_per_episode" in refused(DQN, "GruPolicy", gradient_steps=50)
    DQN("GruPolicy", toys.Pair(2), **SETTINGS, gradient_steps=50, train_freq=4)
    for kind, count in ((DQN, 5), (QRDQN, None)):
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


def test_named_demonstrations_serve_an_environment_without_names() -> None:
    prey = {"focal": "prey", "observation": "full"}
    single = DTWReward(gym.make("AnimaRL/Agent-v0", **prey))
    shown = SlotVecEnv("agent", 1, focal="prey").offline_data()
    model = DQDIL("GruPolicy", single, demonstrations=shown, offline_epochs=1, device="cpu")
    assert model.pretrain().done


def test_pretraining_needs_epochs_and_again_changes_nothing() -> None:
    cloning = BC("GruPolicy", toys.Pair(2), demonstrations=demonstrations(), **SETTINGS)
    assert cloning.settings.offline_epochs == BC.default_settings()["offline_epochs"] > 0
    assert "give offline_epochs" in refused(BC, "GruPolicy", offline_epochs=0)
    without = make_pair_learner("dqdil", demonstrations=demonstrations())
    refuses("give offline_epochs", without.pretrain)
    model = make_pair_learner("dqdil-pt")
    progress = model.pretrain()
    after = weights(model)
    assert model.pretrain() is progress and progress.epoch == len(progress.history) == 2
    assert (weights(model) == after).all()
