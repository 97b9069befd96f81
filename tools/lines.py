"""Measure the size of the two packages: ``python -m tools.lines`` prints a table by folder.

Tokens are counted by Python's ``tokenize``: each name, operator, number and string (a docstring or
an f-string is one), without comments, line ends and indentation. They are the measure of size,
since packing several statements' worth of code into a line does not lower them.

Every line of Python is one of: docstring, comment, empty, import, head of a function (decorators,
names, types), refusal (``raise`` and ``require`` with their sentences), or other code. JavaScript,
CSS, HTML and their templates are counted in lines.
"""

from __future__ import annotations

import ast
import io
import tokenize
from collections import Counter
from pathlib import Path

from animarl_envs.drawing import markdown_table

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("animarl_envs", "animarl_algos")
KINDS = ("docstring", "empty", "comment", "import", "head", "refusal", "code")
WEB_SUFFIXES = (".js", ".css", ".html", ".j2", ".wat")
COUNTED_TOKENS = {tokenize.NAME, tokenize.OP, tokenize.NUMBER, tokenize.STRING}


def count_tokens(text: str) -> int:
    """Return the number of names, operators, numbers and strings in a module.

    From Python 3.12 on ``tokenize`` divides an f-string; it is counted as one here too.
    """
    count = depth = 0
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        kind = tokenize.tok_name[token.type]
        starts = kind in ("FSTRING_START", "TSTRING_START")
        if depth == 0 and (starts or token.type in COUNTED_TOKENS):
            count += 1
        depth += starts - (kind in ("FSTRING_END", "TSTRING_END"))
    return count


def count_kinds(text: str) -> Counter[str]:
    """Count the lines of a module by their kind."""
    lines = text.splitlines()
    kinds = dict.fromkeys(range(1, len(lines) + 1), "code")

    def mark(kind: str, first: int, last: int) -> None:
        kinds.update(dict.fromkeys(range(first, last + 1), kind))

    nodes = list(ast.walk(ast.parse(text)))
    for node in nodes:
        called = None
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Call):
            called = node.value.func
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
    return Counter(kinds.values())


def measure_folders() -> dict[str, Counter[str]]:
    """Return for each folder its files, tokens, lines of Python by kind, and lines for browsers.

    A package's own modules count as a folder; a folder includes those inside it.
    """
    folders: dict[str, Counter[str]] = {}
    for package in PACKAGES:
        for path in sorted((ROOT / package).rglob("*")):
            if path.suffix not in (".py", *WEB_SUFFIXES):
                continue
            parts = path.relative_to(ROOT).parts
            sizes = folders.setdefault("/".join(parts[: 2 if len(parts) > 2 else 1]), Counter())
            text = path.read_text()
            if path.suffix == ".py":
                sizes.update(count_kinds(text), files=1, tokens=count_tokens(text))
            else:
                sizes["web"] += len(text.splitlines())
    return folders


def main() -> None:
    """Print the table."""
    folders = measure_folders()
    for package in PACKAGES:
        own = [sizes for folder, sizes in folders.items() if folder.split("/")[0] == package]
        folders[f"all of {package}"] = sum(own, Counter())
    folders["all"] = sum((folders[f"all of {package}"] for package in PACKAGES), Counter())
    rows = []
    for folder, sizes in folders.items():
        kinds = [sizes[kind] for kind in KINDS]
        numbers = [sizes["files"], sizes["tokens"], sum(kinds), *kinds, sizes["web"]]
        rows.append((folder, *(f"{number:,}" for number in numbers)))
    header = ("folder", "files", "tokens", "lines", *KINDS, "JS, CSS, HTML")
    print(markdown_table(header, rows))


if __name__ == "__main__":
    main()
