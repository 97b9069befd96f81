"""Where bodies point, in a chase whose species has it: state ``(n, B)``, n = K or 0 individuals.

A body with a :class:`animarl_envs.species.turning.Turning` turns by it, or as was recorded where a
demonstration with headings is followed; all others point where they walk and keep their heading at
rest. An episode begins with the recorded heading, else along the velocity, else towards the focus.
Angles count counter-clockwise from x in the arena frame.
"""

import math
from typing import NamedTuple

import numpy as np

from animarl_envs.array_types import Bools, Floats, Ints
from animarl_envs.compiling import inline_kernel, jit
from animarl_envs.focus import focus_directions
from animarl_envs.kinematics import next_turn, turn_between, wrapped
from animarl_envs.scenario import REPLAY
from animarl_envs.species import ChaseSpecies
from animarl_envs.worlds.chase.layout import ABSENT, ChaseGroup
from animarl_envs.worlds.chase.neighbours import INDEX

NOT_RECORDED = -1  # in the place of a frame


class Bodies(NamedTuple):
    """State, scratch and numbers of the bodies of ``B`` copies."""

    heading: Floats  # (n, B), in [-pi, pi) [rad]
    turn: Floats  # (n, B), of the last step [rad]
    facing: Floats  # (n, 2, B), scratch: the unit vectors
    recorded: Floats  # (frames, K) [rad], or no frames
    turns: Bools  # (n,), by the numbers below; otherwise it points where it walks
    numbers: Floats  # (5, n): persistence, gain, cosine and sine of the slip, speed
    traits: Floats  # (2, K, B), of the individuals [sd]


def bodies_of(species: ChaseSpecies, num_copies: int, recorded: Floats | None = None) -> Bodies:
    """Return bodies that point along x; ``recorded`` headings are ``(frames, K)`` [rad]."""
    K = species.num_individuals
    n = K if species.has_headings else 0
    turns, numbers = np.zeros(n, dtype=bool), np.ones((5, n))
    for i, own in enumerate(species.turning):
        if own is not None:
            slip = math.cos(own.slip), math.sin(own.slip)
            turns[i], numbers[:, i] = True, (own.persistence, own.gain, *slip, own.speed)
    return Bodies(
        np.zeros((n, num_copies)),
        np.zeros((n, num_copies)),
        np.zeros((n, 2, num_copies)),
        np.zeros((0, K)) if recorded is None else np.ascontiguousarray(recorded),
        turns,
        numbers,
        np.zeros((2, K, num_copies)),
    )


def first_headings(
    species: ChaseSpecies,
    position: Floats,
    velocity: Floats,
    recorded: Floats,
) -> Floats:
    """Return headings ``(..., K)`` at the start of episodes [rad].

    ``position`` and ``velocity`` are ``(..., K, 2)``; ``recorded`` ``(..., K)`` is NaN where
    nothing was.
    """
    known = np.isfinite(recorded)
    towards = focus_directions(position, species.roles)
    at_rest = np.where(known, recorded, np.arctan2(towards[..., 1], towards[..., 0]))
    moving = (velocity != 0.0).any(axis=-1)
    heading = np.where(moving, np.arctan2(velocity[..., 1], velocity[..., 0]), at_rest)
    turns = np.array([own is not None for own in species.turning], dtype=bool)
    if len(turns):
        heading = np.where(known & turns, recorded, heading)
    return np.asarray((heading + np.pi) % (2.0 * np.pi) - np.pi)


def recorded_bodies(
    species: ChaseSpecies,
    position: Floats,
    velocity: Floats,
    steps: Ints,
    recorded: Floats | None = None,
) -> Bodies:
    """Return the bodies in recorded frames, one copy a frame, as the world computes them.

    ``position`` and ``velocity`` are ``(frames, K, 2)``, ``steps`` ``(frames,)`` count from the
    start of each episode, ``recorded`` ``(frames, K)`` are headings [rad].
    """
    bodies = bodies_of(species, len(position), recorded)
    if len(bodies.heading):
        starts = steps == 0
        known = np.full(position.shape[:2], np.nan) if recorded is None else recorded
        first = first_headings(species, position[starts], velocity[starts], known[starts])
        bodies.heading[:, starts] = first.T
        _follow_frames(np.ascontiguousarray(velocity), steps, bodies)
    return bodies


# -- turning --------------------------------------------------------------------------------------


@inline_kernel
def turned(i, heading, turn, velocity_x, velocity_y, frame, bodies):  # type: ignore[no-untyped-def]
    """Return heading and turn of individual ``i`` after a step.

    ``frame`` is the recorded frame that it follows, or ``NOT_RECORDED``.
    """
    if not bodies.turns[i]:
        if velocity_x == 0.0 and velocity_y == 0.0:
            return heading, 0.0
        along = wrapped(math.atan2(velocity_y, velocity_x))
        return along, turn_between(heading, along)
    if frame != NOT_RECORDED:
        recorded = wrapped(bodies.recorded[frame, i])
        return recorded, turn_between(heading, recorded)
    own = bodies.numbers
    turn = next_turn(
        turn,
        math.cos(heading),
        math.sin(heading),
        velocity_x,
        velocity_y,
        own[0, i],
        own[1, i],
        own[2, i],
        own[3, i],
        own[4, i],
    )
    return wrapped(heading + turn), turn


@inline_kernel
def turn_bodies(drivers, warmup, demos, demo, step_count, velocity, bodies, headed):  # type: ignore[no-untyped-def]
    """Turn all bodies after a step; ``velocity`` ``(K, 2, B)`` is that of the step."""
    if headed is None:
        return
    for i in range(bodies.heading.shape[0]):
        for b in range(bodies.heading.shape[1]):
            frame = NOT_RECORDED
            follows = drivers[i] == REPLAY or step_count[b] <= warmup
            if len(bodies.recorded) > 0 and demo[b] >= 0 and follows:
                at = demos.start[demo[b]] + step_count[b]
                if at < demos.start[demo[b] + 1]:
                    frame = at
            heading, turn = turned(
                i,
                bodies.heading[i, b],
                bodies.turn[i, b],
                velocity[i, 0, b],
                velocity[i, 1, b],
                frame,
                bodies,
            )
            bodies.heading[i, b] = heading
            bodies.turn[i, b] = turn


@jit
def _follow_frames(velocity, steps, bodies):  # type: ignore[no-untyped-def]
    """Turn the bodies frame by frame; frames that begin an episode keep their heading."""
    known = len(bodies.recorded) > 0
    for i in range(bodies.heading.shape[0]):
        for t in range(1, len(steps)):
            if steps[t] > 0:
                heading, turn = turned(
                    i,
                    bodies.heading[i, t - 1],
                    bodies.turn[i, t - 1],
                    velocity[t, i, 0],
                    velocity[t, i, 1],
                    t if known else NOT_RECORDED,
                    bodies,
                )
                bodies.heading[i, t] = heading
                bodies.turn[i, t] = turn


# -- seeing ---------------------------------------------------------------------------------------


@inline_kernel
def set_facing(bodies, headed):  # type: ignore[no-untyped-def]
    """Set the unit vectors of the headings."""
    if headed is None:
        return
    for i in range(bodies.heading.shape[0]):
        for b in range(bodies.heading.shape[1]):
            bodies.facing[i, 0, b] = math.cos(bodies.heading[i, b])
            bodies.facing[i, 1, b] = math.sin(bodies.heading[i, b])


@inline_kernel
def observe_headings(i, seen, towards, first, others, bodies, headed, observation):  # type: ignore[no-untyped-def]
    """Observe where individual ``i`` and the others that it sees point, in its frame."""
    if headed is None or first[0, ChaseGroup.HEADING] == ABSENT:
        return
    for rank in range(-1, seen):
        at = first[0, ChaseGroup.HEADING] if rank < 0 else first[rank + 1, ChaseGroup.OTHER_HEADING]
        for b in range(others.shape[2]):
            j = i if rank < 0 else int(others[rank, INDEX, b])
            ex = towards[i, 0, b]
            ey = towards[i, 1, b]
            x = bodies.facing[j, 0, b]
            y = bodies.facing[j, 1, b]
            observation[i, at, b] = min(1.0, max(-1.0, x * ex + y * ey))
            observation[i, at + 1, b] = min(1.0, max(-1.0, y * ex - x * ey))
