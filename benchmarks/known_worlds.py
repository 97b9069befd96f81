"""Simulated animals of known statistics, perfect simulators of them, and simulators with one fault.

Two worlds: a *free pair*, in which one follows the other's speed and nothing ends an episode but
time, and a *chase*, which contact ends. Both have what recordings of animals have and two-second
windows do not show: bursts that begin faster than they end, turns that persist for seconds, a
preferred side, individuals that differ, a partner that reacts late. All data here is synthetic.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from animarl_algos.evaluation.rollouts import NO_CUE, Rollouts
from animarl_envs.arena import Arena
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.episode import TIME_OUT

Floats = NDArray[np.float64]

DT = 0.1  # [s]
LIMIT = 200  # steps of an episode
CONTACT = 0.12  # [arena unit]
ARENA = Arena("open", 1.0, 1.1)
BLOCK = 20  # steps: order is lost beyond 2 s
LATE = 3  # steps that a reaction is late


@dataclass(frozen=True)
class KnownWorld:
    """A world of two animals; ``chase`` says whether the first pursues the second."""

    chase: bool

    @property
    def roles(self) -> tuple[str, str]:
        return ("pursuer", "target") if self.chase else ("pursuer", "pursuer")

    def episodes(self, start: Floats, rng: np.random.Generator) -> tuple[list[Floats], list[int]]:
        """Simulate an episode from each start ``(episodes, 2, 2)``; paths and outcomes."""
        many = len(start)
        heading = rng.uniform(-np.pi, np.pi, (many, 2))
        side = 0.25 + rng.normal(0.0, 0.3, (many, 2))  # preferred turning [rad/s]
        turn = side.copy()
        boldness = np.exp(rng.normal(0.0, 0.15, (many, 2)))
        speed = np.zeros((many, 2))
        position, path = start.copy(), [start.copy()]
        alive, length = np.ones(many, dtype=bool), np.full(many, LIMIT + 1)
        late = [speed.copy() for _ in range(4)]
        for step in range(1, LIMIT + 1):
            turn += DT / 3.0 * (side - turn) + 0.6 * np.sqrt(2 * DT / 3.0) * rng.normal(
                size=(many, 2)
            )
            heading += DT * turn + 0.1 * rng.normal(size=(many, 2))
            burst = rng.random((many, 2)) < np.array([0.08, 0.05])
            kick = np.array([0.5, 0.35]) * boldness * rng.uniform(0.6, 1.4, (many, 2))
            speed = np.where(burst, np.maximum(speed, kick), 0.9 * speed)
            if self.chase:
                offset = position[:, 1] - position[:, 0]
                wanted = np.arctan2(offset[:, 1], offset[:, 0])
                error = np.angle(np.exp(1j * (wanted - heading[:, 0])))
                heading[:, 0] += 0.25 * error
                near = np.linalg.norm(offset, axis=1) < 0.4
                away = np.angle(np.exp(1j * (wanted - heading[:, 1])))
                heading[:, 1] += np.where(near, 0.2 * away, 0.0)
                speed[:, 1] = np.where(near & (rng.random(many) < 0.1), 0.45, speed[:, 1])
            else:
                speed[:, 1] = 0.75 * speed[:, 1] + 0.2 * late[0][:, 0]
            late = [*late[1:], speed.copy()]
            moved = np.where(speed < 0.03, 0.0, speed)
            course = np.stack([np.cos(heading), np.sin(heading)], axis=-1)
            position = position + DT * moved[..., None] * course
            path.append(position.copy())
            if self.chase:
                met = np.linalg.norm(position[:, 0] - position[:, 1], axis=1) < CONTACT
                length[alive & met] = step + 1
                alive &= ~met
        paths = np.stack(path, axis=1)
        ends = [TIME_OUT if n == LIMIT + 1 else 1 for n in length.tolist()]
        return [one[:n] for one, n in zip(paths, length.tolist())], ends

    def recordings(self, count: int, rng: np.random.Generator) -> Demonstrations:
        """Record so many episodes."""
        first = rng.uniform(-0.5, 0.5, (count, 1, 2))
        angle = rng.uniform(-np.pi, np.pi, (count, 1))
        apart = rng.uniform(0.5, 0.9, (count, 1, 1)) * np.stack([np.cos(angle), np.sin(angle)], -1)
        paths, ends = self.episodes(np.concatenate([first, first + apart], axis=1), rng)
        return Demonstrations(
            species="custom",
            individuals=("first", "second"),
            roles=self.roles,
            dt=DT,
            arena=ARENA,
            positions=np.concatenate(paths),
            lengths=np.array([len(path) for path in paths]),
            initial_velocity=np.zeros((count, 2, 2)),
            condition=np.zeros(count, dtype=np.int8),
            outcome=np.array(ends),
            split=np.full(count, "test"),
            recording=np.array([f"recording {i}" for i in range(count)]),
            provenance={"source": "benchmarks/known_worlds.py", "licence": "MIT",
                        "synthetic": True},
        )  # fmt: skip

    def rollouts(self, recorded: Demonstrations, each: int, rng: np.random.Generator) -> Rollouts:
        """Let a perfect simulator run ``each`` times from every start."""
        demo = np.repeat(np.arange(len(recorded)), each)
        start = recorded.positions[recorded.offsets[:-1]][demo]
        return _rollouts(recorded, *self.episodes(start, rng), demo, each)


WORLDS = {"free pair": KnownWorld(chase=False), "chase": KnownWorld(chase=True)}


def _rollouts(
    recorded: Demonstrations, paths: list[Floats], ends: list[int], demo: NDArray[np.int64],
    each: int,
) -> Rollouts:  # fmt: skip
    return Rollouts(
        method="simulator",
        individuals=recorded.individuals,
        roles=recorded.roles,
        dt=DT,
        positions=np.concatenate(paths),
        lengths=np.array([len(path) for path in paths]),
        outcome=np.array(ends),
        condition=np.zeros(len(demo), dtype=np.int8),
        cue=np.full(len(demo), NO_CUE),
        demo=demo,
        seed=np.zeros(len(demo), dtype=np.int64),
        repetition=np.tile(np.arange(each), len(recorded)),
    )


# -- faults ---------------------------------------------------------------------------------------

Fault = Callable[[list[Floats], np.random.Generator], list[Floats]]


def _from_steps(path: Floats, step: Floats) -> Floats:
    return np.concatenate([path[:1], path[:1] + np.cumsum(step, axis=0)])


def faster(factor: float) -> Fault:
    """Make every step longer."""
    return lambda paths, rng: [_from_steps(p, factor * np.diff(p, axis=0)) for p in paths]


def order_lost(paths: list[Floats], rng: np.random.Generator) -> list[Floats]:
    """Shuffle pieces of two seconds of each path."""
    out = []
    for path in paths:
        step = np.diff(path, axis=0)
        pieces = [step[i : i + BLOCK] for i in range(0, len(step), BLOCK)]
        shuffled = [pieces[i] for i in rng.permutation(len(pieces))]
        out.append(_from_steps(path, np.concatenate(shuffled)) if pieces else path)
    return out


def bursts_reversed(paths: list[Floats], rng: np.random.Generator) -> list[Floats]:
    """Reverse the speeds of every bout of motion; directions stay."""
    out = []
    for path in paths:
        step = np.diff(path, axis=0)
        length = np.linalg.norm(step, axis=-1)
        reverse = length.copy()
        for k in range(length.shape[1]):
            moving = np.concatenate([[False], length[:, k] > 0, [False]])
            edges = np.flatnonzero(np.diff(moving.astype(int)))
            for begin, end in zip(edges[::2], edges[1::2]):
                reverse[begin:end, k] = length[begin:end, k][::-1]
        unit = step / np.where(length > 0, length, 1.0)[..., None]
        out.append(_from_steps(path, unit * reverse[..., None]))
    return out


def path_reversed(paths: list[Floats], rng: np.random.Generator) -> list[Floats]:
    """Play every path backwards, moved to its start."""
    return [_from_steps(path, -np.diff(path, axis=0)[::-1]) for path in paths]


def mirrored(paths: list[Floats], rng: np.random.Generator) -> list[Floats]:
    """Mirror every path at the line through the starts of both."""
    out = []
    for path in paths:
        axis = path[0, 1] - path[0, 0]
        axis = axis / max(float(np.linalg.norm(axis)), 1e-12)
        offset = path - path[0, 0]
        along = offset @ axis
        out.append(path[0, 0] + 2 * along[..., None] * axis - offset)
    return out


def roles_swapped(paths: list[Floats], rng: np.random.Generator) -> list[Floats]:
    """Let each do what the other did."""
    return [_from_steps(path, np.diff(path, axis=0)[:, ::-1]) for path in paths]


def frozen(paths: list[Floats], rng: np.random.Generator) -> list[Floats]:
    """Stop three in ten after a third of the episode."""
    out = []
    for path in paths:
        step = np.diff(path, axis=0)
        if rng.random() < 0.3:
            step[len(step) // 3 :] = 0.0
        out.append(_from_steps(path, step))
    return out


def straight(paths: list[Floats], rng: np.random.Generator) -> list[Floats]:
    """Let the first go straight at the second with the speeds it had."""
    out = []
    for path in paths:
        moved, length = path.copy(), np.linalg.norm(np.diff(path[:, 0], axis=0), axis=-1)
        for t, one in enumerate(length):
            gap = path[t, 1] - moved[t, 0]
            far = float(np.linalg.norm(gap))
            moved[t + 1, 0] = moved[t, 0] + min(one, far) * gap / max(far, 1e-12)
        out.append(moved)
    return out


def independent_speeds(paths: list[Floats], rng: np.random.Generator) -> list[Floats]:
    """Give the second the speeds of another episode's second; directions stay."""
    order = np.roll(np.arange(len(paths)), 1)
    out = []
    for path, other in zip(paths, order):
        step = np.diff(path, axis=0)
        length = np.linalg.norm(step[:, 1], axis=-1)
        given = np.linalg.norm(np.diff(paths[other][:, 1], axis=0), axis=-1)
        given = np.resize(given, len(length)) if len(given) else length
        unit = step[:, 1] / np.where(length > 0, length, 1.0)[:, None]
        step[:, 1] = unit * given[:, None]
        out.append(_from_steps(path, step))
    return out


def late(paths: list[Floats], rng: np.random.Generator) -> list[Floats]:
    """Let the second do everything 0.3 s later than it did."""
    out = []
    for path in paths:
        step = np.diff(path, axis=0)
        step[:, 1] = np.concatenate([np.zeros((LATE, 2)), step[:, 1]])[: len(step)]
        out.append(_from_steps(path, step))
    return out


def circles(paths: list[Floats], rng: np.random.Generator) -> list[Floats]:
    """Let everybody walk in circles, with the speeds they had."""
    out = []
    for path in paths:
        length = np.linalg.norm(np.diff(path, axis=0), axis=-1)
        angle = 0.15 * np.arange(len(length))[:, None, None]
        course = np.concatenate([np.cos(angle), np.sin(angle)], axis=-1)
        out.append(_from_steps(path, length[..., None] * course))
    return out


def too_much_alike(paths: list[Floats], rng: np.random.Generator) -> list[Floats]:
    """Let all episodes have the mean speed of all."""
    length = [np.linalg.norm(np.diff(p, axis=0), axis=-1).mean(axis=0) for p in paths]
    mean = np.mean(length, axis=0)
    factors = [mean / np.where(one > 0, one, 1.0) for one in length]
    return [_from_steps(p, f[:, None] * np.diff(p, axis=0)) for p, f in zip(paths, factors)]


FAULTS: dict[str, Fault] = {
    "8 % too fast": faster(1.08),
    "20 % too fast": faster(1.2),
    "order lost beyond 2 s": order_lost,
    "bursts reversed": bursts_reversed,
    "path reversed": path_reversed,
    "mirrored": mirrored,
    "roles swapped": roles_swapped,
    "30 % frozen": frozen,
    "straight at the target": straight,
    "independent speeds": independent_speeds,
    "0.3 s late": late,
    "circles": circles,
    "too much alike": too_much_alike,
}


def with_fault(rollouts: Rollouts, fault: Fault, rng: np.random.Generator) -> Rollouts:
    """Apply a fault to every rollout; endings stay as they were."""
    paths = fault([rollouts.path(i) for i in range(len(rollouts))], rng)
    return replace(rollouts, positions=np.concatenate(paths))
