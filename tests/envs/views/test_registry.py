"""Every registered id, view, condition and wrapper passes the libraries' checks and agrees."""

import copy
import itertools
import json
import pickle
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from importlib import import_module
from importlib.util import find_spec
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray
from pettingzoo.test import parallel_api_test, parallel_seed_test
from recordings import dogs, recordings_of

import animarl_envs
from animarl_envs.demos.episode import UNFINISHED
from animarl_envs.demos.packaged import load_packaged, packaged_names
from animarl_envs.scenario import make_scenario
from animarl_envs.species import CUSTOM, SPECIES
from animarl_envs.tasks import TASKS, find_task
from animarl_envs.worlds import make_world
from animarl_envs.wrappers import (
    ConditionFlag,
    ConditionFlagParallel,
    ConditionFlagVector,
    DTWReward,
    DTWRewardParallel,
    DTWRewardVector,
)

pytestmark = [
    pytest.mark.filterwarnings("error"),
    pytest.mark.filterwarnings(
        "ignore:reset has no option .options.:UserWarning"
    ),  # PettingZoo asks
    pytest.mark.usefixtures("_garbage_collected"),
]

NAMES = (*SPECIES, CUSTOM, *TASKS)
WRAPPERS: dict[str, tuple[tuple[Any, Any, Any], ...]] = {  # single, vector, parallel
    "bare": (),
    "dtw": ((DTWReward, DTWRewardVector, DTWRewardParallel),),
    "flag": ((ConditionFlag, ConditionFlagVector, ConditionFlagParallel),),
}
WRAPPERS["dtw+flag"] = WRAPPERS["dtw"] + WRAPPERS["flag"]
SINGLE, VECTOR, PARALLEL = range(3)


@dataclass(frozen=True)
class Case:
    """One environment of the table: a species, with or without demonstrations, in a condition."""

    name: str
    recorded: bool
    condition: Any
    wrappers: str

    @property
    def options(self) -> dict[str, Any]:
        task = find_task(self.name)
        species = self.name if task is None else task.base.name
        made = dogs(2) if species == CUSTOM else recordings_of(species)
        start = {"start": "demo"} if self.recorded and task is not None else {}
        return {"demos": made if self.recorded else None, "condition": self.condition} | start

    def single(self, **more: Any) -> gym.Env[Any, Any]:
        env = gym.make(animarl_envs.environment_id(self.name), **self.options, **more)
        return self._wrapped(env, SINGLE)

    def vector(self, num_envs: int, **more: Any) -> Any:
        name = animarl_envs.environment_id(self.name)
        env = gym.make_vec(name, num_envs=num_envs, **self.options, **more)
        return self._wrapped(env, VECTOR)

    def parallel(self, **more: Any) -> Any:
        env = animarl_envs.parallel_env(self.name, **self.options, **more)
        return self._wrapped(env, PARALLEL)

    def _wrapped(self, env: Any, view: int) -> Any:
        for forms in WRAPPERS[self.wrappers]:
            env = forms[view](env)
        return env

    def __str__(self) -> str:
        start = "recorded" if self.recorded else "free"
        return f"{self.name}-{start}-{self.condition}-{self.wrappers}"


def table() -> Iterator[Case]:
    for name, recorded, wrappers in itertools.product(NAMES, (True, False), WRAPPERS):
        task = find_task(name)
        species = SPECIES.get(name) if task is None else task.base
        two = species is not None and bool(species.conditions)
        if name == CUSTOM and not recorded:
            continue  # it is made from its demonstrations
        if "dtw" in wrappers and not recorded:
            continue  # refused, see test_wrappers
        if "flag" in wrappers and not two:
            continue  # refused, see test_wrappers
        conditions = (0, 1, "demo") if two else (0, "demo")
        for condition in conditions[-1:] if "dtw" in wrappers else conditions:
            yield Case(name, recorded, condition, wrappers)


CASES = tuple(table())
every_case = pytest.mark.parametrize("case", CASES, ids=str)


def test_registry_is_what_is_tested() -> None:
    ids = {name for name in gym.registry if name.startswith("AnimaRL/")}
    assert ids == {animarl_envs.environment_id(n) for n in NAMES}
    assert "AnimaRL/SilkmothMemory-v0" in ids
    assert len(CASES) > 40


@every_case
def test_registry_single_passes_the_libraries_checks(case: Case) -> None:
    env = case.single()
    if find_spec("stable_baselines3") is not None:  # the core does without
        import_module("stable_baselines3.common.env_checker").check_env(env)
    if case.wrappers == "bare":
        check_env(env.unwrapped, skip_render_check=True)
        return
    warnings.filterwarnings("ignore", ".*different from the unwrapped version")
    check_env(env, skip_render_check=True)


@every_case
def test_registry_parallel_passes_the_libraries_checks(case: Case) -> None:
    parallel_api_test(case.parallel(), num_cycles=60)
    parallel_seed_test(case.parallel, num_cycles=30)


@every_case
def test_registry_vector_equals_singles(case: Case) -> None:
    """Beyond several ends of episodes: the limit is shorter than the run."""
    copies, most = 3, 25
    vector = case.vector(copies, time_limit=most)
    views = [case.single(time_limit=most) for _ in range(copies)]
    rng = np.random.default_rng(0)
    observations = vector.reset(seed=20)[0]
    assert vector.observation_space.contains(observations)
    assert np.array_equal(observations, [v.reset(seed=20 + b)[0] for b, v in enumerate(views)])
    ended = np.zeros(copies, dtype=bool)
    for _ in range(3 * most):
        actions = rng.integers(13, size=copies)
        observations, rewards, terminated, truncated, _ = vector.step(actions)
        assert vector.observation_space.contains(observations)
        for b, view in enumerate(views):
            if ended[b]:
                row, reward, over, cut = view.reset()[0], 0.0, False, False
            else:
                row, reward, over, cut, _ = view.step(actions[b])
            assert np.array_equal(row, observations[b])
            assert (reward, over, cut) == (rewards[b], terminated[b], truncated[b])
        ended = terminated | truncated


@every_case
def test_registry_parallel_equals_single(case: Case) -> None:
    """The others of the single view follow policies that say what the parallel view is told."""
    everyone = case.parallel()
    plan = np.random.default_rng(1).integers(13, size=(30, len(everyone.possible_agents)))
    clock = {"t": 0}

    def planned(i: int) -> Any:
        return lambda seen: np.full(len(seen), plan[clock["t"], i])

    *rest, focal = everyone.possible_agents
    env = case.single(focal=focal, others={name: planned(i) for i, name in enumerate(rest)})
    assert np.array_equal(env.reset(seed=2)[0], everyone.reset(seed=2)[0][focal])
    for t, row in enumerate(plan):
        clock["t"] = t
        seen, reward, over, cut, info = env.step(int(row[-1]))
        all_seen, rewards, overs, cuts, infos = everyone.step(
            dict(zip(everyone.possible_agents, row.tolist(), strict=True))
        )
        assert np.array_equal(seen, all_seen[focal])
        assert (reward, over, cut) == (rewards[focal], overs[focal], cuts[focal])
        assert info["outcome"] == infos[focal]["outcome"]
        if over or cut:
            break


def _same(one: Any, two: Any) -> bool:
    """Equality of what a step returns, arrays in dictionaries included."""
    if isinstance(one, dict):
        return one.keys() == two.keys() and all(_same(v, two[k]) for k, v in one.items())
    if isinstance(one, tuple):
        return len(one) == len(two) and all(map(_same, one, two))
    if isinstance(one, np.ndarray) and one.dtype == object:
        return all(map(_same, one.tolist(), two.tolist()))
    return bool(np.array_equal(one, two))


def _everyone(action: int, agents: list[str]) -> dict[str, int]:
    return {agent: (action + k) % 13 for k, agent in enumerate(agents)}


@every_case
def test_registry_copies_continue_identically(case: Case) -> None:
    """Pickled or deeply copied in the middle of an episode, in every view."""
    single, vector, everyone = case.single(), case.vector(3), case.parallel()
    for env in (single, vector, everyone):
        env.reset(seed=7)  # of episodes that last
    agents = everyone.possible_agents
    act: list[tuple[Any, Any]] = [
        (single, lambda a: a),
        (vector, lambda a: np.array([a, (a + 5) % 13, 12])),
        (everyone, lambda a: _everyone(a, agents)),
    ]
    for env, actions in act:
        for _ in range(5):
            env.step(actions(3))
        twins = [copy.deepcopy(env), pickle.loads(pickle.dumps(env))]
        for action in (0, 12, 7, 1):
            expected = env.step(actions(action))
            for twin in twins:
                assert _same(twin.step(actions(action)), expected)


def _arrays(value: Any) -> list[NDArray[Any]]:
    if isinstance(value, np.ndarray):
        return [value, *_arrays(value.tolist())] if value.dtype == object else [value]
    if isinstance(value, dict):
        return [a for v in value.values() for a in _arrays(v)]
    return [a for v in value for a in _arrays(v)] if isinstance(value, tuple | list) else []


@every_case
def test_registry_nothing_returned_shares_memory(case: Case) -> None:
    """Not with what is returned later, nor between individuals, nor with the world."""
    single, everyone = case.single(), case.parallel()
    vector = case.vector(3, time_limit=11, autoreset_mode=AutoresetMode.SAME_STEP)
    agents = everyone.possible_agents
    for env, actions in (
        (single, 3), (vector, np.array([3, 3, 3])), (everyone, _everyone(3, agents)),
    ):  # fmt: skip
        returned = _arrays(env.reset(seed=0)[0])
        kept = [array.copy() for array in returned]
        for _ in range(11):
            step = env.step(actions)
            returned += _arrays(step)
            kept += [array.copy() for array in _arrays(step)]
            if env is single and (step[2] or step[3]):
                break
        assert all(_same(a, b) for a, b in zip(returned, kept, strict=True))
        world = env.unwrapped.world
        owned = [a for a in vars(world).values() if isinstance(a, np.ndarray) and a.size]
        for a in returned:
            assert not any(np.shares_memory(a, b) for b in owned)


@every_case
def test_registry_spec_round_trip(case: Case) -> None:
    env, vector = case.single(time_limit=30), case.vector(2, time_limit=30)
    again = gym.make(env.spec)  # type: ignore[arg-type]
    assert type(again.unwrapped) is type(env.unwrapped)
    assert again.spec == env.spec
    assert np.array_equal(env.reset(seed=3)[0], again.reset(seed=3)[0])
    for action in (0, 4, 12):
        assert _same(env.step(action), again.step(action))
    if case.wrappers == "bare":
        twin = gym.make_vec(vector.spec)
        assert np.array_equal(vector.reset(seed=3)[0], twin.reset(seed=3)[0])
        assert twin.unwrapped.scenario.species == vector.unwrapped.scenario.species


@pytest.mark.parametrize("name", SPECIES)
def test_registry_spec_goes_through_json(name: str) -> None:
    options = {
        "demos": None, "contact_radius": 0.06, "time_limit": 77, "observation_noise": 0.01,
        "observation_delay": 2, "arena": 1.5, "locomotion": {SPECIES[name].individuals[0]: 1.2},
    }  # fmt: skip
    env = gym.make(animarl_envs.environment_id(name), **options)
    assert env.spec is not None
    again = gym.make(gym.envs.registration.EnvSpec.from_json(env.spec.to_json()))
    assert np.array_equal(env.reset(seed=3)[0], again.reset(seed=3)[0])
    said = again.reset(seed=3)[1]["scenario"]
    assert said["contact_radius"] == 0.06
    assert said["time_limit"] == 77
    assert said["observation_delay"] == 2
    assert said["arena"]["size"] == 1.5
    assert said["locomotion"][0]["thrust"] == 1.2 * SPECIES[name].locomotion[0].thrust


@every_case
def test_registry_info_at_reset_is_plain_and_complete(case: Case) -> None:
    info = case.single().reset(seed=0)[1]
    infos = case.vector(2).reset(seed=0)[1]
    said = info["scenario"]
    assert json.loads(json.dumps(said)) == said
    drivers = ("drivers",)  # differ: the others of a single view replay or follow a script
    for other in (*infos["scenario"], case.parallel().scenario_data):
        assert all(other[key] == said[key] for key in said if key not in drivers)
    spec = case.single().unwrapped.scenario.species  # type: ignore[attr-defined]
    assert {"species", "drivers", "condition", "start", "demonstrations", "split"} <= set(said)
    assert set(vars(spec)) - {"name", "version_history"} <= set(said)
    assert said["episodes"] == (
        len(case.options["demos"].select(split="train")) if case.recorded else 0
    )
    if case.name == "silkmoth":
        assert said["plume"] == "model"


@every_case
def test_registry_infos_of_all_individuals_have_one_shape(case: Case) -> None:
    env = case.parallel(max_cycles=20)
    shapes = []
    infos = env.reset(seed=0)[1]
    cut = False
    for _ in range(60):
        shapes += [sorted(info) for info in infos.values()]
        assert all(np.isscalar(value) for info in infos.values() for value in info.values())
        assert all(info["TimeLimit.truncated"] == cut for info in infos.values())
        if env.agents:
            actions = {agent: env.action_space(agent).n - 1 for agent in env.agents}
            *_, truncated, infos = env.step(actions)
            cut = any(truncated.values())
        else:
            infos = env.reset()[1]
    assert all(one == shapes[0] for one in shapes)
    assert env.state().shape == env.state_space.shape and env.state() in env.state_space


def test_registry_modules_are_as_pettingzoos_users_write() -> None:
    from animarl_envs import newt_v0

    env = newt_v0.parallel_env(render_mode=None)
    assert env.possible_agents == ["male_0", "male_1", "female"]
    turns = newt_v0.env()
    turns.reset(seed=0)
    assert turns.agent_selection == "male_0"
    with pytest.raises(ImportError):
        from animarl_envs import dodo_v0  # noqa: F401


@pytest.mark.slow
def test_registry_torchrl_takes_all_individuals() -> None:
    torchrl = pytest.importorskip("torchrl.envs")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of a newer PettingZoo than TorchRL is tested with
        env = torchrl.PettingZooWrapper(animarl_envs.parallel_env("agent", demos=None))
    steps = env.rollout(5)
    assert tuple(steps.batch_size) == (5,)
    assert {"predator", "prey"} <= set(env.group_map)


@pytest.mark.parametrize("name", packaged_names())
def test_registry_packaged_demonstrations_end_as_recorded(name: str) -> None:
    """Replayed in their world, all of them, at the recorded step and with the recorded outcome."""
    demos = load_packaged(name)
    drivers = dict.fromkeys(demos.individuals, "replay")
    world = make_world(make_scenario(name, split=None, drivers=drivers), len(demos))
    world.reset(demo=np.arange(len(demos)))
    steps = demos.lengths - 1
    for t in range(1, int(steps.max()) + 1):
        world.step(np.zeros((len(demos), demos.num_individuals), dtype=int))
        running = steps >= t
        over = world.terminated | world.truncated
        if not demos.has_goal:  # the film ends; the animals go on
            assert not world.terminated[running].any() and (demos.outcome == UNFINISHED).all()
            continue
        assert np.array_equal(over[running], steps[running] == t)
        assert np.array_equal(world.outcome[steps == t], demos.outcome[steps == t])
