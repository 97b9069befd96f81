"""The shapes of a picture: ground, paths and bodies, drawn on a canvas with world coordinates."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from animarl_envs.drawing import palette
from animarl_envs.drawing.palette import RGB
from animarl_envs.drawing.scene import Scene
from animarl_envs.worlds.plume.plume import PlumeField

if TYPE_CHECKING:
    from pygame import Surface

# Lengths in shares of the width of the picture.
MARGIN = 1.07  # how much wider the view is than what it must show
ZOOM_STEP = 1.25  # the view widens in such steps when somebody leaves it
WIDEST_BOUNDARY = 1.5  # a boundary is in view up to this many arena sizes
BODY_LENGTH = (0.042, 0.060)  # a body is as long as the contact radius, within these bounds
LEAST_BODY = 0.03  # of a searcher with antennae
TRAIL_WIDTH = 0.0055
RECORDED_WIDTH = 0.0035
OUTLINE_WIDTH = 0.0032
DASH = 0.011
TRAIL_FADE = 25.0  # [frames] over which a trail fades towards its floor


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
            _thick_line(draw, sheet, rgba, start, end, width)
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
            _thick_line(self.pygame.draw, self.surface, colour, start, end, width)

    def arrow(self, direction: float, colour: RGB) -> None:
        """An arrow across the canvas, towards ``direction`` [rad]."""
        placed = _placed(ARROW, np.full(2, self.pixels / 2), direction, 0.9 * self.pixels)
        self.polygon(placed, colour)

    def polygon(self, points: NDArray[np.floating], colour: RGB) -> None:
        """A filled polygon of pixel coordinates ``(n, 2)``."""
        self.pygame.draw.polygon(self.surface, colour, points.tolist())


def draw_ground(canvas: Canvas, scene: Scene) -> None:
    """The arena's floor and edge, its virtual boundary, the plume and the odour source."""
    arena = scene.arena
    if arena.shape == "open":
        canvas.surface.fill(palette.ARENA)
    else:
        edge = _edge(arena.shape, arena.size)
        canvas.polygon(canvas.at(edge), palette.ARENA)
        line = canvas.width(OUTLINE_WIDTH)
        if arena.size < arena.boundary <= WIDEST_BOUNDARY * arena.size and not arena.rebound:
            boundary = _edge(arena.shape, arena.boundary)
            canvas.outline(
                boundary, palette.BOUNDARY, canvas.width(OUTLINE_WIDTH * 0.7), dashed=True
            )
        canvas.outline(edge, palette.OUTLINE, line, dashed=False)
    if scene.plume is not None:
        _draw_plume(canvas, scene.plume)
    if scene.source is not None:
        _draw_source(canvas, scene)


def draw_paths(canvas: Canvas, scene: Scene) -> None:
    """The recorded paths, faintly, and over them the trails, fading with age."""
    if scene.demonstration is not None:
        for i in range(len(scene.names)):
            recorded = scene.demonstration[:, i]
            even = np.full(len(recorded), 0.55)
            hue = palette.mix(palette.DEMONSTRATION, _colour(scene, i), 0.35)
            canvas.path(recorded, hue, canvas.width(RECORDED_WIDTH), even)
    age = np.arange(len(scene.trails))[::-1]
    alpha = palette.TRAIL_FLOOR + (palette.TRAIL_ALPHA - palette.TRAIL_FLOOR) * np.exp(
        -age / TRAIL_FADE
    )
    for i in range(len(scene.names)):
        canvas.path(scene.trails[:, i], _colour(scene, i), canvas.width(TRAIL_WIDTH), alpha)


def draw_bodies(canvas: Canvas, scene: Scene) -> None:
    """Reach of contact around the target, antennae, and everybody, the target on top."""
    reach = scene.contact_radius * canvas.scale
    for i, role in enumerate(scene.roles):
        if role == "target":
            if scene.touched[i]:
                canvas.veil(scene.positions[i], reach, palette.TOUCH, 0.5)
            else:
                canvas.veil(scene.positions[i], reach, palette.TARGET, 0.07)
    low, high = BODY_LENGTH
    length = min(max(reach, low * canvas.pixels), high * canvas.pixels)
    if scene.antennae is not None:
        to_tip = float(np.hypot(*(scene.antennae[0] - scene.positions[-1]))) * canvas.scale
        length = min(
            length, max(1.3 * to_tip, LEAST_BODY * canvas.pixels)
        )  # the antennae stand out
        _draw_antennae(canvas, scene, max(to_tip, 0.75 * length))
    for i in range(len(scene.names)):
        _draw_body(canvas, scene, i, length)


def _draw_body(canvas: Canvas, scene: Scene, i: int, length: float) -> None:
    centre, colour = canvas.at(scene.positions[i]), _colour(scene, i)
    heading = float(scene.headings[i])
    if scene.touched[i] and scene.roles[i] != "target":
        halo = _placed(BODY_SHAPE * 1.3, centre, heading, length)
        canvas.polygon(halo, palette.TOUCH)
    canvas.polygon(_placed(BODY_SHAPE * 1.1, centre, heading, length), palette.BACKGROUND)
    canvas.polygon(_placed(BODY_SHAPE, centre, heading, length), colour)
    light = palette.mix(colour, palette.BACKGROUND, 0.85)
    for eye in _placed(EYES, centre, heading, length).tolist():
        canvas.pygame.draw.circle(canvas.surface, light, eye, 0.055 * length)


def _draw_antennae(canvas: Canvas, scene: Scene, reach: float) -> None:
    """Both antennae in their directions, lit by what they smell; ``reach`` in px."""
    assert scene.antennae is not None
    root = canvas.at(scene.positions[-1])
    for tip, smell in zip(scene.antennae, scene.odour, strict=True):
        width = canvas.width(0.8 * OUTLINE_WIDTH)
        ahead = canvas.at(tip) - root
        end = (root + ahead * reach / max(float(np.hypot(*ahead)), 1e-9)).tolist()
        _thick_line(
            canvas.pygame.draw, canvas.surface, _colour(scene, 0), root.tolist(), end, width
        )
        lit = palette.mix(palette.BACKGROUND, palette.TOUCH, min(max(float(smell), 0.0), 1.0))
        canvas.pygame.draw.circle(canvas.surface, _colour(scene, 0), end, 0.0085 * canvas.pixels)
        canvas.pygame.draw.circle(canvas.surface, lit, end, 0.006 * canvas.pixels)


def _draw_source(canvas: Canvas, scene: Scene) -> None:
    source = np.array(scene.source)
    reach = scene.contact_radius * canvas.scale
    reached = bool(scene.touched.any())
    canvas.veil(
        source, reach, palette.TOUCH if reached else palette.PLUME, 0.45 if reached else 0.14
    )
    around = np.linspace(0, 2 * np.pi, 96, endpoint=False)
    ring = source + scene.contact_radius * np.stack([np.cos(around), np.sin(around)], axis=-1)
    canvas.outline(ring, palette.PLUME, canvas.width(OUTLINE_WIDTH * 0.7), dashed=False)
    canvas.disc(source, 0.008 * canvas.pixels, palette.mix(palette.PLUME, palette.TARGET, 0.35))


def _draw_plume(canvas: Canvas, plume: PlumeField) -> None:
    pygame = canvas.pygame
    strength = np.clip(plume.values, 0.0, 1.0)[::-1].T  # columns, then rows downwards
    sheet = pygame.Surface(strength.shape, pygame.SRCALPHA, 32)
    sheet.fill((*palette.PLUME, 0))
    opacity = pygame.surfarray.pixels_alpha(sheet)
    opacity[:] = np.round(255 * palette.PLUME_ALPHA * strength)
    del opacity  # unlocks the surface
    x_low, x_high, y_low, y_high = plume.extent
    corner, opposite = canvas.at(np.array([[x_low, y_high], [x_high, y_low]])).round()
    size = np.maximum(opposite - corner, 1).astype(int).tolist()
    canvas.surface.blit(pygame.transform.smoothscale(sheet, size), corner.tolist())


def _colour(scene: Scene, i: int) -> RGB:
    return palette.TARGET if scene.roles[i] == "target" else palette.pursuer(i)


# A body of length 1 that looks along x: round head in front, tapering tail.
_ROUND = np.linspace(0.0, 2 * np.pi, 48, endpoint=False)
BODY_SHAPE: NDArray[np.float64] = np.stack(
    [-0.5 * np.cos(_ROUND) + 0.05, 0.40 * np.sin(_ROUND) * np.sin(_ROUND / 2) ** 1.3], axis=-1
)
EYES: NDArray[np.float64] = np.array([(0.36, 0.13), (0.36, -0.13)])

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


def _placed(
    shape: NDArray[np.float64], centre: NDArray[np.float64], heading: float, length: float
) -> NDArray[np.float64]:
    """A shape of the body frame in pixels: turned to ``heading`` (y up), scaled, moved."""
    cos, sin = math.cos(heading), math.sin(heading)
    turned = shape @ np.array([(cos, -sin), (-sin, -cos)])
    return np.asarray(centre + length * turned)


def _edge(shape: str, size: float) -> NDArray[np.float64]:
    if shape == "disc":
        around = np.linspace(0, 2 * np.pi, 240, endpoint=False)
        return size * np.stack([np.cos(around), np.sin(around)], axis=-1)
    return size * np.array([(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)])


def _resampled(points: NDArray[np.float64], spacing: float) -> NDArray[np.float64]:
    """Points along a line ``(n, 2)``, an even number of even steps of about ``spacing``."""
    steps = np.hypot(*np.diff(points, axis=0).T)
    along = np.concatenate([[0.0], np.cumsum(steps)])
    count = max(2, 2 * round(along[-1] / spacing / 2))
    wanted = np.linspace(0.0, along[-1], count + 1)
    return np.stack([np.interp(wanted, along, points[:, k]) for k in range(2)], axis=-1)


def _thick_line(
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
