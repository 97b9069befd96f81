"""Episodes out of sessions: durations as published, one episode from each session.

The paper gives the number of episodes, the shortest, the longest and the total. Durations are the
quantiles of a shifted log-normal between the two, with the spread solved for the total; newts' go
up to 300 s, of which the last 50 s are kept. For each duration T a contact is drawn that comes T
after a frame farther than the threshold, with no contact between. Sessions and stretches without
such an end are left out: a selection, not a change of what happens within an episode.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from statistics import NormalDist

import numpy as np
from numpy.typing import NDArray

from animarl_envs.demos.episode import TIME_OUT
from animarl_envs.errors import InputError
from animarl_envs.species import ChaseSpecies
from tools.packaged_data.courtship_behaviour import Behaviour, Sessions, simulate
from tools.packaged_data.courtship_published import Published

SETTLED = 600  # steps at the beginning of a session that are not used: all start at rest
HEAD_ON = 2000  # starts that are tried where no session holds so short an approach
CLEAR = 1e-4  # distances are this far from the thresholds, so that rounding decides nothing


@dataclass(frozen=True)
class Window:
    """An episode: frames ``start`` to ``stop`` (included) of a session."""

    sessions: Sessions
    session: int
    start: int
    stop: int
    outcome: int
    label: str


def durations(published: Published, dt: float) -> NDArray[np.int64]:
    """Steps of each episode, growing; they add up to the published total."""
    count, total = published.episodes, round(published.total / dt)
    normal = NormalDist()
    z = np.array([normal.inv_cdf((i + 0.5) / count) for i in range(count)])

    def steps(spread: float) -> NDArray[np.float64]:
        shares = np.exp(spread * z)
        median = (published.before_the_cut - published.shortest) / (shares[-1] - shares[0])
        time = published.shortest + median * (shares - shares[0])
        return np.asarray(np.minimum(time, published.longest) / dt)

    low, high = 1e-3, 10.0  # a wider spread between the same ends makes most episodes shorter
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if steps(middle).sum() > total else (low, middle)
    found = np.round(steps(low)).astype(np.int64)
    inner = np.flatnonzero((found > found[0]) & (found < found[-1]))
    left = total - int(found.sum())  # what rounding left over, a step here and there
    found[np.linspace(0, len(inner) - 1, abs(left)).round().astype(int) + inner[0]] += np.sign(left)
    return np.sort(found)


def outcomes(
    published: Published, steps: NDArray[np.int64], limit: int, rng: np.random.Generator
) -> NDArray[np.int8]:
    """Who touches, at the published rates; the rest run into the time limit, where they can."""
    count = len(steps)
    touches = [round(rate * count) for rate in published.touch_rates]
    without = min(max(count - sum(touches), 0), int((steps == limit).sum()))
    touches[0] = count - without - touches[1]
    codes = np.full(count, TIME_OUT, dtype=np.int8)
    codes[: count - without] = rng.permutation(np.repeat([1, 2], touches))
    return codes


def choose_windows(
    species: ChaseSpecies,
    behaviour: Behaviour,
    sessions: Sessions,
    steps: Sequence[int] | NDArray[np.int64],
    codes: NDArray[np.int8],
    rng: np.random.Generator,
) -> list[Window]:
    """An episode for each number of steps and outcome, each from its own session.

    Raises
    ------
    InputError
        If the sessions are too few.
    """
    candidates = _Candidates(species, sessions, SETTLED)
    used = np.zeros(sessions.position.shape[1], dtype=bool)
    found: dict[int, Window] = {}
    for i in np.argsort(-np.asarray(steps), kind="stable").tolist():
        length, code = int(steps[i]), int(codes[i])
        place = candidates.draw(length, code, used, rng)
        if place is not None:
            used[place[0]] = True
            label = f"synthetic session {place[0]}"
            found[i] = Window(sessions, *place, place[1] + length, code, label)
        elif code == TIME_OUT or not _too_short_from_rest(species, length):
            raise InputError(
                f"no session of {species.name} holds {length} steps that end with outcome {code}: "
                "choose another --seed"
            )
        else:
            found[i] = _head_on(species, behaviour, length, code, rng)
    return [found[i] for i in range(len(found))]


class _Candidates:
    """Contacts and starts of sessions, as arrays ``(frames, B)``."""

    def __init__(self, species: ChaseSpecies, sessions: Sessions, settled: int) -> None:
        position = sessions.position
        distance = np.linalg.norm(position[:, :, :-1] - position[:, :, -1:], axis=3)
        nearest = distance.min(axis=2)
        frame = np.arange(len(nearest))[:, None]
        near = nearest < species.contact_radius - CLEAR
        farther = species.recording.start_farther_than
        assert farther is not None
        if species.arena.shape == "disc":
            extent = np.linalg.norm(position, axis=3).max(axis=2)
        else:
            extent = np.abs(position).max(axis=(2, 3))
        # The last frame, up to each, that an episode must not hold.
        barred = (nearest < species.contact_radius + CLEAR) | (extent > species.arena.size)
        barred[:settled] = True
        self.before = np.maximum.accumulate(np.where(barred, frame, -1))
        self.far = nearest > farther + CLEAR
        self.touch = near & (extent <= species.arena.size)
        self.by = distance.argmin(axis=2) + 1

    def draw(
        self, length: int, code: int, used: NDArray[np.bool_], rng: np.random.Generator
    ) -> tuple[int, int] | None:
        """Session and first frame of an episode that lasts and ends so, or nothing."""
        frames = len(self.far)
        if length >= frames:
            return None
        clear = self.before[length - 1 : -1] < np.arange(frames - length)[:, None]
        fits = self.far[:-length] & clear & ~used
        if code == TIME_OUT:
            fits &= self.before[length:] < np.arange(frames - length)[:, None]
        else:
            fits &= self.touch[length:] & (self.by[length:] == code)
        eligible = np.flatnonzero(fits.any(axis=0))
        if len(eligible) == 0:
            return None
        session = int(rng.choice(eligible))
        return session, int(rng.choice(np.flatnonzero(fits[:, session])))


def _too_short_from_rest(species: ChaseSpecies, length: int) -> bool:
    """Whether it takes more than half the terminal speed all along to close in that fast."""
    farther = species.recording.start_farther_than
    assert farther is not None
    needed = (farther - species.contact_radius) / (length * species.dt)
    return needed > 0.5 * min(m.terminal_speed(species.dt) for m in species.locomotion)


def _head_on(
    species: ChaseSpecies, behaviour: Behaviour, length: int, code: int, rng: np.random.Generator
) -> Window:
    """An approach shorter than any from rest: both are already running at each other.

    The published locomotion is too slow for the shortest published approaches of newts, so these
    start faster than the terminal speed.
    """
    farther = species.recording.start_farther_than
    assert farther is not None
    count, males = HEAD_ON, species.num_pursuers
    bearing = rng.uniform(-np.pi, np.pi, count)
    ahead = np.stack([np.cos(bearing), np.sin(bearing)], axis=-1)
    gap = rng.uniform(farther + CLEAR, farther + 0.05, count)
    closing = (gap - species.contact_radius) / (length * species.dt) * rng.uniform(0.9, 1.3, count)
    position = np.empty((count, males + 1, 2))
    velocity = np.zeros_like(position)
    middle = rng.uniform(-0.3, 0.3, (count, 2))
    position[:, -1] = middle + 0.5 * gap[:, None] * ahead
    velocity[:, -1] = -0.4 * closing[:, None] * ahead
    for male in range(males):
        position[:, male] = middle - 0.5 * gap[:, None] * ahead
        velocity[:, male] = 0.6 * closing[:, None] * ahead
        if male != code - 1:  # elsewhere, at rest
            aside = np.stack([-ahead[:, 1], ahead[:, 0]], axis=-1)
            position[:, male] += 0.6 * aside * rng.choice([-1, 1], count)[:, None]
            velocity[:, male] = 0.0
    sessions = simulate(species, behaviour, count, length, rng, (position, velocity))
    unused = np.zeros(count, dtype=bool)
    place = _Candidates(species, sessions, settled=0).draw(length, code, unused, rng)
    if place is None:
        raise InputError(
            f"no head-on start of {species.name} leads to contact in {length} steps: "
            "choose another --seed"
        )
    label = f"synthetic head-on start of {length} steps"
    return Window(sessions, *place, place[1] + length, code, label)
