"""Toys that only the feature under test can solve, each with the ablation that fails."""

from typing import Any

import confounded
import numpy as np
import pytest
import torch
import toys
from pair_learners import Split

from animarl_algos.data.dataset import OfflineDataset
from animarl_algos.learner.algorithm import SequenceQLearning
from animarl_algos.recipes.registry import BC, DQAAS, DQCIL, DQDIL, DQN

LEARN: dict[str, Any] = {
    "learning_rate": 3e-3, "gamma": 0.95, "buffer_size": 5000,
    "target_update_interval": (100, "episode"), "updates_per_episode": 0.2,
    "exploration_initial_eps": 1.0, "exploration_final_eps": 0.1, "exploration_steps": 4000,
    "offline_epochs": 0, "seed": 0, "device": "cpu",
}  # fmt: skip


def greedy_returns(model: SequenceQLearning, env: toys.Toy, steps: int) -> np.ndarray[Any, Any]:
    """Returns of the episodes that the greedy policy finishes within ``steps``."""
    observation, state = env.reset(), None
    starts = np.ones(env.num_envs, dtype=bool)
    running = np.zeros(env.num_envs)
    finished = []
    for _ in range(steps):
        actions, state = model.predict(observation, state, starts, deterministic=True)
        observation, reward, starts, _ = env.step(actions)
        running += reward
        finished.append(running[starts])
        running[starts] = 0.0
    return np.concatenate(finished)


def test_recall_needs_the_gru() -> None:
    scores = {}
    settings = LEARN | {"exploration_steps": 2_000, "updates_per_episode": 0.25}
    for policy in ("GruPolicy", "MlpPolicy"):
        model = DQN(policy, toys.Recall(16), **settings).learn(6_000)
        scores[policy] = greedy_returns(model, toys.Recall(64, seed=5), 40).mean()
    assert scores["GruPolicy"] > 0.95
    assert scores["MlpPolicy"] < 0.6  # by construction one half is all that can be had


def lock_demonstrations() -> Split:
    """The lock opened from its start and from three later places; a wrong digit costs 1."""
    runs = [np.arange(start, toys.Lock.LENGTH + 1) for start in (0, 3, 6, 9)]
    places = np.concatenate(runs)
    last = np.cumsum([len(run) for run in runs]) - 1
    actions = np.append(toys.Lock.KEY, -1)[places]
    rewards = np.zeros(len(places))
    rewards[last - 1] = 1.0
    dataset = OfflineDataset(
        toys.Lock.features(places)[:, None], actions[:, None], np.array([len(run) for run in runs]),
        toys.Lock.num_actions, rewards=rewards[:, None],
        action_penalties=(np.arange(3) != actions[:, None]).astype(float)[:, None],
        terminated=np.ones(len(runs), dtype=bool), names=("agent",),
    )  # fmt: skip
    return Split(dataset, dataset)


@pytest.mark.parametrize("recipe", [BC, pytest.param(DQDIL, marks=pytest.mark.slow)])
def test_a_sparse_reward_needs_demonstrations(recipe: type[SequenceQLearning]) -> None:
    offline = {"offline_epochs": 100, "offline_learning_rate": 3e-3, "offline_batch_size": 4}
    online = {"exploration_initial_eps": 0.1, "learning_rate": 3e-4, "gamma": 0.99}
    scores = {"offline_alpha": 1.0, "offline_scaled_penalties": False, "offline_gamma": 0.99}
    settings = LEARN | offline | online | scores
    pretrained = recipe(
        "MlpPolicy", toys.Lock(8), demonstrations=lock_demonstrations(), **settings
    ).learn(2_000)
    assert greedy_returns(pretrained, toys.Lock(4, seed=5), 40).mean() == 1.0


def test_a_sparse_reward_is_not_found_at_random() -> None:
    scratch = DQN("MlpPolicy", toys.Lock(8), **LEARN).learn(4_000)
    assert greedy_returns(scratch, toys.Lock(4, seed=5), 40).mean() == 0.0


def routes() -> dict[str, toys.GridWalk]:
    """Two mirrored ways from (0, 0) to (2, 2); the demonstration takes one of them."""
    east = [(0, 0), (1, 0), (2, 0), (2, 1), (2, 2)]
    north = [(y, x) for x, y in east]
    return {
        "east": toys.GridWalk(east, [0, 0, 1, 1, 1], (2, 2), margin=1),
        "north": toys.GridWalk(north, [1, 1, 0, 0, 0], (2, 2), margin=1),
    }


def walked_path(model: SequenceQLearning, env: toys.GridWalk) -> list[tuple[int, int]]:
    """Greedy path of one copy until it is reset."""
    observation, state = env.reset(), None
    starts = np.ones(env.num_envs, dtype=bool)
    path = [(0, 0)]
    for _ in range(env.time_limit):
        actions, state = model.predict(observation, state, starts, deterministic=True)
        here = np.array(path[-1]) + env.MOVES[actions[0]]
        path.append((int(here[0]), int(here[1])))
        observation, _, starts, _ = env.step(actions)
        if starts[0]:
            break
    return path


WALK = LEARN | {
    "buffer_size": 20_000, "exploration_steps": 3_000, "target_update_interval": (50, "episode"),
    "updates_per_episode": 0.4,
}  # fmt: skip


@pytest.mark.slow
def test_choosing_between_equal_routes_needs_the_distance_reward() -> None:
    followed = {}
    for recipe, alpha in ((DQDIL, 0.3), (DQN, 0.0)):
        taken = {}
        for name, env in routes().items():
            model = recipe("MlpPolicy", env, alpha=alpha, **WALK).learn(4_000)
            taken[name] = walked_path(model, env) == [tuple(p) for p in env.path.astype(int)]
        followed[recipe] = taken
    assert followed[DQDIL] == {"east": True, "north": True}
    assert not all(followed[DQN].values())  # to it both worlds are the same


@pytest.mark.slow
def test_a_demonstration_at_half_speed_needs_the_alignment() -> None:
    """Four cells east, four north, two frames in each: by the clock, the turn comes too late."""
    cells = [(i, 0) for i in range(4)] + [(4, j) for j in range(5)]
    path = [cell for cell in cells for _ in range(2)]
    labels = [0] * 8 + [1] * 10
    arrived = {}
    for step_aligned in (False, True):
        env = toys.GridWalk(path, labels, (4, 4), step_aligned=step_aligned)
        model = DQAAS("MlpPolicy", env, lambda3=5.0, **WALK).learn(4_000)
        arrived[step_aligned] = walked_path(model, env)[-1] == (4, 4)
    assert arrived == {False: True, True: False}


def opposite_demonstrations() -> tuple[Split, np.ndarray, np.ndarray]:
    """Under condition 1 the right action is the one that is wrong under condition 0.

    With the demonstrations come their observations (n, 3) and actions (n,).
    """
    rng = np.random.default_rng(0)
    episodes, steps = 400, 3
    observations = rng.normal(size=(episodes * steps, 1, 3))
    condition = np.arange(episodes) % 2
    observations[..., -1] = np.repeat(condition, steps)[:, None]
    actions = ((observations[..., 1] > 0) ^ (observations[..., -1] > 0)).astype(np.int64)
    dataset = OfflineDataset(
        observations, actions, np.full(episodes, steps), toys.Confounded.num_actions,
        condition=condition, names=("agent",),
    )  # fmt: skip
    return Split(dataset, dataset), observations[:, 0].astype(np.float32), actions[:, 0]


CONDITION_INPUTS = {
    "linear head": {"condition_input": "head", "head_layers": 0},
    "hidden layer": {"condition_input": "head", "head_layers": 1},
    "encoder": {"condition_input": "encoder", "head_layers": 0},
}


@pytest.mark.parametrize("policy_kwargs", CONDITION_INPUTS.values(), ids=CONDITION_INPUTS.keys())
def test_opposite_answers_under_two_conditions_need_the_flag_times_the_state(
    policy_kwargs: dict[str, Any],
) -> None:
    """With the products of flag and features held at zero half of the actions stay wrong."""
    data, observations, demonstrated = opposite_demonstrations()
    right = {}
    for additive in {False, policy_kwargs is CONDITION_INPUTS["linear head"]}:
        model = BC(
            "MlpPolicy", toys.Confounded(1), demonstrations=data, policy_kwargs=policy_kwargs,
            **LEARN | {"offline_epochs": 30, "offline_learning_rate": 3e-3},
        )  # fmt: skip
        if additive:
            network = model.policy.q_net
            for layer in (network.dueling.value, network.dueling.advantage):
                products = slice(network.units + 1, None)
                with torch.no_grad():
                    layer.weight[:, products] = 0.0
                kept = torch.ones_like(layer.weight)
                kept[:, products] = 0.0
                layer.weight.register_hook(lambda gradient, kept=kept: gradient * kept)
        model.learn(0)
        actions, _ = model.predict(observations, deterministic=True)
        right[additive] = (actions == demonstrated).mean()
    assert right.pop(False) > 0.95
    assert all(share < 0.6 for share in right.values())


@pytest.mark.slow
def test_flipping_a_confounded_condition_needs_the_reversal() -> None:
    """Action 1 is right under condition 1, and a louder nuisance always agrees with the condition.

    Both learners act rightly in training. Only the one whose memory must not tell the condition has
    to take it from the flag, and so follows when the flag alone is flipped. Its treatment head ends
    at chance on fresh episodes, where a probe of that form reads all of DQDIL's memory.
    (A probe without an opponent still reads DQCIL's too: benchmarks/treatment_head.py.)
    """
    followed = {}
    readings = {}
    for recipe in (DQDIL, DQCIL):
        world = toys.Confounded(16)
        model = recipe("GruPolicy", world, seed=0, **confounded.SETTINGS | confounded.SETTLED)
        model.learn(3_000)
        factual, followed[recipe] = confounded.flip_behaviour(model)
        assert factual > 0.95
        readings[recipe] = [confounded.read_condition(model, seed) for seed in (1234, 4321)]
    assert followed[DQCIL] > 0.9
    assert followed[DQDIL] < 0.1
    probe = confounded.probe_balanced_accuracy(*(reading.rows() for reading in readings[DQDIL]))
    assert probe > 0.95
    for reading in readings[DQCIL]:
        assert 0.4 < reading.head_accuracy() < 0.6
        assert reading.head_cross_entropy() > 0.65  # log 2 is chance
