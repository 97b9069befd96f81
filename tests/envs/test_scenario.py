"""A scenario's options: what they change, and what is refused by name."""

from dataclasses import replace

import numpy as np
import pytest
from refusals import refuses

from animarl_envs.arena import Arena
from animarl_envs.demos.episode import UNFINISHED
from animarl_envs.demos.packaged import load_packaged
from animarl_envs.locomotion import Locomotion
from animarl_envs.scenario import make_scenario
from animarl_envs.species import AGENT, SHOAL, ChaseSpecies
from animarl_envs.species.options import with_options


def test_no_options_leave_the_species_as_it_is_and_a_larger_arena_keeps_its_margin() -> None:
    assert with_options(AGENT) == with_options(AGENT, individuals=None) == AGENT
    arena = with_options(AGENT, arena=2.0).arena
    assert arena.size == 2.0
    assert arena.boundary / arena.size == pytest.approx(AGENT.arena.boundary / AGENT.arena.size)
    disc = Arena("disc", 1.0, 1.5)
    assert with_options(AGENT, arena=disc).arena == disc


def test_pursuers_are_renamed_and_keep_their_locomotion() -> None:
    slow, fast, prey = Locomotion(0.25, 2.4), Locomotion(0.25, 3.0), Locomotion(0.25, 3.5)
    species = with_options(with_options(AGENT, locomotion=(slow, fast, prey)), num_pursuers=3)
    assert species.individuals == ("predator_0", "predator_1", "predator_2", "prey")
    assert species.locomotion == (slow, fast, slow, prey)


def test_animals_that_nobody_pursues_are_as_many_as_named_or_become_a_chase() -> None:
    named = ("a", "b", "c")
    refuses("give one of the two", with_options, SHOAL, individuals=named, num_pursuers=5)
    assert with_options(SHOAL, individuals=named, num_pursuers=3).individuals == named
    chase = with_options(SHOAL, free=False)
    assert isinstance(chase, ChaseSpecies)
    assert not chase.free and chase.roles == ("pursuer",) * 11 + ("target",)


def test_a_factor_scales_the_thrust_of_one_individual_only() -> None:
    species = with_options(AGENT, locomotion={"prey": 1.2})
    assert species.locomotion[:2] == AGENT.locomotion[:2]
    assert species.locomotion[2].thrust == pytest.approx(1.2 * AGENT.locomotion[2].thrust)
    assert species.locomotion[2].damping == AGENT.locomotion[2].damping


def test_more_of_ones_own_pursuers_than_recorded_start_anywhere() -> None:
    """Own data has no ``demos=None``: the species is made from it all the same."""
    without = make_scenario("agent", num_pursuers=5, demos=None)
    assert not without.paired and len(without.names) == 6
    demos = replace(load_packaged("agent"), species="custom")
    refuses("or start='uniform'", make_scenario, "custom", demos=demos, num_pursuers=4)
    scenario = make_scenario("custom", demos=demos, num_pursuers=4, start="uniform")
    assert not scenario.paired and len(scenario.names) == 5
    recorded = make_scenario("custom", demos=demos).species
    fitted = scenario.species.locomotion
    assert fitted[:2] == fitted[2:4] == recorded.locomotion[:2]
    assert fitted[-1] == recorded.locomotion[-1] and scenario.species.arena == recorded.arena


def test_fewer_pursuers_replay_the_first_ones() -> None:
    whole = load_packaged("agent").select(split="train")
    demos = make_scenario("agent", num_pursuers=1).demos
    assert demos is not None
    assert demos.individuals == ("predator_0", "prey")
    assert np.array_equal(demos.positions, whole.positions[:, [0, 2]])
    assert np.array_equal(demos.velocities(), whole.velocities()[:, [0, 2]])
    left_out = whole.outcome == 2
    assert (demos.outcome[left_out] == UNFINISHED).all()
    assert np.array_equal(demos.outcome[~left_out], whole.outcome[~left_out])
