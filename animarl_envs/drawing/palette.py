"""The colours of pictures and figures, and the bodies of the animals.

The hues are those of Okabe and Ito (2008), distinguishable with every common colour vision
deficiency; the target is near-black, as in the paper. Colours are RGB triples, 0 to 255, so that
this file needs no plotting library.

Bodies are outlines of length about 1 that look along x, seen from above. What a species looks like
is its field ``bodies``. The shapes are drawn by hand, to be recognised at thirty pixels, and
measure nothing.
"""

from typing import NamedTuple

import numpy as np

from animarl_envs.array_types import Floats

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


Outline = Floats
WING, PALE = 0.5, 0.85  # shares of white


class Part(NamedTuple):
    """A filled outline ``(n, 2)`` in the body frame [body length].

    ``white`` is the share of white in its colour; ``rimmed``: a white rim sets it off.
    """

    outline: Outline
    white: float = 0.0
    rimmed: bool = True


Body = tuple[Part, ...]
"""Parts, drawn in order."""

_AROUND = np.linspace(0.0, 2 * np.pi, 32, endpoint=False)


def _ellipse(x: float, y: float, length: float, width: float, turn: float = 0.0) -> Outline:
    """Return an ellipse centred at ``(x, y)``, turned by ``turn`` [degrees]."""
    cos, sin = np.cos(np.radians(turn)), np.sin(np.radians(turn))
    along, across = 0.5 * length * np.cos(_AROUND), 0.5 * width * np.sin(_AROUND)
    return np.stack([x + cos * along - sin * across, y + sin * along + cos * across], axis=-1)


def _both(outline: Outline, white: float = 0.0, rimmed: bool = True) -> Body:
    """Return the part on the left and its mirror image on the right."""
    return Part(outline, white, rimmed), Part(outline * (1.0, -1.0), white, rimmed)


def _ribbon(spine: list[tuple[float, float, float]]) -> Outline:
    """Return a band along points ``(x, y, width)`` of a spine, smoothed between them."""
    x, y, width = np.array(spine).T
    at, fine = np.arange(len(spine)), np.linspace(0.0, len(spine) - 1.0, 4 * len(spine))
    middle = np.stack([np.interp(fine, at, x), np.interp(fine, at, y)], axis=-1)
    half = 0.5 * np.interp(fine, at, width)[:, None]
    ahead = np.gradient(middle, axis=0)
    aside = np.stack([-ahead[:, 1], ahead[:, 0]], axis=-1)
    aside /= np.linalg.norm(aside, axis=1, keepdims=True)
    return np.concatenate([middle + half * aside, (middle - half * aside)[::-1]])


def _eyes(x: float, y: float, size: float = 0.11) -> Body:
    return _both(_ellipse(x, y, size, size), PALE, rimmed=False)


_DROP = np.stack(
    [-0.5 * np.cos(_AROUND) + 0.05, 0.40 * np.sin(_AROUND) * np.sin(_AROUND / 2) ** 1.3], axis=-1
)
_FIN = np.array([(0.12, 0.14), (-0.22, 0.42), (-0.12, 0.12)])
_FOREWING = np.array([(0.24, 0.05), (0.30, 0.42), (0.16, 0.60), (-0.08, 0.46), (-0.16, 0.06)])
_HINDWING = np.array([(-0.02, 0.06), (-0.12, 0.44), (-0.36, 0.40), (-0.44, 0.16), (-0.28, 0.04)])
_ARROWHEAD = np.array(
    [(0.60, 0.0), (0.36, 0.15), (0.0, 0.25), (-0.50, 0.40), (-0.30, 0.0)]
    + [(-0.50, -0.40), (0.0, -0.25), (0.36, -0.15)]
)
_NEWT = _ribbon(
    [(0.62, 0.0, 0.12), (0.54, 0.0, 0.25), (0.42, 0.0, 0.25), (0.34, 0.0, 0.19)]
    + [(0.14, 0.0, 0.26), (-0.10, 0.0, 0.21), (-0.28, 0.03, 0.15)]
    + [(-0.48, 0.10, 0.12), (-0.68, 0.11, 0.09), (-0.86, 0.04, 0.03)]
)

BODIES: dict[str, Body] = {
    "animal": (Part(_DROP), *_eyes(0.36, 0.13)),
    "predator": (Part(_ARROWHEAD), *_eyes(0.26, 0.10, 0.10)),
    "prey": (*_both(_FIN), Part(_ellipse(0.02, 0.0, 0.86, 0.50)), *_eyes(0.28, 0.13)),
    "fly": (
        Part(_ellipse(-0.16, 0.0, 0.58, 0.30)),
        *_both(_ellipse(-0.24, 0.20, 0.74, 0.24, -20.0), WING),
        Part(_ellipse(0.16, 0.0, 0.36, 0.30)),
        Part(_ellipse(0.40, 0.0, 0.20, 0.34)),
        *_eyes(0.42, 0.12, 0.13),
    ),
    "newt": (
        *_both(_ribbon([(0.20, 0.06, 0.09), (0.28, 0.26, 0.07), (0.40, 0.28, 0.05)])),
        *_both(_ribbon([(-0.12, 0.06, 0.09), (-0.20, 0.25, 0.07), (-0.32, 0.27, 0.05)])),
        Part(_NEWT),
        *_eyes(0.52, 0.08, 0.08),
    ),
    "moth": (
        *_both(_HINDWING, WING),
        *_both(_FOREWING, WING),
        Part(_ellipse(-0.04, 0.0, 0.62, 0.19)),
        Part(_ellipse(0.30, 0.0, 0.18, 0.18)),
    ),
}
"""By the names that a species may give in ``bodies``."""
