"""The look of pages and figures: one table of colours, thin axes, text that stays text.

Figures are drawn with the light colours. Where such a colour stands in a drawing it becomes a
variable of the style sheet, with itself as what is taken where there is none. Figures are made
without pyplot, so nothing global changes and nothing has to be closed.
"""

from __future__ import annotations

import hashlib
import io
import re
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from html import escape
from itertools import cycle
from typing import TYPE_CHECKING, Any

from animarl_envs.drawing.palette import RGB, to_hex

if TYPE_CHECKING:
    from matplotlib.figure import Figure


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


PAGE = Colour("page", (255, 255, 255), (22, 23, 26))
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

COLOURS = tuple(one for one in list(globals().values()) if isinstance(one, Colour))
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

DASHES: tuple[Any, ...] = ("-", (0, (5, 2)), (0, (1, 1.4)), (0, (6, 2, 1, 2)), (0, (3, 1.2)))
MARKERS = ("o", "s", "^", "D", "v", "P")
"""Lines and marks by position, so that nothing is told by colour alone."""

FONTS = "system-ui, -apple-system, 'Segoe UI', Roboto, Helvetica, Arial, sans-serif"
"""Of texts in figures, as of the page around them; all are narrower than the one laid out with."""

POINTS_PER_INCH = 72
RC: Any = {
    "savefig.dpi": 220,  # of the parts that are drawn as pixels
    "svg.fonttype": "none",
    "text.parse_math": False,  # a name with dollar signs is a name
    "svg.hashsalt": "animarl",  # same figure, same bytes
    "font.family": ["sans-serif"],
    "font.size": 9.0,
    "text.color": TEXT.hex,
    "axes.titlesize": 9.5,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.titlepad": 7.0,
    "axes.titley": 1.0,  # no search for what stands above the axes: nothing does
    "axes.labelsize": 9.0,
    "axes.labelcolor": TEXT.hex,
    "axes.edgecolor": MUTED.hex,
    "axes.linewidth": 0.7,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.axisbelow": True,
    "legend.frameon": False,
    "legend.fontsize": 8.5,
    "legend.handlelength": 1.2,
    "lines.linewidth": 1.4,
    "lines.solid_capstyle": "round",
} | {
    f"{axis}tick.{key}": value
    for axis in "xy"
    for key, value in {
        "color": MUTED.hex,
        "labelcolor": TEXT.hex,
        "labelsize": 8.5,
        "major.width": 0.7,
        "major.size": 3.0,
    }.items()
}


def method_colour(name: str, position: int = 0) -> str:
    """Return the colour of a method, a quantile twin's that of its recipe; else by position."""
    known = METHODS.get(name.casefold().removeprefix("qr-"))
    return (known or PURSUERS[position % len(PURSUERS)]).hex


def method_label(name: str) -> str:
    """Return how figures and tables write a method: recipes in capitals, the rest as given."""
    plain = ("recorded", "random", "untrained")
    return name if name.casefold() in plain or not name.islower() else name.upper()


@dataclass(frozen=True)
class Look:
    """How one individual is drawn: colour, line and mark all tell it from the others."""

    colour: str
    dashes: Any
    marker: str


def looks(roles: Sequence[str]) -> list[Look]:
    """Pursuers in hues, the target near-black and solid."""
    return [
        Look(TARGET.hex, DASHES[0], "X") if role == "target" else Look(hue.hex, dashes, marker)
        for role, hue, dashes, marker in zip(roles, cycle(PURSUERS), cycle(DASHES), cycle(MARKERS))
    ]


def figure_style(changes: Mapping[str, Any] | None = None) -> AbstractContextManager[None]:
    """Return a context within which new figures share one look, but for ``changes`` of it."""
    from matplotlib import rc_context

    return rc_context(RC | dict(changes or {}))


def new_figure(width: float, height: float, rows: int = 1, columns: int = 1) -> tuple[Figure, Any]:
    """Yield a figure of so many inches with its axes (one, or an array of them)."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    return figure, figure.subplots(rows, columns)


@dataclass(frozen=True)
class Image:
    """A figure for a web page, or for a file of its own, and its words."""

    drawing: str  # an svg element
    alt: str

    @property
    def themed(self) -> str:
        """The drawing in the page's colours: ``var(--text, #2b2b2f)`` for ``#2b2b2f``."""

        def variable(match: re.Match[str]) -> str:
            name = _BY_HEX.get(match[0])
            return f"var(--{name}, {match[0]})" if name else match[0]

        return re.sub(r"#[0-9a-f]{6}\b", variable, self.drawing)


def to_image(figure: Figure, alt: str) -> Image:
    """Return the figure as SVG; the same figure gives the same bytes.

    It is laid out, then drawn once; ``savefig`` draws it twice.
    """
    from matplotlib.backends.backend_svg import FigureCanvasSVG

    buffer = io.StringIO()
    with figure_style():
        figure.set_facecolor("none")
        for axes in figure.axes:
            axes.set_facecolor("none")
        canvas: Any = FigureCanvasSVG(figure)
        layout = figure.get_layout_engine()
        assert layout is not None  # of new_figure
        figure.set_dpi(POINTS_PER_INCH)  # of the drawing
        layout.execute(figure)
        figure.set_layout_engine("none")
        figure.set_dpi(RC["savefig.dpi"])
        canvas.print_svg(buffer, metadata={"Date": None})
    drawing = buffer.getvalue()
    drawing = drawing[drawing.index("<svg") :]
    for nothing in (r"<metadata>.*?</metadata>", r"<style.*?</style>", r"<!--.*?-->"):
        drawing = re.sub(nothing, "", drawing, flags=re.DOTALL)
    drawing = re.sub(r"font-family: [^;\"]+", f"font-family: {FONTS}", drawing)
    drawing = re.sub(r"(font: [\d.]+px) [^;\"]+", rf"\1 {FONTS}", drawing)
    drawing = _with_own_ids(drawing)
    box = re.search(r'viewBox="[^"]+"', drawing)
    assert box is not None  # matplotlib writes one
    width = round(figure.get_figwidth() * 96)
    opening = (
        f'<svg xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink" '
        f'{box[0]} width="{width}" role="img" aria-label="{escape(alt, quote=True)}" '
        'style="stroke-linejoin: round; stroke-linecap: butt">'
    )
    body = drawing[drawing.index(">") + 1 :].strip()
    return Image(opening + body, alt)


def _with_own_ids(drawing: str) -> str:
    """Make the ids of a drawing unique on a page, and remove those that nothing refers to."""
    own = hashlib.sha256(drawing.encode()).hexdigest()[:10]
    used = set(re.findall(r'(?:xlink:href="#|url\(#)([\w.-]+)', drawing))
    drawing = re.sub(
        r' id="([^"]+)"',
        lambda match: f' id="f{own}-{match[1]}"' if match[1] in used else "",
        drawing,
    )
    return re.sub(r'(xlink:href="#|url\(#)', rf"\1f{own}-", drawing)
