"""Names, commands and options that the README and the pages under ``docs`` use.

``python tests/public_names_list.py`` prints them as ``tests/public_names.txt`` holds them.
"""

import ast
import re
import shlex
from importlib import import_module

import pages
from pages import ROOT

FRONT_DOORS = ("animarl_envs", "animarl_envs.views", "animarl_envs.wrappers", "animarl_algos")


def blocks(*languages: str) -> list[str]:
    """Code blocks of some languages on all pages; a block without a language has an empty one."""
    folders = ("docs", "docs/data", "docs/environments", "docs/results")
    files = [path for folder in folders for path in sorted((ROOT / folder).glob("*.md"))]
    return [
        block for page in (ROOT / "README.md", *files) for kind in languages
        for block in pages.blocks(str(page), kind)
    ]  # fmt: skip


def imported_names() -> set[str]:
    """Names that examples import, and those that the front doors export."""
    found = {f"{door}.{name}" for door in FRONT_DOORS for name in import_module(door).__all__}
    for block in blocks("python"):
        try:
            tree = ast.parse(block)
        except SyntaxError:  # a fragment
            continue
        for node in ast.walk(tree):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("animarl_"):
                found |= {f"{node.module}.{alias.name}" for alias in node.names}
    return found


def command_lines() -> set[str]:
    """Commands with each option that pages give them: ``animarl fit --thrusts``."""
    found = set()
    for block in blocks("", "bash", "sh", "console"):
        for line in block.replace("\\\n", " ").splitlines():
            start = re.match(r"\s*(?:\$ )?(animarl .*)", line)
            if start is None or "|" in line:
                continue
            try:
                words = shlex.split(start[1].split("  #")[0], comments=True)
            except ValueError:
                continue
            depth = 3 if words[1:2] in (["data"], ["benchmark"]) else 2
            named = [w for w in words[:depth] if re.fullmatch(r"[a-z][a-z-]*", w)]
            command = " ".join(named)
            found.add(command)
            options = (word.partition("=")[0] for word in words)
            found |= {f"{command} {option}" for option in options if option.startswith("--")}
    return {each for each in found if each != "animarl"}


def public_names() -> list[str]:
    """All of them, sorted."""
    return sorted(imported_names()) + sorted(command_lines())


if __name__ == "__main__":
    print("\n".join(public_names()))
