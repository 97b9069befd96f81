"""The colours of the page, light and dark: one table, for the style sheet, the figures, the player.

Figures are drawn with the light colours; where such a colour stands in a drawing it becomes a
variable of the style sheet, with itself as what is taken where there is none.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

from animarl_envs.drawing.palette import RGB, mix, to_hex

WHITE: RGB = (255, 255, 255)


@dataclass(frozen=True)
class Colour:
    """One colour of the page: what it is called, and how it looks on either ground."""

    name: str
    light: RGB
    dark: RGB

    @property
    def hex(self) -> str:
        """As figures are drawn with it."""
        return to_hex(self.light)


PAGE = Colour("page", WHITE, (22, 23, 26))
RAISED = Colour("raised", (246, 245, 241), (34, 35, 39))
TEXT = Colour("text", (43, 43, 47), (232, 231, 227))
MUTED = Colour("muted", (102, 100, 95), (173, 171, 165))
LINE = Colour("line", (222, 220, 214), (62, 63, 68))
FLOOR = Colour("floor", (250, 249, 247), (30, 31, 34))
FILL = Colour("fill", (112, 112, 115), (150, 150, 152))  # of demonstrated values, under others
WARM = Colour("warm", (150, 78, 0), (242, 181, 90))  # of what limits a conclusion
TOUCH = Colour("touch", (186, 98, 0), (245, 170, 40))  # contact

# Okabe and Ito's hues (2008), told apart with every common colour vision deficiency; the lighter
# ones somewhat darker than theirs on white, all lighter on dark.
BLUE = Colour("blue", (0, 114, 178), (92, 168, 230))
VERMILION = Colour("vermilion", (200, 84, 0), (255, 132, 66))
GREEN = Colour("green", (0, 132, 98), (64, 200, 160))
PURPLE = Colour("purple", (178, 96, 146), (222, 146, 196))
SKY = Colour("sky", (52, 142, 196), (168, 218, 255))
ORANGE = Colour("orange", (178, 120, 0), (240, 190, 70))
PLUM = Colour("plum", (140, 60, 110), (196, 110, 166))
TARGET = Colour("target", (34, 34, 38), (240, 239, 235))
STONE = Colour("stone", (132, 130, 124), (146, 144, 138))
CLAY = Colour("clay", (118, 106, 92), (190, 176, 158))

COLOURS = (
    PAGE, RAISED, TEXT, MUTED, LINE, FLOOR, FILL, WARM, TOUCH, BLUE, VERMILION, GREEN, PURPLE, SKY,
    ORANGE, PLUM, TARGET, STONE, CLAY,
)  # fmt: skip
TEXTS = (TEXT, MUTED, WARM, BLUE)
"""Those that words are written in, on the page and on raised ground."""
PURSUERS = (BLUE, VERMILION, GREEN, PURPLE, SKY, ORANGE)
"""One per pursuer or searcher, in order; they repeat after the last."""

METHODS = {
    "recorded": TARGET,
    "random": STONE,
    "untrained": CLAY,
    "dqn": ORANGE,
    "bc": VERMILION,
    "soft-bc": VERMILION,
    "dqaas": GREEN,
    "dqdil": SKY,
    "dqdil-pt": BLUE,
    "dqcil": PURPLE,
    "dqcil-pt": PLUM,
}
"""One per recipe, so that a method looks alike in every figure."""

_BY_HEX = {colour.hex: colour.name for colour in COLOURS}


def themed(drawing: str) -> str:
    """A drawing whose colours follow the page's theme: ``var(--text, #2b2b2f)`` for ``#2b2b2f``."""
    return re.sub(
        r"#[0-9a-f]{6}\b",
        lambda found: (
            f"var(--{_BY_HEX[found[0]]}, {found[0]})" if found[0] in _BY_HEX else found[0]
        ),
        drawing,
    )


def luminance(colour: RGB) -> float:
    """Relative luminance, 0 to 1 (WCAG 2.2)."""
    linear = [
        c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4
        for c in (part / 255 for part in colour)
    ]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def contrast(first: RGB, second: RGB) -> float:
    """Contrast ratio, 1 to 21 (WCAG 2.2)."""
    dark, light = sorted((luminance(first), luminance(second)))
    return (light + 0.05) / (dark + 0.05)


def faded(colour: Colour, share: float) -> str:
    """A colour mixed with a share of the page's ground, for drawings that have no theme."""
    return to_hex(mix(colour.light, PAGE.light, share))
