"""Intermittent courtship: how two males and a female decide, and sessions of them in their world.

Each individual alternates between *moving* and *pausing* (a semi-Markov process: durations are
drawn from the quantiles of a :class:`~tools.packaged_data.courtship_shapes.Shape`). A pause counts
from when the animal has come to rest. While moving it wants a velocity: a courting male that of the
bearing to the female with a slowly changing error, everybody else a wandering one, the female turns
away from a near male. Nobody wants to be faster towards the wall than it can brake. The action is
the one of the 13 whose next velocity comes nearest to the wanted one; pausing means wanting none.
After touching the female a male loses interest for a while.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from animarl_envs.errors import InputError
from animarl_envs.locomotion import COAST
from animarl_envs.scenario import make_scenario
from animarl_envs.species import ChaseSpecies
from animarl_envs.worlds.chase.world import ChaseWorld, observe
from tools.packaged_data.courtship_shapes import MOVING_SHARE, Shape, quantile

BRAKING = 0.5  # share of the thrust that wanted velocities near the wall count on


@dataclass(frozen=True, kw_only=True)
class Behaviour:
    """What the recordings do not tell, chosen by hand for the published statistics."""

    shape: Shape
    top: float  # that speeds are shares of [arena unit / s]
    pause_stretch: float  # pauses last so many times longer than the recorded ones
    move_stretch: float
    approach_error: float  # standard deviation of the bearing's error [rad]
    error_time: float  # over which it changes [s]
    alarm: float  # the female turns away from a male nearer than this [arena unit]
    disinterest: float  # mean time for which a male does not court after contact [s]
    wall_margin: float  # room that is left to the wall [arena unit]

    def __post_init__(self) -> None:
        for name in ("top", "pause_stretch", "move_stretch", "error_time", "disinterest"):
            if not 0 < getattr(self, name) < float("inf"):
                raise InputError(f"{name} is {getattr(self, name)}: it must be a positive number")


@dataclass(eq=False)
class CourtshipPolicy:
    """Decides for all individuals of ``world``, in all its copies. Call :meth:`act` once a step."""

    world: ChaseWorld
    behaviour: Behaviour
    rng: np.random.Generator

    def __post_init__(self) -> None:
        B, K = self.world.num_copies, self.world.num_individuals
        self.moving = self.rng.random((B, K)) < 0.5
        self.left = np.zeros((B, K))  # of the present state [s]
        self.speed = np.zeros((B, K))  # wanted while moving [arena unit / s]
        self.heading = self.rng.uniform(-np.pi, np.pi, (B, K))  # of wandering [rad]
        self.error = np.zeros((B, K))  # of the bearing [rad]
        self.bored = np.zeros((B, K - 1))  # until a male courts again [s]
        locomotion = self.world.scenario.species.locomotion
        self._damping = np.array([m.damping for m in locomotion])
        self._thrust = np.array([m.thrust for m in locomotion])

    def act(self) -> NDArray[np.int64]:
        """Actions ``(B, K)`` for the present state of the world."""
        self._change_state()
        return self._nearest_action(self._wanted_velocity())

    def _change_state(self) -> None:
        behaviour, dt = self.behaviour, self.world.scenario.species.dt
        shape = behaviour.shape
        draw, turn, noise = (
            self.rng.random(self.left.shape),
            *self.rng.standard_normal((2, *self.left.shape)),
        )
        slow = np.linalg.norm(self.world.velocity, axis=2) < MOVING_SHARE * behaviour.top
        self.left -= np.where(self.moving | slow, dt, 0.0)
        over = self.left <= 0
        self.moving ^= over
        lasts = np.where(
            self.moving,
            behaviour.move_stretch * quantile(shape.move, draw),
            behaviour.pause_stretch * quantile(shape.pause, draw),
        )
        self.left = np.where(over, lasts, self.left)
        speed = behaviour.top * quantile(shape.speed, self.rng.random(self.left.shape))
        self.speed = np.where(over & self.moving, speed, self.speed)
        self.heading += np.where(self.moving, shape.turning * np.sqrt(dt) * turn, 0.0)
        keep = dt / behaviour.error_time
        self.error += -keep * self.error + behaviour.approach_error * np.sqrt(2 * keep) * noise
        apart = self.world.position[:, :-1] - self.world.position[:, -1:]
        touching = np.linalg.norm(apart, axis=2) < self.world.scenario.species.contact_radius
        rest = self.rng.exponential(behaviour.disinterest, self.bored.shape)
        self.bored = np.where(touching & (self.bored <= 0), rest, self.bored - dt)

    def _wanted_velocity(self) -> NDArray[np.float64]:
        """``(B, K, 2)``, arena frame."""
        towards, position = self.world.towards, self.world.position
        direction = np.stack([np.cos(self.heading), np.sin(self.heading)], axis=-1)
        c, s = np.cos(self.error), np.sin(self.error)
        aim = np.stack(
            [c * towards[..., 0] - s * towards[..., 1], s * towards[..., 0] + c * towards[..., 1]],
            axis=-1,
        )
        courts = self.bored <= 0
        direction[:, :-1] = np.where(courts[..., None], aim[:, :-1], direction[:, :-1])
        nearest = np.linalg.norm(position[:, :-1] - position[:, -1:], axis=2).min(axis=1)
        fear = np.clip(1.0 - nearest / self.behaviour.alarm, 0.0, 1.0)[:, None]
        direction[:, -1] = (1.0 - fear) * direction[:, -1] - 2.0 * fear * towards[:, -1]
        direction /= np.maximum(np.linalg.norm(direction, axis=2, keepdims=True), 1e-9)
        wanted = np.where(self.moving, self.speed, 0.0)[..., None] * direction
        return self._short_of_the_wall(wanted)

    def _short_of_the_wall(self, wanted: NDArray[np.float64]) -> NDArray[np.float64]:
        """Outward speeds limited to what can be braked; who is stopped so turns inwards."""
        arena, position = self.world.scenario.species.arena, self.world.position
        limit = arena.size - self.behaviour.wall_margin
        if arena.shape == "disc":
            radius = np.linalg.norm(position, axis=2, keepdims=True)
            axes = [(position / np.maximum(radius, 1e-9), radius[..., 0])]
        else:
            axes = [
                (np.sign(position) * unit, np.abs(position[..., x]))
                for x, unit in enumerate(np.eye(2))
            ]
        for outward, distance in axes:
            room = limit - distance
            most = np.sign(room) * np.sqrt(2 * BRAKING * self._thrust * np.abs(room))
            speed = (wanted * outward).sum(axis=2)
            excess = np.maximum(speed - most, 0.0)
            wanted = wanted - excess[..., None] * outward
            inwards = np.arctan2(-outward[..., 1], -outward[..., 0])
            turn = (inwards - self.heading + np.pi) % (2 * np.pi) - np.pi
            self.heading += np.where(excess > 0.5 * self.speed, 0.1 * turn, 0.0)
        return wanted

    def _nearest_action(self, wanted: NDArray[np.float64]) -> NDArray[np.int64]:
        """In the egocentric frame: the nearest of the 12 directions, or none below one half."""
        world, dt = self.world, self.world.scenario.species.dt
        gap = (wanted - (1.0 - self._damping)[:, None] * world.velocity) / (
            self._thrust[:, None] * dt
        )
        towards = world.towards
        ahead = (gap * towards).sum(axis=2)
        left = gap[..., 1] * towards[..., 0] - gap[..., 0] * towards[..., 1]
        angle = np.arctan2(left, ahead)
        action = np.round(-angle / np.deg2rad(30.0)).astype(np.int64)
        along = np.hypot(ahead, left) * np.cos(angle + np.deg2rad(30.0) * action)
        return np.where(along > 0.5, action % COAST, COAST)


@dataclass(frozen=True, eq=False)
class Sessions:
    """Continuous recordings of the generator: B sessions of T steps, from one seed."""

    position: NDArray[np.float32]  # (T + 1, B, K, 2), arena frame [arena unit]
    velocity: NDArray[np.float32]  # (T + 1, B, K, 2), [arena unit / s]
    actions: NDArray[np.int8]  # (T, B, K)


def simulate(
    species: ChaseSpecies,
    behaviour: Behaviour,
    sessions: int,
    steps: int,
    rng: np.random.Generator,
    start: tuple[NDArray[np.float64], NDArray[np.float64]] | None = None,
    progress: Callable[[float], None] | None = None,
) -> Sessions:
    """Let ``sessions`` trios court for ``steps`` steps.

    ``start`` gives positions and velocities ``(B, K, 2)``; everybody then moves on at once the way
    it was going. Without it they start at rest near the centre.
    """
    scenario = make_scenario(species, demos=None, time_limit=steps + 1)
    world = ChaseWorld(scenario, sessions)
    world.seed(rng.integers(2**63, size=sessions))
    world.reset()
    policy = CourtshipPolicy(world, behaviour, rng)
    if start is not None:
        state = world.get_state()
        state["position"], state["velocity"] = start
        state["towards"] = observe(species, *start)[1]
        world.set_state(state)
        policy.moving[:] = True
        policy.left[:] = steps * species.dt
        policy.speed[:] = np.linalg.norm(start[1], axis=2)
        policy.heading[:] = np.arctan2(start[1][..., 1], start[1][..., 0])
    position = np.empty((steps + 1, *world.position.shape), dtype=np.float32)
    velocity = np.empty_like(position)
    actions = np.empty((steps, *world.position.shape[:2]), dtype=np.int8)
    position[0], velocity[0] = world.position, world.velocity
    for t in range(steps):
        actions[t] = policy.act()
        world.step(actions[t])
        position[t + 1], velocity[t + 1] = world.position, world.velocity
        if progress is not None:
            progress((t + 1) / steps)
    return Sessions(position, velocity, actions)
