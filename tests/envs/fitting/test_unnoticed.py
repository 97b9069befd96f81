"""Rules that the code could once lose without any test noticing, one test for each."""

import numpy as np
import pytest
import torch
from pair_learners import make_pair_learner
from recordings import SYNTHETIC

from animarl_envs.arena import Arena
from animarl_envs.demos import Demonstrations
from animarl_envs.fitting.joint import bootstrap_joint, fit_joint
from animarl_envs.fitting.transitions import Transitions, onset_data
from animarl_envs.locomotion import ACTION_VECTORS


def test_no_onset_is_taken_across_the_border_of_two_episodes() -> None:
    """Both end at rest or start in motion; between them the animal is somewhere else."""
    dt, crossing = 0.1, 0.05
    still = np.zeros((4, 2))
    moving = np.column_stack([5.0 + 0.1 * np.arange(4), np.zeros(4)])
    starting = np.column_stack([[9.0, 9.0, 9.02, 9.05], np.zeros(4)])
    demos = Demonstrations(
        species="custom", individuals=("a",), roles=("pursuer",), dt=dt, arena=Arena("open"),
        positions=np.concatenate([still, moving, starting])[:, None], lengths=np.full(3, 4),
        initial_velocity=np.zeros((3, 1, 2)), condition=np.zeros(3, np.int8),
        outcome=np.zeros(3, np.int8), split=np.full(3, "train"),
        recording=np.array(["a", "b", "c"]), provenance=SYNTHETIC,
    )  # fmt: skip
    data = onset_data(demos, 0, crossing / dt)
    assert data.onset_speed.tolist() == pytest.approx([0.2])
    assert data.onset_episode.tolist() == [2]
    assert len(data.speed) == 9 and data.speed.max() == pytest.approx(1.0)
    assert np.bincount(data.episode).tolist() == [3, 3, 3]


def test_the_bootstrap_of_the_joint_fit_leaves_tracking_jumps_out() -> None:
    """With some steps thrown far, intervals are those of the same tracks without these steps."""
    rng = np.random.default_rng(0)
    episodes, steps, dt = 30, 40, 0.1
    count = episodes * steps
    velocity = rng.normal(0.0, 0.5, (count, 2))
    action = ACTION_VECTORS[rng.integers(13, size=count)]
    focus = np.tile([1.0, 0.0], (count, 1))
    after = 0.7 * velocity + 2.0 * dt * action + rng.normal(0.0, 0.004, (count, 2))
    episode = np.repeat(np.arange(episodes), steps)
    jumps = np.zeros(count, dtype=bool)
    jumps[7::60] = True
    after[jumps] += rng.choice([-30.0, 30.0], (int(jumps.sum()), 2))
    with_jumps = Transitions(velocity, after, focus, episode, episodes, dt)
    kept = ~jumps
    without = Transitions(velocity[kept], after[kept], focus[kept], episode[kept], episodes, dt)
    weights = rng.multinomial(episodes, np.full(episodes, 1 / episodes), 300).astype(float)
    spread = [
        bootstrap_joint(data, fit_joint(data), weights).std(axis=0)
        for data in (with_jumps, without)
    ]
    assert spread[0] == pytest.approx(spread[1], rel=0.1)


def test_the_weights_of_the_best_epoch_are_kept_not_those_of_the_last() -> None:
    settings = {"offline_learning_rate": 0.3, "gradient_steps": 1}
    model = make_pair_learner("bc", offline_epochs=8, **settings)
    history = model.pretrain().history
    earlier = 0
    for k, who in enumerate(model.layout.individuals):
        figures = [row[f"val/{model.recipe.selection}/{who}"] for row in history]
        best = 8 - int(np.argmin(figures[::-1]))  # of equals the later
        earlier += best < 8
        shorter = make_pair_learner("bc", offline_epochs=best, **settings)
        shorter.pretrain()
        for kept, last in zip(
            model.policy.q_net.parameters(), shorter.policy.q_net.parameters(), strict=True
        ):
            assert torch.equal(kept[k], last[k])
    assert earlier
