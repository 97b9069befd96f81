"""A programmed silkmoth: surge, zigzag, loop.

The sequence that a male starts anew at every contact with pheromone (Kanzaki, Sugi and Shibuya
1992): it *surges* straight ahead, then turns to one side and the other for longer and longer
(*zigzag*), then circles (*loop*) until the next contact. Which side it turns to first, and a slight
turn of the surge, follow the antenna that was hit (Takasaki, Namiki and Kanzaki 2012; Ando and
Kanzaki 2015).
Wind and vision modulate the sequence (Yamada et al. 2021): with the wind from ahead the moth surges
fast, with the wind from elsewhere carefully, and turns into it; visual flow tells how far the body
really turned, and the next step makes good the difference.

``python -m animarl_envs.demos.programmed_moth [DATA_DIR]`` prints how often, how fast and on how
long a path it finds the source, and the same of recorded moths.

The policy sees observations only. It plans in its body's frame, and uses the body angle only to
say its plan in the world's 13 actions, never as a compass: with wind blocked it does not know where
upwind is. Without any contact it stands still.

References
----------
Kanzaki, Sugi and Shibuya (1992), Zoological Science 9: 515-527. Takasaki, Namiki and Kanzaki
(2012), Journal of Comparative Physiology A 198: 295-307. Ando and Kanzaki (2015), Journal of
Experimental Biology 218: 3845-3854. Yamada, Ohashi, Hosoda, Kurabayashi and Shigaki (2021), eLife
10: e72001.
"""

from __future__ import annotations

import argparse
import math
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from animarl_envs.errors import InputError
from animarl_envs.locomotion import ACTION_VECTORS, Locomotion
from animarl_envs.species import SILKMOTH, SearchSpecies

AHEAD, LEFT, BODY_ANGLE, ODOUR_LEFT, ODOUR_RIGHT, FLOW = range(6)
WIND_FRONT, WIND_RIGHT, WIND_LEFT, WIND_BACK = range(6, 10)
_NEVER = 1_000_000  # steps since the last contact, before the first


@dataclass(frozen=True, kw_only=True)
class MothProgramme:
    """Numbers of the sequence.

    Chosen by random search for success, duration and path of recorded moths (``docs/plume.md``).
    """

    surge: float = 1.0  # duration [s]
    turns: tuple[float, ...] = (1.0, 2.0, 3.0)  # durations of the zigzag turns [s]
    yaw_rate: float = 1.3  # of zigzag and loop [rad / s]
    surge_speed: float = 0.021  # [arena unit / s]
    turn_speed: float = 0.0075  # [arena unit / s]
    careful: float = 0.7  # share of the surge's speed with the wind not from ahead
    odour_turn: float = 0.5  # of the surge, towards the antenna that was hit [rad]
    wind_turn: float = 0.08  # of the surge, into the wind, per step [rad]
    motor_noise: float = 0.25  # standard deviation of the angle turned, per step [rad]

    def __post_init__(self) -> None:
        for name in ("surge", "yaw_rate", "surge_speed", "turn_speed"):
            if not 0 < getattr(self, name) < math.inf:
                raise InputError(f"{name} is {getattr(self, name)}: it must be a positive number")
        if not all(0 < t < math.inf for t in self.turns):
            raise InputError(f"turns are {self.turns}: give positive durations in seconds")
        if not 0 < self.careful <= 1:
            raise InputError(f"careful is {self.careful}: it must lie between 0 and 1")
        if not 0 <= self.motor_noise < math.inf:
            raise InputError(f"motor_noise is {self.motor_noise}: it must be zero or positive")


@dataclass(eq=False)
class ProgrammedMoth:
    """The policy, for ``copies`` moths side by side.

    Call :meth:`reset` where an episode starts and :meth:`act` once per step.

    Parameters
    ----------
    copies
        Number of moths.
    generator
        Source of the motor noise and of the side where both antennae are hit.
    species
        Gives the time step and the locomotion that a plan is turned into actions with.
    programme
        The numbers of the sequence.
    """

    copies: int
    generator: np.random.Generator
    species: SearchSpecies = SILKMOTH
    programme: MothProgramme = field(default_factory=MothProgramme)

    def __post_init__(self) -> None:
        self._since = np.full(self.copies, _NEVER)  # steps since the last contact
        self._side = np.ones(self.copies)  # of the first turn, 1 left
        self.turned = np.zeros(self.copies)  # what the last step meant to turn, to the left [rad]
        dt = self.species.dt
        starts = np.cumsum([self.programme.surge, *self.programme.turns]) / dt
        self._phase_starts = np.maximum.accumulate(np.round(starts)).astype(int)

    def reset(self, mask: NDArray[np.bool_] | None = None) -> None:
        """Forget the past where ``mask`` (copies,) is true (everywhere by default)."""
        mask = np.ones(self.copies, dtype=bool) if mask is None else mask
        self._since[mask] = _NEVER
        self.turned[mask] = 0.0

    def act(self, observation: NDArray[np.floating]) -> NDArray[np.int64]:
        """Actions ``(copies, 1)`` for observations ``(copies, 1, 10)`` of the search world."""
        seen = np.asarray(observation, dtype=np.float64)[:, 0]
        programme, dt, count = self.programme, self.species.dt, self.copies
        draw_side = np.where(self.generator.random(count) < 0.5, 1.0, -1.0)
        noise = programme.motor_noise * self.generator.standard_normal(count)

        left, right = seen[:, ODOUR_LEFT] >= 1.0, seen[:, ODOUR_RIGHT] >= 1.0
        contact = left | right
        side = left.astype(float) - right
        self._since = np.where(contact, 0, np.minimum(self._since + 1, _NEVER))
        self._side = np.where(contact, np.where(side == 0, draw_side, side), self._side)

        # The phase of the sequence: 0 surge, 1, 2, ... turns, then the loop.
        phase = np.searchsorted(self._phase_starts, self._since, side="right")
        surging = phase == 0
        alternate = np.where(phase % 2 == 1, self._side, -self._side)
        turn = np.where(surging, programme.odour_turn * side, alternate * programme.yaw_rate * dt)
        speed = np.where(surging, programme.surge_speed, programme.turn_speed)

        # Wind: fast with it from ahead; otherwise slowly, and into it.
        wind = seen[:, WIND_FRONT:]
        felt = wind.any(axis=1)
        into = seen[:, WIND_LEFT] - seen[:, WIND_RIGHT] + seen[:, WIND_BACK] * self._side
        turn = np.where(felt & surging, turn + programme.wind_turn * into, turn)
        careful = felt & surging & (seen[:, WIND_FRONT] == 0)
        speed = np.where(careful, programme.careful * speed, speed)

        # Vision: make good what the last turn missed; visual flow is minus the yaw rate.
        missed = self.turned + seen[:, FLOW] * dt
        saturated = np.abs(seen[:, FLOW]) >= self.species.flow_limit
        turn = np.where(felt & ~saturated, turn + missed, turn)
        self.turned = turn

        direction = seen[:, BODY_ANGLE] + turn + noise
        wanted = speed[:, None] * np.stack([np.cos(direction), np.sin(direction)], axis=-1)
        wanted[self._since >= _NEVER] = 0.0
        return self._nearest_action(seen[:, [AHEAD, LEFT]], wanted)[:, None]

    def _nearest_action(
        self, velocity: NDArray[np.float64], wanted: NDArray[np.float64]
    ) -> NDArray[np.int64]:
        """The action whose next velocity is nearest to the wanted one; both in the upwind frame."""
        loco = self.species.locomotion[0]
        coasting = (1.0 - loco.damping) * velocity
        reachable = coasting[:, None] + loco.thrust * self.species.dt * ACTION_VECTORS
        error = np.linalg.norm(reachable - wanted[:, None], axis=-1)
        return np.asarray(error.argmin(axis=1), dtype=np.int64)


# -- how well it searches -------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Searches:
    """How ``episodes`` searches ended; arrays ``(episodes,)``."""

    reached: NDArray[np.bool_]
    duration: NDArray[np.float64]  # [s]; the time limit where the source was not reached
    path: NDArray[np.float64]  # walked [arena unit], at one sample per decision step

    @property
    def rate(self) -> float:
        """Share of searches that reached the source."""
        return float(self.reached.mean())

    def interval(self) -> tuple[float, float]:
        """95 % Wilson interval of the rate."""
        n, p, z = len(self.reached), self.rate, 1.96
        middle = (p + z * z / (2 * n)) / (1 + z * z / n)
        half = z / (1 + z * z / n) * math.sqrt(p * (1 - p) / n + z * z / (4 * n * n))
        return middle - half, middle + half


def search_rates(
    species: SearchSpecies,
    condition: int,
    *,
    episodes: int,
    seed: int,
    programme: MothProgramme | None = None,
) -> Searches:
    """Let programmed moths search, each from the start without a demonstration.

    The plume patterns are those of ``species.train_plumes``.
    """
    from animarl_envs.scenario import Scenario
    from animarl_envs.worlds.search import SearchWorld

    if episodes < 1:
        raise InputError(f"episodes is {episodes}: it must be at least 1")
    scenario = Scenario(
        species=species,
        condition=condition,  # type: ignore[arg-type]
        start="uniform",
        drivers=("action",),
    )
    world = SearchWorld(scenario, episodes)
    generator = np.random.default_rng(seed)
    world.seed(generator.integers(2**63, size=episodes))
    world.reset()
    moths = ProgrammedMoth(episodes, generator, species, programme or MothProgramme())
    reached = np.zeros(episodes, dtype=bool)
    duration = np.full(episodes, species.time_limit * species.dt)
    path = np.zeros(episodes)
    for step in range(1, species.time_limit + 1):
        world.step(moths.act(world.observation))
        searching = ~reached
        path += np.where(searching, np.linalg.norm(world.velocity[:, 0], axis=1) * species.dt, 0.0)
        arrived = searching & world.terminated
        duration[arrived] = step * species.dt
        reached |= arrived
        if reached.all():
            break
    return Searches(reached, duration, path)


def recorded_searches(folder: Path, species: SearchSpecies = SILKMOTH) -> Searches:
    """The recorded runs in ``folder/raw`` (time, x, y [mm] at 30 Hz), sampled like the world."""
    files = sorted((folder / "raw").glob("*.csv"))
    if not files:
        raise InputError(f"{folder}: it holds no raw/*.csv: name the folder of recorded moths")
    reached, duration, path = [], [], []
    for file in files:
        track = np.genfromtxt(file, delimiter=",", skip_header=1, usecols=(0, 1, 2))
        position = track[:, 1:] / 1000.0
        every = round(species.dt * species.recording.frame_rate)
        kept = np.unique([*range(0, len(position), every), len(position) - 1])
        reached.append(float(np.linalg.norm(position[-1])) < species.contact_radius + 0.001)
        duration.append(track[-1, 0] - track[0, 0])
        path.append(np.linalg.norm(np.diff(position[kept], axis=0), axis=1).sum())
    return Searches(np.array(reached), np.array(duration), np.array(path))


def main() -> None:
    """Command line; see the top of this module."""
    parser = argparse.ArgumentParser(description="How well the programmed moth searches.")
    parser.add_argument("folder", type=Path, nargs="?", help="folder of recorded moths")
    parser.add_argument("--episodes", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    onset_fit = replace(SILKMOTH, locomotion=(Locomotion(0.341, 0.0171),))
    cases = [
        (f"{who}, {plumes}, {SILKMOTH.conditions[condition]}", spec, condition)
        for who, spec in (("default", SILKMOTH), ("d = 0.341, u = 0.0171", onset_fit))
        for plumes, spec in (
            ("training plumes", spec),
            ("held-out plumes", replace(spec, train_plumes=SILKMOTH.test_plumes)),
        )
        for condition in (0, 1)
    ]
    for name, spec, condition in cases:
        _report(name, search_rates(spec, condition, episodes=given.episodes, seed=given.seed))
    if given.folder is not None:
        _report("recorded moths", recorded_searches(given.folder))


def _report(name: str, found: Searches) -> None:
    low, high = found.interval()
    duration = np.percentile(found.duration[found.reached], (25, 50, 75)).round(1)
    path = np.percentile(found.path[found.reached], (25, 50, 75)).round(2)
    print(
        f"{name}: reached {found.reached.sum()} of {len(found.reached)} "
        f"= {found.rate:.3f} [{low:.3f}, {high:.3f}]; "
        f"of those, quartiles of duration {duration} s, path {path} m"
    )


if __name__ == "__main__":
    main()
