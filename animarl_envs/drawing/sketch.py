"""The shapes of a picture: ground, paths and bodies, drawn on a canvas with world coordinates."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from animarl_envs.arena import Arena
from animarl_envs.drawing import palette
from animarl_envs.drawing.bodies import BODIES, Body
from animarl_envs.drawing.canvas import WIDEST_BOUNDARY, Canvas, placed
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
UPWIND_FADE = 0.06  # the same at its beginning, where the source is near
PLUME_MARGIN = 0.04  # share of the field at its end that holds nothing, beyond the cut
TRAIL_FADE = 25.0  # [frames] over which a trail fades towards its floor
RIM = 0.05  # white around a body [body length]


def draw_arena(canvas: Canvas, arena: Arena) -> None:
    """The arena's floor and edge, and its virtual boundary: what stays for a whole episode."""
    if arena.shape == "open":
        canvas.surface.fill(palette.ARENA)
        return
    edge = _edge(arena.shape, arena.size)
    canvas.polygon(canvas.at(edge), palette.ARENA)
    line = canvas.width(OUTLINE_WIDTH)
    if arena.size < arena.boundary <= WIDEST_BOUNDARY * arena.size and not arena.rebound:
        boundary = _edge(arena.shape, arena.boundary)
        canvas.outline(boundary, palette.BOUNDARY, canvas.width(OUTLINE_WIDTH * 0.7), dashed=True)
    canvas.outline(edge, palette.OUTLINE, line, dashed=False)


def draw_odour(canvas: Canvas, scene: Scene) -> None:
    """The plume and the odour source, where there are any."""
    if scene.plume is not None:
        _draw_plume(canvas, scene.plume)
    if scene.source is not None:
        _draw_source(canvas, scene)


def draw_paths(canvas: Canvas, scene: Scene) -> None:
    """The recorded paths, faintly, and over them the trails, fading with age."""
    if scene.demonstration is not None:
        for i in range(len(scene.names)):
            recorded = scene.demonstration[:, i]
            hue = palette.mix(palette.DEMONSTRATION, _colour(scene, i), 0.35)
            faint = palette.mix(palette.ARENA, hue, 0.55)
            canvas.path(recorded, [faint] * (len(recorded) - 1), canvas.width(RECORDED_WIDTH))
    pieces = len(scene.trails) - 1
    for i in range(len(scene.names)):
        colours = _faded(_colour(scene, i), max(pieces, 0))
        canvas.path(scene.trails[:, i], colours, canvas.width(TRAIL_WIDTH))


@lru_cache(maxsize=64)
def _fading_colours(colour: RGB) -> list[RGB]:
    """Of a trail's pieces on the floor, the youngest first, until nothing fades any more."""
    ages = np.arange(round(5 * TRAIL_FADE))
    share = palette.TRAIL_FLOOR + (palette.TRAIL_ALPHA - palette.TRAIL_FLOOR) * np.exp(
        -ages / TRAIL_FADE
    )
    return [palette.mix(palette.ARENA, colour, float(each)) for each in share]


def _faded(colour: RGB, pieces: int) -> list[RGB]:
    """The colours of so many pieces of a trail, the oldest first."""
    young = _fading_colours(colour)[:pieces]
    return [young[-1]] * (pieces - len(young)) + young[::-1] if young else []


def draw_reach(canvas: Canvas, scene: Scene) -> None:
    """The reach of contact around the target."""
    for i, role in enumerate(scene.roles):
        if role == "target":
            hue, alpha = (palette.TOUCH, 0.5) if scene.touched[i] else (palette.TARGET, 0.07)
            reach = scene.contact_radius * canvas.scale
            canvas.disc(canvas.at(scene.positions[i]), reach, hue, alpha)


def draw_bodies(canvas: Canvas, scene: Scene) -> None:
    """Antennae and everybody, the target on top."""
    low, high = BODY_LENGTH
    reach = scene.contact_radius * canvas.scale
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
    centre, own = canvas.at(scene.positions[i]), _colour(scene, i)
    body = BODIES[scene.body(i)]
    points, ends = _outlines(body)
    at = np.split(placed(points, centre, float(scene.headings[i]), length), ends)
    halo = scene.touched[i] and scene.roles[i] != "target"
    rim = palette.TOUCH if halo else palette.BACKGROUND
    rims = [part for part in body if part.rimmed]
    colours = [rim] * len(rims) + [part.colour(own) for part in body]
    canvas.shapes(list(zip(at, colours, strict=True)))


@lru_cache(maxsize=64)
def _outlines(body: Body) -> tuple[NDArray[np.float64], list[int]]:
    """The rims and parts of a body in one array ``(n, 2)``, and where to cut it."""
    rims = [_widened(part.outline) for part in body if part.rimmed]
    every = rims + [part.outline for part in body]
    return np.concatenate(every), np.cumsum([len(each) for each in every])[:-1].tolist()


def _widened(outline: NDArray[np.float64]) -> NDArray[np.float64]:
    """The outline, moved outwards from its own middle by the width of a rim."""
    middle = outline.mean(axis=0)
    out = outline - middle
    return np.asarray(outline + RIM * out / np.linalg.norm(out, axis=1, keepdims=True))


def _draw_antennae(canvas: Canvas, scene: Scene, reach: float) -> None:
    """Both antennae in their directions, lit by what they smell; ``reach`` in px."""
    assert scene.antennae is not None
    root, own = canvas.at(scene.positions[-1]), _colour(scene, 0)
    for tip, smell in zip(scene.antennae, scene.odour, strict=True):
        ahead = canvas.at(tip) - root
        end = root + ahead * reach / max(float(np.hypot(*ahead)), 1e-9)
        line = canvas.width(0.8 * OUTLINE_WIDTH)
        canvas.pygame.draw.aaline(canvas.surface, own, root.tolist(), end.tolist(), line)
        lit = palette.mix(palette.BACKGROUND, palette.TOUCH, min(max(float(smell), 0.0), 1.0))
        canvas.disc(end, 0.0085 * canvas.pixels, own)
        canvas.disc(end, 0.006 * canvas.pixels, lit)


def _draw_source(canvas: Canvas, scene: Scene) -> None:
    source = canvas.at(np.array(scene.source))
    reach = scene.contact_radius * canvas.scale
    reached = bool(scene.touched.any())
    hue, alpha = (palette.TOUCH, 0.45) if reached else (palette.PLUME, 0.14)
    canvas.disc(source, reach, hue, alpha)
    canvas.ring(source, reach, palette.PLUME, canvas.width(OUTLINE_WIDTH * 0.7))
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


@lru_cache(maxsize=8)
def _fading(shape: tuple[int, int]) -> NDArray[np.float64]:
    """1 within the field, falling to 0 before its ends and its sides, where it is cut."""
    columns, rows = ((np.arange(n) + 0.5) / n for n in shape)
    before, along, across = (
        np.clip((left - margin) / fade, 0.0, 1.0)
        for left, margin, fade in (
            (columns, 0.0, UPWIND_FADE),
            (1.0 - columns, PLUME_MARGIN, PLUME_FADE),
            (np.minimum(rows, 1.0 - rows), PLUME_MARGIN, PLUME_FADE / 2),
        )
    )
    return np.asarray((before * along)[:, None] * across)


def _colour(scene: Scene, i: int) -> RGB:
    return palette.TARGET if scene.roles[i] == "target" else palette.pursuer(i)


def _edge(shape: str, size: float) -> NDArray[np.float64]:
    if shape == "disc":
        around = np.linspace(0, 2 * np.pi, 240, endpoint=False)
        return size * np.stack([np.cos(around), np.sin(around)], axis=-1)
    return size * np.array([(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)])
