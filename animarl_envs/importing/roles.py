"""Who is who in the recordings of an import: names, the target, the order of the others."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from animarl_envs.errors import InputError
from animarl_envs.importing.cutting import most_approached
from animarl_envs.importing.import_recipe import ImportRecipe
from animarl_envs.importing.sessions import TARGET, Sessions, named_by_role, target_of
from animarl_envs.importing.tracks import Tracks

AUTO = "auto"


def named(tracks: Tracks, recipe: ImportRecipe) -> Tracks:
    """The recording with the individuals, names and frame rate that the recipe states."""
    strangers = sorted(set(recipe.rename) - set(tracks.individuals))
    if strangers:
        raise InputError(
            f"{tracks.recording}: there is no individual {strangers[0]!r} to rename: choose among "
            f"{', '.join(tracks.individuals)}"
        )
    if recipe.individuals is not None:
        tracks = tracks.choose(recipe.individuals)
    names = tuple(recipe.rename.get(name, name) for name in tracks.individuals)
    rate = recipe.frame_rate or tracks.frame_rate
    return replace(tracks, individuals=names, frame_rate=rate)


def with_target(
    recordings: list[Tracks], recipe: ImportRecipe, sessions: Sessions, name: str
) -> tuple[list[Tracks], str | None]:
    """The target's name, and the recordings, named by role where theirs differ.

    Raises
    ------
    InputError
        If a target is named for some recordings only, or the recordings differ in their unit.
    """
    _check_units(recordings, name)
    stated = [target_of(sessions.of(tracks.recording)) for tracks in recordings]
    targets = [who for who in stated if who is not None]
    if targets:
        if None in stated:
            untold = recordings[stated.index(None)].recording
            raise InputError(
                f"{name}: no target is named for {untold}: name one for every recording"
            )
        if (
            len({(tracks.individuals, who) for tracks, who in zip(recordings, stated, strict=True)})
            > 1
        ):
            return named_by_role(recordings, targets), TARGET
        return recordings, targets[0]
    if recipe.target != AUTO:
        return recordings, recipe.target
    names = recordings[0].individuals
    if len(names) < 2 or any(tracks.individuals != names for tracks in recordings):
        return recordings, None
    return recordings, names[most_approached([tracks.bodies for tracks in recordings])]


def roles_of(
    cleaned: Sequence[Tracks], target: str | None, recipe: ImportRecipe, name: str
) -> tuple[tuple[str, ...], tuple[str, ...], list[int]]:
    """Names and roles, the target last, and the order of the tracks' columns."""
    names = cleaned[0].individuals
    rate = cleaned[0].frame_rate
    for tracks in cleaned:
        if tracks.individuals != names:
            raise InputError(
                f"{name}: {tracks.recording} has individuals {', '.join(tracks.individuals)}, "
                f"{cleaned[0].recording} has {', '.join(names)}: choose the same in all of them, "
                "or name the target of each by --metadata"
            )
        if recipe.decision_rate is None and tracks.frame_rate != rate:
            raise InputError(
                f"{name}: {tracks.recording} has {tracks.frame_rate} frames a second, "
                f"{cleaned[0].recording} {rate}: give a decision rate"
            )
    order = list(range(len(names)))
    if target is None:
        role = "searcher" if recipe.searcher else "pursuer"
        return names, (role,) * len(names), order
    if target not in names:
        raise InputError(f"{name}: there is no target {target!r}: choose among {', '.join(names)}")
    last = names.index(target)
    order = [i for i in order if i != last] + [last]
    roles = ("pursuer",) * (len(names) - 1) + ("target",)
    return tuple(names[i] for i in order), roles, order


def _check_units(cleaned: Sequence[Tracks], name: str) -> None:
    for tracks in cleaned:
        if tracks.unit != cleaned[0].unit:
            raise InputError(
                f"{name}: {tracks.recording} is in {tracks.unit}, {cleaned[0].recording} in "
                f"{cleaned[0].unit}: give px_per_cm of all recordings, or of none"
            )
