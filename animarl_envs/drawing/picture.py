"""The picture of a view: who moved is recorded step by step and drawn when asked for."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from animarl_envs.errors import InputError
from animarl_envs.worlds.base import World

if TYPE_CHECKING:
    from animarl_envs.drawing.render import Renderer
    from animarl_envs.drawing.scene import SceneRecorder

RENDER_MODES = ("human", "rgb_array")


class Picture:
    """Of the first copy of ``world``; without a ``render_mode`` nothing is recorded or drawn.

    What draws is loaded when the first picture is.

    Raises
    ------
    InputError
        If there is no such mode.
    """

    def __init__(self, world: World, render_mode: str | None) -> None:
        if render_mode is not None and render_mode not in RENDER_MODES:
            raise InputError(f"render_mode is {render_mode!r}: choose 'human' or 'rgb_array'")
        self.world, self.render_mode = world, render_mode
        self.frame_rate = round(1.0 / world.scenario.species.dt)  # [Hz], real time
        self._recorder: SceneRecorder | None = None
        self._renderer: Renderer | None = None

    def start(self) -> None:
        """A new episode begins."""
        self._record().start()

    def follow(self) -> None:
        """A step was taken."""
        self._record().follow()

    def draw(self) -> NDArray[np.uint8] | None:
        """The present scene as ``(height, width, 3)`` uint8, or in a window."""
        if self.render_mode is None:
            raise InputError("nothing can be rendered: make the environment with render_mode=")
        if self._renderer is None:
            from animarl_envs.drawing.render import Renderer

            self._renderer = Renderer(
                self.render_mode,  # type: ignore[arg-type]
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

            self._recorder = SceneRecorder(self.world)
        return self._recorder
