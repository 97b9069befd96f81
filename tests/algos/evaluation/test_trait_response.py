"""A clone that shrinks the traits of animals is told them louder, until animals differ enough."""

from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest
import torch
from gymnasium import spaces

from animarl_algos.evaluation.collect import MemorylessPolicy, collect_rollouts
from animarl_algos.evaluation.trait_response import LARGEST_GAIN, trait_gains
from animarl_algos.networks.policies import MlpPolicy
from animarl_envs.demos.packaged import load_packaged
from animarl_envs.scenario import make_scenario
from animarl_envs.species.traits import Traits, episode_traits
from animarl_envs.worlds import make_world

TABLE = np.array([[[-1.0, 0.0]], [[0.0, 0.0]], [[1.0, 0.0]]])


class Eager(MemorylessPolicy):
    """Pushes the more often, the quicker it is told to be."""

    def __init__(self, strength: float) -> None:
        self._strength, self._draw = strength, np.random.default_rng(0)

    def act(self, observation: Any) -> np.ndarray:
        told = self._strength * observation[:, -2]
        eager = self._draw.random(len(told)) < 0.5 + 0.2 * told
        return np.where(eager, self._draw.integers(12, size=len(told)), 12)


def worlds(centre: float = 0.0, scale: float = 1.0) -> tuple[Any, Traits]:
    """Searches whose animals differ in their speed, of such a mean and standard deviation."""
    traits = Traits(np.full((2, 1, 2), centre), np.array([[scale, np.inf]]), TABLE)
    demos = load_packaged("silkmoth")
    demos = replace(demos, recording=[str(i) for i in range(demos.num_episodes)])  # each its own
    options = {"traits": traits, "split": "test", "warmup": 0, "time_limit": 150}
    scenario = make_scenario("silkmoth", demos=demos, **options)
    return partial(make_world, scenario), traits


@pytest.fixture(scope="module")
def recorded() -> tuple[float, float]:
    """Mean and standard deviation of the speeds of animals that are as they are told."""
    made = collect_rollouts(worlds()[0], Eager(1.0), method="x", seed=1, repetitions=40)
    speeds = episode_traits(made.positions, made.lengths, made.dt)[:, 0, 0]
    return float(speeds.mean()), float(speeds.std() / TABLE[:, 0, 0].std())


@pytest.mark.parametrize(
    ("strength", "low", "high"),
    [(1.0, 1.0, 1.15), (0.6, 1.5, 1.8), (0.35, LARGEST_GAIN, LARGEST_GAIN), (0.0, 1.0, 1.0)],
)
def test_traits_are_told_louder_to_who_shrinks_them(
    recorded: tuple[float, float], strength: float, low: float, high: float
) -> None:
    make, traits = worlds(*recorded)
    gains = trait_gains(Eager(strength), make, traits, seed=0)
    assert low <= gains[0] <= high and gains[1] == 1.0  # in their turning animals are alike


def test_a_network_hears_an_amplified_input_from_its_mean_on() -> None:
    space = spaces.Box(-np.inf, np.inf, (3,), np.float32)
    policy = MlpPolicy(space, spaces.Discrete(4), lambda _: 1e-3)
    mean, sd = torch.tensor([[1.0, 2.0, 3.0]]), torch.tensor([[1.0, 2.0, 4.0]])
    policy.q_net.standardise_inputs(mean, sd)
    before = policy.advance(np.array([[1.5, 6.0, 3.0]], np.float32), None, None)[0]
    policy.q_net.amplify_inputs([1, 2], np.array([2.0, 3.0]))
    after = policy.advance(np.array([[1.5, 4.0, 3.0]], np.float32), None, None)[0]
    np.testing.assert_allclose(after, before, rtol=1e-5)
