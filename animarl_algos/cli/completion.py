"""What the shell offers for the values of options; nothing that takes long to import."""

from __future__ import annotations

import ast
from collections.abc import Callable, Iterable
from importlib.resources import files
from pathlib import Path

from animarl_envs import SPECIES, environment_id
from animarl_envs.demos.packaged import packaged_names
from animarl_envs.species import CUSTOM

Completion = Callable[[str], list[str]]


def _offering(names: Callable[[], Iterable[str]]) -> Completion:
    """Those of ``names`` that begin like what was typed."""

    def complete(incomplete: str) -> list[str]:
        return [name for name in names() if name.startswith(incomplete)]

    return complete


def _recipes() -> list[str]:
    """Names of the learners, read off the registry: importing it would load torch."""
    source = (files("animarl_algos.recipes") / "registry.py").read_text(encoding="utf-8")
    for node in ast.parse(source).body:
        if not isinstance(node, ast.AnnAssign) or ast.unparse(node.target) != "RECIPES":
            continue
        if isinstance(node.value, ast.Dict):
            return [ast.literal_eval(key) for key in node.value.keys if key]
    raise LookupError("the registry lists no RECIPES")


def _sources() -> list[str]:
    from animarl_envs.importing.readers import available_readers

    return [reader.name for reader in available_readers()]


def _files(first: Iterable[str], incomplete: str) -> list[str]:
    """Names, and the files and folders that begin like what was typed."""
    typed = Path(incomplete)
    folder = typed if incomplete.endswith("/") else typed.parent
    there = sorted(folder.iterdir()) if folder.is_dir() else []
    paths = [f"{path}/" if path.is_dir() else str(path) for path in there]
    return [name for name in (*first, *paths) if name.startswith(incomplete)]


def run_file(incomplete: str) -> list[str]:
    """A file of demonstrations, or those that come with the species."""
    return _files(("packaged",), incomplete)


def demonstrations(incomplete: str) -> list[str]:
    """A file of demonstrations, or a packaged set by name."""
    return _files(packaged_names(), incomplete)


def runs(incomplete: str) -> list[str]:
    """Folders, a run's own without a slash behind it."""
    found = [name for name in _files((), incomplete) if name.endswith("/")]
    return [name[:-1] if (Path(name) / "settings.json").exists() else name for name in found]


def models(incomplete: str) -> list[str]:
    """A packaged model by name, or a run's folder."""
    packaged = sorted(f.name for f in (files("animarl_algos") / "pretrained").iterdir())
    return [*(name for name in packaged if name.startswith(incomplete)), *runs(incomplete)]


species = _offering(lambda: (*SPECIES, CUSTOM))
environments = _offering(lambda: (environment_id(name) for name in (*SPECIES, CUSTOM)))
recipes = _offering(_recipes)
sources = _offering(_sources)
presets = _offering(lambda: ("default", "paper"))
policies = _offering(lambda: ("GruPolicy", "MlpPolicy"))
fit_methods = _offering(lambda: ("joint", "onset", "noise"))
acting_rules = _offering(lambda: ("chosen", "greedy", "boltzmann:", "epsilon:"))
