"""What the lines of the two packages are: ``python -m tools.lines`` prints a table by folder.

Every line is one of: docstring, comment, empty, import, head of a function (decorators, names,
types), refusal (``raise`` and ``require`` with their sentences), or other code.
"""

from __future__ import annotations

import ast
from collections import Counter
from pathlib import Path

from animarl_envs.drawing import markdown_table

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("animarl_envs", "animarl_algos")
KINDS = ("docstring", "empty", "comment", "import", "head", "refusal", "code")


def kinds_of(text: str) -> Counter[str]:
    """Count the lines of a module by their kind."""
    lines = text.splitlines()
    found = dict.fromkeys(range(1, len(lines) + 1), "code")

    def mark(kind: str, first: int, last: int) -> None:
        found.update(dict.fromkeys(range(first, last + 1), kind))

    nodes = list(ast.walk(ast.parse(text)))
    for node in nodes:
        called = node.value.func if isinstance(node, ast.Expr) and isinstance(
            node.value, ast.Call) else None  # fmt: skip
        if isinstance(node, ast.Import | ast.ImportFrom):
            mark("import", node.lineno, node.end_lineno or 0)
        elif isinstance(node, ast.Raise) or getattr(called, "id", "") == "require":
            mark("refusal", node.lineno, node.end_lineno or 0)  # type: ignore[attr-defined]
        elif isinstance(node, ast.FunctionDef):
            first = min([node.lineno, *(one.lineno for one in node.decorator_list)])
            mark("head", first, node.body[0].lineno - 1)
    for number, line in enumerate(lines, 1):
        if not line.strip() or line.lstrip().startswith("#"):
            mark("comment" if line.strip() else "empty", number, number)
    for node in nodes:
        if isinstance(node, ast.FunctionDef | ast.ClassDef | ast.Module) and ast.get_docstring(
            node
        ):
            mark("docstring", node.body[0].lineno, node.body[0].end_lineno or 0)
    return Counter(found.values())


def main() -> None:
    """Print the table."""
    rooms: dict[str, Counter[str]] = {}
    for package in PACKAGES:
        for path in sorted((ROOT / package).rglob("*.py")):
            room = "/".join(path.relative_to(ROOT).parts[: 2 if path.parent.name != package else 1])
            rooms.setdefault(room, Counter(files=0)).update(kinds_of(path.read_text()), files=1)
    rooms["all"] = sum(rooms.values(), Counter())
    rows = [
        (room, *(f"{n:,}" for n in (one["files"], sum(one[kind] for kind in KINDS),
                                    *(one[kind] for kind in KINDS))))
        for room, one in rooms.items()
    ]  # fmt: skip
    print(markdown_table(("folder", "files", "lines", *KINDS), rows))


if __name__ == "__main__":
    main()
