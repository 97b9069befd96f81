"""Pictures as a clip: an animated gif, or an mp4."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from animarl_envs.errors import InputError, MissingExtraError
from animarl_envs.files import write_then_rename

CLIP_SUFFIXES = (".gif", ".mp4")
GIF_COLOURS = 128  # of each frame


def write_clip(frames: Iterable[NDArray[np.uint8]], path: str | Path, fps: float = 10.0) -> Path:
    """Write pictures as an animated ``.gif`` or an ``.mp4`` (H.264).

    Parameters
    ----------
    frames
        Pictures ``(height, width, 3)`` uint8, all of one shape; taken one by one.
    path
        Where to; the file appears when it is complete.
    fps
        Frames per second; a gif keeps time in hundredths of a second.

    Raises
    ------
    InputError
        For another suffix, an impossible ``fps`` or no frames at all.
    MissingExtraError
        If imageio, or ffmpeg for an mp4, is not installed.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in CLIP_SUFFIXES:
        raise InputError(f"{path}: a clip cannot be written as {suffix!r}: use .gif or .mp4")
    if not 0 < fps < math.inf:
        raise InputError(f"fps is {fps!r}: it must be a positive number")
    counted = _Counted(frames)
    with write_then_rename(path) as part:
        (_write_gif if suffix == ".gif" else _write_mp4)(counted, part, fps)
        if counted.count == 0:
            raise InputError(f"{path}: there is no frame to write: run at least one step")
    return path


class _Counted:
    """Hands frames on and counts them."""

    def __init__(self, frames: Iterable[NDArray[np.uint8]]) -> None:
        self.frames = frames
        self.count = 0

    def __iter__(self) -> Iterator[NDArray[np.uint8]]:
        for frame in self.frames:
            self.count += 1
            yield frame


def _write_mp4(frames: Iterable[NDArray[np.uint8]], part: Path, fps: float) -> None:
    try:
        import imageio.v2 as imageio
    except ModuleNotFoundError as error:
        raise MissingExtraError("writing a clip", "render") from error
    writer: Any = imageio.get_writer(part, fps=fps, codec="libx264", quality=8, macro_block_size=2)
    with writer:
        for frame in frames:
            writer.append_data(frame)


def _write_gif(frames: Iterable[NDArray[np.uint8]], part: Path, fps: float) -> None:
    """Frames in few colours each, without dithering: areas stay even, and the file small."""
    try:
        from PIL import Image
    except ModuleNotFoundError as error:
        raise MissingExtraError("writing a clip", "render") from error

    def reduced() -> Iterator[Image.Image]:
        for frame in frames:
            yield Image.fromarray(frame).quantize(
                GIF_COLOURS, method=Image.Quantize.MEDIANCUT, dither=Image.Dither.NONE
            )

    pictures = reduced()
    first = next(pictures, None)
    if first is not None:
        options = {"duration": 1000.0 / fps, "loop": 0}
        first.save(part, "GIF", save_all=True, append_images=pictures, **options)
