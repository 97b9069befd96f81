"""The shapes of a picture: ground, paths and bodies, drawn on a canvas with world coordinates."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from animarl_envs.drawing import palette
from animarl_envs.drawing.canvas import WIDEST_BOUNDARY, Canvas, placed, thick_line
from animarl_envs.drawing.palette import RGB
from animarl_envs.drawing.scene import Scene
from animarl_envs.worlds.plume.plume import PlumeField

# Lengths in shares of the width of the picture.
BODY_LENGTH = (0.042, 0.060)  # a body is as long as the contact radius, within these bounds
LEAST_BODY = 0.03  # of a searcher with antennae
TRAIL_WIDTH = 0.0055
RECORDED_WIDTH = 0.0035
OUTLINE_WIDTH = 0.0032
PLUME_FADE = 0.2  # share of the field, before its end, in which the plume fades out
PLUME_MARGIN = 0.04  # share of the field at its end that holds nothing, beyond the cut
TRAIL_FADE = 25.0  # [frames] over which a trail fades towards its floor


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
        halo = placed(BODY_SHAPE * 1.3, centre, heading, length)
        canvas.polygon(halo, palette.TOUCH)
    canvas.polygon(placed(BODY_SHAPE * 1.1, centre, heading, length), palette.BACKGROUND)
    canvas.polygon(placed(BODY_SHAPE, centre, heading, length), colour)
    light = palette.mix(colour, palette.BACKGROUND, 0.85)
    for eye in placed(EYES, centre, heading, length).tolist():
        canvas.pygame.draw.circle(canvas.surface, light, eye, 0.055 * length)


def _draw_antennae(canvas: Canvas, scene: Scene, reach: float) -> None:
    """Both antennae in their directions, lit by what they smell; ``reach`` in px."""
    assert scene.antennae is not None
    root = canvas.at(scene.positions[-1])
    for tip, smell in zip(scene.antennae, scene.odour, strict=True):
        width = canvas.width(0.8 * OUTLINE_WIDTH)
        ahead = canvas.at(tip) - root
        end = (root + ahead * reach / max(float(np.hypot(*ahead)), 1e-9)).tolist()
        thick_line(canvas.pygame.draw, canvas.surface, _colour(scene, 0), root.tolist(), end, width)
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
    strength = strength * _fading(strength.shape)
    sheet = pygame.Surface(strength.shape, pygame.SRCALPHA, 32)
    sheet.fill((*palette.PLUME, 0))
    opacity = pygame.surfarray.pixels_alpha(sheet)
    opacity[:] = np.round(255 * palette.PLUME_ALPHA * strength)
    del opacity  # unlocks the surface
    x_low, x_high, y_low, y_high = plume.extent
    corner, opposite = canvas.at(np.array([[x_low, y_high], [x_high, y_low]])).round()
    size = np.maximum(opposite - corner, 1).astype(int).tolist()
    canvas.surface.blit(pygame.transform.smoothscale(sheet, size), corner.tolist())


def _fading(shape: tuple[int, int]) -> NDArray[np.float64]:
    """1 within the field, falling to 0 before its downwind end and its sides, where it is cut."""
    columns, rows = ((np.arange(n) + 0.5) / n for n in shape)
    to_side = np.minimum(rows, 1.0 - rows)
    along, across = (
        np.clip((left - PLUME_MARGIN) / fade, 0.0, 1.0)
        for left, fade in ((1.0 - columns, PLUME_FADE), (to_side, PLUME_FADE / 2))
    )
    return np.asarray(along[:, None] * across)


def _colour(scene: Scene, i: int) -> RGB:
    return palette.TARGET if scene.roles[i] == "target" else palette.pursuer(i)


# A body of length 1 that looks along x: round head in front, tapering tail.
_ROUND = np.linspace(0.0, 2 * np.pi, 48, endpoint=False)
BODY_SHAPE: NDArray[np.float64] = np.stack(
    [-0.5 * np.cos(_ROUND) + 0.05, 0.40 * np.sin(_ROUND) * np.sin(_ROUND / 2) ** 1.3], axis=-1
)
EYES: NDArray[np.float64] = np.array([(0.36, 0.13), (0.36, -0.13)])


def _edge(shape: str, size: float) -> NDArray[np.float64]:
    if shape == "disc":
        around = np.linspace(0, 2 * np.pi, 240, endpoint=False)
        return size * np.stack([np.cos(around), np.sin(around)], axis=-1)
    return size * np.array([(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)])
