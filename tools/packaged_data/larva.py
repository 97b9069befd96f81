"""A larva that runs and turns after Davies, Louis and Webb (2015), and its turn rate found again.

Davies, Louis and Webb (2015), A model of Drosophila larva chemotaxis, PLoS Computational Biology
11(11), e1004606, without an odour: a run at constant speed ends at a constant rate; then the larva
stops and sweeps its head from side to side, at a constant rate of turning, until it accepts a
direction, again at a constant rate, and runs on that way. During runs the head swings a little to
either side, and the tail follows it. Here the larva is a point that goes where its head points, and
its speed varies a little (both ours); the numbers are those that larvaworld
(github.com/nawrotlab/larvaworld) has of the paper.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

FINE = 0.02  # step of the simulation [s]
SLOW = 0.65  # of the median way in two frames: the larva stood for a while


@dataclass(frozen=True, kw_only=True)
class RunAndTurnLaw:
    """The numbers of the model; rates are per second."""

    speed: float = 1.0  # of a run [mm/s]
    speed_varies: float = 0.05  # standard deviation, of the speed
    speed_lasts: float = 1.0  # correlation time of these variations [s]
    turn_rate: float = 0.148  # at which a run ends
    shortest_run: float = 1.0  # before it may end [s]
    sweep: float = 240.0  # of the head while it stands [deg/s]
    smallest_turn: float = 37.0  # that may be accepted [deg]
    largest_turn: float = 120.0  # then the head sweeps back [deg]
    accept_rate: float = 2.0  # of a direction
    swing: float = 60.0  # of the head during runs [deg/s]
    largest_swing: float = 20.0  # [deg]
    swing_ends: float = 2.0  # rate
    swing_begins: float = 1.0  # rate
    length: float = 4.0  # of the body, by which the tail follows [mm]


def simulate(
    law: RunAndTurnLaw, larvae: int, frames: int, dt: float, rng: np.random.Generator
) -> Floats:
    """Return paths ``(larvae, frames, 2)`` [mm], a frame each ``dt`` [s], from the origin."""
    most, every = np.deg2rad(law.largest_turn), round(dt / FINE)
    body = rng.uniform(-np.pi, np.pi, larvae)
    head, age, position = np.zeros(larvae), np.zeros(larvae), np.zeros((larvae, 2))
    pace, keeps = rng.normal(size=larvae), np.exp(-FINE / law.speed_lasts)
    standing, swinging = np.zeros((2, larvae), dtype=bool)
    side = rng.choice([-1.0, 1.0], larvae)
    path = np.empty((larvae, frames, 2))
    for step in range((frames - 1) * every + 1):
        if step % every == 0:
            path[:, step // every] = position
        draw, coin = rng.random((2, larvae))
        # While it stands, the head sweeps until a direction is accepted.
        large = np.abs(head) >= np.deg2rad(law.smallest_turn)
        accepts = standing & large & (draw < law.accept_rate * FINE)
        begins = ~standing & (age >= law.shortest_run) & (draw < law.turn_rate * FINE)
        body, head = body + accepts * head, np.where(accepts | begins, 0.0, head)
        standing = (standing & ~accepts) | begins
        age = np.where(standing | accepts, 0.0, age + FINE)
        # During a run it swings now and then.
        ends = np.where(swinging, coin < law.swing_ends * FINE, coin < law.swing_begins * FINE)
        swinging ^= ends & ~standing
        side = np.where(begins | (ends & swinging), rng.choice([-1.0, 1.0], larvae), side)
        limit = np.where(standing, most, np.deg2rad(law.largest_swing))
        side = np.where(np.abs(head) >= limit, -np.sign(head), side)
        rate = np.deg2rad(np.where(standing, law.sweep, law.swing * swinging))
        follows = np.where(standing, 0.0, law.speed / law.length * np.sin(head))
        head, body = head + FINE * (rate * side - follows), body + FINE * follows
        way = body + np.where(standing, 0.0, head)
        pace = keeps * pace + np.sqrt(1 - keeps**2) * rng.normal(size=larvae)
        moved = law.speed * FINE * np.exp(law.speed_varies * pace) * ~standing
        position = position + moved[:, None] * np.stack([np.cos(way), np.sin(way)], axis=-1)
    return path


def recovered_turn_rate(law: RunAndTurnLaw, paths: list[Floats], dt: float) -> float:
    """Return at what rate runs end along paths ``(frames, 2)`` [1/s].

    A turn is an uninterrupted stretch of frames whose way, over two frames, is shorter than
    ``SLOW`` of the usual one. The rate is the number of turns over the time in which a turn could
    begin, which does not include the shortest run.
    """
    turns, running = 0, 0.0
    ways = [np.linalg.norm(path[2:] - path[:-2], axis=1) for path in paths]
    usual = np.median(np.concatenate(ways))
    for way in ways:
        slow = way < SLOW * usual
        begins = slow[1:] & ~slow[:-1]
        turns += int(begins.sum())
        running += float((~slow).sum()) * dt
    return turns / (running - turns * law.shortest_run)
