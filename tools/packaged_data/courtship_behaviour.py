"""Intermittent courtship: how two males and a female decide, and rollouts of them in their world.

A policy, in the sense of the learners: what it does depends on what an individual sees at that step
(places, velocities, its own last acceleration) and on chance, never on a plan or on how the episode
will end. So a learner can be as good as it is.

Each individual rests, moves or brakes. At rest it sets out at a constant rate, in one of the 12
directions: a male towards the female, more or less; the female as her weights say, and away from a
male that is too near. It keeps its thrust, and the faster it is the sooner it stops; then it brakes
until it is at rest. Nobody sets out for the wall or goes on where it could not brake before it.
Which of the three it does shows in velocity and last acceleration: who thrusts against its velocity
brakes, who is too slow to brake rests.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from animarl_envs.demos.episode import TIME_OUT
from animarl_envs.errors import InputError
from animarl_envs.locomotion import COAST, NUM_DIRECTIONS, Locomotion
from animarl_envs.scenario import make_scenario
from animarl_envs.species import ChaseSpecies
from animarl_envs.worlds.chase.world import ChaseWorld, observe

BRAKING = 0.8  # share of the thrust that is counted on to stop before a wall
TURNS = NUM_DIRECTIONS // 2 + 1
"""Directions to one side: straight at the focus, 30, 60, ... 180 deg away from it."""


@dataclass(frozen=True, kw_only=True)
class Behaviour:
    """Chosen by hand for the published statistics.

    ``courting`` and ``female`` weigh the angles (0, 30, ... 180 deg) between the bearing of the
    focus and the direction in which males and the female set out, either side alike.
    """

    peak: float  # speed at which one step in two ends a move [arena unit / s]
    spread: float  # share of that speed over which this sets in
    pause: tuple[float, float]  # mean rest of males and of the female [s]
    courting: tuple[float, ...]
    female: tuple[float, ...]
    alarm: float  # the female sets out away from a male nearer than this [arena unit]
    wall_margin: float  # room that is left to the wall [arena unit]

    def __post_init__(self) -> None:
        for name in ("peak", "spread", "pause"):
            if not np.all(np.isfinite(value := getattr(self, name))) or np.min(value) <= 0:
                raise InputError(f"{name} is {value}: it must be positive")
        for name in ("courting", "female"):
            if len(value := getattr(self, name)) != TURNS or min(value) < 0 or sum(value) <= 0:
                raise InputError(f"{name} is {value}: give {TURNS} weights that are not negative")


@dataclass(eq=False)
class CourtshipPolicy:
    """Decides for all individuals of ``world``, in all its copies, by what they see.

    In a changed world they perceive their motion as trained policies do
    (:data:`animarl_envs.species.base.Reading`). ``believed`` is the locomotion that they plan with,
    by default that of these scales.
    """

    world: ChaseWorld
    behaviour: Behaviour
    rng: np.random.Generator
    believed: tuple[Locomotion, ...] | None = None

    def __post_init__(self) -> None:
        species = self.world.scenario.species
        bodies = self.believed or species.scales.locomotion
        self._peak = self.behaviour.peak / np.array(species.scales.own_velocity)
        self._damping = np.array([[body.damping] for body in bodies])
        self._thrust = np.array([[body.thrust] for body in bodies])
        angles = np.abs(np.arange(-TURNS + 2, TURNS))  # of the actions 0 to 11, in steps of 30 deg
        angles = np.roll(angles, -TURNS + 2)
        self._weights = np.array(
            [self.behaviour.courting] * (species.num_individuals - 1) + [self.behaviour.female]
        )[:, angles]
        self._away = np.roll(np.eye(TURNS)[0][angles], NUM_DIRECTIONS // 2)

    def act(self) -> NDArray[np.int64]:
        """Actions ``(B, K)`` for the present state of the world."""
        velocity, acceleration = self.world.velocity, self.world.acceleration
        dt, behaviour = self.world.scenario.species.dt, self.behaviour
        speed = np.linalg.norm(velocity, axis=2)
        brake = self._nearest_action(-(1.0 - self._damping) * velocity / (self._thrust * dt))
        along = (velocity * acceleration).sum(axis=2)
        thrusting = np.linalg.norm(acceleration, axis=2) > 0.5
        onwards = np.where(thrusting[..., None], acceleration, velocity / (self._thrust * dt))
        draw, direction = self.rng.random((2, *speed.shape))
        peaks = np.exp(-(speed / self._peak - 1.0) / behaviour.spread)
        stops = (draw < 1.0 / (1.0 + peaks)) | self._meets_wall(velocity)
        onwards = self._nearest_action(onwards)
        going = np.where(stops | (thrusting & (along < 0.0)), brake, onwards)
        pause = np.full(speed.shape[1], behaviour.pause[0])
        pause[-1] = behaviour.pause[1]
        setting_out = np.where(draw < dt / pause, self._direction(direction), COAST)
        return np.where(brake == COAST, setting_out, going)

    def _direction(self, draw: NDArray[np.float64]) -> NDArray[np.int64]:
        """In which of the 12 directions each sets out, away from the wall; else none."""
        world, position = self.world, self.world.position
        weights = np.broadcast_to(self._weights, (*draw.shape, NUM_DIRECTIONS)).copy()
        nearest = np.linalg.norm(position[:, :-1] - position[:, -1:], axis=2).min(axis=1)
        weights[nearest < self.behaviour.alarm, -1] = self._away
        angle = np.deg2rad(-30.0) * np.arange(NUM_DIRECTIONS)
        towards = world.towards[..., None, :]
        ahead, left = np.cos(angle)[:, None], np.sin(angle)[:, None]
        across = np.stack([-towards[..., 1], towards[..., 0]], axis=-1)
        reach = (self._peak[:, None] ** 2 / self._thrust)[..., None]  # of a move of usual speed
        place = position[..., None, :] + reach * (ahead * towards + left * across)
        weights *= self._inside(place)
        summed = weights.cumsum(axis=2)
        total = summed[..., -1]
        chosen = (summed <= (draw * total)[..., None]).sum(axis=2)
        return np.where(total > 0.0, chosen, COAST)

    def _meets_wall(self, velocity: NDArray[np.float64]) -> NDArray[np.bool_]:
        speed = np.linalg.norm(velocity, axis=2, keepdims=True)
        stopped = self.world.position + velocity * speed / (2.0 * BRAKING * self._thrust)
        return ~self._inside(stopped)

    def _inside(self, place: NDArray[np.float64]) -> NDArray[np.bool_]:
        arena = self.world.scenario.species.arena
        apart = np.linalg.norm(place, axis=-1) if arena.shape == "disc" else np.abs(place).max(-1)
        return np.asarray(apart < arena.size - self.behaviour.wall_margin)

    def _nearest_action(self, wanted: NDArray[np.float64]) -> NDArray[np.int64]:
        """For accelerations ``(B, K, 2)`` [thrust]: the nearest direction, none below one half."""
        towards = self.world.towards
        ahead = (wanted * towards).sum(axis=2)
        left = wanted[..., 1] * towards[..., 0] - wanted[..., 0] * towards[..., 1]
        angle = np.arctan2(left, ahead)
        action = np.round(-angle / np.deg2rad(30.0)).astype(np.int64)
        along = np.hypot(ahead, left) * np.cos(angle + np.deg2rad(30.0) * action)
        return np.where(along > 0.5, action % NUM_DIRECTIONS, COAST)


@dataclass(frozen=True, eq=False)
class Rollouts:
    """B rollouts of the policy, of at most T steps each."""

    position: NDArray[np.float32]  # (T + 1, B, K, 2), arena frame [arena unit]
    velocity: NDArray[np.float64]  # (B, K, 2), at the start [arena unit / s]
    actions: NDArray[np.int8]  # (T, B, K)
    steps: NDArray[np.int64]  # (B,), until contact or the time limit
    outcome: NDArray[np.int8]  # (B,)


def roll_out(
    species: ChaseSpecies,
    behaviour: Behaviour,
    position: NDArray[np.float64],
    velocity: NDArray[np.float64],
    rng: np.random.Generator,
    steps: int | None = None,
    progress: Callable[[float], None] | None = None,
) -> Rollouts:
    """Let trios court from given states ``(B, K, 2)`` until contact or for so many steps.

    By default until the time limit.
    """
    count, limit = len(position), steps or species.time_limit
    world = ChaseWorld(make_scenario(species, demos=None), count)
    world.seed(rng.integers(2**63, size=count))
    world.reset()
    state = world.get_state()
    state["position"], state["velocity"] = position, velocity
    state["towards"] = observe(species, position, velocity)[1]
    world.set_state(state)
    policy = CourtshipPolicy(world, behaviour, rng)
    path = np.zeros((limit + 1, *position.shape), dtype=np.float32)
    actions = np.zeros((limit, *position.shape[:2]), dtype=np.int8)
    lasted = np.full(count, limit)
    outcome = np.full(count, TIME_OUT, dtype=np.int8)
    path[0] = position
    for t in range(limit):
        actions[t] = policy.act()
        world.step(actions[t])
        path[t + 1] = world.position
        ended = world.terminated & (outcome == TIME_OUT)
        lasted[ended], outcome[ended] = t + 1, world.outcome[ended]
        over = bool((outcome != TIME_OUT).all())
        if progress is not None:
            progress(1.0 if over else (t + 1) / limit)
        if over:
            break
    return Rollouts(path, velocity, actions, lasted, outcome)
