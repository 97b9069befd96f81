"""What users of stable-baselines3 write out of habit: understood, or refused in one sentence."""

import warnings
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import stable_baselines3
import torch
import toys
from pair_learners import SETTINGS
from refusals import refuses
from stable_baselines3.common.callbacks import EvalCallback
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.torch_layers import FlattenExtractor, NatureCNN
from stable_baselines3.common.vec_env import VecMonitor
from torch import nn

from animarl_algos import DQDIL, DQN, QRDQN, EvaluateIndividuals, SlotVecEnv, evaluate_individuals
from animarl_algos.data.vec_env import MixedMeansWarning

CARTPOLE = "CartPole-v1"


def learner(kind: Any = DQN, **more: Any) -> Any:
    settings = SETTINGS | {"device": "cpu"} | more
    return kind("MlpPolicy", toys.Pair(2), **settings)


def test_clients_give_the_learning_rate_third() -> None:
    model = DQN("MlpPolicy", gym.make(CARTPOLE), 3e-3, device="cpu")
    assert model.learning_rate == 3e-3
    assert model.policy.optimizer.param_groups[0]["lr"] == 3e-3
    falling = DQN("MlpPolicy", gym.make(CARTPOLE), lambda left: 1e-3 * left, device="cpu")
    assert falling.lr_schedule(0.5) == 5e-4


def test_clients_list_layers() -> None:
    habits: dict[str, Any] = {
        "net_arch": [48, 48, 48], "activation_fn": nn.ReLU,
        "features_extractor_class": FlattenExtractor, "features_extractor_kwargs": {},
    }  # fmt: skip
    ours = {"hidden": 48, "depth": 3}
    shapes = [
        {name: p.shape for name, p in learner(policy_kwargs=table).policy.named_parameters()}
        for table in (habits, ours)
    ]
    assert shapes[0] == shapes[1]
    assert shapes[0]["q_net.encoder_3.weight"] == (2, 48, 48)


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ({"net_arch": [64, 32]}, r"net_arch is \[64, 32\]: .*give a list such as \[64, 64\], or"),
        ({"net_arch": []}, "net_arch is"),
        ({"net_arch": {"pi": [64], "qf": [64]}}, "net_arch is"),
        ({"net_arch": [64], "hidden": 32}, "net_arch and hidden say the same thing"),
        ({"activation_fn": nn.Tanh}, r"activation_fn is Tanh: .*give torch\.nn\.ReLU"),
        ({"features_extractor_class": NatureCNN}, "NatureCNN: .*give FlattenExtractor"),
        ({"features_extractor_kwargs": {"features_dim": 3}}, "features_dim"),
        ({"net_arch": [0]}, "hidden"),
        ({"share_features_extractor": True}, "'share_features_extractor' is unknown"),
    ],
)
def test_clients_are_told_which_layers_there_are_not(table: dict[str, Any], words: str) -> None:
    refuses(words, learner, policy_kwargs=table)


def test_clients_give_settings_by_their_place() -> None:
    model = DQN("MlpPolicy", gym.make(CARTPOLE), 1e-3, 5_000, 10, 16, 1.0, 0.9)
    assert (model.buffer_size, model.batch_size, model.gamma) == (5_000, 16, 0.9)
    assert model.device.type == "cpu"  # "auto", even where there is a GPU
    assert learner(optimize_memory_usage=False, replay_buffer_class=None).replay_buffer is not None
    refuses("optimize_memory_usage is True: .*leave it out", learner, optimize_memory_usage=True)
    refuses("'buffer_size' is given twice", DQN, "MlpPolicy", CARTPOLE, 1e-3, 10, buffer_size=9)
    refuses("9 settings have no name", DQN, "MlpPolicy", CARTPOLE, 1e-3, *range(9))


@pytest.mark.parametrize("kind", [DQN, QRDQN])
@pytest.mark.parametrize("policy", ["MlpPolicy", "GruPolicy"])
def test_clients_call_the_network_with_observations(kind: Any, policy: str) -> None:
    model = kind(policy, toys.Pair(2), **SETTINGS | {"device": "cpu"})
    seen = np.random.default_rng(0).normal(size=(4, 4)).astype(np.float32)
    values = model.q_net(torch.from_numpy(seen))
    assert values.requires_grad
    expected = model.policy.advance(seen, None, None)[0]
    np.testing.assert_allclose(values.detach().numpy(), expected, atol=1e-5)


def test_clients_find_networks_and_memory_under_their_names() -> None:
    model = learner()
    assert model.q_net is model.policy.q_net
    assert model.q_net_target is model.policy.q_net_target
    assert model.replay_buffer.size() == 0
    model.learn(60)
    assert model.replay_buffer.size() == model.replay_buffer.num_steps > 0


def test_clients_load_zips_of_another_learner_in_vain(tmp_path: Path) -> None:
    learner(DQN).save(tmp_path / "dqn")
    learner(QRDQN, policy_kwargs={"n_quantiles": 5}).save(tmp_path / "quantiles.zip")
    assert isinstance(DQN.load(tmp_path / "dqn", device="cpu"), DQN)
    with (tmp_path / "dqn.zip").open("rb") as file:
        assert isinstance(DQN.load(file, device="cpu"), DQN)
    for kind, name, saved in (
        (DQDIL, "dqn", "DQN"), (QRDQN, "dqn", "DQN"), (DQN, "quantiles", "QRDQN"),
    ):  # fmt: skip
        words = rf"was saved by {saved} and is no {kind.__name__}: load it with {saved}\.load"
        refuses(words, kind.load, tmp_path / name, device="cpu")


def test_clients_load_files_of_others_in_vain(tmp_path: Path) -> None:
    stable_baselines3.DQN("MlpPolicy", CARTPOLE, device="cpu").save(tmp_path / "theirs")
    (tmp_path / "text.zip").write_text("no zip")
    for name in ("theirs.zip", "text.zip"):
        words = "it is no model of DQN: load it with the class that"
        refuses(words, DQN.load, tmp_path / name, device="cpu")
    with pytest.raises(FileNotFoundError):
        DQN.load(tmp_path / "nothing", device="cpu")


def slots(**more: Any) -> SlotVecEnv:
    env = SlotVecEnv("agent", 2, split="val", time_limit=20, **more)
    env.seed(0)
    return env


def short(env: Any) -> DQN:
    return DQN("MlpPolicy", env, device="cpu", seed=0, learning_starts=10_000)


def test_clients_who_average_over_individuals_are_warned() -> None:
    model = short(slots())
    with pytest.warns(UserWarning, match="average over predator_0, predator_1, prey: use anima"):
        evaluate_policy(model, slots(), n_eval_episodes=6)
    with pytest.warns(UserWarning, match="EvaluateIndividuals"):
        model.learn(40, callback=EvalCallback(slots(), eval_freq=20, n_eval_episodes=6, verbose=0))
    with pytest.warns(UserWarning, match="EvaluateIndividuals"):
        VecMonitor(slots())


@pytest.mark.filterwarnings("ignore:Evaluation environment is not wrapped")
def test_clients_who_learn_one_individual_are_not_warned() -> None:
    model = short(slots(focal="prey"))
    with warnings.catch_warnings():
        warnings.simplefilter("error", MixedMeansWarning)
        mean, _ = evaluate_policy(model, slots(focal="prey"), n_eval_episodes=4)
    env = slots(focal="prey")
    assert evaluate_individuals(model, env, 4).mean == {"prey": pytest.approx(mean)}


@pytest.mark.parametrize("episodes", [1, 5])
def test_clients_get_the_return_of_each_individual(episodes: int) -> None:
    """Summed by hand from the same steps."""
    model, env, twin = short(slots()), slots(), slots()
    env.seed(3), twin.seed(3)
    found = evaluate_individuals(model, env, episodes)
    assert found.individuals == ("predator_0", "predator_1", "prey")
    assert found.returns.shape == (episodes, 3) and found.lengths.shape == (episodes,)
    seen, state, starts = twin.reset(), None, np.ones(6, dtype=bool)
    sums, steps, counts = np.zeros((2, 3)), np.zeros(2, dtype=int), [0, 0]
    expected, lengths = [], []
    wanted = [episodes // 2, episodes - episodes // 2]
    while counts != wanted:
        actions, state = model.predict(seen, state, starts, deterministic=True)
        seen, rewards, starts, _ = twin.step(actions)
        sums, steps = sums + rewards.reshape(2, 3), steps + 1
        for b in range(2):
            if starts[3 * b]:
                if counts[b] < wanted[b]:
                    expected.append(sums[b].copy())
                    lengths.append(steps[b])
                    counts[b] += 1
                sums[b], steps[b] = 0.0, 0
    np.testing.assert_allclose(found.returns, expected, rtol=1e-6)
    assert found.lengths.tolist() == lengths
    assert found.mean["prey"] == pytest.approx(np.mean([row[2] for row in expected]), rel=1e-6)


def test_clients_can_log_each_individual_while_learning(tmp_path: Path) -> None:
    model = short(slots())
    model.set_logger(stable_baselines3.common.logger.configure(str(tmp_path), ["csv"]))
    scored = EvaluateIndividuals(slots(), every=30, episodes=2)
    model.learn(100, callback=scored, log_interval=1)
    assert [step for step, _ in scored.history] == [30, 60, 90]
    first, second = (found.returns for _, found in scored.history[:2])
    assert np.array_equal(first, second)  # nothing was learnt, and the seed is the same
    header = (tmp_path / "progress.csv").read_text().splitlines()[0]
    for name in ("predator_0", "predator_1", "prey"):
        assert f"eval/mean_reward/{name}" in header


@pytest.mark.parametrize("deterministic", [True, False])
def test_clients_learn_the_same_whether_they_evaluate_or_not(deterministic: bool) -> None:
    models = [short(slots()) for _ in range(2)]
    scored = EvaluateIndividuals(slots(), every=30, episodes=2, deterministic=deterministic)
    actions = []
    for model, callback in zip(models, (None, scored), strict=True):
        model.learn(100, callback=callback)
        assert model.replay_buffer is not None
        actions.append(model.replay_buffer.frames.actions)
    np.testing.assert_array_equal(*actions)
    first, second = (found.returns for _, found in scored.history[:2])
    np.testing.assert_array_equal(first, second)  # the seed is that of the draws too


def test_clients_repeat_draws_by_seeding_the_model() -> None:
    model, drawn = short(slots()), []
    observation = np.zeros((6, *model.observation_space.shape), np.float32)
    for _ in range(2):
        model.set_random_seed(5)
        drawn.append([model.predict(observation)[0].tolist() for _ in range(20)])
    assert drawn[0] == drawn[1]


@pytest.mark.parametrize("given", [{"every": 0}, {"episodes": 0}])
def test_clients_who_never_evaluate_are_told(given: dict[str, int]) -> None:
    refuses(next(iter(given)), EvaluateIndividuals, slots(), **given)
