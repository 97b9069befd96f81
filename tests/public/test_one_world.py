"""One id is one world, whatever is made from it."""

import itertools
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from commands import animarl
from refusals import refuses
from stable_baselines3.common.callbacks import CheckpointCallback, EvalCallback
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.vec_env import VecEnv

from animarl_algos import DQN, SlotVecEnv
from animarl_algos.data.slot_layout import declared
from animarl_algos.recipes.registry import RECIPES
from animarl_algos.runs.run import Run
from animarl_algos.zoo.manager import slot_environment, validation_environment
from animarl_envs import SPECIES, environment_id, parallel_env
from animarl_envs.locomotion import COAST
from animarl_envs.tasks import SHARED_CHANGES, TASKS

WORLDS = ("Agent", "Fly", "Newt", "Silkmoth", "Solo", "Shoal")
IDS = tuple(environment_id(name) for name in (*WORLDS, *TASKS))
SMALL = {"hidden": 8, "depth": 1}


def scenario_of(env: Any) -> dict[str, Any]:
    """What a world is made of, but who moves whom."""
    scenario = declared(env, "scenario") if isinstance(env, VecEnv) else env.unwrapped.scenario
    return {
        "species": scenario.species,
        "start": scenario.start,
        "condition": scenario.condition,
        "demos": None if scenario.demos is None else scenario.demos.fingerprint(),
        "noise": (scenario.observation_noise, scenario.observation_delay),
    }


@pytest.mark.parametrize("env_id", IDS)
def test_one_world_however_it_is_made(env_id: str) -> None:
    single = gym.make(env_id)
    learner = DQN("MlpPolicy", env_id, policy_kwargs=SMALL, device="cpu")
    ways = [
        gym.make_vec(env_id, num_envs=2),
        parallel_env(env_id),
        SlotVecEnv(env_id, 1),
        SlotVecEnv(env_id, 1, focal=single.unwrapped.scenario.names[0]),  # type: ignore[attr-defined]
        learner.get_env(),
        slot_environment(env_id, 1),  # the zoo's
    ]
    for other in ways:
        assert scenario_of(other) == scenario_of(single)
    drivers = [declared(env, "scenario").drivers for env in (ways[3], learner.get_env())]
    assert drivers == [single.unwrapped.scenario.drivers] * 2  # type: ignore[attr-defined]
    scored = validation_environment(env_id, 1)
    assert declared(scored, "scenario").species == scenario_of(single)["species"]


@pytest.mark.parametrize("name", WORLDS)
def test_one_world_of_animals_has_the_numbers_of_their_species(name: str) -> None:
    assert scenario_of(gym.make(environment_id(name)))["species"] == SPECIES[name.lower()]


@pytest.mark.slow
def test_one_world_of_the_command_line(tmp_path: Path) -> None:
    words = ("--algo", "dqn", "--steps", "30", "--set", "policy_kwargs={hidden: 8}")
    animarl("train", "--env", "AnimaRL/Fly-v0", *words, "--out", tmp_path / "run")
    assert Run(tmp_path / "run").species == SPECIES["fly"]
    task = ("train", "--env", "AnimaRL/FlyTask-v0", "--out", tmp_path / "task")
    refuses("is a task .*animarl_algos.zoo train", animarl, *task)


@pytest.mark.parametrize("task", TASKS)
def test_one_world_of_a_task_has_the_changes_of_its_table(task: str) -> None:
    found, base = scenario_of(gym.make(environment_id(task))), TASKS[task].base
    changes = SHARED_CHANGES | dict(TASKS[task].changes)
    assert found["start"] == changes.pop("start", "demo")
    for name, value in changes.items():
        if name == "locomotion":
            for who, factor in value.items():
                k = base.individuals.index(who)
                ratio = found["species"].locomotion[k].thrust / base.locomotion[k].thrust
                assert ratio == pytest.approx(factor)
        else:
            holder = found["species"].arena if name == "rebound" else found["species"]
            assert getattr(holder, name) == value


# Every learner in one world, and the two kinds of learners in every world; cloning there is slow.
FIRST = dict.fromkeys(
    [*((name, "AnimaRL/Agent-v0") for name in RECIPES), *itertools.product(("dqn",), IDS)]
)
CLONES = [pair for pair in itertools.product(("bc",), IDS) if pair not in FIRST]
PAIRS = [*FIRST, *(pytest.param(*pair, marks=pytest.mark.slow) for pair in CLONES)]


@pytest.mark.parametrize(("name", "env_id"), PAIRS)
def test_one_world_to_learn_and_to_act_in(name: str, env_id: str, tmp_path: Path) -> None:
    """A model made from an id acts in, is scored in and is loaded with ``gym.make`` of the id."""
    kind, env = RECIPES[name].algorithm, gym.make(env_id, time_limit=30)
    small = SMALL | ({"n_quantiles": 5} if kind.quantiles else {})
    given: dict[str, Any] = {"policy_kwargs": small, "device": "cpu", "seed": 0}
    if kind.recipe.needs_distance or kind.recipe.needs_alignment or kind.recipe.needs_condition:
        refuses(rf'{kind.recipe.name}.*SlotVecEnv\("', kind, "MlpPolicy", env_id, **given)
        return
    if not kind.recipe.online or RECIPES[name].pretrained:
        small_phase = {"sequence_length": 4, "updates_per_epoch": 2, "passes_per_epoch": None}
        given |= {"offline_epochs": 1, "offline_kwargs": small_phase, "offline_batch_size": 4}
    model = kind("MlpPolicy", env_id, **given)
    model.learn(40)
    action, _ = model.predict(env.reset(seed=0)[0])
    assert env.action_space.contains(action)
    mean, _ = evaluate_policy(model, env, 1)
    assert np.isfinite(mean)
    model.save(tmp_path / "model.zip")
    again = kind.load(tmp_path / "model.zip", env=gym.make(env_id), device="cpu")
    both = [m.predict(env.reset(seed=1)[0], deterministic=True)[0] for m in (model, again)]
    assert both[0] == both[1]


@pytest.mark.parametrize("copies", [None, 16])
def test_one_world_step_is_one_call_of_a_callback(copies: int | None, tmp_path: Path) -> None:
    env_id = "AnimaRL/FlyTask-v0"
    env: Any = gym.make(env_id) if copies is None else SlotVecEnv(env_id, copies, focal="male_0")
    scored = EvalCallback(gym.make(env_id, time_limit=5), eval_freq=200, n_eval_episodes=1)
    saved = CheckpointCallback(100, str(tmp_path))
    model = DQN("MlpPolicy", env, policy_kwargs=SMALL, seed=0, device="cpu")
    model.learn(1000, callback=[saved, scored])
    steps = sorted(int(path.stem.split("_")[2]) for path in tmp_path.glob("*.zip"))
    assert steps == list(range(100, 1001, 100))
    assert scored.n_calls == model.num_timesteps and scored.last_mean_reward > -np.inf


@pytest.mark.parametrize("env_id", IDS)
def test_one_world_has_one_time_limit(env_id: str) -> None:
    for options in ({"max_episode_steps": 13}, {"time_limit": 13}):
        env = gym.make(env_id, **options)
        many = gym.make_vec(env_id, num_envs=2, vectorization_mode="vector_entry_point", **options)
        env.reset(seed=0)
        steps, terminated, truncated = 0, False, False
        while not (terminated or truncated):
            _, _, terminated, truncated, _ = env.step(COAST)
            steps += 1
        assert terminated or steps == 13
        assert env.spec is not None and env.spec.max_episode_steps == 13
        assert many.spec is not None and many.spec.max_episode_steps == 13
    plain = gym.make(env_id)
    assert plain.spec is not None
    assert plain.spec.max_episode_steps == scenario_of(plain)["species"].time_limit
