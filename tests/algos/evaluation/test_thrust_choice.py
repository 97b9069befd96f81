"""As many thrust magnitudes are chosen as a classifier needs to be fooled."""

from dataclasses import replace

import numpy as np
import pytest

from animarl_algos.evaluation.thrust_choice import (
    choose_thrusts,
    tracking_floor,
)
from animarl_envs.arena import Arena
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.packaged import load_packaged
from animarl_envs.fitting.custom_species import arena_of
from animarl_envs.fitting.joint import joint_locomotion
from animarl_envs.fitting.tracking import track
from animarl_envs.locomotion import Locomotion


@pytest.fixture(scope="module")
def chases() -> Demonstrations:
    demos = load_packaged("agent")
    long = np.flatnonzero((demos.split == "train") & (demos.lengths > 60))
    return demos.select(episodes=long[:40])


def test_animals_with_one_thrust_get_one(chases: Demonstrations) -> None:
    assert choose_thrusts(chases)[0] == 1
    assert tracking_floor(chases, joint_locomotion(chases)).estimate < 0.6


def test_animals_that_push_with_several_strengths_get_several(chases: Demonstrations) -> None:
    """Tracks of the chases that can be followed with magnitudes of 1.6, 0.8 and 0.3 only."""
    strengths = (Locomotion(0.25, 3.0, (1.6, 0.8, 0.3)),) * 3
    wobbly = replace(chases, positions=track(chases, strengths).positions)
    assert choose_thrusts(wobbly)[0] > 1
    assert tracking_floor(wobbly, joint_locomotion(wobbly)).estimate > 0.8


def test_too_few_to_say_get_as_many_as_recorded_animals_ask_for(chases: Demonstrations) -> None:
    """Three recordings of newts do not say whether one thrust will do; three exact chases do."""
    newts = load_packaged("newt").select(split="train").select(episodes=np.arange(3))
    floor = tracking_floor(newts, joint_locomotion(newts))
    assert floor.estimate <= 2 / 3 and floor.high - floor.low > 1 / 3
    assert choose_thrusts(newts)[0] == 3
    assert "too few to tell" in choose_thrusts(newts)[1]
    assert choose_thrusts(chases.select(episodes=np.arange(3)))[0] == 1


def test_the_floor_is_tracked_within_the_walls_of_the_world() -> None:
    """Flies that are too sluggish to turn in time: through the edge, unless it is a wall."""
    packaged = load_packaged("fly").select(split="train")
    demos = replace(packaged, arena=replace(packaged.arena, rebound=False))
    sluggish = (Locomotion(0.003, 0.05),) * demos.num_individuals
    walled = arena_of(demos)
    assert walled.rebound and not demos.arena.rebound
    assert farthest(demos, sluggish, demos.arena) > 1.02
    assert farthest(demos, sluggish, walled) <= 1.0
    floor = tracking_floor(demos, sluggish)
    assert floor == tracking_floor(demos, sluggish, arena=walled)
    assert floor != tracking_floor(demos, sluggish, arena=demos.arena)


def farthest(demos: Demonstrations, locomotion: tuple[Locomotion, ...], arena: Arena) -> float:
    """From the centre of the dish [arena unit]."""
    return float(np.linalg.norm(track(demos, locomotion, arena).positions, axis=2).max())
