"""The look of all figures: one colour per role, thin axes, text that stays text.

Figures are made without pyplot, so nothing global changes and nothing has to be closed.
"""

from __future__ import annotations

import base64
import io
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from animarl_algos.evaluation.rollouts import RECORDED
from animarl_envs.drawing import palette
from animarl_envs.drawing.palette import mix, to_hex
from animarl_envs.errors import MissingExtraError

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

TEXT = to_hex(palette.TEXT)
MUTED = to_hex(palette.MUTED_TEXT)
FAINT = to_hex(mix(palette.MUTED_TEXT, palette.BACKGROUND, 0.75))
FLOOR = to_hex(mix(palette.ARENA, palette.BACKGROUND, 0.4))
RECORDED_COLOUR = to_hex(palette.TARGET)
RECORDED_FILL = to_hex(mix(palette.TARGET, palette.BACKGROUND, 0.35))
SIMULATED_COLOUR = to_hex(palette.SIMULATED)

METHOD_COLOURS = {
    "recorded": palette.TARGET,
    "random": (168, 166, 160),
    "untrained": (140, 128, 112),
    "dqn": (204, 140, 0),
    "bc": (213, 94, 0),
    "dqaas": (0, 148, 110),
    "dqdil": (64, 160, 215),
    "dqdil-pt": (0, 114, 178),
    "dqcil": (178, 96, 146),
    "dqcil-pt": (140, 60, 110),
}
"""Okabe and Ito's hues (2008), one per recipe, so that a method looks alike in every figure."""

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


def method_colour(name: str, position: int = 0) -> str:
    """The colour of a method, a quantile twin's that of its recipe; other names by position."""
    known = METHOD_COLOURS.get(name.casefold().removeprefix("qr-"))
    return to_hex(known if known is not None else palette.pursuer(position))


def method_label(name: str) -> str:
    """How figures and tables write a method: recipes in capitals, the rest as given."""
    plain = ("recorded", "random", "untrained")
    return name if name.casefold() in plain or not name.islower() else name.upper()


def individual_colours(roles: Sequence[str]) -> list[str]:
    """Pursuers in hues, the target near-black, as in the renderer."""
    return [
        to_hex(palette.TARGET if role == "target" else palette.pursuer(i))
        for i, role in enumerate(roles)
    ]


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
    """A figure for a web page: a data URI, its natural width, and what it shows in words.

    ``figure`` is what it was drawn from, to write it in other formats.
    """

    source: str
    width: int  # [CSS px]
    alt: str
    figure: Figure | None = field(default=None, compare=False, repr=False)


def to_image(figure: Figure, alt: str) -> Image:
    """The figure as SVG inside a data URI; the same figure gives the same bytes."""
    buffer = io.BytesIO()
    with figure_style():
        figure.savefig(buffer, format="svg", transparent=True, metadata={"Date": None})
    drawing = re.sub(r"font-family: [^;\"]+", f"font-family: {FONTS}", buffer.getvalue().decode())
    encoded = base64.b64encode(drawing.encode()).decode()
    width = round(figure.get_figwidth() * 96)
    return Image(f"data:image/svg+xml;base64,{encoded}", width, alt, figure)
