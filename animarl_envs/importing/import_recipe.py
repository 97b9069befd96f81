"""A recipe: all settings that turn tracker files into demonstrations, saved as YAML."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_type_hints

import numpy as np
from pydantic import TypeAdapter, ValidationError

from animarl_envs.checks import check_options, option, plain
from animarl_envs.demos.splits import Splitting
from animarl_envs.errors import InputError, require, require_extra
from animarl_envs.files import read_yaml, write_then_rename
from animarl_envs.importing.cleaning import Cleaning, Scaling
from animarl_envs.importing.cutting import Cutting
from animarl_envs.species import CUSTOM, SPECIES

SMALLEST = 1e-6  # length, time or rate; much less overflows
NOT_STATED = "not stated"  # the licence, where nobody said


@dataclass(frozen=True, kw_only=True)
class ImportRecipe:
    """From files to demonstrations; each entry says what it is, and how the command calls it."""

    source: str | None = option(None, "", "Name of the reader; default: found by content.")
    options: Mapping[str, Any] = option(
        dict, "option", "An option of the reader, as name=value (YAML)."
    )
    individuals: tuple[str, ...] | None = option(
        None, "individuals", "Which individuals, in order: a,b,c. To rename: a=male,b=female."
    )
    rename: Mapping[str, str] = option(dict, "", "Other names of individuals.")
    merge_individuals: bool = option(
        False, "merge_individuals", "The files hold one animal each: join them."
    )
    target: str | None = option(
        None, "target", "The pursued individual; auto (default): found by approaches; none."
    )
    pursuer: str | None = option(None, "pursuer", "The only pursuer; all others are its targets.")
    searcher: bool = option(False, "", "Whether they search a source at the origin, not a target.")
    neighbours: int | None = option(
        None, "neighbours", "Of a group without a target: how many of the others each one sees, "
        "the nearest; default: 4.", "zero or positive",
    )  # fmt: skip
    frame_rate: float | None = option(
        None, "fps", "Frame rate of the recording.", "a positive number", "Hz"
    )
    decision_rate: float | None = option(
        None, "decision_rate", "Frame rate of the demonstrations.", "a positive number", "Hz"
    )
    keep_last_frame: bool = option(
        False, "", "Whether an episode's last frame is kept though it falls between decisions; "
        "velocities then know the shorter interval, and fits leave that step out.",
    )  # fmt: skip
    metadata: str | None = option(
        None, "metadata", "Table with the column recording, and any of condition, split, "
        "target, px_per_cm; or with a row for each individual and its role.",
    )  # fmt: skip
    name_pattern: str | None = option(
        None, "name_pattern", r"Condition or split from the names of recordings, by a named "
        r"group: (?P\<condition>sham|drug) or (?P\<split>train|test).",
    )  # fmt: skip
    species: str = option(CUSTOM, "species", "Species of the recordings.")
    condition: int | None = option(None, "condition", "Condition of all episodes: 0 or 1.")
    licence: str = option(NOT_STATED, "licence", "Licence of the recordings.")
    synthetic: bool = option(False, "synthetic", "No animal was recorded; results then say so.")
    cleaning: Cleaning = option(Cleaning, "", "See :class:`Cleaning`.")
    scaling: Scaling = option(Scaling, "", "See :class:`Scaling`.")
    cutting: Cutting = option(Cutting, "", "See :class:`Cutting`.")
    splitting: Splitting = option(Splitting, "", "See :class:`Splitting`.")

    def __post_init__(self) -> None:
        check_options(self)
        if self.individuals is not None:
            object.__setattr__(self, "individuals", tuple(self.individuals))
        known = [*SPECIES, CUSTOM]
        require(
            self.species in known,
            f"species {self.species!r} is unknown: choose one of {', '.join(known)}",
        )
        require(
            self.target is None or not self.searcher,
            "a searcher has no target: leave one of them out",
        )
        require(
            self.pursuer is None or (self.target is None and not self.searcher),
            "where a pursuer is named all others are its targets: name no target, and no search",
        )
        require(
            self.metadata is None or self.name_pattern is None,
            "metadata and a name pattern say the same: leave one of them out",
        )
        require(self.condition in (None, 0, 1), f"condition is {self.condition}: it must be 0 or 1")

    def to_dict(self) -> dict[str, Any]:
        """Plain values, infinity as a string."""
        found: dict[str, Any] = plain(self)
        return found

    @classmethod
    def from_dict(cls, record: Mapping[str, Any], name: str = "recipe") -> ImportRecipe:
        """The inverse of :meth:`to_dict`; unknown entries are refused."""
        values = dict(record)
        for kind in (Cleaning, Scaling, Cutting, Splitting):
            key = kind.__name__.lower()
            if key in values:
                values[key] = _build(kind, values[key], f"{name}: {key}")
        built = _build(cls, values, name)
        assert isinstance(built, ImportRecipe)
        return built

    def save(self, path: str | Path) -> Path:
        """Write YAML."""
        with require_extra("recipes in YAML", "data"):
            import yaml
        with write_then_rename(path) as part:
            part.write_text(yaml.safe_dump(self.to_dict(), sort_keys=False))
        return Path(path)

    @classmethod
    def load(cls, path: str | Path) -> ImportRecipe:
        """Read YAML written by :meth:`save`."""
        record = read_yaml(Path(path))
        if not isinstance(record, dict):
            raise InputError(
                f"{path}: it is no recipe: give one that 'animarl import' wrote beside its --out"
            )
        return cls.from_dict(record, str(path))


def _build(kind: type[Any], values: Any, name: str) -> Any:
    require(isinstance(values, Mapping), f"{name}: it is {values!r:.80}: give names and values")
    hints = get_type_hints(kind)
    if unknown := sorted(str(key) for key in set(values) - set(hints)):
        raise InputError(
            f"{name}: the entry {unknown[0]!r} is unknown: choose among {', '.join(sorted(hints))}"
        )
    checked = {key: _of_kind(hints[key], value, f"{name}: {key}") for key, value in values.items()}
    try:
        return kind(**checked)
    except InputError as error:
        raise InputError(f"{name}: {error}") from None


def _of_kind(hint: Any, value: Any, place: str) -> Any:
    """Return a value of the kind that ``hint`` is; infinity may be text, and a tuple a list."""
    if isinstance(value, str) and value in ("inf", "-inf"):
        value = float(value)
    elif isinstance(value, list):
        value = tuple(value)
    elif isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float) and 0 < abs(value) < SMALLEST:
        raise InputError(f"{place} is {value:g}: give 0, or at least {SMALLEST:g}")
    try:
        return TypeAdapter(hint).validate_python(value, strict=True)
    except ValidationError as error:
        problem = error.errors()[0]["msg"].replace("Input", "it", 1)
        raise InputError(f"{place} is {value!r:.80}: {problem[0].lower()}{problem[1:]}") from None
