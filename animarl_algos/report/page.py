"""A page: templates, style sheets and scripts put together into one file that loads nothing.

Whatever makes a page (a run, a comparison of runs) gives blocks; nothing here knows what they say.
"""

from __future__ import annotations

import base64
import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from animarl_algos.report.blocks import Section
from animarl_algos.report.scenes import Player
from animarl_algos.report.themes import COLOURS
from animarl_algos.report.verdict_section import Lead
from animarl_envs.drawing.palette import to_hex
from animarl_envs.errors import MissingExtraError

TEMPLATES = Path(__file__).parent / "templates"
SCRIPTS = (
    "themes.js", "tables.js", "downloads.js", "paths.js", "stage.js", "player.js", "start.js",
)  # fmt: skip
"""In this order, inside one function: a later one uses what an earlier one defines."""


@dataclass(frozen=True, kw_only=True)
class Page:
    """What a page shows, from top to bottom.

    Parameters
    ----------
    kind
        What sort of page it is, above its title.
    facts
        Names and values, below the title.
    lead, player
        The verdict and the player, side by side where there is room; either may be missing.
    glossary
        Terms and what they mean.
    """

    title: str
    kind: str
    synthetic: bool
    facts: Sequence[tuple[str, str]]
    sections: Sequence[Section]
    lead: Lead | None = None
    player: Player | None = None
    glossary: Sequence[tuple[str, str]] = ()


def render_page(page: Page) -> str:
    """The page as HTML.

    Raises
    ------
    MissingExtraError
        If jinja2 is not installed.
    """
    try:
        from jinja2 import Environment, FileSystemLoader, StrictUndefined
    except ImportError as error:
        raise MissingExtraError("the report", "algos") from error
    environment = Environment(
        loader=FileSystemLoader(TEMPLATES),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    program = script()
    return environment.get_template("page.html.j2").render(
        page=page,
        colours=[(c.name, to_hex(c.light), to_hex(c.dark)) for c in COLOURS],
        player_data=None if page.player is None else as_data(page.player.data),
        script=program,
        policy=policy(program),
    )


def script() -> str:
    """All scripts as one function, so that they leave no name behind."""
    parts = [(TEMPLATES / name).read_text(encoding="utf-8").strip() for name in SCRIPTS]
    return "\n".join(["(() => {", '"use strict";', *parts, "})();"])


def policy(program: str) -> str:
    """What the browser lets the page do: run this script and show what it holds; load nothing."""
    digest = base64.b64encode(hashlib.sha256(f"\n{program}\n".encode()).digest()).decode()
    return (
        f"default-src 'none'; script-src 'sha256-{digest}'; style-src 'unsafe-inline'; "
        "img-src data: blob:"
    )


def as_data(value: Any) -> str:
    """JSON that can stand inside a script element."""
    text = json.dumps(value, separators=(",", ":"), allow_nan=False)
    for sign in "<>&":
        text = text.replace(sign, f"\\u{ord(sign):04x}")
    return text
