"""The table of what the individuals of a chase observe.

The kernel of :mod:`animarl_envs.worlds.chase.senses` writes the groups of this table, each where
:func:`first_rows` says; observation spaces, documentation and mirror images are read from it too.

``observation="full"`` holds what simulators were found to need; ``"paper"`` the components of the
paper, of which three are constant or copies, as the frame points at the focus.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from enum import IntEnum
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from animarl_envs.species import ChaseSpecies
from animarl_envs.worlds.base import ObservationComponent

ARENA, EGO = "arena", "egocentric, x towards the focus, y to the left"
WALL = "of the nearest wall, x outwards"
LENGTH, SPEED = "arena unit", "arena unit / s"
FULL, PAPER = "full", "paper"
COMPASS = "senses_compass"
REST = 0.3  # added to the speed [u dt] before its logarithm is taken
HARDEST = 4.0  # accelerations are seen up to so many times the thrust
NEAR = 0.1  # added to distances before they are inverted [arena size]
PAST = (2, 6)  # velocities before the present one are averaged over so many steps, exponentially
HARMONICS = (2, 3, 4)  # of a direction, where it is seen as finely as actions divide the circle
FAINT = 0.1  # a vector of this length [u dt, or u] counts half in its direction
BODY, REACH = 0.03, 0.1  # distances kept by animals that follow a wall [arena size]


class Group(NamedTuple):
    """Entries that the kernel writes together, one below the other.

    ``entries`` are names and their signs in a mirrored world. ``range`` names an entry of
    :func:`ranges`. ``seen`` lists the observations that hold the group; ``of_focus`` says whether
    the full one holds it for the focus too, which lies straight ahead by definition,
    ``of_walls`` whether only a field with walls has it, and ``sense`` the field of a species
    that must be true, but for the paper's observation.
    """

    entries: tuple[tuple[str, float], ...]
    frame: str
    unit: str
    range: str
    seen: tuple[str, ...] = (FULL,)
    of_focus: bool = True
    of_walls: bool = False
    sense: str = ""


def _pair(first: str, second: str) -> tuple[tuple[str, float], ...]:
    """Two entries of which a mirror turns the second round."""
    return (first, 1.0), (second, -1.0)


def _plane(name: str) -> tuple[tuple[str, float], ...]:
    return _pair(f"{name} x", f"{name} y")


def _ahead_left(name: str) -> tuple[tuple[str, float], ...]:
    return _pair(f"{name} ahead", f"{name} left")


def _out_along(name: str) -> tuple[tuple[str, float], ...]:
    return _pair(f"{name} outwards", f"{name} along")


def _circle(name: str) -> tuple[tuple[str, float], ...]:
    return _pair(f"{name} cosine", f"{name} sine")


def _harmonics(vector: str) -> tuple[tuple[str, float], ...]:
    """A direction by its harmonics, as the kernel ``_observe_direction`` writes it."""
    return tuple(entry for k in HARMONICS for entry in _circle(f"{vector} harmonic {k}"))


def _fine(velocity: str, sense: str = "") -> Group:
    return Group(_ahead_left(f"tanh of {velocity} / (u dt)"), EGO, "1", "fine", sense=sense)


def _coarse(velocity: str, sense: str = "") -> Group:
    return Group(_ahead_left(f"tanh of {velocity} / (3 u dt)"), EGO, "1", "coarse", sense=sense)


def _log(speed: str, sense: str = "") -> Group:
    name = f"log of ({speed} / (u dt) + 0.3)"
    return Group(((name, 1.0),), "any", "1", "log speed", sense=sense)


_SHORT, _LONG = (f"mean velocity over {over} steps" for over in PAST)


class Seen(IntEnum):
    """The groups of an observation in its order: columns of :func:`first_rows`.

    Where velocities are measured by it, u is the smallest of the individual's thrusts: how an
    animal rests shows among velocities that no larger one could bring to a stop. The others
    stand in order: the last individual first (the target, or a lone pursuer), then the others by
    distance; the first is the focus. Of the arena, the paper's observation holds something if the
    species senses it, the full one if there is an edge, and where it stands if that is a wall.
    """

    group: Group

    def __new__(cls, *group: Any) -> Seen:
        member = int.__new__(cls, len(cls.__members__))
        member._value_, member.group = len(cls.__members__), Group(*group)
        return member

    # The individual itself
    POSITION = Group(_plane("own position"), ARENA, LENGTH, "place", (PAPER, FULL), sense=COMPASS)
    VELOCITY = Group(_ahead_left("own velocity"), EGO, SPEED, "own speed", (PAPER, FULL))
    PLANE_VELOCITY = Group(_plane("own velocity"), ARENA, SPEED, "own speed", sense=COMPASS)
    FINE = _fine("own velocity")
    COARSE = _coarse("own velocity")
    LOG_SPEED = _log("own speed")
    ACCELERATION = Group(_ahead_left("own acceleration / u"), EGO, "1", "acceleration")
    FOCUS = Group(_circle("focus direction"), ARENA, "1", "unit", (PAPER, FULL), sense=COMPASS)
    TIME = Group(
        (("log of (1 + steps since the start)", 1.0),), "any", "1", "log steps", sense="senses_time"
    )
    FINE_SHORT = _fine(_SHORT, "senses_past")
    COARSE_SHORT = _coarse(_SHORT, "senses_past")
    LOG_SHORT = _log(_SHORT, "senses_past")
    FINE_LONG = _fine(_LONG, "senses_past")
    COARSE_LONG = _coarse(_LONG, "senses_past")
    LOG_LONG = _log(_LONG, "senses_past")
    HEADING = Group(_circle("own heading"), EGO, "1", "unit", sense="senses_heading")
    COURSE = Group(_harmonics("own velocity"), EGO, "1", "unit", sense="senses_course")
    PUSH = Group(_harmonics("own acceleration"), EGO, "1", "unit", sense="senses_course")
    # Each other individual
    PLACE = Group(
        _ahead_left("relative position"), EGO, LENGTH, "offset", (PAPER, FULL), of_focus=False
    )
    DRIFT = Group(_ahead_left("relative velocity"), EGO, SPEED, "difference", (PAPER, FULL))
    DISTANCE = Group((("distance", 1.0),), "any", LENGTH, "distance", (PAPER, FULL))
    BEARING = Group((("bearing", -1.0),), EGO, "rad", "angle", (PAPER,))
    NEARNESS = Group(
        (("inverse of (distance + 0.1 size)", 1.0),), "any", "1 / arena unit", "nearness"
    )
    BEARING_CIRCLE = Group(_circle("bearing"), EGO, "1", "unit", of_focus=False)
    OTHER_POSITION = Group(_plane("position"), ARENA, LENGTH, "place", sense=COMPASS)
    OTHER_VELOCITY = Group(_plane("velocity"), ARENA, SPEED, "speed", sense=COMPASS)
    OFFSET = Group(_plane("difference"), ARENA, LENGTH, "offset", sense=COMPASS)
    DIRECTION = Group(_circle("direction"), ARENA, "1", "unit", of_focus=False, sense=COMPASS)
    OTHER_HEADING = Group(_circle("heading"), EGO, "1", "unit", sense="senses_heading")
    # The arena
    CENTRE_DISTANCE = Group((("distance from the centre", 1.0),), ARENA, LENGTH, "radius", (PAPER,))
    EDGE = Group((("distance to the edge", 1.0),), ARENA, LENGTH, "inside")
    CENTRE = Group(_ahead_left("centre of the arena"), EGO, LENGTH, "centre")
    AT_WALL = Group(
        (("tanh of distance to the wall / (0.03 size)", 1.0),), WALL, "1", "at wall", of_walls=True
    )
    BY_WALL = Group(
        (("tanh of distance to the wall / (0.1 size)", 1.0),), WALL, "1", "by wall", of_walls=True
    )
    WALL_CIRCLE = Group(_circle("direction of the wall"), EGO, "1", "unit", of_walls=True)
    FINE_WALL = Group(_out_along("tanh of own velocity / (u dt)"), WALL, "1", "fine", of_walls=True)
    COARSE_WALL = Group(
        _out_along("tanh of own velocity / (3 u dt)"), WALL, "1", "coarse", of_walls=True
    )


ABSENT = -1


def rows(species: ChaseSpecies) -> Iterator[tuple[int, Seen, Group]]:
    """The groups of an observation in order: whose (0 itself, 1 the focus, ...), which, group."""
    kind = species.observation
    senses_field = species.senses_centre if kind == PAPER else species.arena.shape != "open"

    def held(first: Seen, end: int) -> Iterator[tuple[Seen, Group]]:
        for seen in list(Seen)[first:end]:
            sense = seen.group.sense
            if kind in seen.group.seen and (kind == PAPER or not sense or getattr(species, sense)):
                yield seen, seen.group

    for seen, group in held(Seen.POSITION, Seen.PLACE):
        yield 0, seen, group
    for rank in range(1, species.num_individuals):
        for seen, group in held(Seen.PLACE, Seen.CENTRE_DISTANCE):
            if rank > 1 or group.of_focus or kind == PAPER:
                yield rank, seen, group
    for seen, group in held(Seen.CENTRE_DISTANCE, len(Seen)):
        if senses_field and (species.arena.rebound or not group.of_walls):
            yield 0, seen, group


def past_scales(species: ChaseSpecies) -> int:
    """How many averages of past velocities are seen."""
    return len(PAST) if species.senses_past and species.observation == FULL else 0


def first_rows(species: ChaseSpecies) -> NDArray[np.int64]:
    """Where each group begins in an observation: ``(individuals, groups)``, ``ABSENT`` where not.

    The first row is of the individual itself and the arena, the following of the others in order.
    """
    first = np.full((species.num_individuals, len(Seen)), ABSENT, dtype=np.int64)
    end = 0
    for rank, seen, group in rows(species):
        first[rank, seen] = end
        end += len(group.entries)
    return first


def observation_components(
    species: ChaseSpecies, fastest: float = 0.0, farthest: float = 0.0
) -> tuple[ObservationComponent, ...]:
    """What each entry of an observation means, in order.

    Its range follows from the edge of the arena and from the top speed: the terminal speed of the
    fastest individual. Demonstrations may be faster, ``fastest`` [arena unit / s], and lie
    farther out, ``farthest`` [arena unit].
    """
    spans = ranges(species, fastest, farthest)
    return tuple(
        ObservationComponent(
            f"other {rank} {name}" if rank else name,
            group.frame, group.unit, *spans[group.range], sign=sign,
        )
        for rank, _, group in rows(species)
        for name, sign in group.entries
    )  # fmt: skip


def ranges(
    species: ChaseSpecies, fastest: float, farthest: float
) -> dict[str, tuple[float, float]]:
    """Lowest and highest values, by the name that the groups have for them."""
    arena, limit = species.arena, species.time_limit + 1
    top = max(fastest, *(m.top_speed(species.dt, limit, fastest) for m in species.locomotion))
    # A step beyond at the end, unless walls hold; in the open as far as an episode leads.
    steps = limit if arena.shape == "open" else 0 if arena.rebound else 1
    start = arena.size if arena.shape == "open" else arena.edge
    reach = max(start + top * species.dt * steps, farthest)
    round_field = arena.shape == "disc" and species.observation == FULL  # saved spaces keep theirs
    radius = reach if round_field else math.sqrt(2.0) * reach
    apart = 2.0 * radius
    scales = species.scales
    strides = [m.smallest_thrust * scales.dt for m in scales.locomotion]
    relative = top / min(strides)
    fine, coarse = math.tanh(relative), math.tanh(relative / 3.0)
    near = NEAR * scales.arena_size
    own = top * max(1.0, *scales.own_velocity)
    push = _hardest(species, fastest)
    return {
        "place": (-reach, reach),
        "speed": (-top, top),
        "own speed": (-own, own),
        "fine": (-fine, fine),
        "coarse": (-coarse, coarse),
        "log speed": (math.log(REST), math.log(relative + REST)),
        "acceleration": (-push, push),
        "unit": (-1.0, 1.0),
        "log steps": (0.0, math.log(1.0 + scales.time_limit)),
        "offset": (-apart, apart),
        "difference": (-2.0 * top, 2.0 * top),
        "distance": (0.0, apart),
        "angle": (-math.pi, math.pi),
        "nearness": (1.0 / (apart + near), 1.0 / near),
        "radius": (0.0, radius),
        "inside": (inside := (min(0.0, arena.edge - reach), arena.edge)),
        "at wall": _squashed(inside, BODY * scales.arena_size),
        "by wall": _squashed(inside, REACH * scales.arena_size),
        "centre": (-radius, radius),
    }


def _squashed(span: tuple[float, float], scale: float) -> tuple[float, float]:
    return math.tanh(span[0] / scale), math.tanh(span[1] / scale)


def _hardest(species: ChaseSpecies, fastest: float) -> float:
    """How large an acceleration is seen [u]: a thrust, a stop at a wall, or any if recorded."""
    if fastest > 0.0 or species.sense_scales is not None:
        return HARDEST
    pushes = []
    for own in species.locomotion:
        stop = 0.0
        if species.arena.rebound:
            top = own.top_speed(species.dt, species.time_limit + 1)
            stop = (1.0 - own.damping) * top / (own.thrust * species.dt)
        pushes.append(math.hypot(own.magnitudes[0], stop))
    return min(HARDEST, max(pushes) * (1.0 + 1e-6))  # rounded velocities may give a hair more
