"""How a body turns that does not point where it walks; a searcher's or that of one of a chase.

A silkmoth walks sideways as well as ahead: its body is 0.75 rad off its direction of travel (median
of recorded runs at 2 Hz, ``docs/plume.md``). The body is drawn towards the direction of travel, the
more so the faster it walks, and keeps a share of its last turn:

    turn'    = persistence * turn + gain * tanh(|v'| / speed) * sin(travel' + slip - heading)
    heading' = heading + turn'

with ``v'`` the velocity of the step and ``travel'`` its direction. Angles count counter-clockwise
in the arena frame. The kernels' form is :func:`animarl_envs.kinematics.next_turn`, the fit is in
:mod:`animarl_envs.fitting.turning`.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from annotated_types import Ge, Gt, Lt

from animarl_envs.array_types import Floats
from animarl_envs.errors import InputError
from animarl_envs.settings import Positive, check_fields


@dataclass(frozen=True)
class Turning:
    """Turning of one individual, per decision step.

    Parameters
    ----------
    persistence
        Share of the last turn that goes on, in [0, 1).
    gain
        Turn of a fast body that walks at right angles to itself [rad], positive.
    slip
        Angle from the direction of travel to the heading that a straight walk ends in [rad];
        mirrored animals have the opposite slip.
    speed
        Speed about which walking begins to turn the body in full [arena unit / s], positive.
    """

    persistence: Annotated[float, Ge(0), Lt(1)]
    gain: Annotated[float, Gt(0), Lt(np.pi)]
    slip: Annotated[float, Ge(-np.pi), Lt(np.pi)]
    speed: Positive

    def __post_init__(self) -> None:
        check_fields(self, "turning's ")

    def next_turn(
        self,
        turn: Floats,
        heading: Floats,
        velocity: Floats,
    ) -> Floats:
        """Return the turn of a step [rad], ``(...)``.

        ``turn`` and ``heading`` ``(...)`` are those before the step [rad], ``velocity``
        ``(..., 2)`` is that of the step [arena unit / s].
        """
        vx, vy = velocity[..., 0], velocity[..., 1]
        off = np.sin(np.arctan2(vy, vx) + self.slip - heading)
        pull = np.tanh(np.hypot(vx, vy) / self.speed) * off
        return np.asarray(self.persistence * turn + self.gain * pull)


def as_turning(given: Any, place: str) -> Turning | None:
    """Return a turning given as such or by its numbers, or None; ``whose`` is for messages."""
    if isinstance(given, Mapping):
        try:
            return Turning(**given)
        except TypeError as error:
            raise InputError(
                f"{place} is {dict(given)!r}: name persistence, gain, slip and speed"
            ) from error
    if not isinstance(given, Turning | None):
        raise InputError(f"{place} is {given!r}: give a Turning, its numbers by name, or None")
    return given


def turnings_of(given: Any, individuals: Sequence[str]) -> tuple[Turning | None, ...]:
    """Return one for each individual, or none at all where every body points where it walks.

    ``given`` are as many in their order, or some of them by name.
    """
    each = given
    if isinstance(given, Mapping):
        strangers = [name for name in given if name not in individuals]
        if strangers:
            raise InputError(
                f"turning names {strangers[0]!r}: choose among {', '.join(individuals)}"
            )
        each = [given.get(name) for name in individuals]
    listed = isinstance(each, Sequence) and not isinstance(each, str)
    if each is not None and (not listed or len(each) not in (0, len(individuals))):
        raise InputError(
            f"turning is {given!r}: give one for each of {', '.join(individuals)}, some by name, "
            "or None"
        )
    pairs = zip(individuals, each or (), strict=False)
    turnings = tuple(as_turning(one, f"turning of {name}") for name, one in pairs)
    return turnings if any(turnings) else ()
