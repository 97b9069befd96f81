"""The table of what the individuals of a chase observe.

The kernel of :mod:`animarl_envs.worlds.chase.senses` writes the groups of this table, each where
:func:`first_rows` says; observation spaces, documentation and mirror images are read from it too.

``observation="compact"`` holds the own motion, the others and the arena, each once; ``"full"`` what
simulators were found to need; ``"paper"`` the components of the paper, of which three are constant
or copies, as the frame points at the focus.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from enum import IntEnum
from typing import Any, NamedTuple

import numpy as np

from animarl_envs.array_types import Floats, Ints
from animarl_envs.focus import COURSE, share_of
from animarl_envs.locomotion import residual
from animarl_envs.species import COMPACT, ChaseSpecies
from animarl_envs.species.traits import LARGEST, TRAITS
from animarl_envs.worlds.base import ObservationComponent

ARENA, EGO = "arena", "egocentric, x towards the focus, y to the left"
WALL = "of the nearest wall, x outwards"
LENGTH, SPEED = "arena unit", "arena unit / s"
FULL, PAPER = "full", "paper"
COMPASS = "senses_compass"
REST = 0.3  # added to the speed [u dt] before its logarithm is taken
HARDEST = 4.0  # accelerations are seen up to so many times the thrust
NEAR = 0.1  # added to distances before they are inverted [arena size]
PAST = (2, 6)
"""Steps over which velocities before the present one are averaged, exponentially."""
MEMORY = (0.5, COURSE, 5.0, 20.0)
"""The same of free animals, which would forget where they were going [s]: of their velocity, of how
their course turns, and of their speed."""
DELAYS, DELAY = 8, 0.1
"""A delay line of a free animal's speed holds the phase of a rhythm, such as that of a larva's
strides, which averages do not: so many exponential means in a row, each over so long of the one
before [s] (the gamma memory of de Vries & Principe 1992, Neural Networks 5, 565)."""
HARMONICS = (2, 3, 4)  # of a direction, where it is seen as finely as actions divide the circle
FAINT = 0.1  # a vector of this length [u dt, or u] counts half in its direction
BODY, REACH = 0.03, 0.1  # distances kept by animals that follow a wall [arena size]
WAYS = {
    "ahead": "[backwards|forwards]",
    "left": "to the [right|left]",
    "x": "to the [left|right]",
    "y": "[downwards|upwards]",
    "outwards": "[away from|towards] the wall",
    "along": "along the wall",
}
"""How an individual moves, where this entry of a velocity is [below|above] the usual ones."""
SIDES = {
    "ahead": "[behind|ahead of] it",
    "left": "to the [right|left] of it",
    "x": "to the [left|right] of it",
    "y": "[below|above] it",
}
"""Where something is, likewise."""


class GroupSpec(NamedTuple):
    """Entries that the kernel writes together, one below the other.

    ``names`` lists entries; ``{a|b}`` stands for two, of which a mirrored world turns the second
    round, as it does one that begins with ``-``. ``range`` names an entry of :func:`ranges`.
    ``seen`` lists the observations that hold the group; ``of_focus`` says whether the full one
    holds it for the focus too, which lies straight ahead by definition, ``of_walls`` whether only a
    field with walls has it, and ``sense`` the field of a species that must be true, but for the
    paper's observation. ``description`` is that of an
    :class:`~animarl_envs.worlds.base.ObservationComponent`: of the individual ``{who}``, with
    ``{way}`` and ``{side}`` of each direction, and the ``{name}`` of the entry.
    """

    names: tuple[str, ...] | str
    frame: str
    unit: str
    range: str
    description: str
    seen: tuple[str, ...] = (FULL,)
    of_focus: bool = True
    of_walls: bool = False
    sense: str = ""

    @property
    def entries(self) -> list[tuple[str, float, str]]:
        """Names, their signs in a mirrored world, and directions; empty for none."""
        entries = []
        for name in [self.names] if isinstance(self.names, str) else self.names:
            head, two, rest = name.partition("{")
            pair, _, tail = rest.partition("}")
            if two:
                first, _, second = pair.partition("|")
                entries += [(head + first + tail, 1.0, first), (head + second + tail, -1.0, second)]
            else:
                entries.append((name.removeprefix("-"), -1.0 if name.startswith("-") else 1.0, ""))
        return entries

    def describe(self, subject: str, name: str, direction: str) -> str:
        """Return the description of an entry of the individual, another or a landmark."""
        return (
            self.description.replace("{who}", subject)
            .replace("{name}", name)
            .replace("{way}", WAYS.get(direction, ""))
            .replace("{side}", SIDES.get(direction, ""))
        )


def _directions(vector: str) -> tuple[str, ...]:
    """Return names of a direction's harmonics, in the order of ``_observe_direction``."""
    return tuple(f"{vector} harmonic {k} {{cosine|sine}}" for k in HARMONICS)


def _scaled(velocity: str, speed: str, moves: str, fast: str, sense: str = "") -> list[GroupSpec]:
    """Return the groups of a velocity on three scales: fine, coarse, logarithm of the speed."""
    return [
        GroupSpec(
            f"tanh of {velocity} / (u dt) {{ahead|left}}", EGO, "1", "fine", moves, sense=sense
        ),
        GroupSpec(
            f"tanh of {velocity} / (3 u dt) {{ahead|left}}", EGO, "1", "coarse", moves, sense=sense
        ),
        GroupSpec(f"log of ({speed} / (u dt) + 0.3)", "any", "1", "log speed", fast, sense=sense),
    ]


def _averaged(over: str, sense: str) -> list[GroupSpec]:
    """Return the groups of the velocity averaged over some time."""
    mean = f"mean velocity over {over}"
    lately = f"over the last {over} {{who}}"
    fast = f"{lately} was [slower|faster]"
    return _scaled(mean, mean, f"{lately} moved {{way}} faster", fast, sense)


_OWN = _scaled("own velocity", "own speed", "{who} moves {way} faster", "{who} is [slower|faster]")
_SHORT, _LONG = (_averaged(f"{over} steps", "senses_steps") for over in PAST)
_MEMORY = [
    group
    for over in MEMORY
    for group in (
        *_averaged(f"{over:g} s", "free"),
        GroupSpec(
            f"-mean turn of the course over {over:g} s",
            "any",
            "rad / s",
            "turn",
            f"over the last {over:g} s {{who}} turned [right|left] faster",
            sense="free",
        ),
        GroupSpec(
            f"log of (mean speed over {over:g} s / (u dt) + 0.3)",
            "any",
            "1",
            "log speed",
            f"over the last {over:g} s {{who}} was [slower|faster]",
            sense="free",
        ),
    )
]
RECALLED = len(_MEMORY) // len(MEMORY)  # groups of each time
_BOTH, _ALWAYS, _SMALL = (PAPER, FULL), (COMPACT, PAPER, FULL), (COMPACT, FULL)
_WALL = "tanh of distance to the wall /"
_MOVES = "{who} moves {way} faster"
_ELSEWHERE = "{who} is in another direction"
_POINTS = "{who} points in another direction"
_PLACED = "{who} is farther {way} in the arena"
_BESIDE = "{who} is farther {side}"
_NEAR_WALL = "{who} is [nearer to|farther from] the wall"


class ChaseGroup(IntEnum):
    """The groups of an observation in its order: columns of :func:`first_rows`.

    Where velocities are measured by it, u is the smallest of the individual's thrusts: how an
    animal rests shows among velocities that no larger one could bring to a stop. The others
    stand in order: the last individual first (the target, or a lone pursuer), then the others by
    distance; the first is the focus. Of the arena, the paper's observation holds something if the
    species senses it, the full one if there is an edge, and where it stands if that is a wall.
    """

    group: GroupSpec

    def __new__(cls, *group: Any) -> ChaseGroup:
        """Make a member numbered in order, with its :class:`GroupSpec`."""
        member = int.__new__(cls, len(cls.__members__))
        member._value_, member.group = len(cls.__members__), GroupSpec(*group)
        return member

    # The individual itself
    POSITION = GroupSpec(
        "own position {x|y}", ARENA, LENGTH, "place", _PLACED, _BOTH, sense=COMPASS
    )
    VELOCITY = GroupSpec("own velocity {ahead|left}", EGO, SPEED, "own speed", _MOVES, _ALWAYS)
    PLANE_VELOCITY = GroupSpec(
        "own velocity {x|y}", ARENA, SPEED, "own speed", _MOVES, sense=COMPASS
    )
    FINE, COARSE, LOG_SPEED = _OWN
    ACCELERATION = GroupSpec(
        "own acceleration / u {ahead|left}",
        EGO,
        "1",
        "acceleration",
        "{who} pushes {way} harder",
        _SMALL,
    )
    FOCUS = GroupSpec(
        "focus direction {cosine|sine}",
        ARENA,
        "1",
        "unit",
        "what {who} faces is in another direction",
        _BOTH,
        sense=COMPASS,
    )
    TIME = GroupSpec(
        "log of (1 + steps since the start)",
        "any",
        "1",
        "log steps",
        "the episode lasts [shorter|longer]",
        sense="senses_time",
    )
    FINE_SHORT, COARSE_SHORT, LOG_SHORT = _SHORT
    FINE_LONG, COARSE_LONG, LOG_LONG = _LONG
    FINE_MEMORY, COARSE_MEMORY, LOG_MEMORY, TURN_MEMORY, SPEED_MEMORY = _MEMORY[:RECALLED]
    _F1, _C1, _L1, _T1, _S1 = _MEMORY[RECALLED : 2 * RECALLED]
    _F2, _C2, _L2, _T2, _S2 = _MEMORY[2 * RECALLED : 3 * RECALLED]
    _F3, _C3, _L3, _T3, _S3 = _MEMORY[3 * RECALLED :]
    DELAYED_SPEED = GroupSpec(
        tuple(f"log of (speed {k + 1} delays ago / (u dt) + 0.3)" for k in range(DELAYS)),
        "any",
        "1",
        "log speed",
        "in the last second or so {who} was [slower|faster]",
        sense="free",
    )
    OWN_TRAITS = GroupSpec(
        TRAITS,
        "individual",
        "sd",
        "trait",
        "{who} is told of a [lower|higher] {name}",
        sense="traits",
    )
    HEADING = GroupSpec(
        "own heading {cosine|sine}", EGO, "1", "unit", _POINTS, sense="senses_heading"
    )
    COURSE = GroupSpec(
        _directions("own velocity"),
        EGO,
        "1",
        "unit",
        "{who} moves in another direction",
        sense="senses_course",
    )
    PUSH = GroupSpec(
        _directions("own acceleration"),
        EGO,
        "1",
        "unit",
        "{who} pushes in another direction",
        sense="senses_course",
    )
    # Each other individual
    PLACE = GroupSpec(
        "relative position {ahead|left}", EGO, LENGTH, "offset", _BESIDE, _ALWAYS, of_focus=False
    )
    DRIFT = GroupSpec(
        "relative velocity {ahead|left}",
        EGO,
        SPEED,
        "difference",
        "seen from it, {who} moves {way} faster",
        _ALWAYS,
    )
    DISTANCE = GroupSpec(
        "distance", "any", LENGTH, "distance", "{who} is [nearer|farther]", _ALWAYS
    )
    BEARING = GroupSpec("-bearing", EGO, "rad", "angle", _ELSEWHERE, (PAPER,))
    NEARNESS = GroupSpec(
        "inverse of (distance + 0.1 size)",
        "any",
        "1 / arena unit",
        "nearness",
        "{who} is [farther|nearer]",
    )
    BEARING_CIRCLE = GroupSpec(
        "bearing {cosine|sine}", EGO, "1", "unit", _ELSEWHERE, of_focus=False
    )
    OTHER_POSITION = GroupSpec("position {x|y}", ARENA, LENGTH, "place", _PLACED, sense=COMPASS)
    OTHER_VELOCITY = GroupSpec("velocity {x|y}", ARENA, SPEED, "speed", _MOVES, sense=COMPASS)
    OFFSET = GroupSpec("difference {x|y}", ARENA, LENGTH, "offset", _BESIDE, sense=COMPASS)
    DIRECTION = GroupSpec(
        "direction {cosine|sine}", ARENA, "1", "unit", _ELSEWHERE, of_focus=False, sense=COMPASS
    )
    OTHER_HEADING = GroupSpec(
        "heading {cosine|sine}", EGO, "1", "unit", _POINTS, sense="senses_heading"
    )
    # The arena
    CENTRE_DISTANCE = GroupSpec(
        "distance from the centre",
        ARENA,
        LENGTH,
        "radius",
        "{who} is [nearer to|farther from] the centre",
        (PAPER,),
    )
    EDGE = GroupSpec(
        "distance to the edge",
        ARENA,
        LENGTH,
        "inside",
        "{who} is [nearer to|farther from] the edge",
        _SMALL,
    )
    CENTRE = GroupSpec(
        "centre of the arena {ahead|left}",
        EGO,
        LENGTH,
        "centre",
        "the centre of the arena is farther {side}",
        _SMALL,
    )
    AT_WALL = GroupSpec(f"{_WALL} (0.03 size)", WALL, "1", "at wall", _NEAR_WALL, of_walls=True)
    BY_WALL = GroupSpec(f"{_WALL} (0.1 size)", WALL, "1", "by wall", _NEAR_WALL, of_walls=True)
    WALL_CIRCLE = GroupSpec(
        "direction of the wall {cosine|sine}",
        EGO,
        "1",
        "unit",
        "the wall is in another direction",
        of_walls=True,
    )
    FINE_WALL = GroupSpec(
        "tanh of own velocity / (u dt) {outwards|along}", WALL, "1", "fine", _MOVES, of_walls=True
    )
    COARSE_WALL = GroupSpec(
        "tanh of own velocity / (3 u dt) {outwards|along}",
        WALL,
        "1",
        "coarse",
        _MOVES,
        of_walls=True,
    )
    # Each landmark
    LANDMARK_CIRCLE = GroupSpec(
        "bearing {cosine|sine}", EGO, "1", "unit", "{who} is in another direction", _ALWAYS
    )
    LANDMARK_DISTANCE = GroupSpec(
        "tanh of distance / size",
        "any",
        "1",
        "unit",
        "{who} is [nearer|farther]",
        _ALWAYS,
    )


ABSENT = -1


def rows(species: ChaseSpecies) -> Iterator[tuple[int, ChaseGroup, GroupSpec]]:
    """Yield the groups of an observation in order: rank, key, group.

    Ranks are 0 for itself, 1 for the focus, from 2 on for others, and -1, -2, ... for landmarks.
    """
    kind = species.observation
    senses_field = species.senses_centre if kind == PAPER else species.arena.shape != "open"

    def held(first: ChaseGroup, end: int) -> Iterator[tuple[ChaseGroup, GroupSpec]]:
        for seen in list(ChaseGroup)[first:end]:
            sense = seen.group.sense
            if kind in seen.group.seen and (kind == PAPER or not sense or getattr(species, sense)):
                yield seen, seen.group

    for seen, group in held(ChaseGroup.POSITION, ChaseGroup.PLACE):
        yield 0, seen, group
    for rank in range(1, 1 + species.num_seen):
        for seen, group in held(ChaseGroup.PLACE, ChaseGroup.CENTRE_DISTANCE):
            if rank > 1 or species.free or group.of_focus or kind == PAPER:
                yield rank, seen, group
    for seen, group in held(ChaseGroup.CENTRE_DISTANCE, ChaseGroup.LANDMARK_CIRCLE):
        if species.arena.walled and kind != PAPER if group.of_walls else senses_field:
            yield 0, seen, group
    for k in range(len(species.arena.landmarks)):
        for seen, group in held(ChaseGroup.LANDMARK_CIRCLE, len(ChaseGroup)):
            yield -1 - k, seen, group


def past_scales(species: ChaseSpecies) -> int:
    """Return the number of averages of the past.

    Free animals have those of velocity, then turn and speed, then pairs of delayed speeds.
    """
    if species.free:
        return 2 * len(MEMORY) + DELAYS // 2
    return len(PAST) if species.senses_steps and species.observation == FULL else 0


def past_shares(species: ChaseSpecies) -> Floats:
    """Return the share of a step in each average; of free animals the last is of each delay."""
    if species.free:
        return np.array([share_of(seconds, species.dt) for seconds in (*MEMORY, DELAY)])
    return 1.0 / np.array(PAST)


def first_rows(species: ChaseSpecies) -> Ints:
    """Return the row where each group begins, ``(individuals, groups)``, or ``ABSENT``.

    The first row is of the individual itself and the arena, the following of the others in order,
    and the last ones of landmarks, backwards.
    """
    things = 1 + species.num_seen + len(species.arena.landmarks)
    first = np.full((things, len(ChaseGroup)), ABSENT, dtype=np.int64)
    end = 0
    for rank, seen, group in rows(species):
        first[rank, seen] = end
        end += len(group.entries)
    return first


def observation_components(
    species: ChaseSpecies, fastest: float = 0.0, farthest: float = 0.0
) -> tuple[ObservationComponent, ...]:
    """Return what each entry of an observation means, in order.

    Its range follows from the edge of the arena and from the top speed: the terminal speed of the
    fastest individual. Demonstrations may be faster, ``fastest`` [arena unit / s], and lie
    farther out, ``farthest`` [arena unit].
    """
    spans, landmarks = ranges(species, fastest, farthest), species.arena.landmarks

    def subject(rank: int) -> tuple[str, str]:
        """Return how names of entries begin, and what is described."""
        if rank < 0:
            return f"{landmarks[-1 - rank][0]} ", landmarks[-1 - rank][0]
        return (f"other {rank} ", f"{{{rank}}}") if rank else ("", "it")

    return tuple(
        ObservationComponent(
            subject(rank)[0] + name,
            group.frame,
            group.unit,
            *spans[group.range],
            sign=sign,
            description=group.describe(subject(rank)[1], name, direction),
        )
        for rank, _, group in rows(species)
        for name, sign, direction in group.entries
    )


def ranges(
    species: ChaseSpecies, fastest: float, farthest: float
) -> dict[str, tuple[float, float]]:
    """Return lowest and highest values, by the name that the groups have for them."""
    arena, limit = species.arena, species.time_limit + 1
    top = max(fastest, *(m.top_speed(species.dt, limit, fastest) for m in species.locomotion))
    # A step beyond at the end, unless walls hold; in the open as far as an episode leads.
    steps = limit if arena.shape == "open" else 0 if arena.rebound else 1
    start = arena.size if arena.shape == "open" else arena.edge
    reach = max(start + top * species.dt * steps, farthest)
    round_field = arena.shape == "disc" and species.observation != PAPER  # saved spaces keep theirs
    radius = reach if round_field else math.sqrt(2.0) * reach
    scales = species.scales
    relative = top / min(m.smallest_thrust * scales.dt for m in scales.locomotion)
    # Straight walls are huge obstacles; nobody comes deeper into one than across the field.
    near = NEAR * scales.arena_size
    deepest = max(np.minimum(arena.holes[:, 2], 2.0 * radius), default=0.0)
    inside = min(0.0 - deepest, arena.edge - reach)
    at_wall, by_wall = (
        (math.tanh(inside / scale), math.tanh(arena.edge / scale))
        for scale in (BODY * scales.arena_size, REACH * scales.arena_size)
    )
    push = HARDEST  # a thrust, a stop at a wall, or any if recorded [u]
    bounded = species.locomotion[0].course_time is None  # cells change a velocity at will
    if bounded and fastest <= 0.0 and species.sense_scales is None:
        hardest = 0.0
        for own in species.locomotion:
            speed = own.top_speed(species.dt, limit) if arena.walled else 0.0
            stop = -residual(0.0, speed, own.damping) / (own.thrust * species.dt)
            hardest = max(hardest, math.hypot(own.magnitudes[0], stop))
        push = min(HARDEST, hardest * (1.0 + 1e-6))  # rounded velocities may give a hair more
    around = {
        "place": reach,
        "speed": top,
        "own speed": top * max(1.0, *scales.own_velocity),
        "fine": math.tanh(relative),
        "coarse": math.tanh(relative / 3.0),
        "acceleration": push,
        "unit": 1.0,
        "offset": 2.0 * radius,
        "difference": 2.0 * top,
        "angle": math.pi,
        "centre": radius,
        "turn": math.pi / species.dt,
        "trait": LARGEST,
    }
    return {name: (-most, most) for name, most in around.items()} | {
        "log speed": (math.log(REST), math.log(relative + REST)),
        "log steps": (0.0, math.log(1.0 + scales.time_limit)),
        "distance": (0.0, 2.0 * radius),
        "nearness": (1.0 / (2.0 * radius + near), 1.0 / near),
        "radius": (0.0, radius),
        "inside": (inside, arena.edge),
        "at wall": at_wall,
        "by wall": by_wall,
    }
