"""The pictures of a view: motion is recorded step by step and drawn on request."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from animarl_envs.drawing.palette import BACKGROUND
from animarl_envs.errors import InputError
from animarl_envs.worlds.base import World

if TYPE_CHECKING:
    from animarl_envs.drawing.render import Renderer
    from animarl_envs.drawing.scene import SceneRecorder

RENDER_MODES = ("human", "rgb_array")
MOST_DRAWN = 9
"""Copies of a vector environment that are drawn, three in a row."""
SIZE = 600  # width of a picture, or of a row of them [px]


class Picture:
    """Pictures of one copy of ``world``; without a ``render_mode`` nothing is recorded or drawn.

    What draws is loaded when the first picture is.

    Raises
    ------
    InputError
        If there is no such mode.
    """

    def __init__(
        self, world: World, render_mode: str | None, copy: int = 0, size: int = SIZE
    ) -> None:
        if render_mode is not None and render_mode not in RENDER_MODES:
            raise InputError(f"render_mode is {render_mode!r}: choose 'human' or 'rgb_array'")
        self.world, self.render_mode = world, render_mode
        self.copy, self.size = copy, size
        self.frame_rate = round(1.0 / world.scenario.species.dt)  # [Hz], real time
        self._recorder: SceneRecorder | None = None
        self._renderer: Renderer | None = None

    def start(self) -> None:
        """Begin to record a new episode."""
        self._record().start()

    def follow(self) -> None:
        """Record the step that was taken."""
        self._record().follow()

    def draw(self) -> NDArray[np.uint8] | None:
        """The present scene as ``(height, width, 3)`` uint8, or in a window."""
        if self.render_mode is None:
            raise InputError("nothing can be rendered: make the environment with render_mode=")
        if self._renderer is None:
            from animarl_envs.drawing.render import Renderer

            self._renderer = Renderer(
                self.render_mode,  # type: ignore[arg-type]
                self.size,
                fps=self.frame_rate,
            )
        return self._renderer.draw(self._record().scene())

    def close(self) -> None:
        """Close the window, if any."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None

    def _record(self) -> SceneRecorder:
        if self._recorder is None:
            from animarl_envs.drawing.scene import SceneRecorder

            self._recorder = SceneRecorder(self.world, self.copy)
        return self._recorder


class Pictures:
    """Pictures of the first copies of ``world``, each of which is reset by itself.

    Raises
    ------
    InputError
        If the ``render_mode`` is neither ``"rgb_array"`` nor ``None``.
    """

    def __init__(self, world: World, render_mode: str | None) -> None:
        if render_mode not in (None, "rgb_array"):
            raise InputError(
                f"render_mode is {render_mode!r}: choose 'rgb_array' or None for many copies, or "
                "show one with gym.make"
            )
        self.num_copies = world.num_copies
        drawn = min(world.num_copies, MOST_DRAWN)
        self.columns = math.ceil(math.sqrt(drawn))
        size = SIZE // self.columns
        self._all = [Picture(world, render_mode, copy, size) for copy in range(drawn)]
        self.frame_rate = self._all[0].frame_rate
        self._recording = render_mode is not None

    def start(self, begun: NDArray[np.bool_]) -> None:
        """Begin to record new episodes where ``begun`` is true."""
        if self._recording:
            for picture, new in zip(self._all, begun.tolist(), strict=False):
                if new:
                    picture.start()

    def follow(self, begun: NDArray[np.bool_]) -> None:
        """Record a step of all copies but those that have ``begun`` anew in it."""
        if self._recording:
            self.start(begun)
            for picture, new in zip(self._all, begun.tolist(), strict=False):
                if not new:
                    picture.follow()

    def draw(self) -> tuple[NDArray[np.uint8], ...]:
        """A picture ``(height, width, 3)`` of each copy, blank where it is not drawn."""
        drawn = self._drawn()
        blank = np.full_like(drawn[0], BACKGROUND)
        return (*drawn, *(blank.copy() for _ in range(self.num_copies - len(drawn))))

    def grid(self) -> NDArray[np.uint8]:
        """One picture of all copies that are drawn, in rows."""
        drawn = self._drawn()
        rows = math.ceil(len(drawn) / self.columns)
        blank = np.full_like(drawn[0], BACKGROUND)
        places = drawn + [blank] * (rows * self.columns - len(drawn))
        return np.concatenate(
            [
                np.concatenate(places[k : k + self.columns], axis=1)
                for k in range(0, len(places), self.columns)
            ]
        )

    def _drawn(self) -> list[NDArray[np.uint8]]:
        shown = [picture.draw() for picture in self._all]
        return [pixels for pixels in shown if pixels is not None]
