"""What a searcher observes: the one table from which kernel, spaces and pages are made.

:class:`Seen` is the order, :func:`observation_components` says what each entry means, and
:func:`animarl_envs.worlds.search.senses.sense` writes them. The first ``PAPER`` entries are the
paper's; ``observation="paper"`` stops there. The position is not among them.
"""

from __future__ import annotations

import math
from enum import IntEnum, auto

from animarl_envs.species import SearchSpecies
from animarl_envs.worlds.base import ObservationComponent

HARDEST = 4.0  # accelerations are seen up to so many times the thrust
REST = 0.3  # added to the speed in steps of thrust before its logarithm is taken


class Seen(IntEnum):
    """Rows of an observation."""

    @staticmethod
    def _generate_next_value_(name: str, start: int, count: int, last_values: list[int]) -> int:
        return count

    VELOCITY_AHEAD = auto()
    VELOCITY_LEFT = auto()
    BODY_ANGLE = auto()
    ODOUR_LEFT = auto()
    ODOUR_RIGHT = auto()
    FLOW = auto()
    WIND_FRONT = auto()
    WIND_RIGHT = auto()
    WIND_LEFT = auto()
    WIND_BACK = auto()
    HIT_LEFT = auto()
    HIT_RIGHT = auto()
    ODOUR_DIFFERENCE = auto()
    ODOUR_SUM = auto()
    TRACE_LEFT = auto()
    TRACE_RIGHT = auto()
    ANGLE_COSINE = auto()
    ANGLE_SINE = auto()
    FINE_AHEAD = auto()
    FINE_LEFT = auto()
    COARSE_AHEAD = auto()
    COARSE_LEFT = auto()
    LOG_SPEED = auto()
    ACCELERATION_AHEAD = auto()
    ACCELERATION_LEFT = auto()
    YAW_RATE = auto()


PAPER = Seen.WIND_BACK + 1  # components of the paper


def observation_components(
    species: SearchSpecies, fastest: float = 0.0
) -> tuple[ObservationComponent, ...]:
    """What each entry of an observation means, in order.

    The speed is at most the terminal speed, or ``fastest`` [arena unit / s] if demonstrations are.
    """
    limit = species.time_limit + 1
    top = max(fastest, *(m.top_speed(species.dt, limit, fastest) for m in species.locomotion))
    scales = species.scales
    stride, own = scales.locomotion[0].thrust * scales.dt, top * max(1.0, scales.own_velocity[0])
    # The largest thrust (velocities that were rounded may give a hair more), or as was recorded.
    largest = min(HARDEST, species.locomotion[0].magnitudes[0] * (1.0 + 1e-6))
    push = HARDEST if fastest > 0.0 or species.sense_scales is not None else largest
    flow, turn = species.flow_limit, math.pi / species.dt
    ego = "egocentric, x upwind, y to the left"
    entry = ObservationComponent
    table = {
        Seen.VELOCITY_AHEAD: entry("velocity ahead", ego, "arena unit / s", -own, own),
        Seen.VELOCITY_LEFT: entry("velocity left", ego, "arena unit / s", -own, own, -1.0),
        Seen.BODY_ANGLE: entry("body angle", ego, "rad", -math.pi, math.pi, -1.0),
        Seen.ODOUR_LEFT: entry("odour left", "body", "1", 0.0, 1.0, mirror="odour right"),
        Seen.ODOUR_RIGHT: entry("odour right", "body", "1", 0.0, 1.0, mirror="odour left"),
        Seen.FLOW: entry("visual flow", "body", "rad / s", -flow, flow, -1.0),
        Seen.WIND_FRONT: entry("wind from front", "body", "1", 0.0, 1.0),
        Seen.WIND_RIGHT: entry("wind from right", "body", "1", 0.0, 1.0, mirror="wind from left"),
        Seen.WIND_LEFT: entry("wind from left", "body", "1", 0.0, 1.0, mirror="wind from right"),
        Seen.WIND_BACK: entry("wind from back", "body", "1", 0.0, 1.0),
        Seen.HIT_LEFT: entry("hit left", "body", "1", 0.0, 1.0, mirror="hit right"),
        Seen.HIT_RIGHT: entry("hit right", "body", "1", 0.0, 1.0, mirror="hit left"),
        Seen.ODOUR_DIFFERENCE: entry("odour left minus right", "body", "1", -1.0, 1.0, -1.0),
        Seen.ODOUR_SUM: entry("odour left plus right", "body", "1", 0.0, 2.0),
        Seen.TRACE_LEFT: entry("trace left", "body", "1", 0.0, 1.0, mirror="trace right"),
        Seen.TRACE_RIGHT: entry("trace right", "body", "1", 0.0, 1.0, mirror="trace left"),
        Seen.ANGLE_COSINE: entry("body angle, cosine", ego, "1", -1.0, 1.0),
        Seen.ANGLE_SINE: entry("body angle, sine", ego, "1", -1.0, 1.0, -1.0),
        Seen.FINE_AHEAD: entry("velocity ahead, fine", ego, "1", -1.0, 1.0),
        Seen.FINE_LEFT: entry("velocity left, fine", ego, "1", -1.0, 1.0, -1.0),
        Seen.COARSE_AHEAD: entry("velocity ahead, coarse", ego, "1", -1.0, 1.0),
        Seen.COARSE_LEFT: entry("velocity left, coarse", ego, "1", -1.0, 1.0, -1.0),
        Seen.LOG_SPEED: entry(
            "log speed", ego, "1", math.log(REST), math.log(top / stride + REST)
        ),
        Seen.ACCELERATION_AHEAD: entry("acceleration ahead / u", ego, "1", -push, push),
        Seen.ACCELERATION_LEFT: entry("acceleration left / u", ego, "1", -push, push, -1.0),
        Seen.YAW_RATE: entry("yaw rate", "body", "rad / s", -turn, turn, -1.0),
    }  # fmt: skip
    wanted = PAPER if species.observation == "paper" else len(Seen)
    return tuple(table[seen] for seen in Seen)[:wanted]
