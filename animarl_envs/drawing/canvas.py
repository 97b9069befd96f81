"""A canvas with world coordinates, and the window on the arena that it shows."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache
from itertools import pairwise
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from animarl_envs.drawing.palette import RGB
from animarl_envs.drawing.scene import Scene

if TYPE_CHECKING:
    from pygame import Surface

PLACES = 2  # in a pixel, along each axis, where a disc may stand
SUPERSAMPLING = 2  # a power of two: pygame then averages without rounding down

# Lengths in shares of the width of the picture.
MARGIN = 1.07  # how much wider the view is than what it must show
ZOOM_STEP = 1.25  # the view widens in such steps when somebody leaves it
MOVE_STEP = 0.125  # ... and in an open field moves in steps of this share of its half width
WIDEST_BOUNDARY = 1.5  # a boundary is in view up to this many arena sizes
DASH = 0.011


class View(NamedTuple):
    """A square window on the arena frame [arena unit]."""

    x: float
    y: float
    half: float


def view_of(scene: Scene) -> View:
    """What is in view: the arena with its boundary; in an open field source, plume and start.

    It widens in steps when somebody leaves it, and in an open field moves in steps to the middle
    of all that has been seen, so that a long search stays in the picture and the picture stays put.
    """
    arena = scene.arena
    seen = np.concatenate([scene.positions, scene.trails.reshape(-1, 2)])
    if arena.shape != "open":
        half = min(arena.boundary, WIDEST_BOUNDARY * arena.size) * MARGIN
        while float(np.abs(seen).max()) * 1.02 > half:
            half *= ZOOM_STEP
        return View(0.0, 0.0, half)
    points = [scene.trails[:1].reshape(-1, 2), np.zeros((1, 2))]
    if scene.demonstration is not None:
        points.append(scene.demonstration[:1].reshape(-1, 2))
    known = np.concatenate(points)
    middle, reach = _middle(known)
    half = max(reach * 1.35, arena.size * 0.6) * MARGIN
    if float(np.abs(seen - middle).max()) * 1.02 > half:
        middle, reach = _middle(np.concatenate([known, seen]))
        while reach * MARGIN + half * MOVE_STEP / 2 > half:
            half *= ZOOM_STEP
        middle = np.round(middle / (half * MOVE_STEP)) * (half * MOVE_STEP)
    return View(float(middle[0]), float(middle[1]), half)


def _middle(points: NDArray[np.floating]) -> tuple[NDArray[np.float64], float]:
    """The middle of the box around ``(n, 2)``, and half of its longer side."""
    low, high = points.min(axis=0), points.max(axis=0)
    return np.asarray((low + high) / 2), float((high - low).max()) / 2


class Canvas:
    """A surface on which things are placed in the arena frame (y up).

    Lines and discs are drawn with smooth edges at once. Outlines are drawn :data:`SUPERSAMPLING`
    times larger on a sheet of their own and averaged down; sheets carry colours times opacity,
    which is what averages rightly.

    Parameters
    ----------
    surface
        Whose upper left square of ``pixels`` by ``pixels`` is drawn on.
    """

    def __init__(self, pygame: Any, surface: Surface, pixels: int, view: View) -> None:
        self.pygame = pygame
        self.surface = surface
        self.pixels = pixels
        self.view = view
        self.scale = pixels / (2 * view.half)  # [px per arena unit]

    def at(self, points: NDArray[np.floating]) -> NDArray[np.float64]:
        """Pixel coordinates of points ``(..., 2)``."""
        flipped = (points - np.array(self.view[:2])) * (self.scale, -self.scale)
        return np.asarray(flipped + self.pixels / 2)

    def width(self, share: float) -> int:
        """A line width of that share of the picture [px]."""
        return max(1, round(share * self.pixels))

    def disc(
        self, centre: NDArray[np.floating], radius: float, colour: RGB, alpha: float = 1.0
    ) -> None:
        """A filled disc of ``radius`` [px] around pixel coordinates."""
        self._circle(centre, radius, colour, alpha, 0)

    def ring(self, centre: NDArray[np.floating], radius: float, colour: RGB, width: int) -> None:
        """A circle; ``radius`` and ``width`` in px, ``centre`` in pixel coordinates."""
        self._circle(centre, radius, colour, 1.0, width)

    def _circle(
        self, centre: NDArray[np.floating], radius: float, colour: RGB, alpha: float, width: int
    ) -> None:
        side = 2 * math.ceil(radius) + 4
        corner = np.floor(centre - side / 2)
        within = np.round((centre - corner) * PLACES) / PLACES
        kind = (radius, _times(colour, alpha), width)
        self.lay(_circle_sheet(self.pygame, side, tuple(within.tolist()), *kind), corner)

    def lay(self, sheet: Surface, corner: NDArray[np.floating]) -> None:
        """Put a sheet of colours times opacity over what is drawn; ``corner`` is in pixels."""
        self.surface.blit(sheet, corner.tolist(), special_flags=self.pygame.BLEND_PREMULTIPLIED)

    def path(self, points: NDArray[np.floating], colours: Sequence[RGB], width: int) -> None:
        """A line through ``points`` ``(t, 2)``, each of its t - 1 pieces of its own colour."""
        line, surface = self.pygame.draw.aaline, self.surface
        for (start, end), colour in zip(pairwise(self.at(points).tolist()), colours, strict=True):
            line(surface, colour, start, end, width)

    def outline(
        self, points: NDArray[np.floating], colour: RGB, width: int, *, dashed: bool
    ) -> None:
        """A closed line through ``points`` ``(n, 2)``."""
        closed = self.at(np.concatenate([points, points[:1]]))
        if dashed:
            closed = _resampled(closed, DASH * self.pixels)
        for k in range(0, len(closed) - 1, 2 if dashed else 1):
            start, end = closed[k].tolist(), closed[k + 1].tolist()
            if not dashed:
                self.pygame.draw.circle(self.surface, colour, start, width / 2)
            thick_line(self.pygame.draw, self.surface, colour, start, end, width)

    def arrow(self, direction: float, colour: RGB) -> None:
        """An arrow across the canvas, towards ``direction`` [rad]."""
        middle = np.full(2, self.pixels / 2)
        self.shapes([(placed(ARROW, middle, direction, 0.9 * self.pixels), colour)])

    def polygon(self, points: NDArray[np.floating], colour: RGB) -> None:
        """A filled polygon of pixel coordinates ``(n, 2)``, with hard edges."""
        self.pygame.draw.polygon(self.surface, colour, points.tolist())

    def shapes(self, outlines: Sequence[tuple[NDArray[np.floating], RGB]]) -> None:
        """Filled polygons of pixel coordinates ``(n, 2)``, one over the other."""
        everything = np.concatenate([points for points, _ in outlines])
        corner = np.floor(everything.min(axis=0)) - 1.0
        size = (np.ceil(everything.max(axis=0)) + 1.0 - corner).astype(int)
        large = self.pygame.Surface((SUPERSAMPLING * size).tolist(), self.pygame.SRCALPHA, 32)
        for points, colour in outlines:
            self.pygame.draw.polygon(large, colour, (SUPERSAMPLING * (points - corner)).tolist())
        self.lay(self.pygame.transform.smoothscale(large, size.tolist()), corner)


@lru_cache(maxsize=256)
def _circle_sheet(
    pygame: Any,
    side: int,
    centre: tuple[float, float],
    radius: float,
    rgba: tuple[int, int, int, int],
    width: int,
) -> Surface:
    """A disc, or with a ``width`` a circle, on a square sheet."""
    large = pygame.Surface((SUPERSAMPLING * side,) * 2, pygame.SRCALPHA, 32)
    middle = (SUPERSAMPLING * centre[0], SUPERSAMPLING * centre[1])
    pygame.draw.circle(large, rgba, middle, SUPERSAMPLING * radius, SUPERSAMPLING * width)
    sheet: Surface = pygame.transform.smoothscale(large, (side, side))
    return sheet


def _times(colour: RGB, alpha: float) -> tuple[int, int, int, int]:
    """A colour times its opacity, and the opacity."""
    red, green, blue = (round(alpha * part) for part in colour)
    return red, green, blue, round(255 * alpha)


ARROW: NDArray[np.float64] = np.array(
    [
        (-0.5, 0.05),
        (0.15, 0.05),
        (0.15, 0.2),
        (0.5, 0.0),
        (0.15, -0.2),
        (0.15, -0.05),
        (-0.5, -0.05),
    ]
)


def placed(
    shape: NDArray[np.float64], centre: NDArray[np.float64], heading: float, length: float
) -> NDArray[np.float64]:
    """A shape of the body frame in pixels: turned to ``heading`` (y up), scaled, moved."""
    cos, sin = math.cos(heading), math.sin(heading)
    turned = shape @ np.array([(cos, -sin), (-sin, -cos)])
    return np.asarray(centre + length * turned)


def _resampled(points: NDArray[np.float64], spacing: float) -> NDArray[np.float64]:
    """Points along a line ``(n, 2)``, an even number of even steps of about ``spacing``."""
    steps = np.hypot(*np.diff(points, axis=0).T)
    along = np.concatenate([[0.0], np.cumsum(steps)])
    count = max(2, 2 * round(along[-1] / spacing / 2))
    wanted = np.linspace(0.0, along[-1], count + 1)
    return np.stack([np.interp(wanted, along, points[:, k]) for k in range(2)], axis=-1)


def thick_line(
    draw: Any,
    surface: Surface,
    colour: tuple[int, ...],
    start: list[float],
    end: list[float],
    width: float,
) -> None:
    """A straight line as a rectangle, of the same width in every direction."""
    dx, dy = end[0] - start[0], end[1] - start[1]
    length = math.hypot(dx, dy)
    if length == 0.0:
        return
    nx, ny = -dy / length * width / 2, dx / length * width / 2
    corners = [
        (start[0] + nx, start[1] + ny), (end[0] + nx, end[1] + ny),
        (end[0] - nx, end[1] - ny), (start[0] - nx, start[1] - ny),
    ]  # fmt: skip
    draw.polygon(surface, colour, corners)
