"""``public_names.txt``: what the README and the pages use is there, and works."""

import re
from functools import cache
from importlib import import_module
from pathlib import Path

import pytest
from commands import animarl
from public_names_list import public_names

LISTED = (Path(__file__).resolve().parents[1] / "public_names.txt").read_text().splitlines()


@cache
def help_of(command: str) -> str:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("COLUMNS", "200")
        patch.setenv("TERMINAL_WIDTH", "200")
        return animarl(*command.split()[1:], "--help")


def test_public_names_are_all_listed() -> None:
    missing = sorted(set(public_names()) - set(LISTED))
    assert missing == [], "add them to public_names.txt, or change the page that uses them"


@pytest.mark.parametrize("name", [name for name in LISTED if "." in name])
def test_public_names_can_be_imported(name: str) -> None:
    module, _, attribute = name.rpartition(".")
    assert hasattr(import_module(module), attribute)


@pytest.mark.parametrize("line", [line for line in LISTED if line.startswith("animarl ")])
def test_public_names_of_commands_and_options(line: str) -> None:
    command, _, option = line.partition(" --")
    assert re.search(rf"--{option}\b" if option else r"Usage|usage", help_of(command))
