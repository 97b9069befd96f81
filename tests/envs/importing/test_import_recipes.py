"""Recipes come from strangers: whatever stands in them, they are read or refused in a sentence."""

from copy import deepcopy
from math import inf, nan
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from animarl_envs.errors import InputError
from animarl_envs.importing.import_recipe import ImportRecipe
from animarl_envs.importing.readers.registry import follow

WHOLE = {"source": "long-table", "frame_rate": 30.0, "target": "b", "splitting": {}}
VALUES: list[Any] = [
    None, True, 0, -1, 3, -2.5, nan, inf, "inf", "", "x", "../x", [], ["a"], [1, 2], [[1]], {},
    {"a": "b"}, {"a": 1}, {1: 2}, 10**30, "a" * 300, "\0", 1e-300, 1e300, [nan, 0.0],
    [0.5] * 3,
]  # fmt: skip
BASE = ImportRecipe.from_dict(WHOLE).to_dict()
PARTS = ("cleaning", "scaling", "cutting", "splitting")
PLACES = [
    *((name,) for name in BASE),
    *((name, key) for name in PARTS for key in BASE[name]),
    *(("options", name) for name in ("x", "frame", "individual", "unit", "nothing")),
]


@pytest.fixture(scope="module")
def table(tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("recipes") / "tracks.csv"
    steps = np.random.default_rng(0).normal(size=(120, 2, 2))
    rows = ["frame,individual,x,y"]
    for frame, (a, b) in enumerate(np.cumsum(steps, axis=0) + 50):
        rows += [f"{frame},a,{a[0]:.3f},{a[1]:.3f}", f"{frame},b,{b[0]:.3f},{b[1]:.3f}"]
    file.write_text("\n".join(rows) + "\n")
    return file


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("place", PLACES, ids=".".join)
def test_values_of_every_kind_are_read_or_refused(place: tuple[str, ...], table: Path) -> None:
    for value in VALUES:
        record = deepcopy(BASE)
        (record if len(place) == 1 else record[place[0]])[place[-1]] = value
        try:
            recipe = ImportRecipe.from_dict(record, "recipe.yaml")
        except InputError as error:
            assert str(error).startswith("recipe.yaml"), error
            continue
        try:
            follow(recipe, [table])
        except InputError as error:
            sentences = getattr(error, "sentences", [str(error)])
            assert not any("\n" in one for one in sentences)


def test_the_recipe_itself_is_followed_and_empty_options_are_refused(table: Path) -> None:
    assert len(follow(ImportRecipe.from_dict(BASE), [table])) > 0
    with pytest.raises(InputError, match=r"r\.yaml: options is None: give a table"):
        ImportRecipe.from_dict({"options": None}, "r.yaml")
