"""Where animals move: the recorded field, its walls, or the virtual boundary around it."""

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from animarl_envs.array_types import Bools
from animarl_envs.errors import InputError
from animarl_envs.settings import (
    NotNegative,
    Positive,
    PositiveOrInfinite,
    check_fields,
    check_names,
)

ArenaShape = Literal["square", "disc", "open"]
SHAPE_CODES: dict[str, int] = {"square": 0, "disc": 1, "open": 2}


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
    inner
        Radius of the hole in the middle of a disc, which makes it a ring; 0 for none. The hole has
        walls where the field has; else it ends the episode from ``inner * size / boundary`` on.
    landmarks
        Points that individuals perceive by direction and distance: name, x and y of each, or a
        mapping of names to places; a removed landmark is infinitely far.
    """

    shape: ArenaShape = "square"
    size: Positive = 1.0  # [arena unit]
    boundary: PositiveOrInfinite = 1.1  # [arena unit]
    rebound: bool = False
    inner: NotNegative = 0.0  # [arena unit]
    landmarks: tuple[tuple[str, float, float], ...] = ()

    def __post_init__(self) -> None:
        check_fields(self, "arena ")
        object.__setattr__(self, "landmarks", _landmarks(self.landmarks))
        if self.shape == "open":
            object.__setattr__(self, "boundary", math.inf)
            object.__setattr__(self, "rebound", False)
        elif self.boundary < self.size:
            raise InputError(
                f"arena boundary {self.boundary!r} lies inside the arena of size {self.size}: "
                "choose a boundary at least as large as the size"
            )
        if self.inner and (self.shape != "disc" or self.inner >= self.size):
            raise InputError(
                f"arena inner is {self.inner} in a {self.shape} of size {self.size}: only a disc "
                "has a hole, and its radius is below the disc's"
            )

    @property
    def edge(self) -> float:
        """How far out an individual may be: the walls, or without them the boundary."""
        return self.size if self.rebound else self.boundary

    @property
    def hole(self) -> float:
        """How near to the middle of a ring an individual may come."""
        return self.inner * self.size / self.edge

    @property
    def field(self) -> tuple[int, float, float, float]:
        """The shape's code, size, boundary and hole, as kernels take them."""
        return SHAPE_CODES[self.shape], float(self.size), float(self.boundary), float(self.hole)

    def scaled(self, size: float) -> "Arena":
        """Return the arena with another size; its boundary and hole keep their shares of it."""
        boundary, inner = self.boundary / self.size, self.inner / self.size
        factor = size / self.size
        landmarks = tuple((name, factor * x, factor * y) for name, x, y in self.landmarks)
        return replace(
            self, size=size, boundary=size * boundary, inner=size * inner, landmarks=landmarks
        )

    def without_landmark(self, name: str) -> "Arena":
        """Return the arena with a landmark so far away that it is not perceived."""
        far = (name, math.inf, math.inf)
        landmarks = tuple(far if one[0] == name else one for one in self.landmarks)
        return replace(self, landmarks=landmarks)

    def contains(self, positions: NDArray[np.floating], margin: float = 0.0) -> Bools:
        """Return whether positions ``(..., 2)`` lie within the edge, widened by ``margin``."""
        if self.shape == "open":
            return np.ones(positions.shape[:-1], dtype=bool)
        if self.shape == "disc":
            extent = np.hypot(positions[..., 0], positions[..., 1])
        else:
            extent = np.abs(positions).max(axis=-1)
        return np.asarray((extent <= self.edge + margin) & (extent >= self.hole - margin))


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


def parse_shape(text: str) -> tuple[str, float]:
    """Return shape and share of the hole's radius: ``"ring=0.6"`` is a disc with a hole of 0.6."""
    if text in SHAPE_CODES:
        return text, 0.0
    if ring := re.fullmatch(r"ring=(\d*\.?\d+)", text):
        return "disc", float(ring[1])
    raise InputError(
        f"arena is {text!r}: choose square, disc, open, or a ring with the radius of its hole as "
        "a share of its own, such as ring=0.6"
    )
