"""Who is who in the recordings of an import: names, the target or the pursuer, the order."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

from animarl_envs.errors import require
from animarl_envs.importing.cutting import most_approached
from animarl_envs.importing.import_recipe import ImportRecipe
from animarl_envs.importing.sessions import PURSUER, TARGET, Session, Sessions
from animarl_envs.importing.tracks import Tracks

AUTO = "auto"
MANY = {TARGET: PURSUER, PURSUER: TARGET}  # the role of the others, where one has this role


class FocusRole(NamedTuple):
    """Whom all others face: the target, or the pursuer of several targets."""

    name: str
    role: str


def apply_names(tracks: Tracks, recipe: ImportRecipe) -> Tracks:
    """The recording with the individuals, names and frame rate that the recipe states."""
    for name in sorted(recipe.rename):
        require(
            name in tracks.individuals,
            f"{tracks.recording}: there is no individual {name!r} to rename: choose among "
            f"{', '.join(tracks.individuals)}",
        )
    if recipe.individuals is not None:
        tracks = tracks.choose(recipe.individuals)
    names = tuple(recipe.rename.get(name, name) for name in tracks.individuals)
    rate = recipe.frame_rate or tracks.frame_rate
    return replace(tracks, individuals=names, frame_rate=rate)


def assign_focus(
    recordings: list[Tracks], recipe: ImportRecipe, sessions: Sessions, name: str
) -> tuple[list[Tracks], FocusRole | None]:
    """Whom all others face, and the recordings, named by role where theirs differ.

    Raises
    ------
    InputError
        If a target is named for some recordings only, some have several, or their units differ.
    """
    first = recordings[0]
    for one in recordings:
        require(
            one.unit == first.unit,
            f"{name}: {one.recording} is in {one.unit}, {first.recording} in {first.unit}: give "
            "px_per_cm of all recordings, or of none",
        )
    stated = [_stated_focus(sessions.of(one.recording), name, one.recording) for one in recordings]
    told = [focus for focus in stated if focus is not None]
    if told:
        for one, focus in zip(recordings, stated, strict=True):
            require(
                focus,
                f"{name}: no target is named for {one.recording}: name one for every recording",
            )
        require(
            len({focus.role for focus in told}) == 1,
            f"{name}: some recordings have one target and others several: import them apart",
        )
        if len({(one.individuals, focus) for one, focus in zip(recordings, told, strict=True)}) > 1:
            return _named_by_role(recordings, told), FocusRole(told[0].role, told[0].role)
        return recordings, told[0]
    if recipe.pursuer is not None:
        return recordings, FocusRole(recipe.pursuer, PURSUER)
    if recipe.target != AUTO:
        return recordings, None if recipe.target is None else FocusRole(recipe.target, TARGET)
    if len(first.individuals) < 2 or any(t.individuals != first.individuals for t in recordings):
        return recordings, None
    target = most_approached([tracks.bodies for tracks in recordings])
    return recordings, FocusRole(first.individuals[target], TARGET)


def assign_roles(
    cleaned: Sequence[Tracks], focus: FocusRole | None, recipe: ImportRecipe, name: str
) -> tuple[tuple[str, ...], tuple[str, ...], list[int]]:
    """Names and roles, whom all others face last, and the order of the tracks' columns."""
    first = cleaned[0]
    names = first.individuals
    for tracks in cleaned:
        require(
            tracks.individuals == names,
            f"{name}: {tracks.recording} has individuals {', '.join(tracks.individuals)}, "
            f"{first.recording} has {', '.join(names)}: choose the same in all of them, "
            "or name the target of each by --metadata",
        )
        require(
            recipe.decision_rate is not None or tracks.frame_rate == first.frame_rate,
            f"{name}: {tracks.recording} has {tracks.frame_rate} frames a second, "
            f"{first.recording} {first.frame_rate}: give a decision rate",
        )
    order = list(range(len(names)))
    if focus is None:
        role = "searcher" if recipe.searcher else "pursuer"
        return names, (role,) * len(names), order
    require(
        focus.name in names,
        f"{name}: there is no {focus.role} {focus.name!r}: choose among {', '.join(names)}",
    )
    order.append(order.pop(names.index(focus.name)))
    roles = (MANY[focus.role],) * (len(names) - 1) + (focus.role,)
    return tuple(names[i] for i in order), roles, order


def _stated_focus(session: Session, name: str, recording: str) -> FocusRole | None:
    """Who is pursued in a recording, or who pursues several, if it is said."""
    of = {role: [n for n, r in session.roles.items() if r == role] for role in (TARGET, PURSUER)}
    if not of[TARGET]:
        return None if session.target is None else FocusRole(session.target, TARGET)
    role = PURSUER if len(of[TARGET]) > 1 else TARGET
    require(of[role], f"{name}: several targets but no pursuer in {recording}: name who pursues")
    return FocusRole(of[role][0], role)


def _named_by_role(recordings: Sequence[Tracks], focus: Sequence[FocusRole]) -> list[Tracks]:
    """Recordings of different animals under the same names: ``pursuer_0``, ..., ``target``.

    Of several targets: ``target_0``, ..., ``pursuer``.
    """
    renamed = []
    for tracks, (last, role) in zip(recordings, focus, strict=True):
        others = [name for name in tracks.individuals if name != last]
        names = [f"{MANY[role]}_{i}" for i in range(len(others))]
        ordered = tracks.choose([*others, last])
        renamed.append(replace(ordered, individuals=(*names, role)))
    return renamed
