"""The recipes: they run, repeat, save, load, log, and learn offline."""

import sys
from contextlib import closing
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import torch
import toys
from pair_learners import SETTINGS, demonstrations, make_pair_learner, weights
from reference_learner import ALPHA, ReferenceLearner
from scripted_pair import ScriptedPair, log_draws
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.logger import Logger, configure

from animarl_algos.networks.acting_rule import Acting, Kind
from animarl_algos.recipes.registry import DQDIL, DQN, RECIPES, named_recipe
from animarl_envs.wrappers import DTWReward


@pytest.mark.parametrize("name", RECIPES)
def test_every_recipe_trains_repeats_saves_and_loads(name: str, tmp_path: Path) -> None:
    model = make_pair_learner(name)
    before = weights(model)
    model.learn(60)
    assert torch.isfinite(weights(model)).all() and not torch.equal(before, weights(model))
    assert torch.equal(weights(model), weights(make_pair_learner(name).learn(60)))
    model.save(tmp_path / "model")
    env = model.get_env()
    assert env is not None
    loaded = type(model).load(tmp_path / "model", env=env, device="cpu")
    assert torch.equal(weights(model), weights(loaded))
    assert loaded.policy.acting == model.policy.acting
    observation = env.reset()
    expected, state = model.predict(observation, deterministic=True)
    actions, loaded_state = loaded.predict(observation, deterministic=True)
    np.testing.assert_array_equal(actions, expected)
    assert state is not None and loaded_state is not None
    np.testing.assert_array_equal(state[0], loaded_state[0])
    loaded.demonstrations = model.demonstrations
    loaded.learn(30)


@pytest.mark.parametrize("name", ["dqn", "dqdil-pt", "dqcil-pt", "qr-dqdil"])
def test_individuals_that_share_a_network_do_so_to_the_end(name: str, tmp_path: Path) -> None:
    kwargs = SETTINGS["policy_kwargs"] | {"shared": True}
    model = make_pair_learner(name, policy_kwargs=kwargs)
    before = weights(model)
    model.learn(60)
    model.save(tmp_path / "model")
    loaded = type(model).load(tmp_path / "model", env=model.get_env(), device="cpu")
    loaded.demonstrations = model.demonstrations
    loaded.learn(30)
    assert not torch.equal(before, weights(model)) and model.q_net.shared_parameters
    for learner in (model, loaded):
        for weight in learner.q_net.shared_parameters:
            torch.testing.assert_close(weight[0], weight[1], rtol=0, atol=1e-6)


@pytest.mark.cuda
@pytest.mark.parametrize("name", ["dqaas", "dqcil-pt", "qr-dqdil-pt"])
def test_a_cuda_device_learns_the_same(name: str) -> None:
    """Offline, where no draw depends on rounding: the validation figures of the CPU."""
    figures = []
    for device in ("cpu", "cuda"):
        model = make_pair_learner(name, device=device)
        figures.append(model.pretrain().history[-1]["val/cross_entropy"])
        model.learn(60)
        assert torch.isfinite(weights(model)).all()
    assert figures[1] == pytest.approx(figures[0], rel=1e-3)


@pytest.mark.parametrize("policy", ["GruPolicy", "MlpPolicy"])
def test_an_ordinary_gymnasium_environment(policy: str) -> None:
    env = toys.VelocityMasked(gym.make("CartPole-v1"))
    now = {"learning_starts": 0, "train_freq": (4, "step"), "gradient_steps": 4}
    model = DQN(policy, env, **SETTINGS | now, sequence_length=8, burn_in=4)
    model.learn(300)
    assert model._n_updates > 0 and model.num_timesteps == 300
    assert len(model.ep_info_buffer) == model._episode_num  # type: ignore[arg-type]
    mean, _ = evaluate_policy(model, model.get_env(), n_eval_episodes=2, warn=False)
    assert mean > 0


@pytest.mark.parametrize("policy", ["GruPolicy", "MlpPolicy"])
def test_inputs_are_standardised_by_what_is_held_at_the_first_update(policy: str) -> None:
    """Once, on both networks; what is acted on is what is learned from; a loaded learner has it."""
    env = toys.VelocityMasked(gym.make("CartPole-v1"))
    late = SETTINGS | {"train_freq": (4, "step"), "learning_starts": 200, "buffer_size": 600}
    late |= {"gradient_steps": 4}
    length = 8 if policy == "GruPolicy" else 1
    model = DQN(policy, env, **late, standardise_inputs=True, sequence_length=length)
    network = model.policy.q_net
    model.learn(196)
    assert torch.isinf(network.input_limit).all() and not network.input_mean.any()
    model.learn(4, reset_num_timesteps=False)
    assert model.replay_buffer is not None and model._n_updates > 0
    mean, sd = model.replay_buffer.moments()
    np.testing.assert_allclose(network.input_mean[:, 0], mean)
    np.testing.assert_allclose(network.input_sd[:, 0], sd)
    assert torch.equal(model.policy.q_net_target.input_sd, network.input_sd)
    model.learn(200, reset_num_timesteps=False)
    np.testing.assert_allclose(network.input_sd[:, 0], sd)  # and stay


def test_inputs_that_an_offline_phase_left_as_they_were_stay_so_online() -> None:
    """Other units under trained weights would be another network."""
    raw: dict[str, Any] = {"offline_epochs": 2, "offline_kwargs": {"standardise": False}}
    raw["demonstrations"] = demonstrations()
    model = make_pair_learner("dqdil", standardise_inputs=True, **raw).learn(200)
    assert model.offline_progress.done and model._n_updates > 0
    assert torch.isinf(model.policy.q_net.input_limit).all()


def test_progress_callbacks_and_logs(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    seen = []

    def callback(variables: dict[str, Any], _: dict[str, Any]) -> bool:
        seen.append(variables["self"].num_timesteps)
        return True

    model = make_pair_learner("dqcil-pt")
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    with closing(configure(str(tmp_path), ["csv"])) as logger:
        model.set_logger(logger)
        model.learn(60, callback=callback, log_interval=1, progress_bar=True)
    assert seen == list(range(1, 61))  # once a world step, of two copies
    bars = capsys.readouterr().err
    assert "60/60" in bars and "2/2" in bars
    columns = (tmp_path / "progress.csv").read_text().splitlines()[0].split(",")
    assert set(columns) >= {
        "offline/val/mean_rank/seeker", "offline/val/treatment_balanced_accuracy",
        "train/td/avoider", "train/treatment/seeker", "train/treatment_balanced_accuracy/seeker",
        "rollout/exploration_rate", "rollout/buffer_episodes", "time/fps",
    }  # fmt: skip


def test_the_logged_balanced_accuracy_is_of_all_updates_since_the_last_log() -> None:
    """Also where single minibatches hold one condition, and know no balanced accuracy."""

    class Seen(Logger):
        figures: list[float] = []

        def dump(self, step: int = 0) -> None:
            self.figures += [v for k, v in self.name_to_value.items() if "balanced" in k]
            super().dump(step)

    model = make_pair_learner("dqcil", batch_size=1)
    model.set_logger(Seen(None, []))
    model.learn(300, log_interval=10)
    assert Seen.figures and all(0.0 <= figure <= 1.0 for figure in Seen.figures)


def test_ctrl_c_in_random_steps_keeps_the_temperature(monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(*_: Any) -> Any:
        raise KeyboardInterrupt

    model = DQN("GruPolicy", toys.Pair(2), **SETTINGS, learning_starts=150)
    model.policy.acting = Acting.boltzmann(0.7)
    monkeypatch.setattr(model.policy, "predict", interrupted)
    with pytest.raises(KeyboardInterrupt):
        model.learn(10)
    assert model.policy.acting == Acting.boltzmann(0.7)


def test_what_a_callback_leaves_in_the_acting_rule_changes_no_step() -> None:
    def greedy(variables: dict[str, Any], _: dict[str, Any]) -> bool:
        variables["self"].policy.acting = Acting()
        return True

    plain, watched = (make_pair_learner("dqn") for _ in range(2))
    assert torch.equal(weights(plain.learn(80)), weights(watched.learn(80, callback=greedy)))


def test_online_collection_samples_at_temperatures_fitted_after_the_offline_phase() -> None:
    fitted = make_pair_learner("dqdil-pt", exploration="boltzmann")
    fitted.learn(80)
    by_hand = make_pair_learner("dqdil-pt", exploration="epsilon")
    by_hand.pretrain()
    temperatures = by_hand.fit_temperature(by_hand.demonstration_data().val)
    assert by_hand.policy.acting.kind is Kind.EPSILON
    by_hand.policy.acting = Acting.boltzmann(temperatures)
    by_hand.learn(80)
    assert fitted.policy.acting.temperature == tuple(temperatures)
    assert torch.equal(weights(fitted), weights(by_hand))


def test_without_an_offline_phase_there_is_nothing_to_fit() -> None:
    sampled, plain = (make_pair_learner("dqn", exploration=e) for e in ("boltzmann", "epsilon"))
    assert torch.equal(weights(sampled.learn(60)), weights(plain.learn(60)))
    assert sampled.policy.acting.kind is Kind.EPSILON


def test_a_learner_may_begin_as_a_clone_whose_state_values_are_zero() -> None:
    clone, adapting = (
        make_pair_learner(name, offline_loss="cloning", offline_epochs=5)
        for name in ("soft-bc", "dqdil-pt")
    )
    cloned = make_pair_learner("soft-bc", offline_epochs=5)
    for model in (clone, adapting, cloned):
        model.pretrain()
    values, weight = "dueling.value.", cloned.policy.q_net.state_dict()
    for model in (clone, adapting):
        for network in (model.policy.q_net, model.policy.q_net_target):
            for name, found in network.state_dict().items():
                zero = name.startswith(values)
                assert torch.equal(found, torch.zeros_like(found) if zero else weight[name])
    assert any(w.abs().max() > 0 for name, w in weight.items() if name.startswith(values))


@pytest.mark.parametrize("name", ["dqdil-pt", "dqaas", "dqcil-pt"])
def test_cloning_keeps_the_adversary_and_the_online_phase(name: str) -> None:
    recipe = make_pair_learner(name).recipe
    cloning = recipe.cloning()
    assert [t.name for t in cloning.offline] == ["supervision", "treatment"][
        : 1 + recipe.needs_condition
    ]
    assert cloning.online == recipe.online


@pytest.mark.parametrize(
    "name", ["bc", "soft-bc", "dqaas", "dqdil-pt", "dqcil-pt", "qr-bc", "qr-dqdil-pt"]
)
def test_the_demonstrated_action_comes_to_rank_first(name: str) -> None:
    settings = {"offline_learning_rate": 1e-2, "offline_alpha": 1.0, "offline_gamma": 0.5}
    model = make_pair_learner(name, offline_epochs=50, **settings)
    progress = model.pretrain()
    for k, who in enumerate(model.layout.individuals):
        best = progress.history[progress.best_epochs[k] - 1]
        assert best[f"val/top_1/{who}"] > 0.6  # chance: one third
        figure = f"val/{model.recipe.selection}/{who}"
        assert best[figure] == min(row[figure] for row in progress.history)
        if name == "dqcil-pt":
            assert 0.0 <= best["val/treatment_balanced_accuracy"] <= 1.0


NEVER = 10**9
WIRING: dict[str, Any] = {
    "buffer_size": 1000, "batch_size": 3, "offline_epochs": 0, "policy_kwargs": {"hidden": 6},
    "seed": 2, "device": "cpu",
}  # fmt: skip


def test_steps_before_learning_starts_are_acted_at_random() -> None:
    env, greedily = ScriptedPair(2), {"exploration_initial_eps": 0.0, "exploration_final_eps": 0.0}
    late = greedily | {"learning_starts": 200, "updates_per_episode": 0.0}
    model = DQDIL("GruPolicy", env, **WIRING, **late).learn(400)
    greedy = []
    state, begins = model.policy.initial_state(4), np.ones(4, dtype=bool)
    for step in env.steps:
        acted = step.actions.ravel()
        chosen, (hidden, _) = model.policy.predict(
            step.observations.reshape(4, -1), state, begins, deterministic=True
        )
        greedy.append(chosen == acted)
        state, begins = (hidden, acted), np.repeat(step.done, 2)
    assert np.mean(greedy[:100]) == pytest.approx(1 / 3, abs=0.1)  # four standard errors
    assert np.all(greedy[100:])


def test_the_task_reward_is_stored_where_the_reward_is_shaped_already() -> None:
    env = DTWReward(gym.make("AnimaRL/Agent-v0"), alpha=3.0)
    model = DQDIL("MlpPolicy", env, **WIRING, learning_starts=NEVER, alpha=3.0)
    shaped: list[list[float]] = [[]]
    task: list[list[float]] = [[]]

    class Watch(BaseCallback):
        def _on_step(self) -> bool:
            shaped[-1].append(self.locals["rewards"][0])
            info = self.locals["infos"][0]
            task[-1].append(info["task_reward"] - info["dtw_refund"])
            if self.locals["dones"][0]:
                shaped.append([])
                task.append([])
            return True

    model.learn(400, callback=Watch())
    assert model.replay_buffer is not None
    batch = model.replay_buffer.sample(20)
    for column, episode in enumerate(batch.indices[0]):
        found = batch.rewards[0, : len(task[episode]), column].numpy()
        np.testing.assert_array_equal(found, np.float32(task[episode]))
        assert not np.allclose(found, shaped[episode])


def test_the_target_is_renewed_after_every_offline_epoch() -> None:
    model = make_pair_learner(
        "dqdil-pt", demonstrations=demonstrations(), offline_epochs=3, offline_learning_rate=1e-2
    )
    seen = []

    class Look:
        def at_boundary(self) -> None:
            nets = (model.policy.q_net, model.policy.q_net_target)
            seen.append([torch.cat([p.detach().flatten() for p in n.parameters()]) for n in nets])

        def release(self) -> None:
            pass

    model.boundary_hooks = [Look()]
    model.pretrain()
    assert len(seen) == 3
    for online, target in seen:
        assert torch.equal(online, target)
    assert not torch.equal(seen[0][0], seen[1][0])


STEPS = 120
TOLERANCE = 1e-4
FOLLOWED: dict[str, Any] = {
    "learning_rate": lambda remaining: 0.01 * remaining, "buffer_size": 1000, "batch_size": 3,
    "gamma": 0.9, "alpha": 0.7, "lambda1": 1e-3, "lambda2": 0.6, "lambda3": 0.8,
    "max_grad_norm": 1.0, "tau": 0.3, "target_update_interval": (10, "step"), "learning_starts": 20,
    "exploration": "epsilon", "exploration_initial_eps": 0.5, "exploration_final_eps": 0.3,
    "exploration_steps": 100, "offline_epochs": 0, "seed": 5, "device": "cpu",
}  # fmt: skip
PIECES = {"sequence_length": 5, "burn_in": 2}
PAPERS_NETWORK: dict[str, Any] = {
    "hidden": 6, "depth": 2, "head_layers": 1, "dropout": 0.0, "previous_action": None
}  # fmt: skip
MEMORIES: dict[str, tuple[str, dict[str, Any]]] = {
    "recomputed state": ("GruPolicy", PIECES | {"state_mode": "recompute"}),
    "stored state": ("GruPolicy", PIECES | {"state_mode": "stored"}),
    "whole episodes": ("GruPolicy", {}),
    "feed-forward": ("MlpPolicy", PIECES),
}


@pytest.mark.parametrize("memory", MEMORIES)
@pytest.mark.parametrize("name", ["dqdil", "dqaas", "dqcil", "qr-dqdil", "qr-dqaas", "qr-dqcil"])
def test_a_run_equals_its_reference(name: str, memory: str) -> None:
    policy, pieces = MEMORIES[memory]
    env = ScriptedPair(2, flagged="dqcil" in name)
    network = PAPERS_NETWORK | ({"n_quantiles": 4} if name.startswith("qr") else {})
    model = named_recipe(name).algorithm(policy, env, **FOLLOWED, **pieces, policy_kwargs=network)
    references = [ReferenceLearner(model, k, STEPS) for k in range(2)]
    log_draws(model, env)
    model.learn(STEPS)
    assert model._n_updates >= 8
    nets = (model.policy.q_net, model.policy.q_net_target)
    buffer = model.replay_buffer
    assert buffer is not None
    for k, reference in enumerate(references):
        begun = dict(reference.online)
        reference.follow(env.log)
        for net, expected in zip(nets, (reference.online, reference.target)):
            for part, parameter in net.named_parameters():
                torch.testing.assert_close(
                    parameter[k].double(), expected[part], rtol=0.0, atol=TOLERANCE, msg=part
                )
        moved = [(reference.online[n] - begun[n]).abs().max() for n in begun]
        assert max(moved) > 100 * TOLERANCE
        held = buffer.trees.priorities[k][: buffer.num_sequences]
        expected = np.array(reference.priorities) ** ALPHA
        np.testing.assert_allclose(held, expected, rtol=0.0, atol=TOLERANCE)


def test_the_run_holds_every_case() -> None:
    """Both ends, at different times in the two copies, and labels missing."""
    env = ScriptedPair(2)
    named_recipe("dqaas").algorithm("GruPolicy", env, **FOLLOWED).learn(STEPS)
    assert any(step.terminated.any() for step in env.steps)
    assert any(step.truncated.any() for step in env.steps)
    assert sum(step.done[0] != step.done[1] for step in env.steps) > 10
    assert any((step.labels < 0).any() for step in env.steps)
