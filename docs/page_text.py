"""How the pages of :mod:`make_env_pages` write text and numbers."""

from __future__ import annotations

import math
import re
from pathlib import Path

DOCS = Path(__file__).parent
NOTICE = "<!-- Written by `python docs/make_env_pages.py`; do not edit. -->"


def paragraphs(title: str, more: str) -> list[str]:
    return [markdown(text) for text in (title, *re.split(r"\n\s*\n", more.strip())) if text]


def markdown(text: str) -> str:
    """Docstring text on one line, with Markdown's code marks."""
    return " ".join(text.split()).replace("``", "`")


def number(value: float) -> str:
    """Short, and readable as Python."""
    if math.isinf(value):
        return "inf" if value > 0 else "-inf"
    if math.isclose(abs(value), math.pi):
        return "pi" if value > 0 else "-pi"
    return f"{value:.4g}"
