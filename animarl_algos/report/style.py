"""The look of all figures: one colour per role, thin axes, text that stays text.

Figures are made without pyplot, so nothing global changes and nothing has to be closed.
"""

from __future__ import annotations

import hashlib
import io
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from html import escape
from typing import TYPE_CHECKING, Any

from animarl_algos.evaluation.rollouts import RECORDED
from animarl_algos.report import themes
from animarl_envs.errors import MissingExtraError

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

TEXT = themes.TEXT.hex
MUTED = themes.MUTED.hex
FAINT = themes.LINE.hex
FLOOR = themes.FLOOR.hex
GROUND = themes.PAGE.hex
RECORDED_COLOUR = themes.TARGET.hex
RECORDED_FILL = themes.FILL.hex
SIMULATED_COLOUR = themes.BLUE.hex
ON_MAP = "#fefefe"
"""White on a colour map, which does not follow the theme, and so neither does this."""

DASHES: tuple[Any, ...] = ("-", (0, (5, 2)), (0, (1, 1.4)), (0, (6, 2, 1, 2)), (0, (3, 1.2)))
MARKERS = ("o", "s", "^", "D", "v", "P")
"""Lines and marks by position, so that nothing is told by colour alone."""

FONTS = "system-ui, -apple-system, 'Segoe UI', Roboto, Helvetica, Arial, sans-serif"
"""Of texts in figures, as of the page around them; all are narrower than the one laid out with."""

RC: Any = {
    "savefig.dpi": 220,  # of the parts that are drawn as pixels
    "svg.fonttype": "none",
    "text.parse_math": False,  # a name with dollar signs is a name
    "svg.hashsalt": "animarl",  # same figure, same bytes
    "font.family": ["sans-serif"],
    "font.size": 9.0,
    "axes.titlesize": 9.5,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.titlepad": 7.0,
    "axes.labelsize": 9.0,
    "axes.labelcolor": TEXT,
    "axes.edgecolor": MUTED,
    "axes.linewidth": 0.7,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.axisbelow": True,
    "xtick.color": MUTED,
    "ytick.color": MUTED,
    "xtick.labelcolor": TEXT,
    "ytick.labelcolor": TEXT,
    "xtick.labelsize": 8.5,
    "ytick.labelsize": 8.5,
    "xtick.major.width": 0.7,
    "ytick.major.width": 0.7,
    "xtick.major.size": 3.0,
    "ytick.major.size": 3.0,
    "text.color": TEXT,
    "legend.frameon": False,
    "legend.fontsize": 8.5,
    "legend.handlelength": 1.2,
    "lines.linewidth": 1.4,
    "lines.solid_capstyle": "round",
}


def is_method(name: str) -> bool:
    """Whether it is one of those with a colour of their own, or its quantile twin."""
    return _recipe(name) in themes.METHODS


def _recipe(name: str) -> str:
    return name.casefold().removeprefix("qr-")


def method_colour(name: str, position: int = 0) -> str:
    """The colour of a method, a quantile twin's that of its recipe; other names by position."""
    known = themes.METHODS.get(_recipe(name))
    return (known or themes.PURSUERS[position % len(themes.PURSUERS)]).hex


def method_label(name: str) -> str:
    """How figures and tables write a method: recipes in capitals, the rest as given."""
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
    out = []
    for i, role in enumerate(roles):
        hue = themes.TARGET if role == "target" else themes.PURSUERS[i % len(themes.PURSUERS)]
        dashes = DASHES[0] if role == "target" else DASHES[i % len(DASHES)]
        marker = "X" if role == "target" else MARKERS[i % len(MARKERS)]
        out.append(Look(hue.hex, dashes, marker))
    return out


@contextmanager
def figure_style() -> Iterator[None]:
    """Within it, new figures share one look.

    Raises
    ------
    MissingExtraError
        If matplotlib is not installed.
    """
    try:
        from matplotlib import rc_context
    except ImportError as error:
        raise MissingExtraError("drawing figures", "algos") from error
    with rc_context(RC):
        yield


def new_figure(width: float, height: float, rows: int = 1, columns: int = 1) -> tuple[Figure, Any]:
    """A figure of so many inches with its axes (one, or an array of them)."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    return figure, figure.subplots(rows, columns)


def light_grid(axes: Axes, axis: str = "x") -> None:
    """Hairlines across one axis."""
    axes.grid(axis=axis, color=FAINT, linewidth=0.5)  # type: ignore[arg-type]


def is_recorded(name: str) -> bool:
    return name.casefold() == RECORDED


@dataclass(frozen=True)
class Image:
    """A figure for a web page: a drawing that stands in it, its natural width, and its words.

    ``figure`` is what it was drawn from, to write it in other formats.
    """

    drawing: str  # an svg element, its colours variables of the page's style sheet
    width: int  # [CSS px]
    alt: str
    figure: Figure | None = field(default=None, compare=False, repr=False)


def to_image(figure: Figure, alt: str) -> Image:
    """The figure as SVG; the same figure gives the same bytes."""
    buffer = io.BytesIO()
    with figure_style():
        figure.savefig(buffer, format="svg", transparent=True, metadata={"Date": None})
    drawing = buffer.getvalue().decode()
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
    return Image(themes.themed(opening + body), width, alt, figure)


def _with_own_ids(drawing: str) -> str:
    """Ids that are referred to get a name of the drawing's own; the others go."""
    own = hashlib.sha256(drawing.encode()).hexdigest()[:10]
    used = set(re.findall(r'(?:xlink:href="#|url\(#)([\w.-]+)', drawing))
    drawing = re.sub(
        r' id="([^"]+)"',
        lambda found: f' id="f{own}-{found[1]}"' if found[1] in used else "",
        drawing,
    )
    return re.sub(r'(xlink:href="#|url\(#)', rf"\1f{own}-", drawing)
