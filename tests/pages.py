"""Pages of the documentation: their fenced blocks, and their programs run as they stand."""

import re
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]


def blocks(page: str, kind: str = "python") -> list[str]:
    """Return the fenced blocks of a kind on a page of the project, in their order."""
    text = (ROOT / page).read_text()
    fenced = re.findall(r"^```(\w*)\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)
    return [content for found, content in fenced if found == kind]


def run_programs(page: str) -> dict[str, Any]:
    """Run the programs of a page one after the other; return the names that they leave."""
    names: dict[str, Any] = {"__name__": "__main__"}
    for program in blocks(page):
        exec(compile(program, page, "exec"), names)
    return names
