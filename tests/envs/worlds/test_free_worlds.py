"""The world without a target: one animal, and groups of animals that are alike."""

from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest
from recordings import DT, STEPS, SYNTHETIC, begun, group
from refusals import refuses

import animarl_envs
from animarl_envs.arena import Arena
from animarl_envs.fitting.joint import joint_locomotion
from animarl_envs.fitting.tracking import track
from animarl_envs.focus import COURSE
from animarl_envs.scenario import make_scenario
from animarl_envs.worlds import demonstration_observations, observation_components
from animarl_envs.worlds.chase.kernels import PAIRED
from animarl_envs.worlds.chase.layout import DELAY, DELAYS


@pytest.mark.parametrize("animals", [1, 2, 7])
def test_world_labels_and_tracking_have_one_focus(animals: int) -> None:
    """What replayed animals observe and where they head are those of the recorded frames."""
    demos = group(animals)
    drivers = dict.fromkeys(demos.individuals, "replay")
    scenario = make_scenario("custom", demos=demos, split="train", drivers=drivers)
    world = begun(scenario)
    assert scenario.demos is not None
    seen = demonstration_observations(scenario.species, scenario.demos)
    first, focus = int(scenario.demos.offsets[world.demo[0]]), scenario.demos.focus()
    for t in range(STEPS - 1):
        np.testing.assert_allclose(world.observation[0], seen[first + t], atol=2e-5)
        np.testing.assert_allclose(world.towards[0], focus[first + t], atol=1e-12)
        world.step(np.zeros((1, animals), dtype=np.int64))
    # A course is the exponential mean of the velocities so far.
    velocity = scenario.demos.velocities()[first : first + 5, 0]
    mean = velocity[0]
    for before, one in enumerate(velocity[1:], start=1):  # the first few count alike
        mean = mean + (one - mean) * max(DT / COURSE, 1.0 / (1.0 + before))
    np.testing.assert_allclose(focus[first + 4, 0], mean / np.linalg.norm(mean))


def test_the_nearest_few_do_not_depend_on_what_was_seen_before() -> None:
    """As of all pairs, ties by index, while animals move, jump and start anew."""
    scenario = make_scenario("shoal", demos=None, num_pursuers=30, neighbours=5)
    world, rng = begun(scenario, 3), np.random.default_rng(1)
    names = [one.name for one in observation_components(scenario.species)]
    shown = [names.index(f"other {k} relative position ahead") for k in range(1, 6)]
    for step in range(12):
        if step % 4 == 2:  # onto a lattice, where many are as far away
            world.position[:] = rng.integers(-3, 4, world.position.shape) / 4.0
        world.step(rng.integers(13, size=(3, 30)))
        if step == 7:
            world.reset(np.array([True, False, True]))
        offset = world.position[:, None] - world.position[:, :, None]
        apart = np.square(offset).sum(axis=-1)
        apart[:, np.arange(30), np.arange(30)] = np.inf
        nearest = np.argsort(apart, axis=-1, kind="stable")[..., :5]
        towards = np.take_along_axis(offset, nearest[..., None], axis=2)
        ahead = np.einsum("bikx,bix->bik", towards, world.towards)
        np.testing.assert_allclose(world.observation[..., shown], ahead, atol=1e-5)


@pytest.mark.parametrize("dt", [0.1, 0.04], ids=["a step each", "two and a half"])
def test_speeds_are_remembered_in_a_delay_line(dt: float) -> None:
    """What a rhythm leaves behind: each delay follows the one before, and the first the speed."""
    demos = replace(group(1), dt=dt)
    scenario = make_scenario("custom", demos=demos, split="train")
    species = scenario.species
    assert scenario.demos is not None
    names = [one.name for one in observation_components(species)]
    first = next(k for k, name in enumerate(names) if "1 delays ago" in name)
    seen = demonstration_observations(species, scenario.demos)[: STEPS + 1, 0]
    speed = np.linalg.norm(scenario.demos.velocities()[: STEPS + 1, 0], axis=1)
    line = np.full(DELAYS, speed[0])
    stride = species.locomotion[0].smallest_thrust * dt
    for t in range(STEPS + 1):
        told = np.log(line / stride + 0.3)
        np.testing.assert_allclose(seen[t, first : first + DELAYS], told, atol=1e-5)
        if dt == DELAY and t >= DELAYS:  # what it was so many steps ago
            np.testing.assert_allclose(line, speed[t - DELAYS : t][::-1])
        line += min(1.0, dt / DELAY) * (np.concatenate([speed[t : t + 1], line[:-1]]) - line)


def test_who_is_who_does_not_matter() -> None:
    demos = group(5)
    fitted = joint_locomotion(demos, 2)
    assert len(set(fitted)) == 1
    dealt = [3, 0, 4, 1, 2]
    other = make_scenario("custom", demos=demos).species
    seen = demonstration_observations(other, demos)
    moved, velocity = demos.positions[:, dealt], demos.initial_velocity[:, dealt]
    mixed = replace(demos, positions=moved, initial_velocity=velocity)
    np.testing.assert_allclose(demonstration_observations(other, mixed), seen[:, dealt], atol=1e-6)
    assert joint_locomotion(mixed, 2)[0].thrust == pytest.approx(fitted[0].thrust, rel=1e-6)


def test_tracking_follows_free_animals() -> None:
    demos = group(4)
    followed = track(demos, joint_locomotion(demos, 3))
    miss = np.linalg.norm(followed.positions - demos.positions, axis=-1)
    step = np.linalg.norm(np.diff(demos.path(0), axis=0), axis=-1)
    assert np.median(miss) < 0.25 * np.median(step)


def test_nothing_ends_but_by_leaving() -> None:
    """In a walled field only time does; where the edge is open, who leaves it."""
    demos = group(3)
    env = gym.make("AnimaRL/Custom-v0", demos=demos, time_limit=STEPS, contact_radius=0.5)
    env.reset(seed=0)
    for _ in range(STEPS):
        _, reward, terminated, truncated, _ = env.step(env.action_space.sample())
        assert not terminated and reward == 0.0
    assert truncated
    fleeing = begun(make_scenario("custom", demos=demos, rebound=False, boundary=1.1), 2)
    for _ in range(400):
        fleeing.step(np.zeros((2, 3), dtype=np.int64))
        if fleeing.terminated.all():
            break
    assert fleeing.terminated.all() and (fleeing.reward < 0).any()


def test_a_shoal_may_be_paid_for_company() -> None:
    demos = group(4)
    start = np.array([[0.0, 0.0], [0.05, 0.0], [0.5, 0.0], [-0.5, 0.0]])
    paid = {"start": start, "shoaling_reward": True, "contact_radius": 0.2}
    scenario = make_scenario("custom", demos=demos, **paid)
    world = begun(scenario)
    world.step(np.full((1, 4), world.num_actions - 1))
    np.testing.assert_allclose(world.reward[0], [DT, DT, 0.0, 0.0])
    many = begun(make_scenario("shoal", demos=None, num_pursuers=PAIRED + 1, shoaling_reward=True))
    many.step(np.full((1, PAIRED + 1), many.num_actions - 1))
    apart = np.linalg.norm(many.position[0] - many.position[0][:, None], axis=2)
    near = (apart < 0.1).sum(axis=1) > 1
    assert 0 < near.sum() <= PAIRED
    np.testing.assert_array_equal(many.reward[0], np.where(near, 0.1, 0.0))


def test_views_and_options_of_free_animals() -> None:
    demos = group(3)
    both = animarl_envs.parallel_env("custom", demos=demos)
    observed, _ = both.reset(seed=0)
    assert set(observed) == set(demos.individuals)
    fewer = make_scenario("custom", demos=demos, num_pursuers=2)
    assert fewer.species.individuals == demos.individuals[:2]
    more = make_scenario("custom", demos=demos, num_pursuers=20, start="uniform")
    assert more.species.num_individuals == 20 and more.species.free
    refuses("num_targets does not apply", make_scenario, "custom", demos=demos, num_targets=2)
    refuses("neighbours is -1", make_scenario, "custom", demos=demos, neighbours=-1)


def test_a_what_if_of_free_animals_asks_for_no_goal() -> None:
    pytest.importorskip("stable_baselines3")
    from animarl_algos.whatif.quantities import quantities_of
    from animarl_envs.demos.summary import RECORDED_SCALE

    for animals, asked in ((1, ["speed"]), (4, ["speed", "nearest neighbour"])):
        species = make_scenario("custom", demos=group(animals)).species
        assert [one.name for one in quantities_of(species, RECORDED_SCALE)] == asked


def test_free_animals_differ_as_training_animals_do() -> None:
    """Who was quick stays so: each simulated animal has the traits of some recorded one."""
    pytest.importorskip("scipy")
    own = np.linspace(0.5, 1.5, 12)
    rng, steps = np.random.default_rng(0), 60
    turns = rng.normal(0.0, 0.2, (12, steps)).cumsum(axis=1)
    step = 0.01 * own[:, None, None] * np.stack([np.cos(turns), np.sin(turns)], axis=-1)
    paths = np.concatenate([np.zeros((12, 1, 2)), step.cumsum(axis=1)], axis=1)
    demos = replace(
        group(1, 12, "open"), positions=np.concatenate(list(paths))[:, None],
        lengths=np.full(12, steps + 1), initial_velocity=step[:, :1] / DT,
        provenance={**SYNTHETIC, "synthetic": False},
    )  # fmt: skip
    species = make_scenario("custom", demos=demos, split=None).species
    assert species.traits is not None and len(species.traits.table) == 10  # no test episodes
    names = [one.name for one in observation_components(species)]
    seen = demonstration_observations(species, demos)[demos.offsets[:-1], 0]
    assert (np.diff(seen[:, names.index("own speed")]) >= 0).all()
    world = begun(make_scenario(species, demos=demos, split="test"), 200)
    speeds = world.observation[:, 0, names.index("own speed")]
    assert len(np.unique(speeds)) > 5
    table = species.traits.table[:, 0, 0].astype(np.float32)
    assert set(speeds.tolist()) <= set(table.tolist())
    world.step(np.zeros((200, 1), dtype=np.int64))
    np.testing.assert_array_equal(world.observation[:, 0, names.index("own speed")], speeds)


def test_animals_of_a_group_share_their_traits() -> None:
    pytest.importorskip("scipy")
    from animarl_envs.fitting.custom_species import fitted_traits

    demos = group(4, episodes=12)
    pace = np.array([0.4, 0.8, 1.2, 1.6])
    walks = demos.positions[:1] + pace[:, None] * (demos.positions - demos.positions[:1])
    traits = fitted_traits(replace(demos, positions=walks, arena=Arena("open", 1.0)))
    assert traits is not None and traits.table.shape == (4 * 10, 1, 2)


def test_animals_of_a_chase_get_the_traits_of_animals_that_were_recorded_together() -> None:
    pytest.importorskip("scipy")
    rng, steps = np.random.default_rng(0), 60
    pace = np.stack([np.linspace(0.5, 1.5, 12), np.linspace(2.5, 1.5, 12)], axis=1)
    turns = rng.normal(0.0, 0.2, (12, steps, 2)).cumsum(axis=1)
    step = 0.01 * pace[:, None, :, None] * np.stack([np.cos(turns), np.sin(turns)], axis=-1)
    paths = np.concatenate([np.zeros((12, 1, 2, 2)), step.cumsum(axis=1)], axis=1)
    demos = replace(
        group(2, 12, "open"), positions=np.concatenate(list(paths)),
        roles=("pursuer", "target"), individuals=("male", "female"),
        lengths=np.full(12, steps + 1), initial_velocity=step[:, 0] / DT,
        provenance={**SYNTHETIC, "synthetic": False},
    )  # fmt: skip
    species = make_scenario("custom", demos=demos, split=None).species
    assert species.traits is not None and species.traits.table.shape == (10, 2, 2)
    world = begun(make_scenario(species, demos=demos, split="test"), 200)
    at = [one.name for one in observation_components(species)].index("own speed")
    given, table = world.observation[:, :, at], species.traits.table[..., 0].astype(np.float32)
    assert {tuple(pair) for pair in given.tolist()} == {tuple(pair) for pair in table.tolist()}
    one = species.of_individuals([1, 0]).traits
    assert one is not None and np.array_equal(one.table, species.traits.table[:, ::-1])
