"""Write the README's moving picture: demonstrated beside simulated animals from the same starts.

python docs/make_readme_clip.py
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import zip_longest
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from animarl_algos.cli.watch import play, prepare
from animarl_envs.drawing.render import Renderer, write_clip

CLIP = Path(__file__).with_name("images") / "demo.gif"
MODEL, ENV = "agent", "AnimaRL/Agent-v0"
SIZE, TITLE, FPS = 300, 22, 10.0


def side(model: str | None, seed: int, episodes: int, steps: int | None) -> Iterator[Image.Image]:
    """Yield the pictures of test episodes, simulated by a packaged model or as demonstrated."""
    world, actor = prepare(ENV, model=model, seed=seed, demos="packaged", split="test")
    world.seed([seed])
    renderer = Renderer("rgb_array", size=SIZE, fps=FPS)
    for picture in play(world, actor, renderer, episodes=episodes, steps=steps):
        yield titled(picture, "simulated" if model else "demonstrated (synthetic)")
    renderer.close()


def titled(picture: NDArray[np.uint8], title: str) -> Image.Image:
    """Return a picture with its title above."""
    height, width = picture.shape[:2]
    page = Image.new("RGB", (width, height + TITLE), "white")
    ImageDraw.Draw(page).text((6, 4), title, fill="black")
    page.paste(Image.fromarray(picture), (0, TITLE))
    return page


def main(out: Path = CLIP, seed: int = 0, episodes: int = 2, steps: int | None = None) -> None:
    """Write the clip; the side whose episode ends first waits for the other."""
    frames = []
    for episode in range(episodes):
        pair = [side(model, seed + episode, 1, steps) for model in (None, MODEL)]
        last: list[Image.Image] = []
        for shown in zip_longest(*pair):
            last = [new or old for new, old in zip_longest(shown, last)]
            frames.append(np.concatenate([np.asarray(picture) for picture in last], axis=1))
    write_clip(frames, out, FPS)
    print(f"wrote {out} ({out.stat().st_size / 1e6:.2f} MB, {len(frames)} frames)")


if __name__ == "__main__":
    main()
