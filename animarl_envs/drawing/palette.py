"""The colours of pictures and figures.

The hues are those of Okabe and Ito (2008), distinguishable with every common colour vision
deficiency; the target is near-black, as in the paper. Colours are RGB triples, 0 to 255, so that
this file needs no plotting library.
"""

from __future__ import annotations

RGB = tuple[int, int, int]

PURSUERS: tuple[RGB, ...] = (
    (0, 114, 178),  # blue
    (213, 94, 0),  # vermilion
    (0, 148, 110),  # bluish green
    (178, 96, 146),  # reddish purple
    (64, 160, 215),  # sky blue
    (204, 140, 0),  # orange
)
"""One hue per pursuer or searcher, in order; they repeat after the last."""
TARGET: RGB = (34, 34, 38)
TOUCH: RGB = (230, 159, 0)
"""Contact, and a source that was reached."""
BACKGROUND: RGB = (255, 255, 255)
ARENA: RGB = (247, 246, 242)
"""The floor of the arena."""
OUTLINE: RGB = (120, 118, 112)
BOUNDARY: RGB = (190, 187, 180)
PLUME: RGB = (196, 132, 22)
TEXT: RGB = (52, 52, 56)
MUTED_TEXT: RGB = (122, 120, 116)
RECORDED: RGB = (120, 118, 112)
"""Recordings, in figures of simulated over recorded data."""
SIMULATED: RGB = (0, 114, 178)


def colour_of(role: str, index: int) -> RGB:
    """Return the colour of individual ``index``."""
    return TARGET if role == "target" else PURSUERS[index % len(PURSUERS)]


def mix(first: RGB, second: RGB, share: float) -> RGB:
    """Return ``first`` with a ``share`` in [0, 1] of ``second``."""
    red, green, blue = (round(a + (b - a) * share) for a, b in zip(first, second, strict=True))
    return red, green, blue


def to_hex(colour: RGB) -> str:
    """Return ``"#rrggbb"``, for style sheets and plotting libraries."""
    return "#{:02x}{:02x}{:02x}".format(*colour)
