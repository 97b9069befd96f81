"""Several thrust magnitudes: 12 M + 1 actions in every world, view and learner."""

from dataclasses import replace
from functools import partial

import gymnasium as gym
import numpy as np
import pytest
from recordings import begun
from refusals import refuses
from thrust_walks import DT, MULTIPLES, TRUTH, three, walk

import animarl_envs
from animarl_algos.data.slot_layout import refuse_other_actions
from animarl_algos.data.species_data import SpeciesDemonstrations
from animarl_algos.data.vec_env import SlotVecEnv
from animarl_algos.evaluation.collect import RandomPolicy, collect_rollouts
from animarl_algos.recipes.registry import DQN
from animarl_envs.demos.packaged import load_packaged
from animarl_envs.fitting.joint import nearest_actions
from animarl_envs.fitting.tracking import one_step_misses
from animarl_envs.fitting.transitions import demonstrated_actions, transitions
from animarl_envs.focus import focus_directions
from animarl_envs.locomotion import COAST, MOST_THRUSTS, Locomotion, apply_actions, infer_actions
from animarl_envs.scenario import make_scenario
from animarl_envs.species import AGENT, FLY, SILKMOTH, ChaseSpecies, Species
from animarl_envs.species.options import with_options
from animarl_envs.views.common import scenario_as_data
from animarl_envs.worlds import make_world
from animarl_envs.worlds.search.programmed_moth import ProgrammedMoth


def test_magnitudes_are_an_option_by_name() -> None:
    every = {name: {"magnitudes": MULTIPLES} for name in FLY.individuals}
    scenario = make_scenario("fly", locomotion=every)
    assert scenario.species == three(FLY)
    stated = scenario_as_data(scenario)["locomotion"]
    assert [one["magnitudes"] for one in stated] == [list(MULTIPLES)] * 3
    mixed = (Locomotion(0.25, 3.0, MULTIPLES), *AGENT.locomotion[1:])
    refuses("predator_0 3, predator_1 1", replace, AGENT, locomotion=mixed)


@pytest.mark.parametrize("plain", [AGENT, SILKMOTH], ids=["agent", "silkmoth"])
def test_worlds_and_numpy_move_alike(plain: Species) -> None:
    species = three(plain)
    world = begun(make_scenario(species, demos=None), 50)
    rng = np.random.default_rng(0)
    for _ in range(10):
        actions = rng.integers(37, size=(50, species.num_individuals))
        towards = focus_directions(world.position, species.roles)
        expected = np.stack(
            [apply_actions(world.velocity[:, i], actions[:, i], towards[:, i], m, species.dt)
             for i, m in enumerate(species.locomotion)], axis=1,
        )  # fmt: skip
        world.step(actions)
        np.testing.assert_allclose(world.velocity, expected, rtol=1e-12, atol=1e-12)


def test_the_fit_rebuilds_velocities_with_the_same_transition() -> None:
    """The loss of the joint fit is the squared miss of the inferred actions."""
    demos, _ = walk(TRUTH, 2, noise=0.01)
    own = Locomotion(0.3, 1.5, MULTIPLES)
    data = transitions(demos, 0)
    error, _, level = nearest_actions(data, own.damping, own.thrust * np.array(MULTIPLES))
    inferred = infer_actions(data.velocity, data.next_velocity, data.focus, own, DT)
    rebuilt = apply_actions(data.velocity, inferred, data.focus, own, DT)
    missed = np.sum((rebuilt - data.next_velocity) ** 2, axis=1)
    np.testing.assert_allclose(error, missed, rtol=1e-9, atol=1e-15)
    np.testing.assert_array_equal(level, np.where(inferred == 36, -1, inferred // 12))


@pytest.mark.parametrize("name", ["fly", "silkmoth"])
@pytest.mark.parametrize("thrusts", [1, np.int64(2), 3, 5, MOST_THRUSTS])
def test_thrusts_are_an_option_of_all_views(name: str, thrusts: int) -> None:
    env_id, count = animarl_envs.environment_id(name), 12 * thrusts + 1
    env = gym.make(env_id, thrusts=thrusts)
    envs = gym.make_vec(env_id, num_envs=2, thrusts=thrusts)
    everybody = animarl_envs.parallel_env(name, thrusts=thrusts)
    assert env.action_space == envs.unwrapped.single_action_space == gym.spaces.Discrete(count)  # type: ignore[attr-defined]
    assert all(everybody.action_space(each).n == count for each in everybody.possible_agents)  # type: ignore[attr-defined]
    env.reset(seed=0)
    env.step(count - 1)
    refuses(f"0 to {count - 1}", env.unwrapped.step, count)  # type: ignore[attr-defined]
    assert SlotVecEnv(name, 1, thrusts=thrusts).action_space == env.action_space
    assert env.unwrapped.scenario.species.thrusts == thrusts  # type: ignore[attr-defined]


def test_one_thrust_leaves_all_as_it_is() -> None:
    for species in (AGENT, FLY, SILKMOTH):
        assert with_options(species, thrusts=1) == with_options(species, thrusts=None) == species
    richer = with_options(FLY, locomotion=Locomotion(0.1, 1.0, (1.2, 0.3)))
    assert with_options(richer, thrusts=2) == richer
    assert with_options(richer, thrusts=1).locomotion == (Locomotion(0.1, 1.0),) * 3


def test_thrusts_go_with_other_thrusts_and_dampings() -> None:
    female = {"female": {"damping": 0.5}, "male_0": 1.2}
    told = with_options(FLY, thrusts=3, locomotion=female)
    apart = with_options(three(FLY), locomotion=female)
    assert told == apart
    alike = with_options(FLY, thrusts=3, locomotion=Locomotion(0.1, 2.0))
    assert alike.locomotion == (Locomotion(0.1, 2.0, MULTIPLES),) * 3
    assert with_options(AGENT, thrusts=2, num_pursuers=4).thrusts == 2


def test_your_own_animals_have_their_thrusts_fitted() -> None:
    demos, _ = walk(TRUTH, 1)
    species = make_scenario("custom", demos=demos, thrusts=3).species
    assert species.num_actions == 37
    assert isinstance(species, ChaseSpecies) and species.senses_past
    for own, truth in zip(species.locomotion, TRUTH, strict=True):
        expected = truth.thrust * np.array(truth.magnitudes)
        np.testing.assert_allclose(own.thrust * np.array(own.magnitudes), expected, rtol=1e-4)
    assert gym.make("AnimaRL/Custom-v0", demos=demos, thrusts=3).action_space.n == 37  # type: ignore[attr-defined]
    assert make_scenario("custom", demos=demos).species.num_actions == 13


def test_whoever_nobody_drives_coasts() -> None:
    drivers = dict.fromkeys(AGENT.individuals, "coast")
    world = make_world(make_scenario(three(AGENT), demos=None, drivers=drivers), 3)
    world.reset()
    world.velocity[:] = 0.4
    world.step(np.zeros((3, 3), dtype=np.int64))
    np.testing.assert_allclose(world.velocity, 0.3, rtol=1e-12)


def test_the_programmed_moth_uses_what_it_has() -> None:
    species = three(SILKMOTH)
    moth = ProgrammedMoth(200, np.random.default_rng(0), species)
    world = make_world(make_scenario(species, demos=None), 200)
    world.reset()
    taken = np.concatenate([(moth.act(world.observation)) for _ in range(3)])
    assert taken.min() >= 0 and taken.max() == 36
    rest = moth._nearest_action(np.zeros((1, 2)), np.zeros((1, 2)))
    assert rest.tolist() == [36]


def test_data_and_decisions_have_a_value_per_action() -> None:
    demos = load_packaged("agent")
    few = demos.select(
        episodes=np.concatenate([np.flatnonzero(demos.split == s)[:3] for s in ("train", "val")])
    )
    species = three(AGENT)
    train = SpeciesDemonstrations(species, few, species.individuals).train
    batch = next(iter(train.batches(2, np.random.default_rng(0))))
    assert batch.action_penalties.shape[-1] == 37 and batch.actions.max() > COAST
    penalties = one_step_misses(few, species.locomotion)
    assert penalties.shape == (len(few.positions), 3, 37)
    acted = demonstrated_actions(few, species.locomotion)
    np.testing.assert_array_equal(penalties[acted >= 0].argmin(axis=1), acted[acted >= 0])


def test_a_model_of_other_magnitudes_is_refused() -> None:
    model = DQN(env=SlotVecEnv("agent", 2), offline_epochs=0, seed=0, buffer_size=1000)
    richer = SlotVecEnv(three(AGENT), 2)
    refuses(r"13 actions learned and 37 here: .*thrust magnitudes", model.set_env, richer)
    scenario = make_scenario(three(AGENT), split="val")
    make, told = partial(make_world, scenario), {"method": "dqn", "seed": 0, "repetitions": 1}
    refuses("thrust magnitudes", collect_rollouts, make, model, **told)
    refuse_other_actions(37, 37)
    actions, _ = RandomPolicy(0, 37).predict(np.zeros((5000, 4)))
    assert set(actions.tolist()) == set(range(37))
