"""The bodies of the animals: outlines of length about 1 that look along x, seen from above.

A :class:`Body` is a list of parts, drawn in order. What a species looks like is said by its field
``bodies``; the shapes are drawn by hand, to be told apart at thirty pixels, and measure nothing.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from animarl_envs.drawing import palette
from animarl_envs.drawing.palette import RGB

Outline = NDArray[np.float64]


class Tone(Enum):
    """How a part takes up the colour of its individual: mixed with white."""

    FULL = 0.0
    WING = 0.5
    PALE = 0.85


@dataclass(frozen=True, eq=False)
class Part:
    """A filled outline ``(n, 2)`` in the body frame [body length]."""

    outline: Outline
    tone: Tone = Tone.FULL
    rimmed: bool = True
    """Whether it stands out from what is behind it by a white rim."""

    def colour(self, own: RGB) -> RGB:
        """Its colour on an individual of colour ``own``."""
        return palette.mix(own, palette.BACKGROUND, self.tone.value)


Body = tuple[Part, ...]

_AROUND = np.linspace(0.0, 2 * np.pi, 32, endpoint=False)


def _ellipse(x: float, y: float, length: float, width: float, turn: float = 0.0) -> Outline:
    """Centred at ``(x, y)``, turned by ``turn`` [degrees]."""
    cos, sin = np.cos(np.radians(turn)), np.sin(np.radians(turn))
    along, across = 0.5 * length * np.cos(_AROUND), 0.5 * width * np.sin(_AROUND)
    return np.stack([x + cos * along - sin * across, y + sin * along + cos * across], axis=-1)


def _mirrored(outline: Outline) -> Outline:
    return outline * (1.0, -1.0)


def _both(outline: Outline, tone: Tone = Tone.FULL, *, rimmed: bool = True) -> Body:
    """The part on the left and the same on the right."""
    return Part(outline, tone, rimmed), Part(_mirrored(outline), tone, rimmed)


def _ribbon(spine: list[tuple[float, float, float]]) -> Outline:
    """Along points ``(x, y, width)`` of a spine, smoothed between them."""
    x, y, width = np.array(spine).T
    at, fine = np.arange(len(spine)), np.linspace(0.0, len(spine) - 1.0, 4 * len(spine))
    middle = np.stack([np.interp(fine, at, x), np.interp(fine, at, y)], axis=-1)
    half = 0.5 * np.interp(fine, at, width)[:, None]
    ahead = np.gradient(middle, axis=0)
    aside = np.stack([-ahead[:, 1], ahead[:, 0]], axis=-1)
    aside /= np.linalg.norm(aside, axis=1, keepdims=True)
    return np.concatenate([middle + half * aside, (middle - half * aside)[::-1]])


def _eyes(x: float, y: float, size: float = 0.11) -> Body:
    return _both(_ellipse(x, y, size, size), Tone.PALE, rimmed=False)


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

BODIES: dict[str, Body] = {
    "animal": (Part(_DROP), *_eyes(0.36, 0.13)),
    "predator": (Part(_ARROWHEAD), *_eyes(0.26, 0.10, 0.10)),
    "prey": (*_both(_FIN), Part(_ellipse(0.02, 0.0, 0.86, 0.50)), *_eyes(0.28, 0.13)),
    "fly": (
        Part(_ellipse(-0.16, 0.0, 0.58, 0.30)),
        *_both(_ellipse(-0.24, 0.20, 0.74, 0.24, -20.0), Tone.WING),
        Part(_ellipse(0.16, 0.0, 0.36, 0.30)),
        Part(_ellipse(0.40, 0.0, 0.20, 0.34)),
        *_eyes(0.42, 0.12, 0.13),
    ),
    "newt": (
        *_both(_ribbon([(0.20, 0.06, 0.09), (0.28, 0.26, 0.07), (0.40, 0.28, 0.05)])),
        *_both(_ribbon([(-0.12, 0.06, 0.09), (-0.20, 0.25, 0.07), (-0.32, 0.27, 0.05)])),
        Part(
            _ribbon(
                [(0.62, 0.0, 0.12), (0.54, 0.0, 0.25), (0.42, 0.0, 0.25), (0.34, 0.0, 0.19)]
                + [(0.14, 0.0, 0.26), (-0.10, 0.0, 0.21), (-0.28, 0.03, 0.15)]
                + [(-0.48, 0.10, 0.12), (-0.68, 0.11, 0.09), (-0.86, 0.04, 0.03)]
            )
        ),
        *_eyes(0.52, 0.08, 0.08),
    ),
    "moth": (
        *_both(_HINDWING, Tone.WING),
        *_both(_FOREWING, Tone.WING),
        Part(_ellipse(-0.04, 0.0, 0.62, 0.19)),
        Part(_ellipse(0.30, 0.0, 0.18, 0.18)),
    ),
}  # fmt: skip
"""By the names that a species may give in ``bodies``."""
