"""The offline phase beyond the paper's: windows, rates, decay, average, standardised inputs."""

import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import toys
from pair_learners import SETTINGS, Split, demonstrations, make_pair_learner, weights
from refusals import refuses

from animarl_algos.data.dataset import OfflineDataset
from animarl_algos.learner.algorithm import SequenceQLearning
from animarl_algos.learner.callbacks import CheckpointCallback
from animarl_algos.learner.checkpoint import load_checkpoint
from animarl_algos.learner.pretraining import Pretraining
from animarl_algos.learner.settings import OfflineSettings
from animarl_algos.recipes.registry import SoftBC

STEPS = {
    "sequence_length": 1, "updates_per_epoch": 20, "warm_up": 10, "anneal": True,
    "weight_decay": 1e-3, "average": 0.99, "standardise": True,
}  # fmt: skip
WINDOWS = STEPS | {"sequence_length": 3, "burn_in": 2}


def cloning(policy: str = "MlpPolicy", **more: Any) -> SequenceQLearning:
    """Soft-label cloning with everything switched on."""
    kwargs = {"hidden": 16, "dropout": 0.1} | ({"skip": True} if policy == "GruPolicy" else {})
    settings = {
        "policy_kwargs": kwargs,
        "offline_kwargs": WINDOWS if policy == "GruPolicy" else STEPS,
        "offline_learning_rate": 1e-2,
        "offline_batch_size": 64,
        "offline_epochs": 10,
    }
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
    kwargs: dict[str, Any] = {"hidden": 16, "dropout": 0.1}
    if policy == "GruPolicy":  # where Adam's quotient would blow the rounding of no gradient up
        kwargs |= {"skip": True, "optimizer_kwargs": {"eps": 1e-3}}
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
        settings |= {name: getattr(together, name) for name in ("policy_kwargs", "offline_kwargs")}
        alone = SoftBC(policy, env, demonstrations=demonstrations(individuals=(who,)), **settings)
        assert alone.pretrain().best_epochs == progress.best_epochs[k : k + 1]
        nets = (together.policy.q_net, alone.policy.q_net)
        for ours, own in zip(*(net.parameters() for net in nets), strict=True):
            torch.testing.assert_close(ours[k], own[0], rtol=1e-3, atol=1e-4)


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
