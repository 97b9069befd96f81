"""The colours, shared by the renderer and the figures.

The hues are those of Okabe and Ito (2008), distinguishable with every common colour vision
deficiency; the target is near-black, as in the paper. Colours are RGB triples, 0 to 255, so that
this file needs no plotting library; :func:`to_hex` and :func:`to_unit` give the other forms.
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
"""The virtual boundary, dashed."""
PLUME: RGB = (196, 132, 22)
DEMONSTRATION: RGB = (150, 148, 144)
"""The recorded path, where it is shown beneath a simulated one."""
TEXT: RGB = (52, 52, 56)
MUTED_TEXT: RGB = (122, 120, 116)

RECORDED: RGB = (120, 118, 112)
"""Recordings, in figures of simulated over recorded data."""
SIMULATED: RGB = (0, 114, 178)

TRAIL_ALPHA = 0.85
"""Opacity of a trail at the body ..."""
TRAIL_FLOOR = 0.16
"""... and far behind it."""
PLUME_ALPHA = 0.55
"""Opacity of the plume at concentration 1."""


def pursuer(index: int) -> RGB:
    """The colour of pursuer ``index``; the hues repeat after the last."""
    return PURSUERS[index % len(PURSUERS)]


def mix(first: RGB, second: RGB, share: float) -> RGB:
    """``first`` with a ``share`` in [0, 1] of ``second``."""
    red, green, blue = (round(a + (b - a) * share) for a, b in zip(first, second, strict=True))
    return red, green, blue


def to_hex(colour: RGB) -> str:
    """``"#rrggbb"``, for style sheets and plotting libraries."""
    return "#{:02x}{:02x}{:02x}".format(*colour)


def to_unit(colour: RGB) -> tuple[float, float, float]:
    """The triple in 0 to 1."""
    red, green, blue = colour
    return red / 255, green / 255, blue / 255
