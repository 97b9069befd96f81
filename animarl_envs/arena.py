"""Where animals move: the recorded field, its walls, or the virtual boundary around it."""

import math
import re
from collections.abc import Mapping
from dataclasses import InitVar, dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from animarl_envs.array_types import Bools, Floats
from animarl_envs.errors import InputError
from animarl_envs.settings import (
    Positive,
    PositiveOrInfinite,
    check_fields,
    check_names,
)

ArenaShape = Literal["square", "disc", "open"]
SHAPE_CODES: dict[str, int] = {"square": 0, "disc": 1, "open": 2}
Disc = tuple[float, float, float]
"""X, y and radius [arena unit]."""
STRAIGHT = 1000.0
"""Radius of an obstacle that serves as a straight wall, in sizes of the arena: it bends by half a
thousandth of the size from its middle to its end."""


@dataclass(frozen=True)
class Arena:
    """A field centred on the origin of the arena frame (x to the right, y up).

    Parameters
    ----------
    shape
        ``"square"`` (half side ``size``), ``"disc"`` (radius ``size``) or ``"open"`` (no edge).
    size
        Half side or radius of the recorded field, in arena units. Walls stand here: the centres of
        recorded bodies come as far as this (``docs/data/walls.md``).
    boundary
        Half side or radius beyond which an individual is out of bounds where there are no walls;
        ``inf`` in an open field.
    rebound
        ``False``: leaving the boundary ends the episode with a penalty (the paper's rule).
        ``True``: the field has walls. An individual is held at ``size`` and loses the velocity
        into the wall, while it slides along it freely; nobody ever is out of bounds. Never in an
        open field.
    obstacles
        Discs that nobody enters: x, y and radius of each. They have walls where the field has, and
        in an open field; else they end an episode of an animal that is deeper in one than
        ``1 - size / boundary`` of its radius, or ``boundary - size`` where this is less. A removed
        obstacle is infinitely far. A straight wall is the edge of a very large one.
    landmarks
        Points that individuals perceive by direction and distance: name, x and y of each, or a
        mapping of names to places; a removed landmark is infinitely far.
    inner
        Radius of an obstacle in the middle, which makes a disc a ring; 0 for none.
    """

    shape: ArenaShape = "square"
    size: Positive = 1.0  # [arena unit]
    boundary: PositiveOrInfinite = 1.1  # [arena unit]
    rebound: bool = False
    landmarks: tuple[tuple[str, float, float], ...] = ()
    obstacles: tuple[Disc, ...] = ()
    inner: InitVar[float] = 0.0  # [arena unit]

    def __post_init__(self, inner: float) -> None:
        object.__setattr__(self, "landmarks", _landmarks(self.landmarks))
        middle = [(0.0, 0.0, inner)] if inner else []
        object.__setattr__(self, "obstacles", tuple(map(as_obstacle, [*middle, *self.obstacles])))
        check_fields(self, "arena ")
        if self.shape == "open":
            object.__setattr__(self, "boundary", math.inf)
            object.__setattr__(self, "rebound", False)
        elif self.boundary < self.size:
            raise InputError(
                f"arena boundary {self.boundary!r} lies inside the arena of size {self.size}: "
                "choose a boundary at least as large as the size"
            )
        corner = self.size * math.sqrt(2.0) if self.shape == "square" else self.size
        for x, y, radius in self.obstacles:
            if self.shape != "open" and math.hypot(x, y) + corner <= radius:
                raise InputError(
                    f"an obstacle of radius {radius:g} fills the whole {self.shape} of size "
                    f"{self.size:g}: make it smaller"
                )

    @property
    def edge(self) -> float:
        """How far out an individual may be: the walls, or without them the boundary."""
        return self.size if self.rebound else self.boundary

    @property
    def walled(self) -> bool:
        """Whether something holds individuals: walls, or obstacles in an open field."""
        return self.rebound or (self.shape == "open" and bool(self.obstacles))

    @property
    def holes(self) -> Floats:
        """X, y and radius of each disc that nobody enters, ``(n, 3)`` [arena unit]."""
        holes = np.array(self.obstacles, dtype=np.float64).reshape(-1, 3)
        if not self.walled:
            deep = holes[:, 2] * (1.0 - self.size / self.boundary)
            holes[:, 2] -= np.minimum(deep, self.boundary - self.size)
        return holes

    @property
    def pillars(self) -> list[Disc]:
        """The obstacles that are in place and no straight walls."""
        return [one for one in self.obstacles if math.isfinite(one[0]) and not _is_wall(one)]

    @property
    def corners(self) -> Floats:
        """Corners of a square or polygon in turn, ``(n, 2)``, to draw it."""
        corners = self.size * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
        for x, y, radius in filter(_is_wall, self.obstacles):
            if math.isfinite(x):
                away = np.array([x, y]) / math.hypot(x, y)
                beyond = corners @ away - (math.hypot(x, y) - radius)
                kept = []
                for k, corner in enumerate(corners):
                    if beyond[k - 1] * beyond[k] < 0.0:
                        share = beyond[k] / (beyond[k] - beyond[k - 1])
                        kept.append(corner + share * (corners[k - 1] - corner))
                    if beyond[k] <= 0.0:
                        kept.append(corner)
                corners = np.array(kept)
        return corners

    @property
    def field(self) -> tuple[int, float, float, Floats]:
        """The shape's code, size, boundary and holes, as kernels take them."""
        return SHAPE_CODES[self.shape], float(self.size), float(self.boundary), self.holes

    def scaled(self, size: float) -> "Arena":
        """Return the arena with another size; all that is in it keeps its share of it."""
        boundary, factor = self.boundary / self.size, size / self.size
        landmarks = tuple((name, factor * x, factor * y) for name, x, y in self.landmarks)
        obstacles = tuple((factor * x, factor * y, factor * r) for x, y, r in self.obstacles)
        return replace(
            self, size=size, boundary=size * boundary, landmarks=landmarks, obstacles=obstacles
        )

    def without_landmark(self, name: str) -> "Arena":
        """Return the arena with a landmark so far away that it is not perceived."""
        far = (name, math.inf, math.inf)
        landmarks = tuple(far if one[0] == name else one for one in self.landmarks)
        return replace(self, landmarks=landmarks)

    def without_obstacle(self, obstacle: Disc) -> "Arena":
        """Return the arena with an obstacle so far away that nobody meets it."""
        far = (math.inf, math.inf, obstacle[2])
        obstacles = tuple(far if one == obstacle else one for one in self.obstacles)
        return replace(self, obstacles=obstacles)

    def clearance(self, positions: NDArray[np.floating]) -> Floats:
        """Return the distance of positions ``(..., 2)`` to the nearest obstacle, or infinity."""
        return _clearance(positions, self.obstacles)

    def hold(self, positions: Floats) -> Floats:
        """Return positions ``(..., 2)`` with those outside the walls put to the nearest one."""
        for x, y, radius in self.obstacles:
            if not math.isfinite(x):
                continue
            away = positions - (x, y)
            distance = np.maximum(np.linalg.norm(away, axis=-1, keepdims=True), 1e-12)
            positions = np.where(distance < radius, (x, y) + away * radius / distance, positions)
        if self.shape == "square":
            return np.clip(positions, -self.size, self.size)
        if self.shape == "open":
            return positions
        radius = np.maximum(np.linalg.norm(positions, axis=-1, keepdims=True), 1e-12)
        return np.asarray(positions * np.minimum(1.0, self.size / radius))

    def contains(self, positions: NDArray[np.floating], margin: float = 0.0) -> Bools:
        """Return whether positions ``(..., 2)`` lie within the edge, widened by ``margin``."""
        if self.shape == "square":
            extent = np.abs(positions).max(axis=-1)
        else:
            extent = np.hypot(positions[..., 0], positions[..., 1])
        inside = (extent <= self.edge + margin) | (self.shape == "open")
        return np.asarray(inside & (_clearance(positions, self.holes) >= -margin))

    def free_places(self, half: float) -> Floats:
        """Return those places of a grid over the square of this half side where one may be."""
        line = np.linspace(-half, half, 21)
        places = np.dstack(np.meshgrid(line, line)).reshape(-1, 2)
        return np.asarray(places[self.contains(places)])


def _clearance(positions: NDArray[np.floating], holes: Any) -> Floats:
    clear = np.full(positions.shape[:-1], np.inf)
    for x, y, radius in holes:
        away = np.hypot(positions[..., 0] - x, positions[..., 1] - y)
        clear = np.minimum(clear, away - radius)
    return clear


def _landmarks(given: Any) -> tuple[tuple[str, float, float], ...]:
    """Check landmarks: triples of name, x and y, or places by name; a place may be text ``x,y``."""
    pairs = given.items() if isinstance(given, Mapping) else ((n, place) for n, *place in given)
    landmarks = []
    for name, place in pairs:
        try:
            x, y = map(float, place.split(",") if isinstance(place, str) else place)
        except (TypeError, ValueError):
            raise InputError(
                f"landmark {name!r:.80} is at {place!r:.80}: give x and y in arena units, as 0,1"
            ) from None
        landmarks.append((name, x, y))
    names = [name for name, _, _ in landmarks]
    check_names("arena", "a landmark", names)
    if len(set(names)) < len(names):
        raise InputError(f"landmarks are {', '.join(names)}: give each a name of its own")
    for name in names:
        if not re.fullmatch(r"[\w .-]+", name):
            raise InputError(f"landmark {name!r}: use letters, digits, blanks, points and hyphens")
    return tuple(landmarks)


def as_obstacle(given: Any) -> Disc:
    """Return x, y and radius of an obstacle, which may be a text ``x,y,radius``.

    Raises InputError.
    """
    try:
        x, y, radius = map(float, given.split(",") if isinstance(given, str) else given)
    except (TypeError, ValueError):
        radius = math.nan
    if not 0.0 < radius < math.inf or math.isnan(x + y):
        raise InputError(
            f"obstacle {given!r:.80}: give x, y and a positive radius in arena units, as .2,0,.1"
        )
    return x, y, radius


def _is_wall(obstacle: Disc) -> bool:
    return obstacle[2] > STRAIGHT / 10.0


def format_obstacle(obstacle: Disc) -> str:
    """Return an obstacle as users write it: ``"0.2,0,0.1"``; of a wall where it is nearest."""
    x, y, radius = obstacle
    if _is_wall(obstacle):
        share = 1.0 - radius / math.hypot(x, y)
        return f"wall at {share * x:.3g},{share * y:.3g}"
    return ",".join(f"{value:g}" for value in obstacle)


def parse_shape(text: str) -> tuple[Any, tuple[Disc, ...]]:
    """Return the shape of an arena of size 1, and the obstacles that make a ring or a polygon.

    Raises InputError.
    """
    if text in SHAPE_CODES:
        return text, ()
    kind, _, given = text.partition("=")
    try:
        corners = [tuple(map(float, corner.split(","))) for corner in given.split(";")]
    except ValueError:
        corners = []
    (share, *others), *more = corners or [(math.nan,)]
    if kind == "ring" and not (others or more) and 0.0 <= share < 1.0:
        return "disc", ((0.0, 0.0, share),) * (share > 0.0)
    if kind == "rectangle" and not (others or more) and 0.0 < share < math.inf:
        x, y = min(1.0, 1.0 / share), min(1.0, share)
        return "square", _walls(np.array([[x, y], [-x, y], [-x, -y], [x, -y]]))
    if kind == "polygon" and len(corners) > 2 and {len(corner) for corner in corners} == {2}:
        return "square", _walls(np.array(corners))
    raise InputError(
        f"arena is {text!r:.80}: choose square, disc, open, ring=0.6 (the radius of its hole as a "
        "share of its own), rectangle=0.5 (its height as a share of its width) or a polygon by its "
        "corners, such as 'polygon=-1,-1;1,-1;0,1'"
    )


def _walls(corners: Floats) -> tuple[Disc, ...]:
    """Return obstacles along the sides of a polygon, but for those of the square.

    ``corners`` are ``(n, 2)`` [arena sizes]. Raises InputError unless it is convex and around the
    middle, and within the square.
    """
    sides = np.roll(corners, -1, axis=0) - corners
    lengths = np.hypot(*sides.T)
    outwards = np.stack([sides[:, 1], -sides[:, 0]], axis=1) / np.maximum(lengths, 1e-12)[:, None]
    reach = (outwards * corners).sum(axis=1)
    outwards, reach = (outwards, reach) if (reach > 0).all() else (-outwards, -reach)
    behind = (corners @ outwards.T - reach).max() > 1e-9
    if behind or not (reach > 0).all() or np.abs(corners).max() > 1.0:
        raise InputError(
            "the corners of a polygon arena: give them in turn, between -1 and 1 from the middle, "
            "which lies inside, without a corner that points inwards"
        )
    on_square = np.minimum(np.abs(outwards).max(axis=1), reach) > 1.0 - 1e-9
    middles = corners + sides / 2 + STRAIGHT * outwards
    return tuple((x, y, STRAIGHT) for x, y in middles[~on_square].tolist())
