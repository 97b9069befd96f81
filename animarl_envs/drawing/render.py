"""Drawing scenes with pygame: a picture for a window or as an array.

What stays from picture to picture (arena, texts) is drawn once and kept. The same scene gives the
same pixels, with or without a display.
"""

from __future__ import annotations

import math
import os
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from animarl_envs.arena import Arena
from animarl_envs.drawing import palette
from animarl_envs.drawing.canvas import SUPERSAMPLING, Canvas, View, view_of
from animarl_envs.drawing.clips import CLIP_SUFFIXES, write_clip
from animarl_envs.drawing.palette import RGB
from animarl_envs.drawing.scene import Scene
from animarl_envs.drawing.sketch import (
    draw_arena,
    draw_bodies,
    draw_odour,
    draw_paths,
    draw_reach,
)
from animarl_envs.errors import InputError, MissingExtraError

if TYPE_CHECKING:
    from pygame import Surface

__all__ = ["CLIP_SUFFIXES", "RenderMode", "Renderer", "round_length", "write_clip"]

RenderMode = Literal["rgb_array", "human"]
TEXT_SUPERSAMPLING = 4
MOST_TEXTS = 256  # texts that are kept as they were drawn: most stay from picture to picture
STRIP = 0.12  # height of the text strip, in widths of the picture


class Renderer:
    """Draws scenes.

    Parameters
    ----------
    mode
        ``"rgb_array"``: :meth:`draw` returns an array and needs no display. ``"human"``: it shows
        the picture in a window and waits so that at most ``fps`` pictures a second are shown.
    size
        Width of the picture, and height of the field in it [px]; a strip of text stands below.
    fps
        Frames per second of the window.

    Raises
    ------
    MissingExtraError
        If pygame-ce is not installed.
    InputError
        If a value is out of range, or a window is wanted where there is no display.
    """

    def __init__(self, mode: RenderMode, size: int = 600, fps: float = 10.0) -> None:
        if mode not in ("rgb_array", "human"):
            raise InputError(f"render_mode is {mode!r}: choose 'rgb_array' or 'human'")
        if not (isinstance(size, int) and 100 <= size <= 4000):
            raise InputError(f"size is {size!r}: give a whole number of pixels, 100 to 4000")
        if not 0 < fps < math.inf:
            raise InputError(f"fps is {fps!r}: it must be a positive number")
        self.mode = mode
        self.size = size
        self.fps = fps
        self.closed = False
        """Whether the user has closed the window; :meth:`draw` then shows nothing."""
        self._pygame = _import_pygame()
        self._pygame.font.init()
        self._fonts: dict[int, Any] = {}
        self._texts: dict[tuple[str, RGB], Surface] = {}
        self._ground: tuple[tuple[Arena, View, str, float | None], Surface] | None = None
        self._sheet: Surface = self._pygame.Surface((self.size, self.height), 0, 32)
        self._window: Surface | None = None
        self._clock: Any = None

    def __reduce__(self) -> tuple[Any, ...]:
        """A copy or a pickle draws alike, and opens a window of its own."""
        return type(self), (self.mode, self.size, self.fps)

    @property
    def height(self) -> int:
        """Height of the picture [px]."""
        return self.size + 2 * round(STRIP * self.size / 2)

    def draw(self, scene: Scene) -> NDArray[np.uint8] | None:
        """Draw a scene: ``(height, width, 3)`` uint8 as an array, or ``None`` in a window."""
        picture = self._picture(scene)
        if self.mode == "human":
            self._show(picture, scene.title)
            return None
        # Onto a surface whose memory is the array: faster than any of pygame's own conversions.
        pixels = np.empty((self.height, self.size, 3), dtype=np.uint8)
        there = self._pygame.image.frombuffer(pixels, picture.get_size(), "RGB")
        there.blit(picture, (0, 0))
        return pixels

    def close(self) -> None:
        """Close the window, if any. Closing twice is harmless."""
        self._fonts.clear()
        self._texts.clear()
        if self._window is not None:
            self._pygame.display.quit()
            self._window = None

    def _picture(self, scene: Scene) -> Surface:
        view = view_of(scene)
        picture = self._page(scene, view)
        field = picture.subsurface((0, 0, self.size, self.size))
        canvas = Canvas(self._pygame, field, self.size, view)
        draw_odour(canvas, scene)
        draw_reach(canvas, scene)
        draw_paths(canvas, scene)
        draw_bodies(canvas, scene)
        self._write_strip(picture, scene)
        return picture

    def _page(self, scene: Scene, view: View) -> Surface:
        """The empty arena with the strip below it, drawn anew only if it is another one."""
        here = (scene.arena, view, scene.unit, scene.wind)
        if self._ground is None or self._ground[0] != here:
            pygame, large = self._pygame, self.size * SUPERSAMPLING
            ground = pygame.Surface((large, large), 0, 32)
            ground.fill(palette.BACKGROUND)
            draw_arena(Canvas(pygame, ground, large, view), scene.arena)
            page = pygame.Surface((self.size, self.height), 0, 32)
            page.fill(palette.BACKGROUND)
            page.blit(pygame.transform.smoothscale(ground, (self.size,) * 2), (0, 0))
            if scene.arena.shape == "open" or scene.unit != Scene.unit:
                self._draw_scale_bar(page, scene, self.size / (2 * view.half))
            self._ground = here, page
        self._sheet.blit(self._ground[1], (0, 0))
        return self._sheet

    def _show(self, picture: Surface, title: str) -> None:
        pygame = self._pygame
        if self.closed:
            return
        if self._window is None:
            try:
                pygame.display.init()
                self._window = pygame.display.set_mode(picture.get_size())
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
        self._window.blit(picture, (0, 0))
        pygame.display.flip()
        self._clock.tick(self.fps)

    # -- text -------------------------------------------------------------------------------------

    def _write_strip(self, picture: Surface, scene: Scene) -> None:
        """Two lines beneath the field: what and when; who has earned how much."""
        pad, line = 0.03 * self.size, 0.045 * self.size
        right = self.size - pad
        top = self.size + 0.016 * self.size
        x = self._write(picture, scene.title, pad, top, palette.TEXT)
        if scene.condition:
            self._write(picture, f"  \u00b7  {scene.condition}", x, top, palette.MUTED_TEXT)
        clock = f"{scene.time:.1f} s   step {scene.step}"
        self._write(picture, clock, right, top, palette.MUTED_TEXT, from_right=True)

        x, top = pad, top + line
        if scene.note:
            self._write(picture, scene.note, right, top, palette.TEXT, from_right=True)
            right -= self._text_width(scene.note) + pad
        for i, (name, role) in enumerate(zip(scene.names, scene.roles, strict=True)):
            colour = palette.TARGET if role == "target" else palette.pursuer(i)
            label = f"{name}  {scene.rewards[i]:+.1f}"
            left = len(scene.names) - i
            more = f"and {left} more"
            width = self._text_width(label) + 0.03 * self.size
            rest = self._text_width(more) if left > 1 else 0.0
            if x + width + rest > right:
                self._write(picture, more, x, top, palette.MUTED_TEXT)
                return
            self._dot(picture, x, top, colour)
            x = self._write(picture, label, x + 0.024 * self.size, top, palette.TEXT)
            x += 0.03 * self.size

    @property
    def _text_size(self) -> int:
        return max(9, round(0.024 * self.size))

    def _dot(self, picture: Surface, x: float, top: float, colour: RGB) -> None:
        """The colour key of an individual, at the height of the text."""
        side = 0.018 * self.size
        canvas = Canvas(self._pygame, picture, self.size, View(0.0, 0.0, 1.0))
        canvas.disc(
            np.array([x + side / 2, top + 0.1 * self._text_size + 0.4 * side]), 0.46 * side, colour
        )

    def _font(self, size: int) -> Any:
        if size not in self._fonts:
            self._fonts[size] = self._pygame.font.Font(None, size * TEXT_SUPERSAMPLING)
        return self._fonts[size]

    def _text_width(self, text: str) -> float:
        return float(self._font(self._text_size).size(text)[0]) / TEXT_SUPERSAMPLING

    def _write(
        self,
        picture: Surface,
        text: str,
        x: float,
        top: float,
        colour: RGB,
        from_right: bool = False,
    ) -> float:
        """Write one line of text; returns where it ends [px]."""
        drawn = self._text(text, colour)
        width = drawn.get_width()
        left = round(x - width if from_right else x)
        picture.blit(drawn, (left, round(top)))
        return float(left + width)

    def _text(self, text: str, colour: RGB) -> Surface:
        """A line of text, drawn anew only if it is not among the last."""
        if (text, colour) not in self._texts:
            if len(self._texts) == MOST_TEXTS:
                del self._texts[next(iter(self._texts))]
            large = self._font(self._text_size).render(text, True, colour)
            width = math.ceil(large.get_width() / TEXT_SUPERSAMPLING)
            size = (width, large.get_height() // TEXT_SUPERSAMPLING)
            self._texts[text, colour] = self._pygame.transform.smoothscale(large, size)
        return self._texts[text, colour]

    def _draw_scale_bar(self, picture: Surface, scene: Scene, scale: float) -> None:
        """A bar of a round length in the lower left corner, and the wind above it.

        ``scale`` in px per arena unit.
        """
        unit = scene.per_arena_unit
        length, label = round_length(0.2 * self.size / scale * unit, scene.unit)
        left, low = 0.04 * self.size, 0.955 * self.size
        draw, thick = self._pygame.draw, max(2, round(0.005 * self.size))
        bar = (round(left), round(low), round(length / unit * scale), thick)
        draw.rect(picture, palette.OUTLINE, bar)
        self._write(picture, label, left, low - 0.034 * self.size, palette.MUTED_TEXT)
        if scene.wind is None:
            return
        side = round(0.09 * self.size)
        corner = (round(self.size - left - side), round(low - 0.5 * side))
        sheet = picture.subsurface((*corner, side, side))
        Canvas(self._pygame, sheet, side, View(0.0, 0.0, 1.0)).arrow(scene.wind, palette.MUTED_TEXT)
        width = self._text_width("wind")
        self._write(
            picture, "wind", corner[0] - width - 4, low - 0.012 * self.size, palette.MUTED_TEXT
        )


def round_length(longest: float, unit: str) -> tuple[float, str]:
    """The longest of 1, 2 or 5 times a power of ten up to ``longest``, and its label.

    ``unit`` is that of ``longest``; metres are written as m, cm or mm.
    """
    power = 10.0 ** math.floor(math.log10(longest))
    length = max(m * power for m in (1, 2, 5) if m * power <= longest * (1 + 1e-9))
    if unit == "m":
        for shown, factor in (("m", 1.0), ("cm", 100.0), ("mm", 1000.0)):
            if length * factor >= 1 - 1e-9:
                return length, f"{length * factor:g} {shown}"
    return length, f"{length:g} {unit}"


def _import_pygame() -> Any:
    os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")
    try:
        import pygame
    except ModuleNotFoundError as error:
        raise MissingExtraError("drawing", "render") from error
    return pygame
