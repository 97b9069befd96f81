"""Dealing episodes to train, validation and test without leakage."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.episode import SPLITS
from animarl_envs.errors import InputError
from animarl_envs.settings import Checked, option
from animarl_envs.wall import search_names

FEWEST_FOLDS = 3  # train, val and test
FOLD_VALIDATION = 1 / 8  # of the recordings that a fold of a run does not test
FEWEST_RECORDINGS = 3  # with fewer, episodes rather than recordings are dealt to the splits


@dataclass(frozen=True, kw_only=True)
class Splitting(Checked):
    """How episodes are dealt to train, val and test.

    By ``"group"``: recordings whose name gives the same first group of the regular expression
    ``pattern``; ``"auto"``: by recording if there are at least three, else by episode.
    """

    by: Literal["auto", "recording", "episode", "group"] = option(
        "auto", "split_by", "What is kept together: auto, recording, episode or group."
    )
    pattern: str | None = option(None, "split_pattern", "group: regular expression with a (group).")
    fractions: tuple[float, float, float] = (0.8, 0.1, 0.1)
    seed: int = option(0, "split_seed", "Seed of the splits.")

    def __post_init__(self) -> None:
        fractions = tuple(float(share) for share in self.fractions)
        object.__setattr__(self, "fractions", fractions)
        if len(fractions) != 3 or min(fractions) < 0 or not math.isclose(sum(fractions), 1):
            raise InputError(f"fractions are {fractions}: give three that add up to 1")
        super().__post_init__()
        if self.seed < 0:
            raise InputError(f"the seed of the splits is {self.seed}: give zero or more")
        if (self.by == "group") != (self.pattern is not None):
            raise InputError("splitting by group needs a pattern, and only it does: give both")


def deal(demos: Demonstrations, settings: Splitting) -> Demonstrations:
    """Return the same episodes, dealt anew to train, val and test."""
    animals = demos.provenance.get("animals")
    split = split_recordings(demos.recording, settings, demos.condition, animals)
    return replace(demos, split=split)


def learnable(demos: Demonstrations) -> Demonstrations:
    """Return the train and val episodes, which may be learned from; all, if none is of these.

    Whatever fits, trains, tunes or chooses is handed this, which holds no test episode.
    """
    kept = demos.split != "test"
    if kept.all() or not kept.any():
        return demos
    return demos.select(episodes=np.flatnonzero(kept))


def training_episodes(demos: Demonstrations) -> Demonstrations:
    """Return the train episodes; all, if there are none."""
    return demos.select(split="train") if (demos.split == "train").any() else demos


def refuse_empty_splits(demos: Demonstrations) -> None:
    """Refuse demonstrations without at least one training, validation and test episode each.

    Raises InputError if there are none of one of them; it says how to come by them.
    """
    empty = [split for split in SPLITS if not (demos.split == split).any()]
    if not empty:
        return
    recordings, episodes = len(np.unique(demos.recording)), demos.num_episodes
    if recordings >= len(SPLITS):
        fix = "deal them again with 'animarl data split'"
    elif episodes >= len(SPLITS):
        fix = f"it has {recordings} recordings, so deal with 'animarl data split --by episode'"
    else:
        fix = f"it has {episodes} episodes, so record more or 'animarl import' with --piece"
    raise InputError(f"{demos.name}: split {empty[0]!r} holds no episode: {fix}")


def run_folds(demos: Demonstrations, folds: int) -> Iterator[Demonstrations]:
    """Yield the recordings as each fold of a run splits them; the first is the run's own."""
    return cross_validated(demos, folds, FOLD_VALIDATION)


def cross_validated(
    demos: Demonstrations, folds: int, validation: float | None = None
) -> Iterator[Demonstrations]:
    """Yield the demonstrations once per fold: each episode is test once, else val or train.

    Episodes of a recording, and of an animal that is named, stay together, unless there are fewer
    than three of them. Every condition is spread evenly over the folds. The split that they had
    before has no influence. Each episode is val once; with ``validation``, such a share of what is
    not tested is val in each fold instead, so that few folds leave enough to train on.
    Raises InputError if there are fewer than three folds, or fewer recordings (or episodes) than
    folds.
    """
    dealt = _animals_of(demos.recording, demos.provenance.get("animals", {}))
    if len(np.unique(dealt)) < FEWEST_RECORDINGS:
        dealt = np.arange(len(demos)).astype(str)
    names = np.random.default_rng(0).permutation(np.unique(dealt))
    if not FEWEST_FOLDS <= folds <= len(names):
        raise InputError(
            f"{demos.name}: {folds} folds of {len(names)} recordings or episodes: give "
            f"{FEWEST_FOLDS} folds at least, and no more than there are of them"
        )
    conditions = _conditions_by_group(dealt, demos.condition)
    names = names[np.argsort([conditions[name] for name in names.tolist()], kind="stable")]
    fold = {name: i % folds for i, name in enumerate(names.tolist())}
    own = np.array([fold[name] for name in dealt.tolist()])
    for number in range(folds):
        tested, validated = own == (number + 1) % folds, own == number
        if validation is not None:
            kept = [name for name in names.tolist() if fold[name] != (number + 1) % folds]
            count = max(1, round(validation * len(kept)))
            validated = np.isin(dealt, [kept[i * len(kept) // count] for i in range(count)])
        split = np.where(validated, "val", "train")
        split[tested] = "test"
        yield replace(demos, split=split)


def split_recordings(
    recording: NDArray[np.str_],
    settings: Splitting,
    condition: NDArray[np.integer] | None = None,
    animals: Mapping[str, str] | None = None,
) -> NDArray[np.str_]:
    """Return the split of each episode, from the recording it belongs to.

    Each ``condition`` is dealt by itself. Recordings of the same of ``animals``, by recording, stay
    together.
    """
    by = settings.by
    animal = _animals_of(recording, animals or {})
    if by == "auto":
        by = "recording" if len(np.unique(animal)) >= FEWEST_RECORDINGS else "episode"
    groups = animal
    if by == "episode":
        groups = np.array([f"{i:06d}" for i in range(len(recording))])
    elif by == "group":
        assert settings.pattern is not None
        place = f"splitting pattern {settings.pattern!r}"
        matches = search_names(settings.pattern, recording.tolist(), place)
        first = [groups and groups.get("1") for groups in matches]
        if None in first:
            raise InputError(
                f"{place} does not fit every recording or has no (group): write one that does"
            )
        groups = np.array(first)
    return _stratified_splits(groups, settings, condition)


def _animals_of(recording: NDArray[np.str_], animals: Mapping[str, str]) -> NDArray[np.str_]:
    """Return the animal of each recording, or its own name where none is stated."""
    return np.array([animals.get(name, name) for name in recording.tolist()])


def _stratified_splits(
    groups: NDArray[np.str_], settings: Splitting, condition: NDArray[np.integer] | None
) -> NDArray[np.str_]:
    """Return splits in which every condition has its share of each.

    Groups of several conditions are dealt by themselves. Where a condition has too few groups for
    three splits, all are dealt together.
    """
    conditions = _conditions_by_group(groups, condition)
    kinds = np.array([conditions[name] for name in groups.tolist()])
    dealt = np.full(len(groups), SPLITS[0])
    for kind in np.unique(kinds):
        own = kinds == kind
        if len(np.unique(groups[own])) < FEWEST_RECORDINGS:
            return assign_splits(groups, settings.seed, settings.fractions)
        dealt[own] = assign_splits(groups[own], settings.seed, settings.fractions)
    return dealt


def _conditions_by_group(
    groups: NDArray[np.str_], condition: NDArray[np.integer] | None
) -> dict[str, str]:
    """Return the conditions that the episodes of each group are of, as a text."""
    numbers = {name: set[int]() for name in groups.tolist()}
    for name, one in zip(groups.tolist(), [0] * len(groups) if condition is None else condition):
        numbers[name].add(int(one))
    return {name: str(sorted(some)) for name, some in numbers.items()}


def assign_splits(
    groups: Sequence[str] | NDArray[np.str_],
    seed: int,
    fractions: tuple[float, float, float] = (0.8, 0.1, 0.1),
) -> NDArray[np.str_]:
    """Deal whole groups (episodes or recordings) to train, val and test, repeatably.

    Groups are shuffled and dealt until each split has its share of episodes; none straddles
    two splits. With three groups or more no split stays empty.
    """
    groups = np.asarray(groups)
    names = np.unique(groups)
    np.random.default_rng(seed).shuffle(names)
    sizes = np.array([(groups == name).sum() for name in names])
    centre = (np.cumsum(sizes) - sizes / 2) / sizes.sum()
    edges = np.cumsum(fractions)
    part = np.minimum(np.searchsorted(edges, centre, side="right"), 2)
    if len(names) >= 3:
        for missing in range(3):
            if fractions[missing] > 0 and not (part == missing).any():
                donor = np.bincount(part, minlength=3).argmax()
                part[np.flatnonzero(part == donor)[-1]] = missing
    lookup = dict(zip(names.tolist(), part.tolist(), strict=True))
    return np.array([SPLITS[lookup[g]] for g in groups.tolist()])
