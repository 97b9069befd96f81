"""Behaviours of known worth, and what a DTW reward pays for each.

A reward for imitation must rank them: the recorded actions, the same with more and more of them
random, and below all of these every way of not following at all.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from animarl_envs.dtw import DTWTracker
from animarl_envs.focus import focus_directions
from animarl_envs.locomotion import COAST, NUM_ACTIONS, Locomotion, apply_actions
from animarl_envs.scenario import Scenario
from animarl_envs.worlds import make_world
from animarl_envs.worlds.base import World

Actions = NDArray[np.int64]
Behaviour = Callable[[World, np.random.Generator], Actions]
MakeTracker = Callable[[World, float], DTWTracker]
"""A tracker for a world, given the discount."""


def thirteen_directions(world: World) -> NDArray[np.float64]:
    """Where each action accelerates each individual to, ``(B, K, 13, 2)``, arena frame."""
    focus = focus_directions(world.position, world.scenario.species.roles)
    pushed = np.arange(NUM_ACTIONS), focus[:, :, None], Locomotion(0.0, 1.0), 1.0
    return apply_actions(np.zeros(2), *pushed)


def tracking(world: World, rng: np.random.Generator) -> Actions:
    """The actions that bring everybody nearest to the next recorded state.

    From the simulated state, the action of least ``|p' - p_rec'|^2 / dt^2 + |v' - v_rec'|^2``.
    Where the recording was made by the same locomotion these are its actions; where it was not, the
    errors of one step are made good in the next. After its end its last state is tracked.
    """
    species, demos = world.scenario.species, world.demos
    assert demos is not None
    step = np.minimum(world.step_count + 1, demos.lengths[world.demo] - 1)
    frame = demos.offsets[world.demo] + step
    kept = np.array([1.0 - own.damping for own in species.locomotion])[:, None, None]
    gained = np.array([own.thrust * species.dt for own in species.locomotion])[:, None, None]
    velocity = kept * world.velocity[:, :, None] + gained * thirteen_directions(world)
    position = world.position[:, :, None] + velocity * species.dt
    miss = np.square((position - demos.positions[frame][:, :, None]) / species.dt).sum(-1)
    miss += np.square(velocity - demos.velocities()[frame][:, :, None]).sum(-1)
    return miss.argmin(-1)


@dataclass(frozen=True)
class PartlyRandom:
    """Tracking, each action replaced by a random one with probability ``share``."""

    share: float

    def __call__(self, world: World, rng: np.random.Generator) -> Actions:
        tracked = tracking(world, rng)
        random = rng.integers(NUM_ACTIONS, size=tracked.shape)
        return np.where(rng.random(tracked.shape) < self.share, random, tracked)


def same(action: int) -> Behaviour:
    """One action for ever."""
    return lambda world, rng: np.full(world.position.shape[:2], action)


def outwards(world: World, rng: np.random.Generator) -> Actions:
    """Straight away from the centre of the arena."""
    away: Actions = (thirteen_directions(world) * world.position[:, :, None]).sum(-1).argmax(-1)
    return away


@dataclass(frozen=True)
class Course:
    """A behaviour, and after how many steps its episodes are ended (beside the warm-up), if so."""

    behaviour: Behaviour
    ends_after: int | None = None


FAITHFUL: dict[str, Course] = {
    "recorded": Course(tracking),
    "1 % random": Course(PartlyRandom(0.01)),
    "10 % random": Course(PartlyRandom(0.1)),
}
"""From best to worst."""
UNFAITHFUL: dict[str, Course] = {
    "at the focus": Course(same(0)), "coasting": Course(same(COAST)), "outwards": Course(outwards),
    "ended after 1 step": Course(tracking, ends_after=1),
    "... 10 steps": Course(tracking, ends_after=10),
}  # fmt: skip
"""None of which may earn as much as the worst faithful one."""


def shipped(kind: str) -> MakeTracker:
    """The package's tracker with the penalty ``kind``."""

    def make(world: World, gamma: float) -> DTWTracker:
        everyone = np.arange(world.num_individuals)
        scale = world.scenario.species.contact_radius
        return DTWTracker(world.demos, world.num_copies, everyone, scale, kind)

    return make


def returns(
    scenario: Scenario,
    course: Course,
    trackers: Sequence[MakeTracker],
    gamma: float,
    *,
    repetitions: int = 1,
    seed: int = 0,
) -> NDArray[np.float64]:
    """Discounted returns of task reward minus penalty, ``(trackers, B, K)``.

    Every demonstration of the scenario is followed ``repetitions`` times, ``B`` episodes in all.
    """
    assert scenario.demos is not None
    demo = np.repeat(np.arange(len(scenario.demos)), repetitions)
    world = make_world(scenario, len(demo))
    world.seed(seed + np.arange(len(demo)))
    world.reset(demo=demo)
    followed = [make(world, gamma) for make in trackers]
    for tracker in followed:
        tracker.started(world, np.ones(len(demo), dtype=bool))
    last = np.inf if course.ends_after is None else scenario.species.warmup + course.ends_after
    rng = np.random.default_rng(seed)
    running = np.ones(len(demo), dtype=bool)
    total = np.zeros((len(followed), len(demo), world.num_individuals))
    discount, step = 1.0, 0
    while running.any():
        world.step(course.behaviour(world, rng))
        step += 1
        world.terminated |= step >= last
        for earned, tracker in zip(total, followed, strict=True):
            tracker.stepped(world)
            earned[running] += discount * (world.reward - tracker.refund - tracker.penalty)[running]
        running &= ~(world.terminated | world.truncated)
        discount *= gamma
    return total
