"""README.md: short, its programs run, and its picture is small."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "README.md").read_text()


def blocks(kind: str) -> list[str]:
    """Return the fenced blocks of a kind, in their order."""
    fenced = re.findall(r"^```(\w*)\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL)
    return [content for found, content in fenced if found == kind]


def test_the_readme_is_short() -> None:
    assert len(PAGE.splitlines()) <= 150


def test_the_programs_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    programs = blocks("python")
    assert len(programs) == 2
    for program in programs:
        statements = [line for line in program.splitlines() if line and "import " not in line]
        assert len(statements) <= 10
        exec(compile(program, "README.md", "exec"), {})
    assert capsys.readouterr().out.count("caught in") == 2
    assert Path("model.zip").exists()


def test_the_moving_picture_is_small() -> None:
    assert 50_000 < (ROOT / "docs" / "images" / "demo.gif").stat().st_size < 2_000_000
