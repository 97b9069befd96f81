"""A canvas with world coordinates, and the window on the arena that it shows."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from animarl_envs.drawing import palette
from animarl_envs.drawing.palette import RGB
from animarl_envs.drawing.scene import Scene

if TYPE_CHECKING:
    from pygame import Surface

# Lengths in shares of the width of the picture.
MARGIN = 1.07  # how much wider the view is than what it must show
ZOOM_STEP = 1.25  # the view widens in such steps when somebody leaves it
WIDEST_BOUNDARY = 1.5  # a boundary is in view up to this many arena sizes
DASH = 0.011


class View(NamedTuple):
    """A square window on the arena frame [arena unit]."""

    x: float
    y: float
    half: float


def view_of(scene: Scene) -> View:
    """What is in view: the arena with its boundary; in an open field source, plume and start.

    It widens in steps when somebody leaves it.
    """
    arena = scene.arena
    if arena.shape == "open":
        points = [scene.trails[:1].reshape(-1, 2), np.zeros((1, 2))]
        if scene.demonstration is not None:
            points.append(scene.demonstration[:1].reshape(-1, 2))
        known = np.concatenate(points)
        x, y = (known.min(axis=0) + known.max(axis=0)) / 2
        half = max(float(np.ptp(known, axis=0).max()) / 2 * 1.35, arena.size * 0.6)
    else:
        x = y = 0.0
        half = min(arena.boundary, WIDEST_BOUNDARY * arena.size)
    half *= MARGIN
    seen = np.concatenate([scene.positions, scene.trails.reshape(-1, 2)])
    farthest = float(np.abs(seen - (x, y)).max())
    while farthest * 1.02 > half:
        half *= ZOOM_STEP
    return View(float(x), float(y), half)


class Canvas:
    """A square surface on which things are placed in the arena frame (y up)."""

    def __init__(self, pygame: Any, pixels: int, view: View) -> None:
        self.pygame = pygame
        self.pixels = pixels
        self.view = view
        self.scale = pixels / (2 * view.half)  # [px per arena unit]
        self.surface: Surface = pygame.Surface((pixels, pixels), 0, 32)
        self.surface.fill(palette.BACKGROUND)

    def at(self, points: NDArray[np.floating]) -> NDArray[np.float64]:
        """Pixel coordinates of points ``(..., 2)``."""
        flipped = (points - np.array(self.view[:2])) * (self.scale, -self.scale)
        return np.asarray(flipped + self.pixels / 2)

    def width(self, share: float) -> int:
        """A line width of that share of the picture [px]."""
        return max(1, round(share * self.pixels))

    def disc(self, centre: NDArray[np.floating], radius: float, colour: RGB) -> None:
        """A filled disc; ``radius`` in px."""
        self.pygame.draw.circle(self.surface, colour, self.at(centre).tolist(), radius)

    def veil(self, centre: NDArray[np.floating], radius: float, colour: RGB, alpha: float) -> None:
        """A translucent disc; ``radius`` in px."""
        side = 2 * math.ceil(radius) + 2
        sheet = self.pygame.Surface((side, side), self.pygame.SRCALPHA, 32)
        rgba = (*colour, round(255 * alpha))
        self.pygame.draw.circle(sheet, rgba, (side / 2, side / 2), radius)
        self.surface.blit(sheet, (self.at(centre) - side / 2).round().tolist())

    def path(
        self, points: NDArray[np.floating], colour: RGB, width: int, alpha: NDArray[np.floating]
    ) -> None:
        """A line with round joints through ``points`` ``(t, 2)``, each piece of its own opacity."""
        if len(points) < 2:
            return
        at, draw = self.at(points), self.pygame.draw
        corner = np.floor(at.min(axis=0) - width)
        size = np.ceil(at.max(axis=0) + width - corner).astype(int).tolist()
        # Shapes on one sheet replace what is under them: a path never darkens where it crosses.
        sheet = self.pygame.Surface(size, self.pygame.SRCALPHA, 32)
        places = (at - corner).tolist()
        for k, (start, end) in enumerate(pairwise(places)):
            rgba = (*colour, round(255 * float(alpha[k + 1])))
            draw.circle(sheet, rgba, start, width / 2)
            thick_line(draw, sheet, rgba, start, end, width)
        self.surface.blit(sheet, corner.tolist())

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
        self.polygon(placed(ARROW, middle, direction, 0.9 * self.pixels), colour)

    def polygon(self, points: NDArray[np.floating], colour: RGB) -> None:
        """A filled polygon of pixel coordinates ``(n, 2)``."""
        self.pygame.draw.polygon(self.surface, colour, points.tolist())


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
