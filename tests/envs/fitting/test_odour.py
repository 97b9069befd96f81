"""Odour fitted to recordings: what is drawn in the world is what was recorded."""

from dataclasses import replace

import numpy as np
import pytest

from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.packaged import load_packaged
from animarl_envs.fitting.custom_species import fit_odour, odour_steps, species_of
from animarl_envs.scenario import make_scenario
from animarl_envs.worlds import make_world
from animarl_envs.worlds.plume.plume import INPUTS, FittedOdour, mirrored


@pytest.fixture(scope="module")
def recorded() -> Demonstrations:
    """Searches with hits by a known law: hits of both antennae last with .9 and begin with .1."""
    demos, draw = load_packaged("silkmoth"), np.random.default_rng(0)
    left = np.zeros(len(demos.positions), dtype=bool)
    for frame in range(1, len(left)):
        left[frame] = draw.random() < (0.9 if left[frame - 1] else 0.1)
    heading = draw.uniform(-np.pi, np.pi, len(left))
    signals = {"odour_left": left * 1.0, "odour_right": left * 1.0, "heading": heading}
    own = {**demos.provenance, "synthetic": False}
    return replace(demos, signals=signals, provenance=own)


def test_a_law_of_hits_is_found_and_drawn_in_the_world(recorded: Demonstrations) -> None:
    species = species_of(recorded)
    odour = species.plume
    assert isinstance(odour, FittedOdour)
    lasting, beginning = (-p * np.log(p) - (1 - p) * np.log(1 - p) for p in (0.9, 0.1))
    inputs, hits = odour_steps(recorded)
    surprise = -np.log(odour.chances(inputs)[np.arange(len(hits)), hits]).mean()
    assert surprise < 0.5 * (lasting + beginning) + 0.08  # persistence untold: 0.69
    world = make_world(make_scenario(species, demos=None), num_copies=200)
    world.seed(list(range(200)))
    world.reset()
    drawn_hits, draw = [], np.random.default_rng(0)
    for _ in range(100):  # they wander over the places that were recorded
        world.step(draw.integers(species.num_actions, size=(200, 1)))
        drawn_hits.append(world.odour == 1.0)
    drawn = np.array(drawn_hits)
    before, after = drawn[20:-1, :, 0], drawn[21:, :, 0]
    assert after[before].mean() == pytest.approx(0.9, abs=0.05)
    assert after[~before].mean() == pytest.approx(0.1, abs=0.05)
    assert (drawn[..., 0] != drawn[..., 1])[20:].mean() < 0.05


def test_a_copy_smells_the_same_alone_and_beside_others(recorded: Demonstrations) -> None:
    species = species_of(recorded)
    smelt = []
    for copies in (1, 3):
        world = make_world(make_scenario(species, demos=None), num_copies=copies)
        world.seed(list(range(7, 7 + copies)))
        world.reset()
        own = []
        for _ in range(20):
            world.step(np.zeros((copies, 1), dtype=np.int64))
            own.append(world.odour[0].copy())
        smelt.append(np.array(own))
    assert np.array_equal(*smelt)


def test_inputs_have_their_mirror_image(recorded: Demonstrations) -> None:
    part = recorded.select(episodes=np.arange(2))
    left, right = part.signals["odour_left"], part.signals["odour_right"]
    turned = {"odour_left": right, "odour_right": left, "heading": -part.signals["heading"]}
    reflected = replace(part, positions=part.positions * [1, -1], signals=turned)
    inputs, _ = odour_steps(part)
    assert inputs.shape[1] == INPUTS
    assert odour_steps(reflected)[0] == pytest.approx(mirrored(inputs))


def test_test_episodes_and_synthetic_sets_do_not_change_the_odour(recorded: Demonstrations) -> None:
    train = recorded.select(split="train")
    assert np.array_equal(fit_odour(train).first, species_of(recorded).plume.first)
    synthetic = replace(recorded, provenance={**recorded.provenance, "synthetic": True})
    assert species_of(synthetic).plume == "model"
