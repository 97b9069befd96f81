"""A recipe: all settings that turn tracker files into demonstrations, saved as YAML."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

from animarl_envs.checks import option, option_metadata
from animarl_envs.demos.splits import Splitting
from animarl_envs.errors import InputError, MissingExtraError
from animarl_envs.files import write_then_rename
from animarl_envs.importing.cleaning import Cleaning
from animarl_envs.importing.cutting import Cutting
from animarl_envs.importing.plain_yaml import read_yaml
from animarl_envs.importing.scaling import Scaling
from animarl_envs.species import CUSTOM, SPECIES

NOT_STATED = "not stated"  # the licence, where nobody said


@dataclass(frozen=True, kw_only=True)
class ImportRecipe:
    """From files to demonstrations.

    Parameters
    ----------
    source
        Name of the reader; ``None``: found by a look at each file.
    options
        For the reader.
    individuals
        Which to take, in which order; ``None``: all. ``rename`` gives them other names.
    merge_individuals
        Whether the files hold one animal each of one recording.
    target
        Name of the target (after renaming), ``"auto"``: who is approached, if there are two or
        more; ``None``: none.
    pursuer
        Name of the only pursuer (after renaming), of whom all others are targets.
    searcher
        Whether the individuals search a source at the origin instead of chasing.
    frame_rate
        Overrides that of the file [Hz].
    decision_rate
        Of the demonstrations [Hz]; ``None``: the frame rate.
    keep_last_frame
        Whether the last recorded frame of an episode is kept though it falls between decisions;
        velocities then know the shorter interval, and fits leave that step out.
    metadata, name_pattern
        A table of the recordings, or a regular expression over their names, which tells their
        condition, split, roles and scale: :mod:`animarl_envs.importing.sessions`.
    species, condition, licence, synthetic
        What the demonstrations are.
    """

    source: str | None = None
    options: Mapping[str, Any] = field(
        default_factory=dict,
        metadata=option_metadata("option", "Of the reader: name=value, value as YAML."),
    )
    individuals: tuple[str, ...] | None = option(
        None, "individuals", "Which, in order: a,b,c; rename by a=male,b=female."
    )
    rename: Mapping[str, str] = field(default_factory=dict)
    merge_individuals: bool = option(
        False, "merge_individuals", "One file per animal: put together."
    )
    target: str | None = option(
        None, "target", "The pursued individual; auto (default): who is approached; none."
    )
    pursuer: str | None = option(None, "pursuer", "The only pursuer: all others are its targets.")
    searcher: bool = False
    frame_rate: float | None = option(None, "fps", "Frames a second of the recording.")
    decision_rate: float | None = option(
        None, "decision_rate", "Samples a second of the demonstrations."
    )
    keep_last_frame: bool = False
    metadata: str | None = option(
        None,
        "metadata",
        "Table of recordings: recording, and condition, split, target, px_per_cm, or a row for "
        "each individual and role.",
    )
    name_pattern: str | None = option(
        None,
        "name_pattern",
        r"The same by groups in names of recordings: (?P\<condition>sham|drug) or "
        r"(?P\<split>train|test).",
    )
    species: str = option(CUSTOM, "species", "Species they belong to.")
    condition: int | None = option(None, "condition", "0 or 1, of all episodes.")
    licence: str = option(NOT_STATED, "licence", "Of the recordings.")
    synthetic: bool = option(False, "synthetic", "No animal was recorded: say so everywhere.")
    cleaning: Cleaning = field(default_factory=Cleaning)
    scaling: Scaling = field(default_factory=Scaling)
    cutting: Cutting = field(default_factory=Cutting)
    splitting: Splitting = field(default_factory=Splitting)

    def __post_init__(self) -> None:
        for name in ("frame_rate", "decision_rate"):
            rate = getattr(self, name)
            if rate is not None and not 0 < rate < math.inf:
                raise InputError(f"{name} is {rate} Hz: it must be a positive number")
        if self.individuals is not None:
            object.__setattr__(self, "individuals", tuple(self.individuals))
        if self.species not in (*SPECIES, CUSTOM):
            raise InputError(
                f"species {self.species!r} is unknown: choose one of "
                f"{', '.join([*SPECIES, CUSTOM])}"
            )
        if self.target is not None and self.searcher:
            raise InputError("a searcher has no target: leave one of them out")
        if self.pursuer is not None and (self.target is not None or self.searcher):
            raise InputError(
                "where a pursuer is named all others are its targets: name no target, and no search"
            )
        if self.metadata is not None and self.name_pattern is not None:
            raise InputError("metadata and a name pattern say the same: leave one of them out")
        if self.condition not in (None, 0, 1):
            raise InputError(f"condition is {self.condition}: it must be 0 or 1")

    def to_dict(self) -> dict[str, Any]:
        """Plain values, infinity as a string."""
        return {key: _plain(value) for key, value in asdict(self).items()}

    @classmethod
    def from_dict(cls, record: Mapping[str, Any], name: str = "recipe") -> ImportRecipe:
        """The inverse of :meth:`to_dict`; unknown entries are refused."""
        parts = {
            "cleaning": Cleaning, "scaling": Scaling, "cutting": Cutting, "splitting": Splitting,
        }  # fmt: skip
        values = dict(record)
        for key, kind in parts.items():
            if key in values:
                values[key] = _build(kind, values[key], f"{name}: {key}")
        built = _build(cls, values, name)
        assert isinstance(built, ImportRecipe)
        return built

    def save(self, path: str | Path) -> Path:
        """Write YAML."""
        with write_then_rename(path) as part:
            part.write_text(_yaml().safe_dump(self.to_dict(), sort_keys=False))
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
    if not isinstance(values, Mapping):
        raise InputError(f"{name}: it is {values!r}: give names and values")
    known = {one.name for one in fields(kind)}
    unknown = sorted(str(key) for key in set(values) - known)
    if unknown:
        raise InputError(
            f"{name}: the entry {unknown[0]!r} is unknown: choose among {', '.join(sorted(known))}"
        )
    given = {
        key: float(value) if isinstance(value, str) and value in ("inf", "-inf") else value
        for key, value in values.items()
    }
    try:
        return kind(**given)
    except InputError as error:
        raise InputError(f"{name}: {error}") from None
    except (TypeError, ValueError) as error:
        raise InputError(f"{name}: a value does not fit ({error}): check the recipe") from None


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _plain(entry) for key, entry in value.items()}
    if isinstance(value, (tuple, list)):
        return [_plain(entry) for entry in value]
    if isinstance(value, float) and math.isinf(value):
        return str(value)
    return value


def _yaml() -> Any:
    try:
        import yaml
    except ImportError as error:
        raise MissingExtraError("recipes in YAML", "data") from error
    return yaml
