"""The figures of a page as files: SVG, PNG and PDF."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from animarl_algos.report.blocks import Gallery, Section
from animarl_algos.report.style import Image, figure_style
from animarl_envs.files import write_then_rename

PIXELS_PER_INCH = 200
LONGEST_NAME = 60
FORMATS: dict[str, dict[str, Any]] = {
    "svg": {"metadata": {"Date": None}},
    "png": {"dpi": PIXELS_PER_INCH, "metadata": {"Software": None}},
    "pdf": {"metadata": {"CreationDate": None}},
}  # without dates: the same figure gives the same bytes


def write_figures(sections: Sequence[Section], folder: str | Path) -> list[str]:
    """Every figure of the sections in all formats, named by section, place and what it shows.

    Returns
    -------
    The names without suffix, in the order of the page.
    """
    folder, names = Path(folder), []
    for name, image in named_figures(sections):
        assert image.figure is not None  # of a page that was just drawn
        image.figure.set_layout_engine(None)  # placed when the page drew it
        for suffix, options in FORMATS.items():
            with figure_style(), write_then_rename(folder / f"{name}.{suffix}") as part:
                image.figure.savefig(part, format=suffix, **options)
        names.append(name)
    return names


def named_figures(sections: Sequence[Section]) -> Iterator[tuple[str, Image]]:
    """The images of all galleries, each with a name of its own."""
    for section in sections:
        images = [i for block in section.blocks if isinstance(block, Gallery) for i in block.images]
        for number, image in enumerate(images, start=1):
            words = re.sub(r"[^a-z0-9]+", "-", image.alt.casefold()).strip("-")
            yield f"{section.anchor}-{number:02d}-{words[:LONGEST_NAME].rstrip('-')}", image
