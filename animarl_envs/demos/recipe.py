"""A recipe: everything that turns tracker files into demonstrations, saved as YAML to repeat it."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from animarl_envs.demos.cleaning import Cleaning, clean, resample, resample_index
from animarl_envs.demos.cutting import (
    FEWEST_PIECES,
    Cut,
    Cutting,
    cut_episodes,
    in_pieces,
    most_approached,
)
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.scaling import Scaling, scale_of
from animarl_envs.demos.splits import assign_splits
from animarl_envs.demos.tracks import Tracks, merge
from animarl_envs.errors import InputError, MissingExtraError
from animarl_envs.files import write_then_rename

FEWEST_RECORDINGS = 3  # with fewer, episodes rather than recordings are dealt to the splits
FEWEST_EPISODES = 3  # with fewer, a recording is cut in pieces
SHORTEST_PIECE = 10  # decisions


@dataclass(frozen=True, kw_only=True)
class Splitting:
    """How episodes are dealt to train, val and test.

    ``by``: ``"recording"`` (episodes of a recording stay together), ``"episode"``, ``"group"``
    (recordings whose name gives the same first group of the regular expression ``pattern``), or
    ``"auto"``: by recording if there are at least three, else by episode.
    """

    by: Literal["auto", "recording", "episode", "group"] = "auto"
    pattern: str | None = None
    fractions: tuple[float, float, float] = (0.8, 0.1, 0.1)
    seed: int = 0

    def __post_init__(self) -> None:
        fractions = tuple(float(share) for share in self.fractions)
        object.__setattr__(self, "fractions", fractions)
        if len(fractions) != 3 or min(fractions) < 0 or not math.isclose(sum(fractions), 1):
            raise InputError(f"fractions are {fractions}: give three that add up to 1")
        if self.by not in {"auto", "recording", "episode", "group"}:
            raise InputError(
                f"splitting by {self.by!r} is unknown: choose auto, recording, episode or group"
            )
        if (self.by == "group") != (self.pattern is not None):
            raise InputError("splitting by group needs a pattern, and only it does: give both")


@dataclass(frozen=True, kw_only=True)
class Recipe:
    """From files to demonstrations.

    Parameters
    ----------
    source
        Name of the reader; ``None``: found by a look at each file.
    options
        For the reader.
    individuals
        Which to take, in which order; ``None``: all. ``rename`` gives them other names.
    target
        Name of the target (after renaming), ``"auto"``: who is approached, ``None``: none.
    searcher
        Whether the individuals search a source at the origin instead of chasing.
    frame_rate
        Overrides that of the file [Hz].
    decision_rate
        Of the demonstrations [Hz]; ``None``: the frame rate.
    keep_last_frame
        Whether the last recorded frame of an episode is kept though it falls between decisions.
    species, condition, licence, synthetic
        What the demonstrations are.
    """

    source: str | None = None
    options: Mapping[str, Any] = field(default_factory=dict)
    individuals: tuple[str, ...] | None = None
    rename: Mapping[str, str] = field(default_factory=dict)
    target: str | None = None
    searcher: bool = False
    frame_rate: float | None = None
    decision_rate: float | None = None
    keep_last_frame: bool = False
    species: str = "custom"
    condition: int | None = None
    licence: str = "not stated"
    synthetic: bool = False
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
        if self.target is not None and self.searcher:
            raise InputError("a searcher has no target: leave one of them out")

    def to_dict(self) -> dict[str, Any]:
        """Plain values, infinity as a string."""
        return {key: _plain(value) for key, value in asdict(self).items()}

    @classmethod
    def from_dict(cls, record: Mapping[str, Any], name: str = "recipe") -> Recipe:
        """The inverse of :meth:`to_dict`; unknown entries are refused."""
        parts = {
            "cleaning": Cleaning, "scaling": Scaling, "cutting": Cutting, "splitting": Splitting,
        }  # fmt: skip
        values = dict(record)
        for key, kind in parts.items():
            if key in values:
                values[key] = _build(kind, values[key], f"{name}: {key}")
        built = _build(cls, values, name)
        assert isinstance(built, Recipe)
        return built

    def save(self, path: str | Path) -> Path:
        """Write YAML."""
        with write_then_rename(path) as part:
            part.write_text(_yaml().safe_dump(self.to_dict(), sort_keys=False))
        return Path(path)

    @classmethod
    def load(cls, path: str | Path) -> Recipe:
        """Read YAML written by :meth:`save`."""
        yaml = _yaml()
        try:
            record = yaml.safe_load(Path(path).read_text())
        except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
            first = str(error).splitlines()[0]
            raise InputError(f"{path}: the recipe cannot be read ({first}): check it") from None
        if not isinstance(record, dict):
            raise InputError(
                f"{path}: it is no recipe: save one with 'animarl import --recipe-out'"
            )
        return cls.from_dict(record, str(path))


def follow(
    recipe: Recipe, files: Sequence[Path], progress: Callable[[float], None] | None = None
) -> Demonstrations:
    """Read, clean, scale, cut, resample and split.

    ``progress`` is told the share of the work done, 0 to 1.

    Raises
    ------
    InputError
        One sentence that names the file, the place and the mend.
    """
    from animarl_envs.demos.readers.registry import read_tracks

    if not files:
        raise InputError("no file was given: name at least one")
    parts: list[Tracks] = []
    for number, file in enumerate(files):
        told = _part_of(progress, number, len(files))
        parts += read_tracks(file, recipe.source, progress=told, **recipe.options)
    name = str(files[0]) if len(files) == 1 else f"{files[0]} and {len(files) - 1} more"
    return demonstrations_from_tracks(merge(parts), recipe, name)


def demonstrations_from_tracks(
    recordings: Sequence[Tracks], recipe: Recipe, name: str = "tracks"
) -> Demonstrations:
    """The same from tracks already in memory."""
    cleaned, bodies, scales, done = [], [], {}, {}
    for tracks in recordings:
        tracks = _named(tracks, recipe)
        tracks, done[tracks.recording] = clean(tracks, recipe.cleaning)
        scale = scale_of(tracks, recipe.scaling)
        scales[tracks.recording] = scale.to_dict()
        cleaned.append(tracks)
        bodies.append(scale.to_arena(tracks.bodies))
    individuals, roles, order = _roles(cleaned, bodies, recipe, name)
    bodies = [body[:, order] for body in bodies]
    episodes = []
    for tracks, body, cuts in zip(
        cleaned, bodies, _cuts(cleaned, bodies, roles, recipe), strict=True
    ):
        done[tracks.recording]["episodes"] = len(cuts)
        if len(cuts) == 1 and tracks.outcome is not None and recipe.cutting.mode == "whole":
            cuts = [replace(cuts[0], outcome=tracks.outcome)]
        episodes += [_episode(tracks, body, cut, order, recipe) for cut in cuts]
    episodes = [one for one in episodes if len(one["positions"]) >= 2]
    if not episodes:
        raise InputError(
            f"{name}: the cut leaves no episode: loosen the distances or the length limits"
        )
    recording = np.array([one["recording"] for one in episodes])
    rate = recipe.decision_rate or cleaned[0].frame_rate
    assert rate is not None
    first = dict(recordings[0].provenance)
    return Demonstrations(
        species=recipe.species,
        individuals=individuals,
        roles=roles,
        dt=1.0 / rate,
        arena=recipe.scaling.arena,
        positions=np.concatenate([one["positions"] for one in episodes]),
        lengths=np.array([len(one["positions"]) for one in episodes]),
        initial_velocity=np.array([one["initial_velocity"] for one in episodes]),
        condition=np.array([one["condition"] for one in episodes], dtype=np.int8),
        outcome=np.array([one["outcome"] for one in episodes], dtype=np.int8),
        split=_split(recording, recipe.splitting),
        recording=recording,
        signals={
            key: np.concatenate([one["signals"][key] for one in episodes])
            for key in episodes[0]["signals"]
        },
        provenance={
            "source": recipe.source or "found by the file",
            "licence": recipe.licence,
            "synthetic": recipe.synthetic,
            **first,
            "recipe": recipe.to_dict(),
            "scales": scales,
            "cleaning": done,
        },
        name=name,
    )


def _named(tracks: Tracks, recipe: Recipe) -> Tracks:
    if recipe.individuals is not None:
        tracks = tracks.choose(recipe.individuals)
    names = tuple(recipe.rename.get(name, name) for name in tracks.individuals)
    rate = recipe.frame_rate or tracks.frame_rate
    return replace(tracks, individuals=names, frame_rate=rate)


def _roles(
    cleaned: Sequence[Tracks],
    bodies: Sequence[NDArray[np.float64]],
    recipe: Recipe,
    name: str,
) -> tuple[tuple[str, ...], tuple[str, ...], list[int]]:
    """Names and roles, the target last, and the order of the tracks' columns."""
    names = cleaned[0].individuals
    rate = cleaned[0].frame_rate
    for tracks in cleaned:
        if tracks.individuals != names:
            raise InputError(
                f"{name}: {tracks.recording} has individuals {', '.join(tracks.individuals)}, "
                f"{cleaned[0].recording} has {', '.join(names)}: choose the same in all of them"
            )
        if recipe.decision_rate is None and tracks.frame_rate != rate:
            raise InputError(
                f"{name}: {tracks.recording} has {tracks.frame_rate} frames a second, "
                f"{cleaned[0].recording} {rate}: give a decision rate"
            )
    order = list(range(len(names)))
    if recipe.target is None:
        role = "searcher" if recipe.searcher else "pursuer"
        return names, (role,) * len(names), order
    if recipe.target == "auto":
        target = most_approached(bodies)
    elif recipe.target in names:
        target = names.index(recipe.target)
    else:
        raise InputError(
            f"{name}: there is no target {recipe.target!r}: choose among {', '.join(names)}"
        )
    order = [i for i in order if i != target] + [target]
    roles = ("pursuer",) * (len(names) - 1) + ("target",)
    return tuple(names[i] for i in order), roles, order


def _cuts(
    cleaned: Sequence[Tracks],
    bodies: Sequence[NDArray[np.float64]],
    roles: tuple[str, ...],
    recipe: Recipe,
) -> list[list[Cut]]:
    """The episodes of each recording; a lone long recording is cut in pieces, see ``Cutting``."""
    rates = [tracks.frame_rate or 1.0 for tracks in cleaned]
    found = [
        cut_episodes(body, roles, rate, recipe.cutting, tracks.recording)
        for tracks, body, rate in zip(cleaned, bodies, rates, strict=True)
    ]
    piece = recipe.cutting.piece
    if recipe.cutting.mode != "whole":
        return found
    if piece is None and 0 < sum(map(len, found)) < FEWEST_EPISODES:
        seconds = sum(
            (cut.stop - cut.start) / rate
            for cuts, rate in zip(found, rates, strict=True)
            for cut in cuts
        )
        decisions = seconds * (recipe.decision_rate or rates[0])
        if decisions >= FEWEST_PIECES * SHORTEST_PIECE:
            piece = seconds / FEWEST_PIECES
    if piece is None:
        return found
    return [
        in_pieces(cuts, rate, piece, rate / (recipe.decision_rate or rate))
        for cuts, rate in zip(found, rates, strict=True)
    ]


def _episode(
    tracks: Tracks, body: NDArray[np.float64], cut: Cut, order: list[int], recipe: Recipe
) -> dict[str, Any]:
    """One episode at the decision rate; its first sample only serves to make the first velocity."""
    assert tracks.frame_rate is not None
    rate = recipe.decision_rate or tracks.frame_rate
    every = tracks.frame_rate / rate
    frames = slice(cut.start, cut.stop)
    if every < 1 - 1e-9:
        raise InputError(
            f"{tracks.recording}: it has {tracks.frame_rate:g} frames a second: choose a decision "
            "rate no higher than that"
        )
    if abs(every - round(every)) < 1e-9:
        index = resample_index(cut.stop - cut.start, round(every), recipe.keep_last_frame)
        samples = body[frames][index]
    else:
        if recipe.keep_last_frame:
            raise InputError(
                f"{tracks.recording}: the last frame can be kept only if the decision rate divides "
                f"{tracks.frame_rate:g} Hz: choose another rate"
            )
        samples = resample(body[frames], tracks.frame_rate, rate)
        index = np.round(np.arange(len(samples)) * every).astype(np.int64)
    several = len(tracks.individuals)
    signals = {}
    for key, value in tracks.signals.items():
        taken = value[frames][index][1:]
        own = taken.ndim > 1 and taken.shape[1] == several
        signals[key] = taken[:, order] if own else taken
    condition = cut.condition if cut.condition is not None else tracks.condition
    first = (samples[1] - samples[0]) * rate if len(samples) > 1 else np.zeros((several, 2))
    return {
        "positions": samples[1:],
        "initial_velocity": first,
        "condition": recipe.condition if recipe.condition is not None else condition,
        "outcome": cut.outcome,
        "recording": tracks.recording,
        "signals": signals,
    }


def deal(demos: Demonstrations, settings: Splitting) -> Demonstrations:
    """The same episodes, dealt anew to train, val and test."""
    return replace(demos, split=_split(demos.recording, settings))


def _split(recording: NDArray[np.str_], settings: Splitting) -> NDArray[np.str_]:
    by = settings.by
    if by == "auto":
        by = "recording" if len(np.unique(recording)) >= FEWEST_RECORDINGS else "episode"
    groups = recording
    if by == "episode":
        groups = np.array([f"{i:06d}" for i in range(len(recording))])
    elif by == "group":
        assert settings.pattern is not None
        try:
            pattern = re.compile(settings.pattern)
        except re.error as error:
            raise InputError(
                f"splitting pattern {settings.pattern!r} is no regular expression ({error})"
            ) from None
        found = [pattern.search(name) for name in recording.tolist()]
        if pattern.groups < 1 or not all(found):
            raise InputError(
                f"splitting pattern {settings.pattern!r} does not fit every recording or has no "
                "(group): write one that does"
            )
        groups = np.array([match.group(1) for match in found if match])
    return assign_splits(groups, settings.seed, settings.fractions)


def _part_of(
    progress: Callable[[float], None] | None, number: int, total: int
) -> Callable[[float], None] | None:
    if progress is None:
        return None
    return lambda share: progress((number + share) / total)


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
