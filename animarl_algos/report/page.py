"""A page: blocks, templates, style sheets and scripts in one file that loads nothing.

Whatever makes a page (a run, a what-if) gives blocks; nothing here knows what they say.
"""

import base64
import hashlib
import json
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import pandas as pd
from jinja2 import Environment, FileSystemLoader, StrictUndefined

from animarl_algos.report.style import COLOURS, Image
from animarl_envs.drawing.palette import to_hex
from animarl_envs.files import write_then_rename

TEMPLATES = Path(__file__).parent / "templates"
SCRIPTS = (
    "themes.js",
    "tables.js",
    "downloads.js",
    "paths.js",
    "stage.js",
    "player.js",
    "start.js",
)
"""In this order, inside one function: a later one uses what an earlier one defines."""
POLICY = (
    "default-src 'none'; script-src 'sha256-{digest}'; style-src 'unsafe-inline'; "
    "img-src data: blob:"
)
"""What the browser lets the page do: run its script and load nothing."""
PAGE_FILE, FIGURES = "report.html", "figures"
LONGEST_NAME = 60  # of a figure's file


# -- blocks ---------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Text:
    """A paragraph or, by its kind, a heading, a command to copy, or a list of sentences."""

    text: str | Sequence[str]
    kind: str = "text"


@dataclass(frozen=True)
class Gallery:
    """Pictures side by side with a caption."""

    kind: ClassVar[str] = "gallery"
    images: Sequence[Image]
    caption: str
    strip: bool = False  # small pictures that stay side by side on a narrow page


class Row(NamedTuple):
    """A row of a table."""

    cells: Sequence[str]
    strong: bool = False
    faint: bool = False
    hatched: bool = False


class Group(NamedTuple):
    """Rows of a table under a heading."""

    title: str
    rows: Sequence[Row]


@dataclass(frozen=True)
class Table:
    """A table that a reader can sort and save."""

    kind: ClassVar[str] = "table"
    label: str
    columns: Sequence[str]
    groups: Sequence[Group]
    caption: str
    left: int = 1  # so many leading columns hold words
    folded: str = ""  # what a reader clicks to see the table; empty: it is shown


@dataclass(frozen=True)
class Pairs:
    """Names with their values."""

    kind: ClassVar[str] = "pairs"
    title: str
    entries: Sequence[tuple[str, str]]


Block = Text | Gallery | Table | Pairs


def tabulate(
    label: str,
    columns: Mapping[str, Callable[[Any], str]],
    groups: Iterable[tuple[str, Iterable[Any] | pd.DataFrame]],
    caption: str,
    *,
    strong: Callable[[Any], bool] = lambda row: False,
    faint: Callable[[Any], bool] = lambda row: False,
    hatched: Callable[[Any], bool] = lambda row: False,
    **options: Any,
) -> Table:
    """Return a table of things: each column says what it writes of one; empty groups are left out.

    Of a data frame the things are its rows. ``strong``, ``faint`` and ``hatched`` say of which the
    row is so; ``options`` are those of :class:`Table`.
    """
    made = []
    for title, given in groups:
        things = [row for _, row in given.iterrows()] if hasattr(given, "iterrows") else given
        rows = [
            Row([write(one) for write in columns.values()], strong(one), faint(one), hatched(one))
            for one in things
        ]
        made.append(Group(title, rows))
    return Table(label, list(columns), [one for one in made if one.rows], caption, **options)


# -- the page -------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Section:
    """A section of a page."""

    anchor: str
    title: str
    blocks: Sequence[Block]
    folded: str = ""  # as of a table


@dataclass(frozen=True)
class Lead:
    """What stands at the top of the page: the judgement, what differs, how surely, what limits it.

    ``mark`` is a sign for the judgement, for readers who do not see its ``colour``.
    """

    judgement: str
    colour: str
    mark: str
    headline: str
    details: Sequence[str]
    cautions: Sequence[str] = ()


@dataclass(frozen=True, eq=False)
class Player:
    """What the script of the page plays, as plain data; ``caption`` says what it is."""

    data: dict[str, Any]
    caption: str


@dataclass(frozen=True, kw_only=True)
class Page:
    """What a page shows, from top to bottom.

    ``kind`` is what sort of page it is, above its title, ``facts`` names and values below it.
    ``lead`` and ``player``, the verdict and the player, stand side by side where there is room;
    either may be missing, and sections without blocks are left out.
    """

    title: str
    kind: str
    synthetic: bool
    facts: Sequence[tuple[str, str]]
    sections: Sequence[Section]
    lead: Lead | None = None
    player: Player | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "sections", [one for one in self.sections if one.blocks])

    def html(self) -> str:
        """Return the page as HTML."""
        parts = [(TEMPLATES / name).read_text(encoding="utf-8").strip() for name in SCRIPTS]
        # One function, so that no name is left behind; the browser lets the page run it alone.
        program = "\n".join(["(() => {", '"use strict";', *parts, "})();"])
        digest = base64.b64encode(hashlib.sha256(f"\n{program}\n".encode()).digest()).decode()
        return render(
            "page.html.j2",
            page=self,
            player_data=None if self.player is None else as_data(self.player.data),
            script=program,
            policy=POLICY.format(digest=digest),
        )

    def write(self, folder: Path) -> None:
        """Write the page as ``report.html``, and every figure of it into ``figures``."""
        write_page(self, folder / PAGE_FILE)
        for name, image in self.figures():
            with write_then_rename(folder / FIGURES / f"{name}.svg") as part:
                part.write_text(image.drawing, encoding="utf-8")

    def figures(self) -> Iterator[tuple[str, Image]]:
        """Yield the images of all galleries, named by section, place and what they show."""
        for section in self.sections:
            galleries = [block for block in section.blocks if isinstance(block, Gallery)]
            images = [image for gallery in galleries for image in gallery.images]
            for place, image in enumerate(images, start=1):
                words = re.sub(r"[^a-z0-9]+", "-", image.alt.casefold()).strip("-")
                yield f"{section.anchor}-{place:02d}-{words[:LONGEST_NAME].rstrip('-')}", image


def render(template: str, **values: Any) -> str:
    """Return a template as HTML, with the colours of all pages; values are escaped."""
    environment = Environment(
        loader=FileSystemLoader(TEMPLATES),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    colours = [(c.name, to_hex(c.light), to_hex(c.dark)) for c in COLOURS]
    return environment.get_template(template).render(colours=colours, **values)


def write_page(page: Page, path: Path) -> Path:
    """Write a page, whole or not at all, and return its path."""
    html = page.html()
    with write_then_rename(path) as part:
        part.write_text(html, encoding="utf-8")
    return path


def as_data(value: Any) -> str:
    """Return JSON that can stand inside a script element."""
    text = json.dumps(value, separators=(",", ":"), allow_nan=False)
    for sign in "<>&":
        text = text.replace(sign, f"\\u{ord(sign):04x}")
    return text
