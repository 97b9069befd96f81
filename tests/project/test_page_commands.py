"""Every command on every page is understood by its program, and every Python program runs.

What takes more than seconds is parsed: its options and values exist. The rest is run, on the pages
on data by ``test_import_pages.py``, the tutorial's by ``test_program_pages.py``, others below.
"""

import argparse
import functools
import re
import runpy
import shlex
import sys
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NoReturn

import pytest
import typer
import typer.main
from commands import animarl
from pages import ROOT, blocks, run_programs
from slow import slowly

from animarl_algos.cli.main import app

PAGES = sorted(
    page.relative_to(ROOT)
    for pattern in ("*.md", "docs/**/*.md", "benchmarks/*.md", "animarl_algos/pretrained/*/*.md")
    for page in ROOT.glob(pattern)
    if not str(page.relative_to(ROOT)).startswith(("docs/_", "CHANGELOG"))
)
PREFIXES = r"(?:\$ |time |/usr/bin/time -v |[A-Z_]+=\S+ )*"
# Programs of these pages are run by the test named; those of all other pages by this file.
RUN_BY = {
    "README.md": "tests/project/test_program_pages.py",
    "docs/contributing.md": "tests/project/test_program_pages.py",
    "docs/data/cleaning.md": "tests/envs/importing/test_import_pages.py",
    "docs/data/readers.md": "tests/envs/importing/test_import_pages.py",
    "docs/faithful.md": "tests/envs/fitting/test_recorded_headings.py",
    "docs/learners.md": "tests/project/test_program_pages.py",
    "docs/tutorial.md": "tests/project/test_program_pages.py",
    "docs/what_if.md": "tests/algos/runs/test_run.py",
}


def text_of(page: Path) -> str:
    return (ROOT / page).read_text().replace("\\\n", " ")


def commands(page: Path) -> list[str]:
    """Return the commands of a page: fenced, indented, and within sentences."""
    text = text_of(page)
    fenced = re.findall(r"^```(?:bash|console|sh)?\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)
    lines = [line for block in fenced for line in block.splitlines()]
    lines += [line.strip() for line in text.splitlines() if line.startswith("    ")]
    prose = re.sub(r"^```.*?^```$", "", text, flags=re.MULTILINE | re.DOTALL)
    lines += [" ".join(one.split()) for one in re.findall(r"`([^`]+)`", prose)]
    parts = [part.strip() for line in lines for part in line.split(" && ")]
    found = [re.fullmatch(rf"{PREFIXES}((?:animarl|python|make) .+)", part) for part in parts]
    return list(dict.fromkeys(one[1] for one in found if one and "..." not in one[1]))


def parse(program: typer.Typer, words: list[str]) -> None:
    """Parse the arguments of a command as typer does; a name by itself need only exist."""
    command: Any = typer.main.get_command(program)
    rest = list(words)
    while hasattr(command, "resolve_command"):
        context = command.make_context("", rest)
        rest = [*context._protected_args, *context.args]
        if not rest:
            return
        _, command, rest = command.resolve_command(context, rest)
    if rest or len(words) != 1:
        command.make_context("", rest)


class Parsed(Exception):
    """A script has come to the point where it reads its arguments."""


@functools.cache
def parser_of(script: str) -> Callable[[list[str]], Any]:
    """Return what parses the arguments of a script."""
    found: list[Callable[[list[str]], Any]] = []

    def stop(self: argparse.ArgumentParser, *_: Any, **__: Any) -> NoReturn:
        found.append(functools.partial(plain, self))
        raise Parsed

    def stop_typer(self: typer.Typer) -> NoReturn:
        found.append(functools.partial(parse, self))
        raise Parsed

    plain, path = argparse.ArgumentParser.parse_args, sys.path[:]
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(argparse.ArgumentParser, "parse_args", stop)
        patched.setattr(typer.Typer, "__call__", stop_typer)
        patched.setattr(sys, "argv", [script])
        patched.setattr(sys, "path", [str((ROOT / script).parent), str(ROOT), *path])
        with pytest.raises(Parsed):
            runpy.run_path(str(ROOT / script), run_name="__main__")
    return found[0]


def check(command: str) -> None:
    """Raise what the command's own parser raises."""
    words = shlex.split(command.partition(" > ")[0], comments=True)
    if words[0] == "make":
        makefile = (ROOT / "Makefile").read_text()
        assert all("=" in word or f"\n{word}:" in makefile for word in words[1:]), command
    elif words[0] == "animarl":
        parse(app, words[1:])
    elif words[1] == "-m":
        assert find_spec(words[2]) is not None, command
    elif words[1].endswith(".py"):
        assert (ROOT / words[1]).is_file(), command
        if words[1].startswith("benchmarks/"):
            parser_of(words[1])(words[2:])


@pytest.mark.parametrize("page", PAGES, ids=str)
def test_commands_parse(page: Path) -> None:
    for command in commands(page):
        try:
            check(command)
        except (Exception, SystemExit) as error:
            if type(error).__name__ == "MissingParameter" and f"`{command}`" in text_of(page):
                continue  # a sentence about an option need not name the file
            pytest.fail(f"{page}: {command}: {error}")


def test_commands_are_found() -> None:
    assert sum(len(commands(page)) for page in PAGES) > 200
    with pytest.raises(Exception, match="No such option: --no-such-option"):
        check("animarl run packaged --no-such-option")
    with pytest.raises(SystemExit):
        check("python benchmarks/tasks.py --no-such-option")


SHORT = re.compile(r"animarl (data show (agent|fly)|page packaged|watch --model fly|.* --list)\b.*")


@pytest.mark.slow
def test_short_commands_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Those that need no file of the reader and write none but pictures."""
    monkeypatch.chdir(tmp_path)
    every = dict.fromkeys(one for page in PAGES for one in commands(page))
    short = [one for one in every if SHORT.fullmatch(one)]
    assert len(short) >= 6
    for command in short:
        animarl(*shlex.split(command, comments=True)[1:])


LATER = Path("docs/pretrained.md")  # which starts two processes
WITH_PROGRAMS = [page for page in PAGES if blocks(str(page)) and page != LATER]


@pytest.mark.parametrize("page", [*WITH_PROGRAMS, *slowly(LATER)], ids=str)
def test_programs_run(page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    if str(page) in RUN_BY:
        assert page.name in (ROOT / RUN_BY[str(page)]).read_text()
        return
    monkeypatch.chdir(tmp_path)
    run_programs(str(page))
