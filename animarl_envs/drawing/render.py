"""Pictures of scenes with pygame, in a window or as arrays, and clips of them.

The same scene gives the same pixels, with or without a display. The empty arena is drawn once and
kept. Lengths are in shares of the width of the picture, which shows a square window on the arena.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterable, Iterator, Sequence
from functools import lru_cache
from itertools import chain, pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from animarl_envs.arena import Arena
from animarl_envs.array_types import Floats
from animarl_envs.demos.summary import RECORDED_SCALE
from animarl_envs.drawing import palette
from animarl_envs.drawing.palette import BODIES, RGB, colour_of
from animarl_envs.drawing.scene import Scene, SceneRecorder
from animarl_envs.errors import InputError, require_extra
from animarl_envs.files import write_then_rename
from animarl_envs.species.base import body_of_each
from animarl_envs.worlds.base import World
from animarl_envs.worlds.plume.plume import PlumeField

if TYPE_CHECKING:
    from pygame import Surface

Points = NDArray[np.floating]

RENDER_MODES = ("human", "rgb_array")
MOST_DRAWN = 9
"""Copies of a vector environment that are drawn, three in a row."""
SIZE = 600  # width of a picture, or of a row of them [px]
STRIP = 0.12  # height of the strip of text below
LEAST_TEXT = 14  # of small pictures [px]
MARGIN = 1.07  # how much wider the view is than what it must show
ZOOM_STEP = 1.25  # the view widens in such steps when somebody leaves it
MOVE_STEP = 0.125  # ... and in an open field moves in steps of this share of its half width
WIDEST_BOUNDARY = 1.5  # a boundary is in view up to this many arena sizes
BODY_LENGTH = (0.042, 0.060)  # a body is as long as the contact radius, within these bounds
LEAST_BODY = 0.03  # of a searcher, whose antennae stand out
RIM = 0.05  # white around a body [body length]
TRAIL_WIDTH, LINE_WIDTH, DASH, LANDMARK = 0.0055, 0.0032, 0.011, 0.009
TRAIL_FADE = 25.0  # [frames] over which a trail fades, from and to these opacities
TRAIL_OPACITY = 0.85, 0.16
PLUME_OPACITY = 0.55  # at concentration 1
PLUME_FADE, UPWIND_FADE = 0.2, 0.06  # shares of the field in which it fades out, at both ends
PLUME_MARGIN = 0.04  # share of the field at its end that holds nothing, beyond the cut
ARROW = np.array(
    [(-0.5, 0.05), (0.15, 0.05), (0.15, 0.2), (0.5, 0.0), (0.15, -0.2), (0.15, -0.05)]
    + [(-0.5, -0.05)]
)


class Window(NamedTuple):
    """A square window on the arena frame [arena unit]."""

    x: float
    y: float
    half: float


def window_of(scene: Scene) -> Window:
    """Return what is in view: the arena with its boundary; in the open source, plume and start.

    It widens in steps when somebody leaves it, and in an open field moves in steps to the middle
    of all that has been seen, so that a long search stays in the picture and the picture stays put.
    """
    arena = scene.species.arena
    seen = np.concatenate([scene.positions, scene.trails.reshape(-1, 2)])
    if arena.shape != "open":
        half = min(arena.boundary, WIDEST_BOUNDARY * arena.size) * MARGIN
        while float(np.abs(seen).max()) * 1.02 > half:
            half *= ZOOM_STEP
        return Window(0.0, 0.0, half)
    known = np.concatenate([scene.trails[:1].reshape(-1, 2), np.zeros((1, 2))])
    middle, reach = _middle(known)
    half = max(reach * 1.35, arena.size * 0.6) * MARGIN
    if float(np.abs(seen - middle).max()) * 1.02 > half:
        middle, reach = _middle(np.concatenate([known, seen]))
        while reach * MARGIN + half * MOVE_STEP / 2 > half:
            half *= ZOOM_STEP
        middle = np.round(middle / (half * MOVE_STEP)) * (half * MOVE_STEP)
    return Window(float(middle[0]), float(middle[1]), half)


def _middle(points: Points) -> tuple[Points, float]:
    """Return the middle of the box around points ``(n, 2)`` and half of its longer side."""
    low, high = points.min(axis=0), points.max(axis=0)
    return (low + high) / 2, float((high - low).max()) / 2


class Renderer:
    """Draws scenes, ``size`` pixels wide; a strip of text stands below the field.

    ``mode`` ``"rgb_array"``: :meth:`draw` returns an array and needs no display. ``"human"``: it
    shows the picture in a window and waits so that at most ``fps`` pictures a second are shown.
    Raises MissingExtraError if pygame-ce is not installed. Raises InputError if a value is out of
    range, or a window is wanted where there is no display.
    """

    def __init__(self, mode: str, size: int = SIZE, fps: float = 10.0) -> None:
        if mode not in RENDER_MODES:
            raise InputError(f"render_mode is {mode!r}: choose 'rgb_array' or 'human'")
        if not (isinstance(size, int) and 100 <= size <= 4000):
            raise InputError(f"size is {size!r}: give a whole number of pixels, 100 to 4000")
        if not 0 < fps < math.inf:
            raise InputError(f"fps is {fps!r}: it must be a positive number")
        self.mode, self.size, self.fps = mode, size, fps
        self.closed = False
        """Whether the user has closed the window; :meth:`draw` then shows nothing."""
        os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")
        with require_extra("drawing", "render"):
            import pygame
        self._pygame: Any = pygame
        pygame.font.init()
        self._text_size = max(LEAST_TEXT, round(0.024 * size))
        self._font = pygame.font.Font(None, round(1.15 * self._text_size))
        self._ground: tuple[Any, Surface] | None = None
        self._page = pygame.Surface((size, self.height), 0, 32)
        self._window: Surface | None = None
        self._clock: Any = None

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle and copy the settings; a copy opens its own window."""
        return type(self), (self.mode, self.size, self.fps)

    @property
    def height(self) -> int:
        """Height of the picture [px]."""
        return self.size + 2 * round(STRIP * self.size / 2)

    def draw(self, scene: Scene) -> NDArray[np.uint8] | None:
        """Draw a scene: ``(height, width, 3)`` uint8 as an array, or ``None`` in a window."""
        self._view = window_of(scene)
        self._scale = self.size / (2 * self._view.half)  # [px per arena unit]
        self._draw_ground(scene)
        self._page.set_clip((0, 0, self.size, self.size))
        if scene.plume is not None:
            self._draw_plume(scene.plume)
        self._draw_reach(scene)
        self._draw_paths(scene)
        self._draw_bodies(scene)
        self._page.set_clip(None)
        self._write_strip(scene)
        if self.mode == "human":
            self._show(scene.species.title)
            return None
        # Onto a surface whose memory is the array: faster than any of pygame's own conversions.
        pixels = np.empty((self.height, self.size, 3), dtype=np.uint8)
        there = self._pygame.image.frombuffer(pixels, self._page.get_size(), "RGB")
        there.blit(self._page, (0, 0))
        return pixels

    def close(self) -> None:
        """Close the window, if any. Closing twice is harmless."""
        if self._window is not None:
            self._pygame.display.quit()
            self._window = None

    def _show(self, title: str) -> None:
        pygame = self._pygame
        if self.closed:
            return
        if self._window is None:
            try:
                pygame.display.init()
                self._window = pygame.display.set_mode(self._page.get_size())
            except pygame.error as error:
                raise InputError(
                    f"no window can be opened ({error}): use render_mode='rgb_array'"
                ) from error
            pygame.display.set_caption(f"AnimaRL: {title}")
            self._clock = pygame.time.Clock()
        if any(event.type == pygame.QUIT for event in pygame.event.get()):
            self.closed = True
            self.close()
            return
        self._window.blit(self._page, (0, 0))
        pygame.display.flip()
        self._clock.tick(self.fps)

    # -- shapes -----------------------------------------------------------------------------------

    def _at(self, points: Points) -> Floats:
        """Return pixel coordinates of points ``(..., 2)`` of the arena frame."""
        flipped = (points - np.array(self._view[:2])) * (self._scale, -self._scale)
        return np.asarray(flipped + (self.size - 1) / 2)

    def _width(self, share: float) -> int:
        return max(1, round(share * self.size))

    def _disc(self, centre: Points, radius: float, colour: RGB, width: int = 0) -> None:
        """Draw a disc around pixel coordinates, or with a ``width`` [px] a circle."""
        self._pygame.draw.aacircle(self._page, colour, centre.tolist(), radius, width)

    def _polygon(self, points: Points, colour: RGB) -> None:
        """Draw a filled polygon of pixel coordinates with smooth edges."""
        self._pygame.draw.polygon(self._page, colour, points.round().tolist())
        self._pygame.draw.aalines(self._page, colour, True, points.tolist())

    def _path(self, points: Points, colours: Sequence[RGB], width: int) -> None:
        """Draw a line through pixels ``(t, 2)``; each of its t - 1 pieces has its own colour."""
        line, page = self._pygame.draw.aaline, self._page
        for (start, end), colour in zip(pairwise(points.tolist()), colours, strict=True):
            line(page, colour, start, end, width)

    # -- the arena --------------------------------------------------------------------------------

    def _draw_ground(self, scene: Scene) -> None:
        """Draw the empty arena and its scale bar; anew only if the arena or the view changed."""
        arena = scene.species.arena
        here = (arena, self._view, scene.unit, scene.searching)
        if self._ground is None or self._ground[0] != here:
            self._page.fill(palette.BACKGROUND)
            if arena.shape == "open":
                self._page.fill(palette.ARENA, (0, 0, self.size, self.size))
            else:
                self._draw_edges(arena)
            for x, y, radius in arena.pillars:
                hole = self._at(np.array([x, y])), radius * self._scale
                self._disc(*hole, palette.BACKGROUND)
                self._disc(*hole, palette.OUTLINE, self._width(LINE_WIDTH))
            for name, x, y in arena.landmarks:
                if math.isfinite(x):
                    place = self._at(np.array([x, y]))
                    self._disc(place, LANDMARK * self.size, palette.OUTLINE)
                    left, top = (place + LANDMARK * self.size).tolist()
                    self._write(name, left, top, palette.MUTED_TEXT)
            if arena.shape == "open" or scene.unit != RECORDED_SCALE:
                self._draw_scale(scene)
            self._ground = here, self._page.copy()
        self._page.blit(self._ground[1], (0, 0))

    def _draw_edges(self, arena: Arena) -> None:
        is_square = arena.shape == "square"
        edge = self._at(arena.corners if is_square else _edge(arena.shape, arena.size))
        self._polygon(edge, palette.ARENA)
        if arena.size < arena.boundary <= WIDEST_BOUNDARY * arena.size and not arena.rebound:
            dashes = _dashed(self._at(_edge(arena.shape, arena.boundary)), DASH * self.size)
            for start, end in zip(dashes[:-1:2], dashes[1::2], strict=True):
                self._path(np.stack([start, end]), [palette.BOUNDARY], self._width(LINE_WIDTH))
        line, colours = self._width(LINE_WIDTH), [palette.OUTLINE] * len(edge)
        if arena.shape == "disc":
            self._disc(self._at(np.zeros(2)), arena.size * self._scale, palette.OUTLINE, line)
        else:
            self._path(np.concatenate([edge, edge[:1]]), colours, line)

    def _draw_scale(self, scene: Scene) -> None:
        """Draw a bar of a round length in the lower left corner, and in a search the wind."""
        per_unit = self._scale / scene.unit.per_arena_unit
        length, label = round_length(0.2 * self.size / per_unit, scene.unit.name)
        left, low = 0.04 * self.size, 0.955 * self.size
        bar = (round(left), round(low), round(length * per_unit), self._width(0.005))
        self._page.fill(palette.OUTLINE, bar)
        self._write(label, left, low - 0.034 * self.size, palette.MUTED_TEXT)
        if scene.searching:
            side = 0.09 * self.size
            middle = np.array([self.size - left - side / 2, low])
            self._polygon(_placed(ARROW, middle, 0.0, 0.9 * side), palette.MUTED_TEXT)
            self._write(
                "wind",
                middle[0] - side / 2 - 4,
                low - 0.012 * self.size,
                palette.MUTED_TEXT,
                from_right=True,
            )

    def _draw_plume(self, plume: PlumeField) -> None:
        pygame = self._pygame
        strength = np.clip(plume.values, 0.0, 1.0)[::-1].T  # columns, then rows downwards
        sheet = pygame.Surface(strength.shape, pygame.SRCALPHA, 32)
        sheet.fill((*palette.PLUME, 0))
        opacity = pygame.surfarray.pixels_alpha(sheet)
        opacity[:] = np.round(255 * PLUME_OPACITY * strength * _fading(strength.shape))
        del opacity  # unlocks the surface
        x_low, x_high, y_low, y_high = plume.extent
        edges = self._at(np.array([[x_low, y_high], [x_high, y_low]]))
        corner, opposite = (edges + 0.5).round()
        size = np.maximum(opposite - corner, 1).astype(int).tolist()
        self._page.blit(pygame.transform.smoothscale(sheet, size), corner.tolist())

    def _draw_reach(self, scene: Scene) -> None:
        """Draw the contact radius around every target, and around the source."""
        reach, touched = scene.species.contact_radius * self._scale, scene.touched
        for i, role in enumerate(scene.species.roles):
            if role == "target":
                hue, share = (palette.TOUCH, 0.5) if touched[i] else (palette.TARGET, 0.07)
                self._disc(
                    self._at(scene.positions[i]), reach, palette.mix(palette.ARENA, hue, share)
                )
        if scene.searching:
            source, line = self._at(np.zeros(2)), self._width(0.7 * LINE_WIDTH)
            if touched.any():
                self._disc(source, reach, palette.mix(palette.ARENA, palette.TOUCH, 0.45))
            self._disc(source, reach, palette.PLUME, line)
            dark = palette.mix(palette.PLUME, palette.TARGET, 0.35)
            self._disc(source, 0.008 * self.size, dark)

    # -- the animals ------------------------------------------------------------------------------

    def _draw_paths(self, scene: Scene) -> None:
        """Draw the trails, which fade with age."""
        for i, trail in enumerate(scene.trails.swapaxes(0, 1)):
            own, pieces = colour_of(scene.species.roles[i], i), max(len(trail) - 1, 0)
            young = _fading_colours(own)[:pieces]
            faded = [*[young[-1]] * (pieces - len(young)), *young[::-1]] if young else []
            self._path(self._at(trail), faded, self._width(TRAIL_WIDTH))

    def _draw_bodies(self, scene: Scene) -> None:
        """Draw the antennae and all individuals, the last one on top."""
        species, touched = scene.species, scene.touched
        reach = species.contact_radius * self._scale
        shortest, longest = (share * self.size for share in BODY_LENGTH)
        length = min(max(reach, shortest), longest)
        if scene.antennae is not None:
            to_tip = float(np.hypot(*(scene.antennae[0] - scene.positions[-1]))) * self._scale
            length = min(length, max(1.3 * to_tip, LEAST_BODY * self.size))
            self._draw_antennae(scene, max(to_tip, 0.75 * length))
        for i, name in enumerate(body_of_each(species.bodies, species.roles)):
            halo = touched[i] and species.roles[i] != "target"
            rim = palette.TOUCH if halo else palette.BACKGROUND
            centre, own = self._at(scene.positions[i]), colour_of(species.roles[i], i)
            heading = float(scene.headings[i])
            for part in BODIES[name]:
                if part.rimmed:
                    out = part.outline - part.outline.mean(axis=0)
                    wider = part.outline + RIM * out / np.linalg.norm(out, axis=1, keepdims=True)
                    self._polygon(_placed(wider, centre, heading, length), rim)
            for part in BODIES[name]:
                colour = palette.mix(own, palette.BACKGROUND, part.white)
                self._polygon(_placed(part.outline, centre, heading, length), colour)

    def _draw_antennae(self, scene: Scene, reach: float) -> None:
        """Draw both antennae, lit by the odour at their tips; ``reach`` is in pixels."""
        assert scene.antennae is not None
        root, own = self._at(scene.positions[-1]), colour_of("searcher", 0)
        for tip, smell in zip(scene.antennae, scene.odour, strict=True):
            ahead = self._at(tip) - root
            end = root + ahead * reach / max(float(np.hypot(*ahead)), 1e-9)
            self._path(np.stack([root, end]), [own], self._width(0.8 * LINE_WIDTH))
            lit = palette.mix(palette.BACKGROUND, palette.TOUCH, float(np.clip(smell, 0.0, 1.0)))
            self._disc(end, 0.0085 * self.size, own)
            self._disc(end, 0.006 * self.size, lit)

    # -- text -------------------------------------------------------------------------------------

    def _write_strip(self, scene: Scene) -> None:
        """Write two lines below the field: title and time; the individuals.

        Each individual has its return beside it, except under a title of its own: the animals of
        recordings get no reward.
        """
        species, pad = scene.species, 0.03 * self.size
        right, top = self.size - pad, 1.016 * self.size
        clock, title = f"{scene.step * species.dt:.1f} s", scene.title or species.title
        while self._font.size(title + clock)[0] > right - 2 * pad and len(title) > 1:
            title = f"{title[:-2]}\u2026"
        x = self._write(title, pad, top, palette.TEXT)
        room = right - pad - x
        condition = f"  \u00b7  {scene.condition}" if scene.condition else ""
        longer = f"{clock}   step {scene.step}"
        if self._font.size(condition + longer)[0] <= room:
            clock = longer
        if self._font.size(condition + clock)[0] <= room:
            self._write(condition, x, top, palette.MUTED_TEXT)
        self._write(clock, right, top, palette.MUTED_TEXT, from_right=True)
        x, top = pad, top + max(0.045 * self.size, 1.05 * self._text_size)
        if scene.note:
            self._write(scene.note, right, top, palette.TEXT, from_right=True)
            right -= self._font.size(scene.note)[0] + pad
        for i, name in enumerate(species.individuals):
            label, left = name, len(species.individuals) - i
            if not scene.title:
                label += f"  {scene.rewards[i]:+.1f}"
            more = f"and {left} more"
            width = self._font.size(label)[0] + 0.03 * self.size
            if x + width + (self._font.size(more)[0] if left > 1 else 0) > right:
                self._write(more, x, top, palette.MUTED_TEXT)
                return
            key = np.array([x + 0.009 * self.size, top + 0.5 * self._text_size])
            self._disc(key, 0.0083 * self.size, colour_of(species.roles[i], i))
            x = self._write(label, x + 0.024 * self.size, top, palette.TEXT) + 0.03 * self.size

    def _write(
        self, text: str, x: float, top: float, colour: RGB, *, from_right: bool = False
    ) -> float:
        """Write one line of text; returns where it ends [px]."""
        drawn = self._font.render(text, True, colour)
        left = round(x - drawn.get_width() if from_right else x)
        self._page.blit(drawn, (left, round(top)))
        return float(left + drawn.get_width())


@lru_cache(maxsize=64)
def _fading_colours(colour: RGB) -> list[RGB]:
    """Return the colours of a trail's pieces, the youngest first, until nothing fades further."""
    first, last = TRAIL_OPACITY
    shares = last + (first - last) * np.exp(-np.arange(round(5 * TRAIL_FADE)) / TRAIL_FADE)
    return [palette.mix(palette.ARENA, colour, share) for share in shares.tolist()]


def _placed(shape: Points, centre: Points, heading: float, length: float) -> Floats:
    """Return a shape of the body frame in pixels: turned to ``heading`` (y up), scaled, moved."""
    cos, sin = math.cos(heading), math.sin(heading)
    return np.asarray(centre + length * (shape @ np.array([(cos, -sin), (-sin, -cos)])))


def _edge(shape: str, size: float) -> Floats:
    if shape == "disc":
        around = np.linspace(0, 2 * np.pi, 240, endpoint=False)
        return size * np.stack([np.cos(around), np.sin(around)], axis=-1)
    return size * np.array([(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)])


def _dashed(points: Points, spacing: float) -> Floats:
    """Return the ends of dashes ``(2 n, 2)`` along a closed line, about ``spacing`` apart."""
    closed = np.concatenate([points, points[:1]])
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(closed, axis=0).T))])
    wanted = np.linspace(0.0, along[-1], 2 * round(along[-1] / spacing / 2) + 1)[:-1]
    return np.stack([np.interp(wanted, along, closed[:, k]) for k in range(2)], axis=-1)


@lru_cache(maxsize=8)
def _fading(shape: tuple[int, int]) -> Floats:
    """Return opacity: 1 within the field, falling to 0 towards its ends and sides."""
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


def round_length(longest: float, unit: str) -> tuple[float, str]:
    """Return the longest of 1, 2 or 5 times a power of ten up to ``longest``, and its label.

    ``unit`` is that of ``longest``; metres are written as m, cm or mm.
    """
    power = 10.0 ** math.floor(math.log10(longest))
    length = max(m * power for m in (1, 2, 5) if m * power <= longest * (1 + 1e-9))
    if unit == "m":
        for name, factor in (("m", 1.0), ("cm", 100.0), ("mm", 1000.0)):
            if length * factor >= 1 - 1e-9:
                return length, f"{length * factor:g} {name}"
    return length, f"{length:g} {unit}"


class Pictures:
    """Pictures of the first copies of ``world``, recorded step by step and drawn on request.

    Without a ``render_mode`` nothing is recorded or drawn. ``"human"``: of one copy.
    """

    def __init__(self, world: World, render_mode: str | None) -> None:
        self.render_mode, self.num_copies = render_mode, world.num_copies
        self.frame_rate = round(1.0 / world.scenario.species.dt)  # [Hz], real time
        drawn = min(world.num_copies, MOST_DRAWN) if render_mode is not None else 0
        self.columns = math.ceil(math.sqrt(drawn))
        self._recorders = [SceneRecorder(world, copy) for copy in range(drawn)]
        self._renderer: Renderer | None = None

    def follow(self, begun: Iterable[bool], stepped: bool = True) -> None:
        """Restart the copies that have ``begun``; record a step of the others, if any.

        In a window, show it.
        """
        for recorder, new in zip(self._recorders, begun, strict=False):
            if new:
                recorder.start()
            elif stepped:
                recorder.follow()
        if self.render_mode == "human":
            self.draw()

    def draw(self) -> list[NDArray[np.uint8]]:
        """Return a picture ``(height, width, 3)`` of each copy, blank where it is not drawn.

        In a window: none.
        """
        if self.render_mode is None:
            raise InputError("nothing can be rendered: make the environment with render_mode=")
        if self._renderer is None:
            self._renderer = Renderer(self.render_mode, SIZE // self.columns, self.frame_rate)
        pictures = [self._renderer.draw(recorder.scene()) for recorder in self._recorders]
        drawn = [pixels for pixels in pictures if pixels is not None]
        rest = range(self.num_copies - len(drawn))
        return drawn + [np.full_like(p, palette.BACKGROUND) for p in drawn[:1] for _ in rest]

    def close(self) -> None:
        """Close the window, if any."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None


# -- clips ----------------------------------------------------------------------------------------

CLIP_SUFFIXES = (".gif", ".mp4")
GIF_COLOURS = 128  # of a palette
GIF_ERROR = 32  # of 255, by which a colour may miss before a frame gets another palette


def write_clip(frames: Iterable[NDArray[np.uint8]], path: str | Path, fps: float = 10.0) -> Path:
    """Write pictures ``(height, width, 3)`` uint8, all alike, as a ``.gif`` or an ``.mp4`` (H.264).

    They are taken one by one, and the file appears when it is complete; a gif keeps time in
    hundredths of a second. Raises InputError: for another suffix, an impossible ``fps`` or no
    frames at all. Raises MissingExtraError if imageio, or ffmpeg for an mp4, is not installed.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in CLIP_SUFFIXES:
        raise InputError(f"{path}: a clip cannot be written as {suffix!r}: use .gif or .mp4")
    if not 0 < fps < math.inf:
        raise InputError(f"fps is {fps!r}: it must be a positive number")
    with require_extra("writing a clip", "render"):
        import imageio.v2 as imageio
        from PIL import Image

    def reduced(pictures: Iterable[NDArray[np.uint8]]) -> Iterator[Any]:
        """Yield pictures in few colours, those of the last while they fit: a file stays small."""
        palette, plain = None, Image.Dither.NONE
        for picture in pictures:
            image = Image.fromarray(picture)
            kept = None if palette is None else image.quantize(palette=palette, dither=plain)
            if (
                kept is None
                or np.abs(np.asarray(kept.convert("RGB"), dtype=int) - picture).max() > GIF_ERROR
            ):
                method = Image.Quantize.MEDIANCUT
                palette = kept = image.quantize(GIF_COLOURS, method=method, dither=plain)
            yield kept

    taken = iter(frames)
    with write_then_rename(path) as part:
        first = next(taken, None)
        if first is None:
            raise InputError(f"{path}: there is no frame to write: run at least one step")
        if suffix == ".gif":
            images = reduced(chain([first], taken))
            next(images).save(
                part,
                "GIF",
                save_all=True,
                append_images=images,
                loop=0,
                duration=1000.0 / fps,
            )
            return path
        options: Any = {"fps": fps, "codec": "libx264", "quality": 8, "macro_block_size": 2}
        writer: Any = imageio.get_writer(part, **options)
        with writer:
            for frame in chain([first], taken):
                writer.append_data(frame)
    return path
