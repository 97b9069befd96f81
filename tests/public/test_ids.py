"""Ids of environments and names of species mean the same wherever they are given."""

from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.wrappers import TimeLimit
from refusals import refuses
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.vec_env import VecNormalize

from animarl_algos import BC, DQAAS, DQCIL, DQDIL, DQN, SlotVecEnv
from animarl_algos.recipes.registry import RECIPES
from animarl_algos.runs.pretrained import model_folder
from animarl_algos.runs.run_settings import RunSettings, environment_options, species_of_options
from animarl_envs import parallel_env
from animarl_envs.demos.packaged import load_packaged

SMALL = {"hidden": 8}
NAMES = ("AnimaRL/Newt-v0", "Newt", "newt")


@pytest.mark.parametrize("name", NAMES)
def test_every_front_door_takes_ids_and_names(name: str) -> None:
    assert parallel_env(name).possible_agents == ["male_0", "male_1", "female"]
    assert SlotVecEnv(name, 1).individuals == ("male_0", "male_1", "female")
    assert RunSettings(species=name, steps=1).species == "newt"
    assert environment_options(name) == {"species": "newt"}
    assert species_of_options(name, name) == species_of_options(None, name) == "newt"
    assert load_packaged(name).species == "newt" and model_folder(name).name == "newt"
    assert DQN("GruPolicy", name, policy_kwargs=SMALL).observation_size == 64


@pytest.mark.parametrize("name", ["AnimaRL/SilkmothMemory-v0", "SilkmothMemory"])
def test_an_id_may_stand_for_options(name: str) -> None:
    seen = parallel_env(name).observation_space("moth").shape
    assert seen == SlotVecEnv(name, 1).observation_space.shape == (2,)
    learner = DQN("MlpPolicy", name, policy_kwargs=SMALL)
    assert learner.observation_size == 2


def test_an_id_may_name_its_module_as_gymnasium_has_it() -> None:
    assert SlotVecEnv("animarl_envs:AnimaRL/Newt-v0", 1).individuals[2] == "female"


def test_a_learner_in_slots_trains_all_individuals() -> None:
    slots = SlotVecEnv("AnimaRL/Newt-v0", 16)
    learner = DQDIL("GruPolicy", slots, seed=0, policy_kwargs={"hidden": 8})
    assert learner.policy.individuals == ("male_0", "male_1", "female")
    before = [weight.clone() for weight in learner.policy.q_net.parameters()]
    learner.learn(500)
    after = list(learner.policy.q_net.parameters())
    for individual in range(3):  # each has learned something
        assert any(
            not np.array_equal(a[individual].detach(), b[individual]) for a, b in zip(after, before)
        )


@pytest.mark.parametrize("name", ["AnimaRL/Dodo-v0", "dodo"])
def test_an_unknown_species_is_one_sentence(name: str) -> None:
    for door in (parallel_env, lambda text: SlotVecEnv(text, 1)):
        refuses("is unknown: choose one of agent, fly, newt, silkmoth", door, name)
    refuses("choose one of agent", DQDIL, "GruPolicy", "AnimaRL/Dodo-v0")


@pytest.mark.parametrize("name", RECIPES)
def test_every_learner_takes_demonstrations_as_they_are(name: str) -> None:
    """Of a species by its name, and beside an environment that was made before."""
    kind, demos = RECIPES[name].algorithm, load_packaged("agent")
    epochs = {"offline_epochs": 1} if kind.recipe.offline else {}
    small = SMALL | ({"n_quantiles": 5} if kind.quantiles else {})
    every = SlotVecEnv("agent", 1, demos=demos, condition_flag=True)
    plainly = not (kind.recipe.needs_distance or kind.recipe.needs_alignment)
    for env in (every, "agent") if plainly else (every,):
        model = kind(
            "MlpPolicy", env, demonstrations=demos, policy_kwargs=small, device="cpu", **epochs
        )
        if epochs:
            data = model.demonstration_data()
            every_name = ("predator_0", "predator_1", "prey")
            assert data.learners == (every_name if env is every else every_name[:1])
            assert "test" not in data.demos.split


def test_one_individual_learns_from_demonstrations_as_they_are() -> None:
    env = gym.make("AnimaRL/Newt-v0", observation="full", focal="female")
    demos = load_packaged("newt")
    model = BC("MlpPolicy", env, demonstrations=demos, offline_epochs=1, policy_kwargs=SMALL)
    assert model.demonstration_data().learners == ("female",)
    before = model.policy.q_net.encoder_1.weight.detach().clone()
    model.learn(0)
    assert not np.array_equal(before, model.policy.q_net.encoder_1.weight.detach())


class Timer(gym.Env[Any, Any]):
    """A reward of 1 a step, without an end."""

    action_space = gym.spaces.Discrete(4)

    def __init__(self, space: gym.Space[Any] | None = None) -> None:
        usual = gym.spaces.Box(-1, 1, (3,), dtype=np.float32)
        self.observation_space = usual if space is None else space

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[Any, dict[str, Any]]:
        super().reset(seed=seed)
        return self.observation_space.sample(), {}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        return self.observation_space.sample(), 1.0, False, False, {}


def test_a_time_limit_around_an_environment_is_seen_and_ends_nothing() -> None:
    model = DQN("MlpPolicy", TimeLimit(Timer(), 20), seed=0, policy_kwargs=SMALL, device="cpu")
    assert model.episode_limit == 20
    model.learn(65)
    batch = model.replay_buffer.sample(16)
    assert (model.replay_buffer.num_episodes, model.replay_buffer.num_steps) == (3, 60)
    assert batch.mask.any() and not batch.terminated.any()


SHOWN = load_packaged("newt")


@pytest.mark.parametrize(
    ("learner", "env", "more", "words"),
    [
        (DQDIL, "CartPole-v1", {}, r"needs the distance .* learn in SlotVecEnv\("),
        (DQDIL, gym.make("AnimaRL/Newt-v0"), {}, r'needs the distance .*SlotVecEnv\("newt"\)'),
        (DQAAS, "newt", {}, r'aligned .*SlotVecEnv\("newt"\), or .*focal="male_0"\)'),
        (DQCIL, "newt", {}, r'SlotVecEnv\("newt", condition_flag=True\)'),
        (BC, "fly", {"demonstrations": SHOWN}, "newt, not of fly"),
        (BC, SlotVecEnv("fly", 1), {"demonstrations": SHOWN}, "newt, not of fly"),
        (BC, "CartPole-v1", {"demonstrations": SHOWN}, "none of AnimaRL's"),
        (BC, "newt", {"demonstrations": [1, 2]}, "is a list: give Demonstrations, or"),
        (BC, "CartPole-v1", {}, "pass demonstrations="),
        (DQN, "custom", {}, "demos"),
        (DQN, Timer(), {}, "give max_episode_steps, or wrap it in gymnasium.wrappers.TimeLimit"),
        (DQN, TimeLimit(Timer(gym.spaces.Discrete(3)), 9), {}, "Discrete .*FlattenObservation"),
        (DQN, TimeLimit(Timer(gym.spaces.Dict()), 9), {}, "Dict .*FlattenObservation"),
        (DQN, VecNormalize(make_vec_env("CartPole-v1")), {}, "give .* standardise_inputs=True"),
    ],
    ids=lambda value: getattr(value, "__name__", type(value).__name__),
)
def test_what_does_not_fit_is_refused_at_construction(
    learner: Any, env: Any, more: dict[str, Any], words: str
) -> None:
    epochs = {} if learner in (DQN, DQDIL) else {"offline_epochs": 1}
    refuses(words, learner, "MlpPolicy", env, policy_kwargs=SMALL, **epochs, **more)
