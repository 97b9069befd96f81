"""Pages of the documentation: their fenced blocks and programs; and a Python of its own."""

import importlib.util
import re
import subprocess
import sys
from pathlib import Path
from types import ModuleType
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


def python(
    program: str, *arguments: object, check: bool = True, **how: Any
) -> subprocess.CompletedProcess[str]:
    """Run a program in a process of its own; it must end well unless ``check`` is false."""
    command = [sys.executable, "-c", program, *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, **how)
    assert not check or done.returncode == 0, done.stderr
    return done


def load_script(path: Path) -> ModuleType:
    """Return a script as a module."""
    spec = importlib.util.spec_from_file_location(f"script_{path.stem}", path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses look it up
    spec.loader.exec_module(module)
    return module
