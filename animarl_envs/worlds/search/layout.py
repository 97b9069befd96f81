"""What a searcher observes: the one table from which kernel, spaces and pages are made.

:class:`SearchEntry` is the order, :func:`observation_components` says what each entry means, and
:func:`animarl_envs.worlds.search.kernels.sense` writes them. The first ``PAPER`` entries are the
paper's, where ``observation="paper"`` stops; ``"compact"`` holds the hits themselves beside them,
``"full"`` all, and ``"odour"`` the hits alone. The position is not among them.
"""

from __future__ import annotations

import math
import re
from enum import IntEnum

from animarl_envs.species import COMPACT, SearchSpecies
from animarl_envs.species.traits import LARGEST, TRAITS
from animarl_envs.worlds.base import ObservationComponent
from animarl_envs.worlds.plume.plume import LONGEST

HARDEST = 4.0  # accelerations are seen up to so many times the thrust
EGO, BODY = "egocentric, x upwind, y to the left", "body"
REST = 0.3  # added to the speed in steps of thrust before its logarithm is taken


class SearchEntry(IntEnum):
    """Rows of an observation: its component's name, frame, unit, range, and look in a mirror.

    ``span`` names a range of :func:`observation_components`; ``description`` and ``sign`` are those
    of an :class:`~animarl_envs.worlds.base.ObservationComponent`.
    """

    component: tuple[str, str, str, str, str, float]

    def __new__(
        cls,
        label: str,
        frame: str,
        unit: str,
        span: str,
        description: str,
        sign: float = 1.0,
    ) -> SearchEntry:
        """Make a member numbered in order, with its component."""
        member = int.__new__(cls, len(cls.__members__))
        member._value_ = len(cls.__members__)
        member.component = label, frame, unit, span, description, sign
        return member

    @property
    def mirror(self) -> str:
        """Label of the component on the other side, if there is one for each side."""
        label = self.component[0]
        other = "left" if "right" in label else "right"
        swapped = re.sub("left|right", other, label)
        labels = {one.component[0] for one in SearchEntry}
        return swapped if swapped != label and swapped in labels else ""

    VELOCITY_AHEAD = (
        "velocity ahead",
        EGO,
        "arena unit / s",
        "speed",
        "it moves [downwind|upwind] faster",
    )
    VELOCITY_LEFT = (
        "velocity left",
        EGO,
        "arena unit / s",
        "speed",
        "it moves to the [right|left] faster",
        -1.0,
    )
    BODY_ANGLE = ("body angle", EGO, "rad", "angle", "it moves in another direction", -1.0)
    ODOUR_LEFT = ("odour left", BODY, "1", "share", "it smells [less|more] on the left")
    ODOUR_RIGHT = ("odour right", BODY, "1", "share", "it smells [less|more] on the right")
    FLOW = ("visual flow", BODY, "rad / s", "flow", "it turns [right|left] faster", -1.0)
    WIND_FRONT = ("wind from front", BODY, "1", "share", "it feels [less|more] wind from the front")
    WIND_RIGHT = ("wind from right", BODY, "1", "share", "it feels [less|more] wind from the right")
    WIND_LEFT = ("wind from left", BODY, "1", "share", "it feels [less|more] wind from the left")
    WIND_BACK = ("wind from back", BODY, "1", "share", "it feels [less|more] wind from the back")
    HIT_LEFT = ("hit left", BODY, "1", "share", "it smells [less|more] on the left")
    HIT_RIGHT = ("hit right", BODY, "1", "share", "it smells [less|more] on the right")
    ODOUR_DIFFERENCE = (
        "odour left minus right",
        BODY,
        "1",
        "unit",
        "it smells more on the [right|left]",
        -1.0,
    )
    ODOUR_SUM = ("odour left plus right", BODY, "1", "sum", "it smells [less|more]")
    TRACE_LEFT = ("trace left", BODY, "1", "share", "it smells [less|more] on the left")
    TRACE_RIGHT = ("trace right", BODY, "1", "share", "it smells [less|more] on the right")
    ANGLE_COSINE = ("body angle, cosine", EGO, "1", "unit", "it moves in another direction")
    ANGLE_SINE = ("body angle, sine", EGO, "1", "unit", "it moves in another direction", -1.0)
    FINE_AHEAD = ("velocity ahead, fine", EGO, "1", "unit", "it moves [downwind|upwind] faster")
    FINE_LEFT = (
        "velocity left, fine",
        EGO,
        "1",
        "unit",
        "it moves to the [right|left] faster",
        -1.0,
    )
    COARSE_AHEAD = ("velocity ahead, coarse", EGO, "1", "unit", "it moves [downwind|upwind] faster")
    COARSE_LEFT = (
        "velocity left, coarse",
        EGO,
        "1",
        "unit",
        "it moves to the [right|left] faster",
        -1.0,
    )
    LOG_SPEED = ("log speed", EGO, "1", "log speed", "it is [slower|faster]")
    ACCELERATION_AHEAD = (
        "acceleration ahead / u",
        EGO,
        "1",
        "push",
        "it pushes [downwind|upwind] harder",
    )
    ACCELERATION_LEFT = (
        "acceleration left / u",
        EGO,
        "1",
        "push",
        "it pushes to the [right|left] harder",
        -1.0,
    )
    YAW_RATE = ("yaw rate", BODY, "rad / s", "turn", "it turns [right|left] faster", -1.0)
    TURN_1 = (
        "turning, 1 s",
        BODY,
        "rad / s",
        "turn",
        "over the last 1 s it turned [right|left] faster",
        -1.0,
    )
    TURN_3 = (
        "turning, 3 s",
        BODY,
        "rad / s",
        "turn",
        "over the last 3 s it turned [right|left] faster",
        -1.0,
    )
    TURN_10 = (
        "turning, 10 s",
        BODY,
        "rad / s",
        "turn",
        "over the last 10 s it turned [right|left] faster",
        -1.0,
    )
    WAY_LEFT_3 = (
        "way left, 3 s",
        EGO,
        "1",
        "strides",
        "over the last 3 s it went farther to the [right|left]",
        -1.0,
    )
    WAY_LEFT_10 = (
        "way left, 10 s",
        EGO,
        "1",
        "strides",
        "over the last 10 s it went farther to the [right|left]",
        -1.0,
    )
    WAY_AHEAD_3 = (
        "way ahead, 3 s",
        EGO,
        "1",
        "strides",
        "over the last 3 s it went farther [downwind|upwind]",
    )
    WAY_AHEAD_10 = (
        "way ahead, 10 s",
        EGO,
        "1",
        "strides",
        "over the last 10 s it went farther [downwind|upwind]",
    )
    SPEED_10 = ("own speed, 10 s", EGO, "1", "strides", "over the last 10 s it was [slower|faster]")
    SINCE_HIT = (
        "time since a hit, log",
        BODY,
        "1",
        "since",
        "it smelled something [more recently|longer ago]",
    )
    OWN_SPEED = (TRAITS[0], "individual", "sd", "trait", "it is told of a [lower|higher] own speed")
    OWN_TURNING = (
        TRAITS[1],
        "individual",
        "sd",
        "trait",
        "it is told of a [lower|higher] own turning",
    )


PAPER = SearchEntry.WIND_BACK + 1  # components of the paper
SMALL = SearchEntry.HIT_RIGHT + 1  # of the compact observation
ALIKE = SearchEntry.YAW_RATE + 1  # components where all individuals are alike
REMEMBERING = SearchEntry.SINCE_HIT + 1  # where they perceive their past, too
PAST = (1.0, 3.0, 10.0, 3.0, 10.0, 3.0, 10.0, 10.0)
"""Time constants of those that are means of the past, exponential, from the start of an episode
at rest [s]."""
ODOUR = 2  # components of "odour": the hits of the present step, which tell nothing of the past


def observation_components(
    species: SearchSpecies, fastest: float = 0.0, farthest: float = 0.0
) -> tuple[ObservationComponent, ...]:
    """Return what each entry of an observation means, in order.

    The speed is at most the terminal speed, or ``fastest`` [arena unit / s] if demonstrations are;
    no entry depends on how far out (``farthest``) they lie.
    """
    limit = species.time_limit + 1
    top = max(fastest, *(m.top_speed(species.dt, limit, fastest) for m in species.locomotion))
    scales = species.scales
    stride, own = scales.locomotion[0].thrust * scales.dt, top * max(1.0, scales.own_velocity[0])
    # The largest thrust (velocities that were rounded may give a hair more), or as was recorded.
    largest = min(HARDEST, species.locomotion[0].magnitudes[0] * (1.0 + 1e-6))
    push = HARDEST if fastest > 0.0 or species.sense_scales is not None else largest
    flow, turn = species.flow_limit, math.pi / species.dt
    spans = {
        "speed": (-own, own),
        "angle": (-math.pi, math.pi),
        "share": (0.0, 1.0),
        "unit": (-1.0, 1.0),
        "sum": (0.0, 2.0),
        "flow": (-flow, flow),
        "log speed": (math.log(REST), math.log(top / stride + REST)),
        "push": (-push, push),
        "turn": (-turn, turn),
        "strides": (-top / stride, top / stride),
        "since": (0.0, math.log(2.0 * LONGEST + 1.0)),
        "trait": (-LARGEST, LARGEST),
    }
    every = REMEMBERING if species.senses_past else ALIKE
    first = {"paper": PAPER, COMPACT: SMALL}.get(species.observation, every)
    wanted = list(SearchEntry)[:first]
    if species.observation == "full" and species.traits is not None:
        wanted += [SearchEntry.OWN_SPEED, SearchEntry.OWN_TURNING]
    if species.observation == "odour":
        wanted = [SearchEntry.HIT_LEFT, SearchEntry.HIT_RIGHT]
    return tuple(
        ObservationComponent(label, frame, unit, *spans[span], sign, seen.mirror, description)
        for seen in wanted
        for label, frame, unit, span, description, sign in [seen.component]
    )
