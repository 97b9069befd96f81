"""A recipe: all settings that turn tracker files into demonstrations, saved as YAML."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from animarl_envs.demos.splits import Splitting
from animarl_envs.errors import InputError, require, require_extra
from animarl_envs.files import read_yaml, write_then_rename
from animarl_envs.importing.cleaning import Cleaning, Scaling
from animarl_envs.importing.cutting import Cutting
from animarl_envs.settings import Checked, CountOrZero, Positive, option, plain
from animarl_envs.species import CUSTOM, SPECIES

SMALLEST = 1e-6  # length, time or rate; much less overflows
NOT_STATED = "not stated"  # the licence, where nobody said


@dataclass(frozen=True, kw_only=True)
class ImportRecipe(Checked):
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
    neighbours: CountOrZero | None = option(
        None,
        "neighbours",
        "Of a group without a target: how many of the others each one sees, "
        "the nearest; default: 4.",
    )
    frame_rate: Positive | None = option(None, "fps", "Frame rate of the recording.")
    decision_rate: Positive | None = option(
        None, "decision_rate", "Frame rate of the demonstrations."
    )
    keep_last_frame: bool = option(
        False,
        "",
        "Whether an episode's last frame is kept though it falls between decisions; "
        "velocities then know the shorter interval, and fits leave that step out.",
    )
    metadata: str | None = option(
        None,
        "metadata",
        "Table with the column recording, and any of condition, split, "
        "target, px_per_cm; or with a row for each individual and its role.",
    )
    name_pattern: str | None = option(
        None,
        "name_pattern",
        r"Condition or split from the names of recordings, by a named "
        r"group: (?P\<condition>sham|drug) or (?P\<split>train|test).",
    )
    species: str = option(CUSTOM, "species", "Species of the recordings.")
    condition: int | None = option(None, "condition", "Condition of all episodes: 0 or 1.")
    licence: str = option(NOT_STATED, "licence", "Licence of the recordings.")
    synthetic: bool = option(False, "synthetic", "No animal was recorded; results then say so.")
    cleaning: Cleaning = option(Cleaning, "", "See :class:`Cleaning`.")
    scaling: Scaling = option(Scaling, "", "See :class:`Scaling`.")
    cutting: Cutting = option(Cutting, "", "See :class:`Cutting`.")
    splitting: Splitting = option(Splitting, "", "See :class:`Splitting`.")

    def __post_init__(self) -> None:
        super().__post_init__()
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
            not (self.searcher and (self.scaling.landmarks or self.scaling.obstacles)),
            "a searcher perceives no landmarks and meets no obstacles: leave them out",
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
        """Return plain values, with infinity as a string."""
        values: dict[str, Any] = plain(self)
        return values

    @classmethod
    def from_dict(cls, record: Mapping[str, Any], name: str = "recipe") -> ImportRecipe:
        """Return the recipe of a dictionary (:meth:`to_dict`); refuse unknown entries."""
        _refuse_tiny(record, name)
        return cls.of(record, f"{name}: ")

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


def _refuse_tiny(record: Any, place: str) -> None:
    """Refuse numbers so small that they overflow in what is computed of them."""
    for key, value in record.items() if isinstance(record, Mapping) else ():
        _refuse_tiny(value, f"{place}: {key}")
        if isinstance(value, float) and 0 < abs(value) < SMALLEST:
            raise InputError(f"{place}: {key} is {value:g}: give 0, or at least {SMALLEST:g}")
