"""Simulated animals of known statistics, perfect simulators of them, and simulators with one fault.

Four worlds: one animal alone and a shoal in a walled dish; a *free pair*, in which one follows the
other's speed and nothing ends an episode but time; and a *chase*, which contact ends. All have what
recordings of animals have and two-second windows do not show: bursts that begin faster than they
end, turns that persist for seconds, a preferred side, individuals that differ, neighbours that
react late. All data here is synthetic.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
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
DISH = Arena("disc", 1.0, 1.1, rebound=True)
BLOCK = 20  # steps: order is lost beyond 2 s
LATE = 3  # steps that a reaction is late


@dataclass(frozen=True)
class KnownWorld:
    """A world of so many animals.

    Parameters
    ----------
    animals
        Two are a free pair or a chase in an open field, any other number is in a dish.
    chase
        Whether the first of two pursues the second.
    late
        Steps by which animals react later than those that were recorded.
    field
        How far from the centre of the dish animals go [arena unit].
    side
        Mean of the turning that animals prefer [rad/s].
    """

    animals: int = 2
    chase: bool = False
    late: int = 0
    field: float = 1 - 1e-6
    side: float = 0.25

    @property
    def arena(self) -> Arena:
        """The open field or the dish."""
        return ARENA if self.animals == 2 else DISH

    @property
    def roles(self) -> tuple[str, ...]:
        """Pursuer and target in a chase; otherwise all are alike."""
        return ("pursuer", "target") if self.chase else ("pursuer",) * self.animals

    @property
    def faults(self) -> tuple[str, ...]:
        """Names of the faults that a simulator of this world can have."""
        missing = set() if self.arena is DISH else {"never at walls"}
        missing |= {"roles swapped", "independent speeds"} if self.animals != 2 else set()
        missing |= set() if self.chase else {"straight at the target"}
        missing |= {"0.3 s late"} if self.animals == 1 else set()
        return tuple(name for name in (*FAULTS, *SETTINGS) if name not in missing)

    def episodes(self, start: Floats, rng: np.random.Generator) -> tuple[list[Floats], list[int]]:
        """Simulate an episode from each start ``(episodes, animals, 2)``; paths and outcomes."""
        many, number = start.shape[:2]
        size = (many, number)
        heading = rng.uniform(-np.pi, np.pi, size)
        side = self.side + rng.normal(0.0, 0.3, size)  # preferred turning [rad/s]
        turn = side.copy()
        boldness = np.exp(rng.normal(0.0, 0.15, size))
        often, hard = (np.array([first] + [rest] * (number - 1)) for first, rest in BURSTS)
        speed = np.zeros(size)
        position, path = start.copy(), [start.copy()]
        alive, length = np.ones(many, dtype=bool), np.full(many, LIMIT + 1)
        past = [(position, heading, speed)] * (self.late + 4)
        for step in range(1, LIMIT + 1):
            turn += DT / 3.0 * (side - turn) + 0.6 * np.sqrt(2 * DT / 3.0) * rng.normal(size=size)
            heading = heading + DT * turn + 0.1 * rng.normal(size=size)
            burst = rng.random(size) < often
            kick = hard * boldness * rng.uniform(0.6, 1.4, size)
            speed = np.where(burst, np.maximum(speed, kick), 0.9 * speed)
            seen = past[-self.late][0] if self.late else position
            if self.chase:
                offset = seen[:, 1] - position[:, 0], position[:, 1] - seen[:, 0]
                wanted, away = (np.arctan2(one[:, 1], one[:, 0]) for one in offset)
                heading[:, 0] += 0.25 * _turned(wanted - heading[:, 0])
                near = np.linalg.norm(offset[1], axis=1) < 0.4
                heading[:, 1] += np.where(near, 0.2 * _turned(away - heading[:, 1]), 0.0)
                speed[:, 1] = np.where(near & (rng.random(many) < 0.1), 0.45, speed[:, 1])
            elif number == 2:
                speed[:, 1] = 0.75 * speed[:, 1] + 0.2 * past[0][2][:, 0]
            elif number > 2:
                heading, speed = _shoaling(position, heading, speed, past[3])
            past = [*past[1:], (position, heading, speed)]
            moved = np.where(speed < 0.03, 0.0, speed)
            course = np.stack([np.cos(heading), np.sin(heading)], axis=-1)
            before, position = position, position + DT * moved[..., None] * course
            if self.arena is DISH:  # who meets the wall goes along it
                position, met = _held(before, position, self.field)
                out = np.arctan2(position[..., 1], position[..., 0])
                along = out + np.where(np.sin(heading - out) < 0, -0.5, 0.5) * np.pi
                heading = np.where(met, along, heading)
            path.append(position.copy())
            if self.chase:
                caught = np.linalg.norm(position[:, 0] - position[:, 1], axis=1) < CONTACT
                length[alive & caught] = step + 1
                alive &= ~caught
        paths = np.stack(path, axis=1)
        ends = [TIME_OUT if n == LIMIT + 1 else 1 for n in length.tolist()]
        return [one[:n] for one, n in zip(paths, length.tolist())], ends

    def recordings(self, count: int, rng: np.random.Generator) -> Demonstrations:
        """Record so many episodes."""
        first = rng.uniform(-0.5, 0.5, (count, 1, 2))
        number = self.animals
        if number == 2:
            angle = rng.uniform(-np.pi, np.pi, (count, 1))
            aside = np.stack([np.cos(angle), np.sin(angle)], -1)
            start = np.concatenate([first, first + rng.uniform(0.5, 0.9, (count, 1, 1)) * aside], 1)
        else:
            start = first + rng.uniform(-0.2, 0.2, (count, number, 2))
        paths, ends = self.episodes(start, rng)
        return Demonstrations(
            species="custom",
            individuals=("first", "second", "third", "fourth")[:number],
            roles=self.roles,
            dt=DT,
            arena=self.arena,
            positions=np.concatenate(paths),
            lengths=np.array([len(path) for path in paths]),
            initial_velocity=np.zeros((count, number, 2)),
            condition=np.zeros(count, dtype=np.int8),
            outcome=np.array(ends),
            split=np.full(count, "test"),
            recording=np.array([f"recording {i}" for i in range(count)]),
            provenance={
                "source": "benchmarks/known_worlds.py",
                "licence": "MIT",
                "synthetic": True,
            },
        )

    def rollouts(self, recorded: Demonstrations, each: int, rng: np.random.Generator) -> Rollouts:
        """Let a perfect simulator run ``each`` times from every start."""
        demo = np.repeat(np.arange(len(recorded)), each)
        start = recorded.positions[recorded.offsets[:-1]][demo]
        return _rollouts(recorded, *self.episodes(start, rng), demo, each)

    def faulty_rollouts(
        self, recorded: Demonstrations, each: int, fault: str, rng: np.random.Generator
    ) -> Rollouts:
        """Let a simulator with one of :attr:`faults` run ``each`` times from every start."""
        if fault in SETTINGS:
            return replace(self, **SETTINGS[fault]).rollouts(recorded, each, rng)
        made = with_fault(self.rollouts(recorded, each, rng), FAULTS[fault], rng)
        if self.arena is not DISH:
            return made
        paths = made.positions.reshape(len(made), LIMIT + 1, self.animals, 2)
        held = [paths[:, 0]]
        for step in np.diff(paths, axis=1).swapaxes(0, 1):
            held.append(_held(held[-1], held[-1] + step, self.field)[0])
        return replace(made, positions=np.stack(held, axis=1).reshape(made.positions.shape))


BURSTS = ((0.08, 0.05), (0.5, 0.35))  # chance a step, and speed, of the first and of the others
WORLDS = {
    "solo": KnownWorld(animals=1),
    "free pair": KnownWorld(),
    "chase": KnownWorld(chase=True),
    "shoal": KnownWorld(animals=4),
}
SETTINGS: Mapping[str, Mapping[str, float]] = {
    "mirrored": {"side": -0.25},
    "0.3 s late": {"late": LATE},
    "never at walls": {"field": 0.8},
}
"""Faults that are another setting of the world; the others change paths."""


def _turned(angle: Floats) -> Floats:
    return np.asarray(np.angle(np.exp(1j * angle)))


def _held(before: Floats, position: Floats, field: float) -> tuple[Floats, NDArray[np.bool_]]:
    """Return positions within the field, or no farther out than before, and which met its edge."""
    most = np.maximum(np.linalg.norm(before, axis=-1), field)
    radius = np.linalg.norm(position, axis=-1)
    inside = position * np.minimum(1.0, most / np.maximum(radius, 1e-12))[..., None]
    return inside, radius > most


def _shoaling(
    position: Floats, heading: Floats, speed: Floats, seen: tuple[Floats, Floats, Floats]
) -> tuple[Floats, Floats]:
    """Return headings and speeds after attraction, alignment and repulsion, by what was seen."""
    number = heading.shape[1]
    others = (np.ones((number, number)) - np.eye(number)) / (number - 1)
    centre = others @ seen[0] - position
    course = np.exp(1j * seen[1]) @ others
    distance = np.linalg.norm(centre, axis=-1)
    wanted = np.arctan2(centre[..., 1], centre[..., 0])
    pull = np.where(distance < 0.15, -0.15, np.minimum(0.3 * distance, 0.15))
    heading = heading + pull * np.sin(wanted - heading)
    heading = heading + 0.12 * np.abs(course) * np.sin(np.angle(course) - heading)
    return heading, speed + 0.1 * (seen[2] @ others - speed)


def _rollouts(
    recorded: Demonstrations,
    paths: list[Floats],
    ends: list[int],
    demo: NDArray[np.int64],
    each: int,
) -> Rollouts:
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
    "roles swapped": roles_swapped,
    "30 % frozen": frozen,
    "straight at the target": straight,
    "independent speeds": independent_speeds,
    "circles": circles,
    "too much alike": too_much_alike,
}


def with_fault(rollouts: Rollouts, fault: Fault, rng: np.random.Generator) -> Rollouts:
    """Apply a fault to every rollout; endings stay as they were."""
    paths = fault([rollouts.path(i) for i in range(len(rollouts))], rng)
    return replace(rollouts, positions=np.concatenate(paths))
