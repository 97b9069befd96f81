"""Episodes of courtship: starts, rollouts of the policy, and a set with the published totals.

A start is drawn, and the policy of :mod:`~tools.packaged_data.courtship_behaviour` acts from there
until contact or the time limit: nothing is cut, and no episode knows its end. Behaviour and starts
were chosen so that rollouts last as long, and touch as often, as published. What chance leaves
over is dealt with by which of twice as many rollouts are kept: of :data:`DRAWS` sets with the
published numbers of outcomes that one whose total is nearest, and one episode exchanged for the
rest. The shortest and the longest are rollouts that happen to last so long, if need be from starts
of their own.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from animarl_envs.demos.episode import TIME_OUT
from animarl_envs.errors import InputError
from animarl_envs.species import ChaseSpecies
from animarl_envs.worlds.chase.world import observe
from tools.packaged_data.courtship_behaviour import Behaviour, Rollouts, roll_out
from tools.packaged_data.courtship_published import Published, Starts

DRAWS = 2000
SEARCHED, TRIES = 1000, 60  # rollouts, and how often so many, to find one of a given length
CLEAR = 1e-4  # distances are this far from the thresholds, so that rounding decides nothing
Floats = NDArray[np.float64]
States = tuple[Floats, Floats]  # positions and velocities, (B, K, 2) each


@dataclass(frozen=True)
class Episode:
    """One rollout of a pool."""

    pool: Rollouts
    index: int
    label: str

    @property
    def steps(self) -> int:
        return int(self.pool.steps[self.index])

    @property
    def outcome(self) -> int:
        return int(self.pool.outcome[self.index])


def draw_starts(
    species: ChaseSpecies,
    behaviour: Behaviour,
    starts: Starts,
    count: int,
    rng: np.random.Generator,
) -> States:
    """Where everybody is at the start and how it moves, ``(count, K, 2)``, arena frame."""
    arena, males = species.arena, species.num_pursuers
    room = arena.size - behaviour.wall_margin
    kept: list[Floats] = []
    while sum(map(len, kept)) < count:
        female = rng.uniform(-room, room, (count, 1, 2))
        gap = rng.uniform(*starts.gap, (count, males))
        gap.sort(axis=1)
        first = rng.random(count) < starts.first_nearer
        gap = np.where(first[:, None], gap, gap[:, ::-1])
        bearing = rng.uniform(-np.pi, np.pi, gap.shape)
        aside = gap[..., None] * np.stack([np.cos(bearing), np.sin(bearing)], axis=-1)
        place = np.concatenate([female + aside, female], axis=1)
        out = np.linalg.norm(place, axis=2) if arena.shape == "disc" else np.abs(place).max(axis=2)
        kept.append(place[(out < room).all(axis=1)])
    position = np.concatenate(kept)[:count]
    towards = observe(species, position, np.zeros_like(position))[1]
    speed = behaviour.peak * rng.random((count, males + 1))
    speed[rng.random(speed.shape) >= starts.moving] = 0.0
    return position, speed[..., None] * towards


def head_on_starts(
    species: ChaseSpecies, length: int, count: int, rng: np.random.Generator
) -> States:
    """The first male and the female already run at each other, faster than they ever get by
    themselves: the published locomotion is too slow for the shortest published approach of newts.
    """
    farther = species.recording.start_farther_than
    assert farther is not None
    bearing = rng.uniform(-np.pi, np.pi, count)
    ahead = np.stack([np.cos(bearing), np.sin(bearing)], axis=-1)
    gap = rng.uniform(farther + CLEAR, farther + 0.05, count)
    closing = (gap - species.contact_radius) / (length * species.dt) * rng.uniform(1.0, 1.4, count)
    position = np.empty((count, species.num_individuals, 2))
    velocity = np.zeros_like(position)
    middle = rng.uniform(-0.2, 0.2, (count, 2))
    position[:, -1] = middle + 0.5 * gap[:, None] * ahead
    velocity[:, -1] = -0.4 * closing[:, None] * ahead
    position[:, :-1] = (middle - 0.5 * gap[:, None] * ahead)[:, None]
    velocity[:, 0] = 0.6 * closing[:, None] * ahead
    aside = 0.6 * np.stack([-ahead[:, 1], ahead[:, 0]], axis=-1)
    position[:, 1:-1] += (aside * rng.choice([-1, 1], count)[:, None])[:, None]  # at rest
    return position, velocity


def make_episodes(
    species: ChaseSpecies,
    behaviour: Behaviour,
    starts: Starts,
    published: Published,
    rng: np.random.Generator,
    progress: Callable[[float], None] | None = None,
) -> list[Episode]:
    """As many episodes as published, of the published extremes, total and outcomes.

    Raises
    ------
    InputError
        If chance does not give them.
    """
    shortest, longest = (round(t / species.dt) for t in (published.shortest, published.longest))
    count = 2 * published.episodes
    states = draw_starts(species, behaviour, starts, count, rng)
    pool = roll_out(species, behaviour, *states, rng, progress=progress)
    usable = clear(species, pool) & (pool.steps > shortest) & (pool.steps <= longest)
    episodes = [Episode(pool, i, f"synthetic rollout {i}") for i in np.flatnonzero(usable).tolist()]
    anywhere = partial(draw_starts, species, behaviour, starts, SEARCHED, rng)
    running = partial(head_on_starts, species, shortest, SEARCHED, rng)
    across = replace(starts, gap=starts.far, moving=0.0)
    apart = partial(draw_starts, species, behaviour, across, SEARCHED, rng)
    find = partial(_lasting, species, behaviour, rng)
    extremes = [find(shortest, running if starts.head_on else anywhere)]
    if not any(each.steps == longest for each in episodes):
        extremes.append(find(longest, apart))
    return _with_total(extremes, episodes, published, species.dt, rng)


def clear(species: ChaseSpecies, pool: Rollouts) -> NDArray[np.bool_]:
    """Whose distances stay away from the contact radius by ``CLEAR``, ``(B,)``."""
    apart = np.linalg.norm(pool.position[:, :, :-1] - pool.position[:, :, -1:], axis=3)
    near = np.abs(apart - species.contact_radius) < CLEAR
    lasts = np.arange(len(apart))[:, None] <= pool.steps
    kept: NDArray[np.bool_] = ~(near.any(axis=2) & lasts).any(axis=0)
    return kept


def _lasting(
    species: ChaseSpecies,
    behaviour: Behaviour,
    rng: np.random.Generator,
    length: int,
    start: Callable[[], States],
) -> Episode:
    """A rollout that ends by contact after so many steps."""
    for _ in range(TRIES):
        pool = roll_out(species, behaviour, *start(), rng, steps=length)
        fits = clear(species, pool) & (pool.steps == length) & (pool.outcome > 0)
        if fits.any():
            return Episode(pool, int(fits.argmax()), f"synthetic rollout of {length} steps")
    raise InputError(f"no {species.name} touches after {length} steps: choose another --seed")


def _with_total(
    given: list[Episode],
    others: list[Episode],
    published: Published,
    dt: float,
    rng: np.random.Generator,
) -> list[Episode]:
    """``given`` and as many of the others as are published, with the published total."""
    steps, outcome = (np.array([getattr(e, k) for e in others]) for k in ("steps", "outcome"))
    wanted = {
        k + 1: round(rate * published.episodes) for k, rate in enumerate(published.touch_rates)
    }
    wanted[TIME_OUT] = published.episodes - sum(wanted.values())
    for each in given:
        wanted[each.outcome] -= 1
    members = {code: np.flatnonzero(outcome == code) for code in wanted}
    for code, number in wanted.items():
        if not 0 <= number <= len(members[code]):
            raise InputError(
                f"{len(members[code])} rollouts end with outcome {code}, {number} are wanted: "
                "choose another --seed"
            )
    target = round(published.total / dt) - sum(each.steps for each in given)
    sets = [
        np.concatenate([rng.permutation(members[c])[:n] for c, n in sorted(wanted.items())])
        for _ in range(DRAWS)
    ]
    chosen = min(sets, key=lambda one: abs(int(steps[one].sum()) - target))
    left = target - int(steps[chosen].sum())
    spare = np.setdiff1d(np.arange(len(others)), chosen)
    change = steps[spare] - steps[chosen][:, None]
    for place, new in np.argwhere(change == left).tolist():
        if outcome[chosen[place]] == outcome[spare[new]]:
            chosen[place] = spare[new]
            return given + [others[i] for i in chosen.tolist()]
    raise InputError(
        f"the total is {left * dt:.1f} s off, too much for one exchange: choose another --seed"
    )
