"""A programmed silkmoth: surge, zigzag, loop.

The sequence that a male starts anew at every contact with pheromone (Kanzaki, Sugi and Shibuya
1992): it *surges* straight ahead, then turns to one side and the other for longer and longer
(*zigzag*), then circles (*loop*) until the next contact. Which side it turns to first, and a slight
turn of the surge, follow the antenna that was hit (Takasaki, Namiki and Kanzaki 2012; Ando and
Kanzaki 2015). Wind and vision modulate the sequence (Yamada et al. 2021): with the wind from ahead
the moth surges fast, with the wind from elsewhere carefully, and turns into it; visual flow tells
how far the body really turned, and the next step makes good the difference. Each moth has its own
pace, and stops now and then.

It plans in its body's frame, and uses the body angle only to say its plan in the world's actions,
never as a compass. Without any contact it stands still.

Kanzaki et al. (1992), Zool. Sci. 9: 515-527. Takasaki et al. (2012), J. Comp. Physiol. A 198:
295-307. Ando and Kanzaki (2015), J. Exp. Biol. 218: 3845-3854. Yamada et al. (2021), eLife 10:
e72001.
"""

import math
from dataclasses import dataclass, field
from typing import Annotated

import numpy as np
from annotated_types import Gt, Le
from numpy.typing import NDArray

from animarl_envs.array_types import Bools, Floats, Ints
from animarl_envs.errors import InputError
from animarl_envs.locomotion import next_velocity
from animarl_envs.settings import NotNegative, Positive, check_fields
from animarl_envs.species import SILKMOTH, SearchSpecies
from animarl_envs.worlds.search.layout import SearchEntry

AHEAD, LEFT, BODY_ANGLE = (
    SearchEntry.VELOCITY_AHEAD,
    SearchEntry.VELOCITY_LEFT,
    SearchEntry.BODY_ANGLE,
)
ODOUR_LEFT, ODOUR_RIGHT, FLOW = SearchEntry.ODOUR_LEFT, SearchEntry.ODOUR_RIGHT, SearchEntry.FLOW
WIND_FRONT, WIND_RIGHT, WIND_LEFT, WIND_BACK = range(
    SearchEntry.WIND_FRONT, SearchEntry.WIND_BACK + 1
)
_NEVER = 1_000_000  # steps since the last contact, before the first


@dataclass(frozen=True, kw_only=True)
class MothProgramme:
    """Numbers of the sequence.

    Fitted by ``python -m tools.packaged_data.moth_fit`` to recorded moths and to the paper's
    figures (``docs/data/packaged_silkmoth.md``).
    """

    surge: Positive = 1.17  # duration [s]
    turns: tuple[float, ...] = (0.721, 3.7, 2.49)  # durations of the zigzag turns [s]
    yaw_rate: Positive = 1.94  # of zigzag and loop [rad / s]
    surge_speed: Positive = 0.0171  # [arena unit / s]
    turn_speed: Positive = 0.00821  # [arena unit / s]
    # share of the surge's speed with the wind not from ahead
    careful: Annotated[float, Gt(0), Le(1)] = 0.417
    odour_turn: float = 1.01  # of the surge, towards the antenna that was hit [rad]
    wind_turn: float = 0.0226  # of the surge, into the wind, per step [rad]
    motor_noise: NotNegative = 0.187  # standard deviation of the angle turned, per step [rad]
    slip: NotNegative = 0.00299  # standard deviation of each velocity component [arena unit / s]
    pace_spread: NotNegative = 0.138  # of moths: standard deviation of their log speed
    pause_rate: NotNegative = 0.118  # how often a walking moth stops [1 / s]
    pause: NotNegative = 1.39  # how long it then stands, on average [s]

    def __post_init__(self) -> None:
        check_fields(self)
        if not all(0 < t < math.inf for t in self.turns):
            raise InputError(f"turns are {self.turns}: give positive durations in seconds")


@dataclass(eq=False)
class ProgrammedMoth:
    """The policy, for ``copies`` moths side by side.

    Call :meth:`reset` where an episode starts and :meth:`act` once per step. ``generator`` draws
    the motor noise, and the side where both antennae are hit; ``species`` gives the time step and
    the locomotion that a plan is turned into actions with.
    """

    copies: int
    generator: np.random.Generator
    species: SearchSpecies = SILKMOTH
    programme: MothProgramme = field(default_factory=MothProgramme)

    def __post_init__(self) -> None:
        self._since = np.full(self.copies, _NEVER)  # steps since the last contact
        self._side = np.ones(self.copies)  # of the first turn, 1 left
        self.turned = np.zeros(self.copies)  # what the last step meant to turn, to the left [rad]
        self._pace = np.ones(self.copies)  # of each moth, times the programme's speeds
        self._standing = np.zeros(self.copies, dtype=bool)
        dt = self.species.dt
        starts = np.cumsum([self.programme.surge, *self.programme.turns]) / dt
        self._phase_starts = np.maximum.accumulate(np.round(starts)).astype(int)
        self.reset()

    def reset(self, mask: Bools | None = None) -> None:
        """Start new moths where ``mask`` (copies,) is true (everywhere by default)."""
        mask = np.ones(self.copies, dtype=bool) if mask is None else mask
        spread = self.programme.pace_spread * self.generator.standard_normal(self.copies)
        self._pace[mask] = np.exp(spread)[mask]
        self._standing[mask] = False
        self._since[mask] = _NEVER
        self.turned[mask] = 0.0

    def act(self, observation: NDArray[np.floating]) -> Ints:
        """Return the actions ``(copies, 1)`` for observations ``(copies, 1, n)``."""
        seen = np.asarray(observation, dtype=np.float64)[:, 0]
        programme, dt, count = self.programme, self.species.dt, self.copies
        draw_side = np.where(self.generator.random(count) < 0.5, 1.0, -1.0)
        noise = programme.motor_noise * self.generator.standard_normal(count)
        change = self.generator.random(count)
        slip = programme.slip * self.generator.standard_normal((count, 2))

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
        wind = seen[:, WIND_FRONT : WIND_BACK + 1]
        felt = wind.any(axis=1)
        into = seen[:, WIND_LEFT] - seen[:, WIND_RIGHT] + seen[:, WIND_BACK] * self._side
        turn = np.where(felt & surging, turn + programme.wind_turn * into, turn)
        careful = felt & surging & (seen[:, WIND_FRONT] == 0)
        speed = np.where(careful, programme.careful * speed, speed)

        # Vision: make good what the last turn missed; visual flow is minus the yaw rate, and the
        # moth expects no more of it than there can be.
        limit = self.species.flow_limit * dt
        missed = np.clip(self.turned, -limit, limit) + seen[:, FLOW] * dt
        turn = np.where(felt, turn + missed, turn)

        # Pauses: stop and go as a two-state process.
        stops, goes = dt * programme.pause_rate, dt / max(programme.pause, dt)
        self._standing = np.where(self._standing, change >= goes, change < stops)
        speed = np.where(self._standing, 0.0, self._pace * speed)
        turn = np.where(self._standing, 0.0, turn)
        self.turned = turn

        direction = seen[:, BODY_ANGLE] + turn + noise
        wanted = speed[:, None] * np.stack([np.cos(direction), np.sin(direction)], axis=-1)
        wanted = np.where(speed[:, None] > 0, wanted + slip, 0.0)
        wanted[self._since >= _NEVER] = 0.0
        return self._nearest_action(seen[:, [AHEAD, LEFT]], wanted)[:, None]

    def _nearest_action(self, velocity: Floats, wanted: Floats) -> Ints:
        """Return the action whose next velocity is nearest the wanted one, in the upwind frame."""
        own = self.species.locomotion[0]
        reachable = next_velocity(
            velocity[:, None], own.action_vectors, own.damping, own.thrust, self.species.dt
        )
        error = np.linalg.norm(reachable - wanted[:, None], axis=-1)
        return np.asarray(error.argmin(axis=1), dtype=np.int64)
