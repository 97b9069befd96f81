"""The pieces a report page is put together from; the template knows how to draw each kind."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

from animarl_algos.report.style import Image


@dataclass(frozen=True)
class Text:
    kind: ClassVar[str] = "text"
    text: str


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


@dataclass(frozen=True)
class Pairs:
    kind: ClassVar[str] = "pairs"
    title: str
    entries: Sequence[tuple[str, str]]


Block = Text | Heading | Command | Gallery | Table | Pairs


@dataclass(frozen=True)
class Section:
    anchor: str
    title: str
    blocks: Sequence[Block]


@dataclass(frozen=True)
class Summary:
    findings: Sequence[str]
    cautions: Sequence[str]
