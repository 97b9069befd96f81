"""The terminal: names and texts from files are shown as they are, never obeyed."""

from __future__ import annotations

from typing import Any

from rich.console import Console

from animarl_envs.checks import printable


class PlainConsole(Console):
    """A console without markup (``[/red]`` is a name like any other) or terminal escapes."""

    def __init__(self, least_width: int = 0, **options: Any) -> None:
        super().__init__(markup=False, emoji=False, **options)
        self.width = max(self.width, least_width)

    def print(self, *objects: Any, **options: Any) -> None:
        """As rich's, with whatever cannot be printed written out."""
        super().print(*(printable(o) if isinstance(o, str) else o for o in objects), **options)
