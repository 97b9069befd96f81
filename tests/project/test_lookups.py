"""Look-ups of docs/contributing.md name what is there; docs/architecture.md has a short path."""

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
LOOKUPS = (ROOT / "docs" / "contributing.md").read_text().partition("## Look-ups")[2]
ROWS = re.findall(r"^\| (.+) \| `([\w/]+\.py)` \| `([\w.]+)` \|$", LOOKUPS, re.MULTILINE)
PATH_SECTION = (ROOT / "docs" / "architecture.md").read_text().partition("## Twelve files")[2]
PATH = re.findall(r"^\| \d+ \| \[`([\w/]+\.py)`\]", PATH_SECTION, re.MULTILINE)
MOST_CODE = 2_632  # cells of the kernels included


def defined_names(path: Path) -> set[str]:
    """Return a module's functions, classes, constants and, as Class.method, methods."""
    names: set[str] = set()
    for node in ast.parse(path.read_text()).body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            names.add(node.name)
            if isinstance(node, ast.ClassDef):
                methods = [each for each in node.body if isinstance(each, ast.FunctionDef)]
                names |= {f"{node.name}.{method.name}" for method in methods}
        elif isinstance(node, ast.Assign):
            names |= {target.id for target in node.targets if isinstance(target, ast.Name)}
        elif isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            names.add(node.target.id)
    return names


def lines_of_code(path: Path) -> int:
    """Return the number of lines without docstrings, comments and empty lines."""
    text = path.read_text()
    documented: set[int] = set()
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Expr) and isinstance(getattr(node.value, "value", None), str):
            documented |= set(range(node.lineno, (node.end_lineno or node.lineno) + 1))
    return sum(
        1
        for number, line in enumerate(text.splitlines(), start=1)
        if line.strip() and not line.strip().startswith("#") and number not in documented
    )


def test_there_are_twenty_lookups() -> None:
    assert len(ROWS) >= 20
    assert len({question for question, _, _ in ROWS}) == len(ROWS)


@pytest.mark.parametrize(("question", "file", "name"), ROWS, ids=[row[2] for row in ROWS])
def test_lookups_name_what_is_there(question: str, file: str, name: str) -> None:
    assert name in defined_names(ROOT / file), f"{question}: look for {name} and correct the page"


def test_lookups_of_the_reading_path() -> None:
    """Twelve files from a row of a table to the verdict."""
    assert len(PATH) == 12
    assert sum(lines_of_code(ROOT / file) for file in PATH) <= MOST_CODE
