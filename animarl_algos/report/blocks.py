"""The pieces a report page is put together from; the template knows how to draw each kind."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

from animarl_algos.report.style import Image


@dataclass(frozen=True)
class Text:
    kind: ClassVar[str] = "text"
    text: str


@dataclass(frozen=True)
class Sentences:
    kind: ClassVar[str] = "sentences"
    sentences: Sequence[str]


@dataclass(frozen=True)
class Heading:
    kind: ClassVar[str] = "heading"
    text: str


@dataclass(frozen=True)
class Command:
    kind: ClassVar[str] = "command"
    text: str


@dataclass(frozen=True)
class Gallery:
    kind: ClassVar[str] = "gallery"
    images: Sequence[Image]
    caption: str
    strip: bool = False  # small pictures that stay side by side on a narrow page


class Row(NamedTuple):
    cells: Sequence[str]
    strong: bool = False
    faint: bool = False


class Group(NamedTuple):
    title: str
    rows: Sequence[Row]


@dataclass(frozen=True)
class Table:
    kind: ClassVar[str] = "table"
    label: str
    columns: Sequence[str]
    groups: Sequence[Group]
    caption: str
    left: int = 1  # so many leading columns hold words
    folded: str = ""  # what a reader clicks to see the table; empty: it is shown


@dataclass(frozen=True)
class Pairs:
    kind: ClassVar[str] = "pairs"
    title: str
    entries: Sequence[tuple[str, str]]


Block = Text | Sentences | Heading | Command | Gallery | Table | Pairs


@dataclass(frozen=True)
class Section:
    anchor: str
    title: str
    blocks: Sequence[Block]

    @property
    def texts(self) -> Iterator[str]:
        """All that is written in it, apart from figures."""
        yield self.title
        for block in self.blocks:
            match block:
                case Text() | Heading() | Command():
                    yield block.text
                case Sentences():
                    yield from block.sentences
                case Gallery():
                    yield block.caption
                    yield from (image.alt for image in block.images)
                case Table():
                    yield from (block.folded, block.caption, *block.columns)
                    for group in block.groups:
                        yield group.title
                        yield from (cell for row in group.rows for cell in row.cells)
                case Pairs():
                    yield from (word for entry in block.entries for word in entry)
