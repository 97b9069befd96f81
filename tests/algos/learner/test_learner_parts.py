"""The parts of a learner, each by itself, and its offline phase beyond the paper's."""

import os
import signal
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import toys
from pair_learners import SETTINGS, Interrupt, Split, demonstrations, make_pair_learner, weights
from refusals import refuses
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.type_aliases import TrainFreq, TrainFrequencyUnit

from animarl_algos.data.dataset import OfflineDataset
from animarl_algos.learner import algorithm
from animarl_algos.learner.algorithm import SequenceQLearning
from animarl_algos.learner.callbacks import CheckpointCallback
from animarl_algos.learner.checkpoint import latest_checkpoint, load_checkpoint
from animarl_algos.learner.pretraining import (
    Pretraining,
    boltzmann_nll,
    demonstrated_rank,
    fit_boltzmann_temperature,
)
from animarl_algos.learner.settings import OfflineSettings
from animarl_algos.learner.updates import AS_MANY_AS_STEPS, UpdateSchedule, minibatch_values
from animarl_algos.recipes.registry import DQN, QRDQN, SoftBC

EPISODES = TrainFreq(2, TrainFrequencyUnit.EPISODE)
EACH_THIRD = TrainFreq(3, TrainFrequencyUnit.STEP)


def test_fractions_of_updates_are_kept_until_they_are_whole() -> None:
    schedule, made = UpdateSchedule(), []
    for _ in range(6):
        schedule.count_step(2)
        made.append(
            schedule.take_updates(EPISODES, copies=4, gradient_steps=1, updates_per_episode=0.375)
        )
    assert made == [0, 1, 1, 1, 0, 1]  # of 0.75, 1.5, 2.25, 3, 3.75 and 4.5 in all
    assert schedule.updates_due == 0.5 and schedule.steps == 0


@pytest.mark.parametrize(("asked", "updates"), [(5, 5), (AS_MANY_AS_STEPS, 12)])
def test_a_rollout_lasts_until_enough_and_its_steps_are_paid_in_updates(
    asked: int, updates: int
) -> None:
    schedule = UpdateSchedule()
    for finished, still in ((0, True), (1, True), (0, True), (1, False)):
        schedule.count_step(finished)
        assert schedule.needs_more_steps(EPISODES) is still
    assert (schedule.steps, schedule.episodes) == (4, 2)
    schedule = UpdateSchedule()
    for _ in range(3):
        assert schedule.needs_more_steps(EACH_THIRD)
        schedule.count_step(0)
    assert not schedule.needs_more_steps(EACH_THIRD)
    due = {"copies": 4, "gradient_steps": asked, "updates_per_episode": 9.0}
    assert schedule.take_updates(EACH_THIRD, **due) == updates  # type: ignore[arg-type]


def test_the_target_is_due_in_its_own_unit_and_the_rest_is_carried() -> None:
    by_steps, by_episodes = UpdateSchedule(), UpdateSchedule()
    due = [
        (by_steps.is_target_due(EACH_THIRD, 2, 1), by_episodes.is_target_due(EPISODES, 2, 1))
        for _ in range(6)
    ]
    assert list(zip(*due)) == [(False, True, True) * 2, (False, True) * 3]


def test_each_step_has_the_epsilon_that_is_due(monkeypatch: pytest.MonkeyPatch) -> None:
    """Not that of the step before: the schedule says how many steps are done."""
    settings = SETTINGS | {"exploration_steps": 100}
    model = DQN("MlpPolicy", toys.Pair(2), **settings, learning_starts=0)
    used, choose = [], model.policy.choose

    def watched(q_values: Any, deterministic: bool) -> Any:
        used.append((model.num_timesteps, model.policy.acting.epsilon))
        return choose(q_values, deterministic)

    monkeypatch.setattr(model.policy, "choose", watched)
    model.learn(60)
    model.learn(60, reset_num_timesteps=False)
    steps, epsilons = zip(*used)
    assert steps == tuple(range(0, 120, 2))
    assert epsilons == pytest.approx([max(0.3, 0.5 - 0.2 * step / 100) for step in steps])


def test_losses_are_means_since_the_last_log(monkeypatch: pytest.MonkeyPatch) -> None:
    model, made = make_pair_learner("dqdil", updates_per_episode=0.0).learn(200), []
    update, logged = algorithm.update, model.logger.name_to_value

    def watched(*given: Any, **options: Any) -> Any:
        made.append(update(*given, **options))
        return made[-1]

    monkeypatch.setattr(algorithm, "update", watched)
    before = weights(model)
    for updates in (1, 3):
        model.train(updates, 4)
    assert not torch.equal(before, weights(model))
    for name in ("td", "l2"):
        losses = torch.stack([losses[name] for losses, _ in made])
        means = [logged[f"train/{name}/{who}"] for who in model.layout.individuals]
        assert len(losses) == 4 and means == pytest.approx(losses.mean(0).tolist())
    model.dump_logs()
    assert not logged


def test_denormals_are_zero_in_an_update_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    model = make_pair_learner("dqdil", updates_per_episode=0.0).learn(200)
    small, seen = torch.full((1,), 1e-39), []
    monkeypatch.setattr(model.policy.optimizer, "step", lambda: seen.append((small * 1.0).item()))
    model.policy.q_net.register_forward_pre_hook(lambda *_: seen.append((small * 1.0).item()))
    for before, times in ((True, 2), (False, 4)):  # the forward pass and the step
        torch.set_flush_denormal(before)
        model.train(1, 4)
        assert seen == [0.0] * times and ((small * 1.0).item() == 0.0) is before


def test_updates_before_learning_starts_are_forfeited() -> None:
    model = DQN("GruPolicy", toys.Pair(2), **SETTINGS, learning_starts=10_000).learn(100)
    model.schedule.count_step(3)
    model._train_if_due()
    assert model.schedule == UpdateSchedule(since_target=model.schedule.since_target)
    assert model._n_updates == 0


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


def test_a_few_actions_that_are_all_the_same_make_no_greedy_animal() -> None:
    """Those of a validation animal at rest: the likelihood alone is highest at temperature 0."""
    values = np.array([4.0, 0.0, 0.0]) + np.random.default_rng(0).normal(0, 0.1, size=(25, 3))
    actions = np.zeros(25, dtype=int)
    fitted = fit_boltzmann_temperature(values, actions)
    assert 0.5 < fitted < 1.0
    assert boltzmann_nll(values, actions, 0.01) < boltzmann_nll(values, actions, fitted)


WHOLE_RUN = 240


class StopAt(BaseCallback):
    """Ends training at a world step, and looks at what it is shown at every one."""

    def __init__(self, step: int) -> None:
        super().__init__()
        self.step = step

    def _on_step(self) -> bool:
        assert {"infos", "dones", "rewards", "actions"} <= set(self.locals)
        layout = self.model.layout
        copies = present_observation(self.model).reshape(
            layout.num_copies, layout.num_individuals, -1
        )
        own = copies[(self.num_timesteps - 1) % layout.num_copies]  # one copy a call
        np.testing.assert_array_equal(self.locals["new_obs"], own)
        return self.num_timesteps < self.step


def present_observation(model: Any) -> Any:
    """What the toy that ``model`` learns in shows now."""
    env = model.env
    assert isinstance(env, toys.Toy)
    return env._slots(env.observe())


@pytest.mark.parametrize("train_freq", [(1, "episode"), (3, "episode"), (7, "step")])
def test_a_callback_may_stop_at_any_step(train_freq: tuple[int, str], tmp_path: Path) -> None:
    """Continuing, and resuming from the checkpoint, equal a straight run."""
    straight = make_pair_learner("dqn", train_freq=train_freq).learn(WHOLE_RUN)
    stopped = make_pair_learner("dqn", train_freq=train_freq)
    for step in (41, 58, 60, 62, 95, 130, WHOLE_RUN):
        until = [CheckpointCallback(tmp_path, every=10_000), StopAt(step)]
        left = WHOLE_RUN - stopped.num_timesteps
        stopped.learn(left, callback=until, reset_num_timesteps=False)
        np.testing.assert_array_equal(stopped._last_obs, present_observation(stopped))
        if step == 95:
            resumed = make_pair_learner("dqn", train_freq=train_freq, seed=99)
            load_checkpoint(resumed, tmp_path)
    resumed.learn(WHOLE_RUN - resumed.num_timesteps, reset_num_timesteps=False)
    for model in (stopped, resumed):
        assert torch.equal(weights(straight), weights(model))
        assert model._n_updates == straight._n_updates > 0
        assert model._episode_num == straight._episode_num


def test_ctrl_c_in_the_last_rollout_is_raised(tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt):
        make_pair_learner("dqn").learn(100, callback=Interrupt(tmp_path, 100))
    assert latest_checkpoint(tmp_path) is not None


def test_a_callback_that_was_interrupted_serves_again(tmp_path: Path) -> None:
    """As in a notebook, where the cell that learns is run once more."""
    callback, model = Interrupt(tmp_path, 100), make_pair_learner("dqn")
    with pytest.raises(KeyboardInterrupt):
        model.learn(WHOLE_RUN, callback=callback)
    model.learn(WHOLE_RUN - model.num_timesteps, callback=callback, reset_num_timesteps=False)
    assert torch.equal(weights(make_pair_learner("dqn").learn(WHOLE_RUN)), weights(model))


def test_ctrl_c_in_the_last_epoch_is_raised(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    train_epoch = Pretraining.train_epoch

    def last_is_interrupted(phase: Pretraining, data: Any) -> Any:
        if phase.progress.epoch == 1:
            os.kill(os.getpid(), signal.SIGINT)
        return train_epoch(phase, data)

    monkeypatch.setattr(Pretraining, "train_epoch", last_is_interrupted)
    with pytest.raises(KeyboardInterrupt):
        make_pair_learner("bc").learn(100, callback=CheckpointCallback(tmp_path, every=10_000))
    resumed = make_pair_learner("bc")
    load_checkpoint(resumed, tmp_path)
    assert resumed.offline_progress.done


STEPS = {
    "sequence_length": 1, "updates_per_epoch": 20, "warm_up": 10, "anneal": True,
    "weight_decay": 1e-3, "average": 0.99, "standardise": True,
}  # fmt: skip
WINDOWS = STEPS | {"sequence_length": 3, "burn_in": 2}


def cloning(policy: str = "MlpPolicy", **more: Any) -> SequenceQLearning:
    """Soft-label cloning with everything switched on."""
    kwargs = {"hidden": 16, "dropout": 0.1} | ({"skip": True} if policy == "GruPolicy" else {})
    settings = {
        "policy_kwargs": kwargs, "offline_kwargs": WINDOWS if policy == "GruPolicy" else STEPS,
        "offline_learning_rate": 1e-2, "offline_batch_size": 64, "offline_epochs": 10,
    }  # fmt: skip
    return make_pair_learner("soft-bc", policy, **settings | more)


kinds = pytest.mark.parametrize("policy", ["MlpPolicy", "GruPolicy"])


@kinds
def test_it_learns_what_can_be_known(policy: str) -> None:
    model = cloning(policy)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        progress = model.pretrain()
    for k, who in enumerate(model.layout.individuals):
        best = progress.history[progress.best_epochs[k] - 1]
        assert best[f"val/cross_entropy_minus_marginal/{who}"] < -0.7  # of log 3 = 1.1
        assert best[f"val/top_1/{who}"] > 0.85


@kinds
def test_individuals_that_share_a_network_learn_from_each_other(policy: str) -> None:
    """Each was seen in one half of the world, and is asked about both."""
    split = []
    for seed in (0, 1):
        observations = np.random.default_rng(seed).normal(size=(48 * 5, 2, 4))
        if seed == 0:
            observations[..., 0] = np.abs(observations[..., 0]) * [1, -1]
        actions, names = observations[..., :3].argmax(-1), toys.Pair.individuals
        split.append(OfflineDataset(observations, actions, np.full(48, 5), 3, names=names))
    figure = {}
    for shared in (False, True):
        kwargs = {"hidden": 16, "shared": shared, "skip": policy == "GruPolicy"}
        model = cloning(policy, demonstrations=Split(*split), policy_kwargs=kwargs)
        progress = model.pretrain()
        figure[shared] = float(np.mean(progress.best_figures))
    assert figure[True] < figure[False] - 0.05
    assert len(set(progress.best_epochs)) == 1
    for weight in model.policy.q_net.shared_parameters:
        torch.testing.assert_close(weight[0], weight[1], rtol=0, atol=1e-6)


def test_a_clone_of_coin_tosses_is_said_to_know_nothing() -> None:
    rng = np.random.default_rng(0)
    frames, lengths = 48 * 5, np.full(48, 5)
    split = [
        OfflineDataset(
            rng.normal(size=(frames, 2, 4)), rng.integers(0, 3, (frames, 2)), lengths, 3,
            names=toys.Pair.individuals,
        )
        for _ in range(2)
    ]  # fmt: skip
    model = cloning(demonstrations=Split(*split), offline_epochs=2)
    with pytest.warns(UserWarning, match="seeker, avoider is no better than predicting"):
        model.pretrain()


@kinds
def test_individuals_together_are_individuals_alone(policy: str) -> None:
    """With dropout, an average and patience: each its own draws, best epoch and end."""
    rate = 0.05
    # Adam's quotient would blow up the rounding of no gradient, as the value stream has.
    kwargs: dict[str, Any] = {"hidden": 16, "dropout": 0.1, "optimizer_kwargs": {"eps": 1e-3}}
    if policy == "GruPolicy":
        kwargs |= {"skip": True}
        rate = 0.01
    phase = {"offline_patience": 2, "offline_epochs": 8, "offline_learning_rate": rate}
    together = cloning(policy, **phase, policy_kwargs=kwargs)
    progress = together.pretrain()
    if policy == "MlpPolicy":
        assert len(set(progress.best_epochs)) == 2  # or nothing is shown of their ends
    for k, who in enumerate(toys.Pair.individuals):
        env = toys.Pair(2)
        env.individuals = (who,)
        toys.VecEnv.__init__(env, 2, env.observation_space, env.action_space)
        settings = SETTINGS | phase | {"offline_batch_size": 64}
        settings |= {
            name: getattr(together.settings, name) for name in ("policy_kwargs", "offline_kwargs")
        }
        alone = SoftBC(policy, env, demonstrations=demonstrations(individuals=(who,)), **settings)
        assert alone.pretrain().best_epochs == progress.best_epochs[k : k + 1]
        nets = (together.policy.q_net, alone.policy.q_net)
        for ours, own in zip(*(net.parameters() for net in nets), strict=True):
            torch.testing.assert_close(ours[k], own[0], rtol=1e-3, atol=1e-4)


@pytest.mark.parametrize("quantiles", [None, 5])
def test_single_steps_are_learned_from_as_sequences_are(quantiles: int | None) -> None:
    """Without a memory the states after single steps are evaluated apart."""
    learner = DQN if quantiles is None else QRDQN
    kwargs: dict[str, Any] = {"hidden": 8, "head_layers": 0}
    kwargs |= {} if quantiles is None else {"n_quantiles": quantiles}
    model = learner(
        *("MlpPolicy", toys.Pair(2)),
        **SETTINGS | {"sequence_length": 1, "policy_kwargs": kwargs, "learning_starts": 10**6},
    ).learn(60)
    phase, policy = model.settings.phase("online"), model.policy
    (term,) = (one for one in model.recipe.online if one.needs_target)
    assert model.replay_buffer is not None
    batch = model.replay_buffer.sample(16)
    apart = minibatch_values(policy, batch, phase, needs_target=True)
    assert apart.successors is not None
    whole = replace(
        apart,
        successors=None,
        online=policy.q_net(batch.observations, batch.previous_actions),
        target=policy.q_net_target(batch.observations, batch.previous_actions),
    )
    gradients = []
    for minibatch in (apart, whole):
        policy.q_net.zero_grad()
        term(minibatch).sum().backward()
        gradients.append([one.grad.clone() for one in policy.q_net.parameters()])
    assert sum(float(one.abs().sum()) for one in gradients[0]) > 0
    torch.testing.assert_close(*gradients, rtol=1e-4, atol=1e-6)
    torch.testing.assert_close(apart.errors, whole.errors)


class Stopped(Exception):
    pass


@pytest.mark.parametrize("device", ["cpu", pytest.param("cuda", marks=pytest.mark.cuda)])
@kinds
def test_a_stopped_phase_goes_on_exactly(policy: str, device: str, tmp_path: Path) -> None:
    straight = cloning(policy, device=device).learn(1)

    class Stop(CheckpointCallback):
        def at_boundary(self) -> None:
            super().at_boundary()
            if self.model.offline_progress.epoch == 4:  # type: ignore[attr-defined]
                raise Stopped

    with pytest.raises(Stopped):
        cloning(policy, device=device).learn(1, callback=Stop(tmp_path, every=1000))
    resumed = cloning(policy, device=device)
    load_checkpoint(resumed, tmp_path)
    assert resumed.offline_progress.epoch == 4 and resumed.offline_progress.average_weights
    resumed.learn(1)
    assert torch.equal(weights(resumed), weights(straight))
    assert torch.equal(resumed.policy.q_net.input_sd, straight.policy.q_net.input_sd)
    assert resumed.offline_progress.history == straight.offline_progress.history


def test_the_weights_of_the_best_epoch_are_kept_not_those_of_the_last() -> None:
    epochs, settings = 16, {"offline_learning_rate": 1.0, "gradient_steps": 1}
    model = make_pair_learner("bc", offline_epochs=epochs, **settings)
    history = model.pretrain().history
    earlier = 0
    for k, who in enumerate(model.layout.individuals):
        figures = [row[f"val/{model.recipe.selection}/{who}"] for row in history]
        best = epochs - int(np.argmin(figures[::-1]))  # of equals the later
        earlier += best < epochs
        shorter = make_pair_learner("bc", offline_epochs=best, **settings)
        shorter.pretrain()
        for kept, last in zip(
            model.policy.q_net.parameters(), shorter.policy.q_net.parameters(), strict=True
        ):
            assert torch.equal(kept[k], last[k])
    assert earlier


def test_the_average_follows_the_weights() -> None:
    """By its recursion, from snapshots after each of five updates."""
    one_update = STEPS | {"updates_per_epoch": 1, "average": 0.3}
    model = cloning("MlpPolicy", offline_kwargs=one_update, offline_epochs=5)
    snapshots, averages = [], []
    train_epoch = Pretraining.train_epoch

    def watched(phase: Pretraining, data: Any) -> Any:
        row = train_epoch(phase, data)
        average = phase.progress.average_weights
        assert average is not None
        snapshots.append([p.detach().clone() for p in phase.policy.q_net.parameters()])
        names = [name for name, _ in phase.policy.q_net.named_parameters()]
        averages.append([average[name].clone() for name in names])
        return row

    start = [p.detach().clone() for p in model.policy.q_net.parameters()]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Pretraining, "train_epoch", watched)
        model.pretrain()
    for t, (now, average) in enumerate(zip(snapshots, averages, strict=True), start=1):
        decay = min(0.3, (1 + t) / (10 + t))
        start = [decay * a + (1 - decay) * w for a, w in zip(start, now, strict=True)]
        for a, b in zip(average, start, strict=True):
            torch.testing.assert_close(a, b)


def test_the_rate_warms_up_and_anneals() -> None:
    settings = OfflineSettings(sequence_length=1, warm_up=4, anneal=True)
    factors = [settings.rate_factor(u, 10**9) for u in range(5)]
    assert factors == pytest.approx([0.25, 0.5, 0.75, 1.0, 1.0])
    assert settings.rate_factor(50, 100) == pytest.approx(0.5)
    assert settings.rate_factor(100, 100) == pytest.approx(0.0)
    assert OfflineSettings().rate_factor(99, 100) == 1.0


def test_few_demonstrations_have_short_epochs() -> None:
    settings = OfflineSettings(sequence_length=2, updates_per_epoch=50, passes_per_epoch=4)
    few, many = 320, 10_000  # steps, in minibatches of 16 windows of 2
    assert (settings.updates(few, 16), settings.updates(many, 16)) == (40, 50)
    assert settings.updates(3, 16) == 1
    unlimited = OfflineSettings(sequence_length=2, updates_per_epoch=50)
    one_pass = OfflineSettings(sequence_length=2)
    assert (unlimited.updates(few, 16), one_pass.updates(few, 16)) == (50, 10)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"sequence_length": 0}, "offline_kwargs: sequence_length is 0"),
        ({"burn_in": 3}, "are for windows"),
        ({"updates_per_epoch": 3}, "are for windows"),
        ({"passes_per_epoch": 4}, "limits updates_per_epoch: give both"),
        ({"sequence_length": 1, "passes_per_epoch": 0}, "passes_per_epoch is 0"),
        ({"average": 1.0}, "offline_kwargs: average is 1.0"),
        ({"anneal": 1}, "anneal is 1: give true or false"),
        ({"weight_decay": -1}, "weight_decay is -1"),
        ({"window": 3}, "'window' is unknown: choose among anneal, average"),
    ],
)
def test_bad_settings_are_refused(given: dict[str, Any], message: str) -> None:
    refuses(message, make_pair_learner, "bc", offline_kwargs=given)


def test_training_leaves_no_temporary_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    DQN("MlpPolicy", toys.Pair(2), **SETTINGS).learn(20)
    assert not any(tmp_path.iterdir())
