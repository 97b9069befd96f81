"""Traits: found where animals differ, drawn from training animals, told to recordings' clones."""

from dataclasses import replace

import numpy as np
import pytest
from refusals import refuses
from search_worlds import random_actions, rollout, search_world

from animarl_envs.demos.packaged import load_packaged
from animarl_envs.fitting.custom_species import species_of
from animarl_envs.species import SILKMOTH
from animarl_envs.species.traits import LARGEST, Floats, Traits, episode_traits, fit_traits
from animarl_envs.worlds import demonstration_observations

DT = 0.5
TABLE = np.array([[[-1.0, 0.5]], [[1.0, -0.5]], [[2.0, 0.0]]])
THREE = Traits(np.zeros((2, 1, 2)), np.ones((1, 2)), TABLE)


def walks(speeds: Floats, steps: int = 80) -> tuple[Floats, np.ndarray]:
    """One walk of each mean speed [arena unit / s]; speeds and courses vary from step to step."""
    draw = np.random.default_rng(1)
    paths = []
    for mean in speeds:
        speed = mean * draw.uniform(0.5, 1.5, steps)
        course = np.cumsum(draw.normal(0.0, 0.3, steps))
        step = DT * speed[:, None] * np.stack([np.cos(course), np.sin(course)], axis=1)
        paths.append(np.concatenate([np.zeros((1, 2)), np.cumsum(step, axis=0)]))
    return np.concatenate(paths)[:, None], np.full(len(speeds), steps + 1)


def test_traits_of_a_circle_are_its_speed_and_its_turning() -> None:
    angle = 0.2 * np.arange(51)
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)[:, None]
    both = np.concatenate([circle, 2.0 * circle])
    (slow, wide), chord = episode_traits(both, np.array([51, 51]), DT)[:, 0], 2 * np.sin(0.1)
    np.testing.assert_allclose(slow, [chord / DT, 0.2 / DT])
    np.testing.assert_allclose(wide, [2 * chord / DT, 0.2 / DT])


def test_animals_that_differ_are_found_and_equal_ones_are_not() -> None:
    pytest.importorskip("scipy")
    differing = np.random.default_rng(0).uniform(0.5, 1.5, 20)
    none = np.zeros(20, dtype=int)
    found = fit_traits(*walks(differing), DT, none)
    assert found is not None
    assert np.corrcoef(found.table[:, 0, 0], differing)[0, 1] > 0.98
    assert found.table[:, 0, 0].std() == pytest.approx(1.0, abs=1e-6)
    assert not found.table[:, 0, 1].any()  # all turn alike
    assert fit_traits(*walks(np.ones(20)), DT, none) is None
    assert fit_traits(*walks(differing[:7]), DT, none[:7]) is None  # so few cannot say


def test_what_a_condition_does_is_no_trait() -> None:
    pytest.importorskip("scipy")
    condition = np.arange(20) % 2
    assert fit_traits(*walks(1.0 + condition), DT, condition) is None
    own = np.random.default_rng(0).uniform(0.5, 1.5, 20)
    found = fit_traits(*walks(own + condition), DT, condition)
    assert found is not None
    for one in (0, 1):
        assert found.table[condition == one, 0, 0].mean() == pytest.approx(0.0, abs=1e-9)


def test_a_simulated_searcher_keeps_the_traits_of_a_training_animal() -> None:
    world = search_world(300, traits=THREE)
    drawn = world.traits.copy()
    seen = rollout(world, random_actions(20, 300))
    assert [c.name for c in world.observation_components[-2:]] == ["own speed", "own turning"]
    np.testing.assert_array_equal(seen[..., -2:], np.broadcast_to(drawn, (21, 300, 2)))
    place = (drawn[:, None] == TABLE[:, 0]).all(axis=2)
    assert (place.sum(axis=1) == 1).all()
    assert (np.abs(place.mean(axis=0) - 1 / 3) < 0.1).all()  # each as often
    again, state = search_world(300, traits=THREE), world.get_state()
    np.testing.assert_array_equal(again.traits, drawn)
    again.reset()
    assert (again.traits != drawn).any()
    again.set_state(state)
    np.testing.assert_array_equal(again.traits, drawn)


def test_recordings_are_told_their_own_traits_and_starts_from_them_others() -> None:
    demos = load_packaged("silkmoth").select(split="train")
    values = episode_traits(demos.positions, demos.lengths, demos.dt)
    traits = Traits(np.stack([values.mean(0)] * 2), values.std(0), TABLE)
    species = replace(SILKMOTH, traits=traits)
    seen = demonstration_observations(species, demos)[:, 0, -2:]
    own = np.clip((values - values.mean(0)) / values.std(0), -LARGEST, LARGEST)[:, 0]
    np.testing.assert_allclose(seen, np.repeat(own, demos.lengths, axis=0), rtol=1e-5)
    plain = demonstration_observations(SILKMOTH, demos)
    assert plain.shape[-1] == demonstration_observations(species, demos).shape[-1] - 2
    world = search_world(50, traits=traits, demos=demos)
    assert (world.traits[:, None] == TABLE[:, 0]).all(axis=2).any(axis=1).all()


def test_closed_loop_spread_comes_from_traits() -> None:
    """Who pushes as its trait says differs from the others for the whole episode."""
    speeds = []
    for traits in (THREE, Traits(THREE.centre, THREE.scale, np.zeros((3, 1, 2)))):
        world, draw = search_world(200, traits=traits), np.random.default_rng(0)
        paths = [world.position[:, 0].copy()]
        for _ in range(60):
            eager = draw.random(200) < 0.5 + 0.2 * world.observation[:, 0, -2]
            world.step(np.where(eager, draw.integers(12, size=200), 12)[:, None])
            paths.append(world.position[:, 0].copy())
        moved = np.linalg.norm(np.diff(paths, axis=0), axis=-1)
        speeds.append(moved.mean(axis=0).std())
    assert speeds[0] > 2 * speeds[1]


def test_own_recordings_get_traits_and_synthetic_ones_do_not() -> None:
    pytest.importorskip("scipy")
    demos = load_packaged("silkmoth")  # its five plumes make programmed moths differ
    assert species_of(demos).traits is None
    heading = np.zeros(len(demos.positions))
    own = {**demos.provenance, "synthetic": False}
    recorded = replace(demos, signals={**demos.signals, "heading": heading}, provenance=own)
    found = species_of(recorded).traits
    assert found is not None and len(found.table) == (demos.split == "train").sum()
    assert species_of(recorded).observation == "full"
    refuses("traits is 3: give Traits or None", replace, SILKMOTH, traits=3)
