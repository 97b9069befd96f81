"""The recipes: they run, repeat, save, load, refuse what they cannot use, and are independent."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import torch
import toys
from given_values import GivenValues
from gymnasium import spaces
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.logger import configure

from animarl_algos.base import SequenceQLearning
from animarl_algos.dqaas import DQAAS
from animarl_algos.dqcil import DQCIL
from animarl_algos.dqdil import DQDIL
from animarl_algos.dqn import DQN
from animarl_algos.exploration import LinearDecay, boltzmann_nll, fit_boltzmann_temperature
from animarl_algos.offline import demonstrated_rank
from animarl_algos.offline_data import OfflineDataset
from animarl_algos.recipes import RECIPES, named_recipe
from animarl_algos.recurrent.batch import SequenceBatch
from animarl_algos.terms import (
    ScoredActionsTemporalDifference,
    TemporalDifference,
    TreatmentAdversary,
)
from animarl_algos.updates import evaluate, sequence_priorities, update
from animarl_envs.errors import InputError

SETTINGS: dict[str, Any] = {
    "learning_rate": 1e-3,
    "buffer_size": 2000,
    "batch_size": 4,
    "target_update_interval": (5, "episode"),
    "exploration_steps": 200,
    "offline_batch_size": 8,
    "policy_kwargs": {"hidden": 8},
    "seed": 3,
    "device": "cpu",
}


EPISODES = 48


class FlaggedPair(toys.Pair):
    """The pair, with the number of its copy modulo two as experimental condition."""

    num_observations = 5
    condition_flag = True

    def observe(self) -> Any:
        flag = np.broadcast_to(
            (np.arange(self.num_copies) % 2)[:, None, None], (self.num_copies, 2, 1)
        )
        return np.concatenate([super().observe(), flag], axis=-1)


@dataclass(frozen=True)
class Split:
    train: OfflineDataset
    val: OfflineDataset


def demonstrations(
    flag: bool = False, individuals: tuple[str, ...] = toys.Pair.individuals
) -> Split:
    """Random episodes in which the demonstrated action can be told from the observation."""
    data = []
    for seed in (0, 1):
        rng = np.random.default_rng(seed)
        lengths = rng.integers(4, 9, size=EPISODES)
        frames, k = int(lengths.sum()), len(toys.Pair.individuals)
        observations = rng.normal(size=(frames, k, 4 + flag))
        actions = observations[..., :3].argmax(-1)
        actions[np.cumsum(lengths) - 1] = -1
        condition = np.arange(EPISODES) % 2
        if flag:
            observations[..., -1] = np.repeat(condition, lengths)[:, None]
        own = [toys.Pair.individuals.index(name) for name in individuals]
        data.append(
            OfflineDataset(
                observations[:, own],
                actions[:, own],
                lengths,
                3,
                rewards=0.1 * rng.normal(size=(frames, k))[:, own],
                action_penalties=(np.arange(3) != actions[..., None]).astype(float)[:, own],
                terminated=np.ones(EPISODES, dtype=bool),
                condition=condition,
                names=individuals,
            )
        )
    return Split(*data)


def make(name: str, policy: str = "GruPolicy", **more: Any) -> SequenceQLearning:
    """Recipe ``name`` on the pair, with demonstrations where it needs them."""
    torch.set_num_threads(1)
    named = named_recipe(name)
    flag = named.algorithm.recipe.needs_condition
    settings = SETTINGS | more
    if named.pretrained:
        settings = {"demonstrations": demonstrations(flag), "offline_epochs": 2} | settings
    return named.algorithm(policy, FlaggedPair(2) if flag else toys.Pair(2), **settings)


def weights(model: SequenceQLearning) -> torch.Tensor:
    return torch.cat([p.detach().flatten() for p in model.policy.q_net.parameters()])


# -- they run -------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", RECIPES)
def test_every_recipe_trains_repeats_saves_and_loads(name: str, tmp_path: Path) -> None:
    model = make(name)
    before = weights(model)
    model.learn(60)
    assert torch.isfinite(weights(model)).all() and not torch.equal(before, weights(model))
    assert torch.equal(weights(model), weights(make(name).learn(60)))
    model.save(tmp_path / "model")
    env = model.get_env()
    assert env is not None
    loaded = type(model).load(tmp_path / "model", env=env, device="cpu")
    assert torch.equal(weights(model), weights(loaded))
    assert loaded.policy.epsilon == model.exploration_rate
    observation = env.reset()
    expected, state = model.predict(observation, deterministic=True)
    actions, loaded_state = loaded.predict(observation, deterministic=True)
    np.testing.assert_array_equal(actions, expected)
    assert state is not None and loaded_state is not None
    np.testing.assert_array_equal(state[0], loaded_state[0])
    loaded.learn(30)


@pytest.mark.cuda
@pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA device")
@pytest.mark.parametrize("name", ["dqaas", "dqcil-pt", "qr-dqdil-pt"])
def test_a_cuda_device_learns_the_same(name: str) -> None:
    """Offline, where no draw depends on rounding: the validation figures of the CPU."""
    figures = []
    for device in ("cpu", "cuda"):
        model = make(name, device=device)
        figures.append(model.pretrain().history[-1]["val/cross_entropy"])
        model.learn(60)
        assert torch.isfinite(weights(model)).all()
    assert figures[1] == pytest.approx(figures[0], rel=1e-3)


def test_load_without_environment_predicts(tmp_path: Path) -> None:
    model = make("dqn").learn(40)
    model.save(tmp_path / "model")
    loaded = DQN.load(tmp_path / "model", device="cpu")
    observation = np.ones((4, 4), dtype=np.float32)
    np.testing.assert_array_equal(
        loaded.predict(observation, deterministic=True)[0],
        model.predict(observation, deterministic=True)[0],
    )


@pytest.mark.parametrize("policy", ["GruPolicy", "MlpPolicy"])
def test_an_ordinary_gymnasium_environment(policy: str) -> None:
    env = toys.VelocityMasked(gym.make("CartPole-v1"))
    model = DQN(policy, env, **SETTINGS, train_freq=(4, "step"), sequence_length=8, burn_in=4)
    model.learn(300)
    assert model._n_updates > 0 and model.num_timesteps == 300
    assert len(model.ep_info_buffer) == model._episode_num  # type: ignore[arg-type]
    mean, _ = evaluate_policy(model, model.get_env(), n_eval_episodes=2, warn=False)
    assert mean > 0


def test_steps_are_counted_in_the_world() -> None:
    model = make("dqn").learn(50)
    assert model.n_envs == 4 and model.layout.num_copies == 2
    assert model.num_timesteps == 50
    assert model.replay_buffer is not None
    running = int(model.replay_buffer.step_count.sum())
    assert model.replay_buffer.num_steps + running == 50


def test_learn_can_be_continued_with_its_memory() -> None:
    """Two calls are one: the same weights as learning in one go ."""
    once = make("dqn", prioritized=False).learn(120)
    twice = make("dqn", prioritized=False).learn(60)
    twice.learn(60, reset_num_timesteps=False)
    assert torch.equal(weights(once), weights(twice))


def test_progress_callbacks_and_logs(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    seen = []

    def callback(variables: dict[str, Any], _: dict[str, Any]) -> bool:
        seen.append(variables["self"].num_timesteps)
        return True

    model = make("dqcil-pt")
    model.set_logger(configure(str(tmp_path), ["csv"]))
    model.learn(60, callback=callback, log_interval=1, progress_bar=True)
    assert seen == list(range(2, 61, 2))
    bars = capsys.readouterr().err
    assert "60/60" in bars and "2/2" in bars
    columns = (tmp_path / "progress.csv").read_text().splitlines()[0].split(",")
    for column in (
        "offline/val/mean_rank/seeker",
        "offline/val/treatment_balanced_accuracy",
        "train/td/avoider",
        "train/treatment/seeker",
        "train/treatment_balanced_accuracy/seeker",
        "rollout/exploration_rate",
        "rollout/buffer_episodes",
        "time/fps",
    ):
        assert column in columns


@pytest.mark.parametrize("prioritized", [False, True])
def test_updates_follow_episodes(prioritized: bool) -> None:
    model = make("dqn", prioritized=prioritized, updates_per_episode=0.5).learn(120)
    assert model._n_updates == model._episode_num // 2


# -- known answers --------------------------------------------------------------------------------


def three_steps() -> SequenceBatch:
    """One episode of three steps and two actions, for one individual; the last step terminates."""
    column = (1, 3, 1)
    return SequenceBatch(
        observations=torch.zeros(1, 4, 1, 2),
        previous_actions=torch.full((1, 4, 1), 2),
        actions=torch.tensor([0, 1, 0]).view(column),
        rewards=torch.tensor([1.0, 0.0, 2.0]).view(column),
        penalties=torch.tensor([0.5, 0.0, 1.0]).view(column),
        terminated=torch.tensor([0.0, 0.0, 1.0]).view(column),
        mask=torch.tensor([1.0, 1.0, 1.0]).view(column),
        weights=torch.ones(1, 1),
        starts=torch.zeros(1, 1, dtype=torch.int64),
        lengths=torch.full((1, 1), 3),
        indices=np.zeros((1, 1), dtype=np.int64),
        labels=torch.tensor([0, 1, 0]).view(column),
        condition=torch.zeros(1, 1),
        active=np.ones(4, dtype=np.int64),
        action_penalties=torch.tensor([[0.0, 1.0], [1.0, 0.0], [0.0, 2.0]]).view(1, 3, 1, 2),
    )


def evaluated(recipe: type[SequenceQLearning] = DQDIL) -> Any:
    """Values: online (1, 2), (3, 1), (0, 4), (9, 9); the target network's ten times; gamma 0.5."""
    model = recipe("MlpPolicy", toys.Recall(2), **SETTINGS, alpha=2.0, gamma=0.5)
    policy = model.policy
    evaluation = evaluate(
        three_steps(),
        model.phase("online"),
        policy.q_net,
        policy.q_net_target,
        policy.distribution,
        needs_target=True,
    )
    online = torch.tensor([[1.0, 2.0], [3.0, 1.0], [0.0, 4.0], [9.0, 9.0]]).view(1, 4, 1, 2, 1)
    evaluation.online, evaluation.target = GivenValues(online), GivenValues(10.0 * online)
    return evaluation


def test_temporal_difference_by_hand() -> None:
    """Targets: 1 + 15 = 16, 0 + 20 = 20, 2; values of the actions taken 1, 1, 0."""
    evaluation = evaluated()
    loss = TemporalDifference()(evaluation)
    assert loss.item() == pytest.approx((15**2 + 19**2 + 2**2) / 3)
    priority = sequence_priorities(evaluation)
    assert priority is not None
    assert priority.item() == pytest.approx(0.9 * 19 + 0.1 * (15 + 19 + 2) / 3)


def test_the_distance_is_subtracted_with_its_weight() -> None:
    """Rewards become 0, 0, 0."""
    loss = TemporalDifference(shaped=True)(evaluated())
    assert loss.item() == pytest.approx((14**2 + 19**2 + 0) / 3)


def test_all_actions_are_scored_by_hand() -> None:
    """Targets: (16, 14), (18, 20), (2, -2)."""
    loss = ScoredActionsTemporalDifference()(evaluated())
    squares = [15**2 + 12**2, 15**2 + 19**2, 2**2 + 6**2]
    assert loss.item() == pytest.approx(sum(squares) / 6)


def test_masked_steps_enter_no_loss() -> None:
    evaluation = evaluated()
    evaluation.valid[0, 1] = False
    assert TemporalDifference()(evaluation).item() == pytest.approx((15**2 + 2**2) / 2)


def test_the_reversal_turns_the_encoders_gradient_alone() -> None:
    """Gradient of J_tr: minus the plain one before the reversal, the plain one behind it."""
    gradients = {}
    for reversal in (1.0, -1.0):  # a reversal of -1 is the identity
        model = make("dqcil", policy_kwargs={"hidden": 8, "reversal": reversal})
        model.updates_per_episode = 0.0
        model.learn(40)
        assert model.replay_buffer is not None
        evaluation = evaluate(
            model.replay_buffer.sample(4),
            model.phase("online"),
            model.policy.q_net,
            model.policy.q_net_target,
            model.policy.distribution,
            needs_target=False,
        )
        model.policy.optimizer.zero_grad()
        TreatmentAdversary()(evaluation).sum().backward()  # type: ignore[no-untyped-call]
        gradients[reversal] = {
            name: p.grad for name, p in model.policy.q_net.named_parameters() if p.grad is not None
        }
    assert any(name.startswith("gru") for name in gradients[1.0])
    for name, gradient in gradients[1.0].items():
        sign = 1.0 if name.startswith("treatment") else -1.0
        torch.testing.assert_close(gradient, sign * gradients[-1.0][name])


def test_ties_rank_as_chance_does() -> None:
    values = np.array([[1.0, 1.0, 1.0], [3.0, 2.0, 1.0], [0.0, 5.0, 5.0]])
    np.testing.assert_array_equal(demonstrated_rank(values, np.array([0, 2, 1])), [2.0, 3.0, 1.5])


def test_the_temperature_is_recovered() -> None:
    rng = np.random.default_rng(0)
    values = rng.normal(size=(20_000, 5))
    gumbel = rng.gumbel(size=values.shape)
    actions = (values / 0.3 + gumbel).argmax(1)  # samples of softmax(values / 0.3)
    fitted = fit_boltzmann_temperature(values, actions)
    assert fitted == pytest.approx(0.3, rel=0.03)
    assert boltzmann_nll(values, actions, fitted) <= boltzmann_nll(values, actions, 0.3)


def test_epsilon_decays_linearly_then_stays() -> None:
    decay = LinearDecay(0.5, 0.3, 100)
    assert [decay(n) for n in (0, 50, 100, 1000)] == pytest.approx([0.5, 0.4, 0.3, 0.3])


# -- independence ---------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["bc", "dqaas", "dqdil-pt", "qr-dqdil-pt"])
def test_individuals_together_are_individuals_alone(name: str) -> None:
    """Offline, from the same demonstrations and seed: the same weights, to rounding."""

    class Alone(toys.Recall):
        num_observations = 4

    together = make(name)
    together.pretrain()
    for k, who in enumerate(toys.Pair.individuals):
        env = Alone(2)
        env.individuals = (who,)
        settings = SETTINGS | {"offline_epochs": 2}
        alone = named_recipe(name).algorithm(
            "GruPolicy", env, demonstrations=demonstrations(individuals=(who,)), **settings
        )
        run = alone.pretrain()
        pairs = zip(together.offline_progress.history, run.history, strict=True)
        for whole, single in pairs:
            assert whole[f"val/mean_rank/{who}"] == pytest.approx(single["val/mean_rank"])
        if run.best_epoch == together.offline_progress.best_epoch:
            for ours, own in zip(
                together.policy.q_net.parameters(), alone.policy.q_net.parameters(), strict=True
            ):
                torch.testing.assert_close(ours[k], own[0], atol=1e-6, rtol=1e-5)


def test_replayed_individuals_together_are_individuals_alone() -> None:
    """Online updates from one fixed memory: the same weights, to rounding."""
    together = make("dqdil").learn(100)
    start = make("dqdil")
    together.policy.load_state_dict(start.policy.state_dict())
    together.reset_optimizer(1e-3)
    assert together.replay_buffer is not None
    losses = []
    alone = [DQDIL("GruPolicy", toys.Pair(2), **SETTINGS) for _ in range(2)]
    single = []
    for k, who in enumerate(toys.Pair.individuals):
        env = toys.Pair(2)
        env.individuals = (who,)
        toys.VecEnv.__init__(env, 2, env.observation_space, env.action_space)
        single.append(DQDIL("GruPolicy", env, **SETTINGS))
        for ours, own in zip(
            alone[k].policy.q_net.parameters(), single[k].policy.q_net.parameters(), strict=True
        ):
            torch.testing.assert_close(ours[k], own[0])
    for _ in range(5):
        batch = together.replay_buffer.sample(4).clone()
        for model, part in [(together, batch), *[(single[k], batch.individual(k)) for k in (0, 1)]]:
            policy = model.policy
            evaluation = evaluate(
                part,
                model.phase("online"),
                policy.q_net,
                policy.q_net_target,
                policy.distribution,
                needs_target=True,
            )
            losses.append(update(evaluation, model.recipe.online, policy.optimizer))
    for k in (0, 1):
        for ours, own in zip(
            together.policy.q_net.parameters(), single[k].policy.q_net.parameters(), strict=True
        ):
            torch.testing.assert_close(ours[k], own[0], atol=1e-6, rtol=1e-5)


# -- the offline phase ----------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["bc", "dqaas", "dqdil-pt", "dqcil-pt", "qr-bc", "qr-dqdil-pt"])
def test_the_demonstrated_action_comes_to_rank_first(name: str) -> None:
    settings = {"offline_learning_rate": 1e-2, "offline_alpha": 1.0, "offline_gamma": 0.5}
    model = make(name, offline_epochs=25, **settings)
    history = model.pretrain().history
    best = history[model.offline_progress.best_epoch - 1]
    assert best["val/top_1"] > 0.6  # chance: one third
    figure = f"val/{model.recipe.selection}"
    assert best[figure] == min(row[figure] for row in history)
    if name == "dqcil-pt":
        assert 0.0 <= best["val/treatment_balanced_accuracy"] <= 1.0


def test_patience_stops_early() -> None:
    model = make("bc", offline_epochs=50, offline_patience=2, offline_learning_rate=0.3)
    progress = model.pretrain()
    assert progress.done and progress.epoch == progress.best_epoch + 2 < 50


# -- bad input ------------------------------------------------------------------------------------


def test_what_a_recipe_needs_is_asked_for_before_training() -> None:
    with pytest.raises(InputError, match="'dtw_penalty'"):
        DQDIL("GruPolicy", toys.Recall(2), **SETTINGS).learn(10)
    with pytest.raises(InputError, match="'aligned_action'"):
        DQAAS("GruPolicy", toys.Recall(2), **SETTINGS).learn(10)
    with pytest.raises(InputError, match="condition flag"):
        DQCIL("GruPolicy", toys.Pair(2), **SETTINGS).learn(10)
    with pytest.raises(InputError, match="was given demonstrations"):
        DQDIL("GruPolicy", toys.Pair(2), **SETTINGS, offline_epochs=1).learn(10)
    with pytest.raises(InputError, match="learns without demonstrations"):
        DQN("GruPolicy", toys.Pair(2), **SETTINGS, offline_epochs=1)
    with pytest.raises(InputError, match="2 individuals with 4"):
        DQDIL(
            "GruPolicy",
            toys.Lock(2),
            demonstrations=demonstrations(),
            offline_epochs=1,
            **SETTINGS,
        ).learn(10)


def test_bad_settings_are_refused() -> None:
    with pytest.raises(InputError, match="choose one of dqn, bc"):
        named_recipe("dqm")
    with pytest.raises(InputError, match="'CnnPolicy' is unknown"):
        DQN("CnnPolicy", toys.Pair(2))
    for wrong, message in (
        ({"gamma": 1.5}, "online gamma is 1.5"),
        ({"offline_alpha": -1.0}, "offline alpha is -1.0"),
        ({"batch_size": 0}, "batch_size is 0"),
        ({"train_freq": (1, "game")}, "train_freq"),
        ({"exploration_final_eps": 2.0}, "exploration_final_eps"),
    ):
        with pytest.raises(InputError, match=message):
            DQN("GruPolicy", toys.Pair(2), **SETTINGS | wrong).learn(5)
    continuous = gym.make("Pendulum-v1")
    assert isinstance(continuous.action_space, spaces.Box)
    with pytest.raises(InputError, match="does not suit"):
        DQN("GruPolicy", continuous)
