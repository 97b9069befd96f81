"""What is fuzzed: every layout of tracks, files with planted pickles, recipes, and bare pickles."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from animarl_envs import wall
from animarl_envs.importing.import_recipe import ImportRecipe
from animarl_envs.importing.plain_pickle import load_plain
from tools.fuzz.judging import Values, assert_true_to_the_file, read_values
from tools.fuzz.layouts import KINDS, write_dlc_h5
from tools.fuzz.mutations import Damage, damaged
from tools.fuzz.pickles import random_pickle

Judge = Callable[[Path, Any, Any, Damage], None]
MARKER = "the-code-ran"  # beside the files, made by a planted pickle that runs


@dataclass(frozen=True)
class Target:
    """How a kind of file is written, damaged, read, and what is read of it judged."""

    write: Callable[[Path], Path]
    read: Callable[[Path], Any]
    judge: Judge
    beside: tuple[str, ...] = ()
    make: Callable[[bytes, np.random.Generator], Damage] = damaged


def _touch(path: str) -> None:
    Path(path).touch()


class _Planted:
    def __init__(self, folder: Path) -> None:
        self.marker = str(folder / MARKER)

    def __reduce__(self) -> tuple[Any, ...]:
        return _touch, (self.marker,)


def _planted_hdf(folder: Path) -> Path:
    import h5py

    path = write_dlc_h5(folder)
    raw = pickle.dumps(_Planted(folder), protocol=0)
    with h5py.File(path, "r+") as file:
        for name in ("TITLE", "info"):
            file["df_with_missing"].attrs[name] = np.bytes_(raw)
    return path


def _planted_npz(folder: Path) -> Path:
    path = folder / "pos_val_rep_2on1_share_equal_K_0.npz"
    np.savez(path, pos=np.array([[_Planted(folder)] * 3], dtype=object))
    return path


def _recipe(folder: Path) -> Path:
    recipe = ImportRecipe(source="long-table", frame_rate=20.0, target="female")
    return recipe.save(folder / "demos.recipe.yaml")


def _recipe_is_its_own(path: Path, found: Any, clean: Any, damage: Damage) -> None:
    """Each changed entry is a value that the text itself gives."""
    again = ImportRecipe.from_dict(yaml.safe_load(path.read_text()), "again").to_dict()
    assert found == again, "other settings than the text holds"


def _plain(path: Path) -> Any:
    return wall.call(_plain_text_of, path, what=str(path))


def _plain_text_of(path: Path) -> str:
    """What a pickle holds, written out, if it is of plain values alone."""
    waiting, seen = [load_plain(path.read_bytes(), str(path))], 0
    text = repr(waiting[0])
    while waiting:
        value = waiting.pop()
        seen += 1
        assert seen < 10**6, "it is larger than its file"
        if isinstance(value, dict):
            waiting += [*value.keys(), *value.values()]
        elif isinstance(value, (list, tuple, set, frozenset)):
            waiting += list(value)
        elif isinstance(value, np.ndarray):
            waiting += value.ravel().tolist()
        else:
            assert isinstance(value, (str, bytes, int, float, type(None))), type(value).__name__
    return text


def _is_inert(path: Path, found: Any, clean: Any, damage: Damage) -> None:
    """Nothing but plain values was found, or it were refused."""


def _write_pickle(folder: Path) -> Path:
    path = folder / "a.pickle"
    path.write_bytes(pickle.dumps({"a": np.arange(3.0)}))
    return path


def _any_pickle(raw: bytes, rng: np.random.Generator) -> Damage:
    return Damage(random_pickle(rng), 1)


def _of_tracks(name: str, write: Callable[[Path], Path] | None = None) -> Target:
    kind = KINDS[name]

    def judge(path: Path, found: Values, clean: Values, damage: Damage) -> None:
        assert_true_to_the_file(kind, path, found, clean, damage)

    return Target(
        write or kind.write, lambda path: read_values(kind, path), judge, beside=kind.beside
    )


TARGETS: dict[str, Target] = {
    **{name: _of_tracks(name) for name in KINDS},
    "planted_h5": _of_tracks("dlc_h5", _planted_hdf),
    "planted_npz": _of_tracks("authors_agents", _planted_npz),
    "recipe": Target(_recipe, lambda path: ImportRecipe.load(path).to_dict(), _recipe_is_its_own),
    "pickle": Target(_write_pickle, _plain, _is_inert, make=_any_pickle),
}
