"""Condition, split, roles and scale of recordings, and the names and roles of their individuals.

That comes from the recipe, from a table with a row per recording (``--metadata``), from a pattern
over their names (``--name-pattern``), or from a column ``condition`` of the tracks.
"""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from animarl_envs.demos.episode import SPLITS
from animarl_envs.demos.splits import Splitting, split_recordings
from animarl_envs.errors import InputError, require
from animarl_envs.importing.cutting import pursued_individual
from animarl_envs.importing.import_recipe import ImportRecipe
from animarl_envs.importing.tables import read_rows
from animarl_envs.importing.tracks import STATED_CONDITION, Tracks
from animarl_envs.settings import check_names
from animarl_envs.wall import search_names

COLUMNS = ("recording", "condition", "split", "target", "individual", "role", "px_per_cm", "animal")
GROUPS = ("condition", "split", "target", "animal")
TARGET, PURSUER = "target", "pursuer"
OTHER_ROLE = {TARGET: PURSUER, PURSUER: TARGET}  # the role of the others, where one has this role
AUTO = "auto"
NO_CONDITION = "condition (two are simulated, and each recording has one: give --metadata TABLE)"


@dataclass(frozen=True, kw_only=True)
class Session:
    """What is stated of one recording; ``None`` where nothing is.

    ``condition`` is the word that stands there. ``roles`` are individuals by name with ``pursuer``
    or ``target``, the others are left out. ``px_per_cm`` is how many of the file's units make 1 cm.
    ``animal`` is the animal, pair or litter, whose recordings stay in one split.
    """

    condition: str | None = None
    split: str | None = None
    target: str | None = None
    roles: Mapping[str, str] = field(default_factory=dict)
    px_per_cm: float | None = None
    animal: str | None = None


@dataclass(frozen=True)
class Sessions:
    """What is stated of each recording; nothing of any where ``by_recording`` is ``None``.

    ``place`` is for messages, ``ignored`` are columns that were not used.
    """

    place: str = ""
    by_recording: Mapping[str, Session] | None = None
    conditions: tuple[str, ...] = ()
    ignored: tuple[str, ...] = ()

    def of(self, recording: str) -> Session:
        """Return the session of a recording, also where it is named with its file's ending.

        Raises InputError if there is none.
        """
        if self.by_recording is None:
            return Session()
        parts = recording.rpartition("/")
        for name in (recording, recording.partition("DLC_")[0], parts[2], parts[0]):
            if name in self.by_recording:
                return self.by_recording[name]
        ending = [one for key, one in self.by_recording.items() if key.endswith(f"/{recording}")]
        require(
            len(ending) == 1,
            f"{self.place}: nothing is said of recording {recording!r}: add a row for it, or leave "
            "its file out",
        )
        return ending[0]

    @property
    def state_roles(self) -> bool:
        """Whether the role of any individual is stated."""
        return any(one.roles or one.target for one in (self.by_recording or {}).values())

    def splits(
        self,
        recording: NDArray[np.str_],
        splitting: Splitting,
        condition: NDArray[np.int8],
        animals: Mapping[str, str],
    ) -> NDArray[np.str_]:
        """Return the split of each episode: as stated for its recording, else dealt."""
        stated = [self.of(name).split for name in recording.tolist()]
        free = np.array([split is None for split in stated])
        dealt = np.array([split or SPLITS[0] for split in stated])
        if free.any():
            own = recording[free], splitting, condition[free], animals
            dealt[free] = split_recordings(*own)
        return dealt

    def animals(self, recordings: Sequence[str]) -> dict[str, str]:
        """Return the animal of each recording of which one is stated."""
        known = {name: self.of(name).animal for name in recordings}
        return {name: animal for name, animal in known.items() if animal is not None}

    def apply(self, tracks: Tracks) -> Tracks:
        """Return the recording with its condition and the individuals that have a role."""
        session = self.of(tracks.recording)
        if session.roles:
            tracks = tracks.choose(list(session.roles))
        elif session.target is not None:
            tracks.choose([session.target])  # refuses whom there is none of
        if session.condition is None:
            return tracks
        return replace(tracks, condition=self.conditions.index(session.condition))

    def provenance(self) -> dict[str, Any]:
        """Return names of two conditions, whether roles are stated, and unused columns."""
        named: dict[str, Any] = {}
        if len(self.conditions) == 2:
            named["conditions"] = list(self.conditions)
        if self.state_roles:
            named["roles_stated"] = True
        return named | ({"metadata_ignored": list(self.ignored)} if self.ignored else {})


def load_sessions(
    recordings: Sequence[Tracks], metadata: str | None, name_pattern: str | None
) -> Sessions:
    """Return what a table or a pattern states of recordings, or else the tracks themselves.

    These state a condition where their column ``condition`` has one word for each recording, and
    two in all.
    """
    names = [tracks.recording for tracks in recordings]
    if metadata is not None:
        return read_sessions(Path(metadata), names)
    if name_pattern is not None:
        return sessions_by_name(name_pattern, names)
    stated = {one.recording: one.provenance.get(STATED_CONDITION) for one in recordings}
    words = set(stated.values())
    if len(words) != 2 or not all(words):
        return Sessions(ignored=(NO_CONDITION,) if len(words) > 1 or "" in words else ())
    own = {name: Session(condition=word) for name, word in stated.items()}
    place = "the column condition"
    return Sessions(place, own, conditions_of(list(stated.values()), place))


def read_sessions(path: Path, recordings: Sequence[str] = ()) -> Sessions:
    """Read a table with a column ``recording`` and any of :data:`COLUMNS`.

    What is no name of one of the ``recordings`` may be that of its file, with the ending.

    Conditions are 0 and 1, or two words, of which the first that occurs is 0. Roles are a column
    ``target`` with a name, or rows of ``recording, individual, role``.

    Raises InputError in one sentence with the line.
    """
    rows, names = read_rows(path, {"recording"})
    sessions: dict[str, Session] = {}
    for number, row in rows:
        place, name = f"{path}: line {number}", row["recording"]
        suffix = Path(name).suffix
        if name not in recordings and re.fullmatch(r"\.[A-Za-z]\w{0,4}", suffix):
            name = name.removesuffix(suffix)
        require(name, f"{place} names no recording: fill the cell, or delete the line")
        own = _session(row, place)
        sessions[name] = (
            _united(sessions[name], own, f"{place} ({name})") if name in sessions else own
        )
    words = conditions_of([one.condition for one in sessions.values()], str(path))
    return Sessions(str(path), sessions, words, tuple(sorted(set(names) - set(COLUMNS))))


def sessions_by_name(pattern: str, recordings: Sequence[str]) -> Sessions:
    """Return what a regular expression with groups as :data:`GROUPS` finds in names of recordings.

    Raises InputError if it is none, has no such group, or does not fit a name.
    """
    place = f"name pattern {pattern!r}"
    matches = search_names(pattern, list(recordings), place)
    groups = set(re.findall(r"\(\?P<(\w+)>", pattern))
    require(
        groups and groups <= set(GROUPS),
        f"{place}: its groups are named {', '.join(sorted(groups)) or 'nothing'}: write one of "
        f"{', '.join(GROUPS)}, as in (?P<condition>fed|starved)",
    )
    sessions = {}
    for name, match in zip(recordings, matches, strict=True):
        if match is None:
            raise InputError(f"{place}: it does not fit recording {name!r}: write one that does")
        cells = {key: value or "" for key, value in match.items()}
        sessions[name] = _session(cells, f"{place}, recording {name!r}")
    return Sessions(place, sessions, conditions_of([s.condition for s in sessions.values()], place))


def conditions_of(words: Sequence[str | None], place: str) -> tuple[str, ...]:
    """Return the names of conditions 0 and 1: ``0`` and ``1``, or words in order of occurrence."""
    conditions = tuple(dict.fromkeys(word for word in words if word is not None))
    alike = {"".join(word.casefold().split()): word for word in conditions}
    for word in conditions:
        other = alike["".join(word.casefold().split())]
        require(
            word == other,
            f"{place}: conditions {word!r} and {other!r} differ only in capitals or blanks: write "
            "them alike",
        )
    if conditions and set(conditions) <= {"0", "1"}:
        return ("0", "1")
    check_names(place, "a condition", conditions)
    require(
        len(conditions) <= 2,
        f"{place}: it has {len(conditions)} conditions, {', '.join(conditions)}: import two at a "
        "time",
    )
    return conditions


def _session(row: Mapping[str, str], place: str) -> Session:
    known: dict[str, str] = {key: cell for key, cell in row.items() if cell}
    split, individual, role, scale = (
        known.get(key) for key in ("split", "individual", "role", "px_per_cm")
    )
    require(
        split is None or split in SPLITS,
        f"{place}: split {split!r} is unknown: choose one of {', '.join(SPLITS)}",
    )
    require(
        (individual is None and role is None) or (individual and role in (PURSUER, TARGET)),
        f"{place}: {individual!r} has the role {role!r}: name an individual, and {PURSUER} or "
        f"{TARGET}",
    )
    try:
        px_per_cm = None if scale is None else float(scale)
    except ValueError:
        px_per_cm = math.nan
    require(
        px_per_cm is None or 0 < px_per_cm < math.inf,
        f"{place}: px_per_cm is {scale!r}: give a positive number",
    )
    return Session(
        condition=known.get("condition"),
        split=split,
        target=known.get("target"),
        roles={individual: role} if individual and role else {},
        px_per_cm=px_per_cm,
        animal=known.get("animal"),
    )


def _united(before: Session, now: Session, place: str) -> Session:
    """Join two rows of one recording, which state the roles of several individuals."""
    roles = {**before.roles, **now.roles}
    require(
        before.roles and now.roles and len(roles) == len(before.roles) + len(now.roles),
        f"{place}: the recording has two rows: keep one of them",
    )
    has = list(roles.values())
    require(
        min(has.count(PURSUER), has.count(TARGET)) < 2,
        f"{place}: several pursuers and several targets: give one individual of a recording "
        "either role",
    )
    for key in ("condition", "split", "px_per_cm"):
        a, b = getattr(before, key), getattr(now, key)
        require(a == b, f"{place}: {key} is {b!r} here and {a!r} above: make them agree")
    return replace(before, target=None, roles=roles)


# -- who is who ------------------------------------------------------------------------------------


class FocusRole(NamedTuple):
    """The individual that all others face: the target, or the pursuer of several targets."""

    name: str
    role: str


def apply_names(tracks: Tracks, recipe: ImportRecipe) -> Tracks:
    """Return the recording with the individuals, names and frame rate of the recipe."""
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
    """Return the recordings, named by role where their names differ, and the individual to face.

    Raises InputError if a target is named for some recordings only, some have several, or their
    units differ.
    """
    first = recordings[0]
    for one in recordings:
        require(
            one.unit == first.unit,
            f"{name}: {one.recording} is in {one.unit}, {first.recording} in {first.unit}: give "
            "px_per_cm of all recordings, or of none",
        )
    stated = [_stated_focus(sessions.of(one.recording), name, one.recording) for one in recordings]
    known = [focus for focus in stated if focus is not None]
    if known:
        for one, focus in zip(recordings, stated, strict=True):
            require(
                focus,
                f"{name}: no target is named for {one.recording}: name one for every recording",
            )
        require(
            len({focus.role for focus in known}) == 1,
            f"{name}: some recordings have one target and others several: import them apart",
        )
        if (
            len({(one.individuals, focus) for one, focus in zip(recordings, known, strict=True)})
            > 1
        ):
            return _named_by_role(recordings, known), FocusRole(known[0].role, known[0].role)
        return recordings, known[0]
    if recipe.pursuer is not None:
        return recordings, FocusRole(recipe.pursuer, PURSUER)
    if recipe.target != AUTO:
        return recordings, None if recipe.target is None else FocusRole(recipe.target, TARGET)
    if len(first.individuals) < 2 or any(t.individuals != first.individuals for t in recordings):
        return recordings, None
    target = pursued_individual([tracks.bodies for tracks in recordings])
    return recordings, None if target is None else FocusRole(first.individuals[target], TARGET)


def assign_roles(
    cleaned: Sequence[Tracks], focus: FocusRole | None, recipe: ImportRecipe, name: str
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return names and roles; the individual that all others face is last."""
    first = cleaned[0]
    names = first.individuals
    for tracks in cleaned:
        remedy = "choose as many in all of them by --individuals"
        if len(tracks.individuals) == len(names):
            remedy = (
                "choose the same in all of them, name the target of each by --metadata, or say "
                "--target none if nobody is pursued"
            )
        require(
            tracks.individuals == names,
            f"{name}: {tracks.recording} has individuals {', '.join(tracks.individuals)}, "
            f"{first.recording} has {', '.join(names)}: {remedy}",
        )
        require(
            recipe.decision_rate is not None or tracks.frame_rate == first.frame_rate,
            f"{name}: {tracks.recording} has {tracks.frame_rate} frames a second, "
            f"{first.recording} {first.frame_rate}: give a decision rate",
        )
    if focus is None:
        role = "searcher" if recipe.searcher else "pursuer"
        return names, (role,) * len(names)
    require(
        len(names) > 1,
        f"{name}: {names[0]} is recorded alone, so nobody pursues it: leave --target out, or say "
        "--target none",
    )
    require(
        focus.name in names,
        f"{name}: there is no {focus.role} {focus.name!r}: choose among {', '.join(names)}",
    )
    others = [name for name in names if name != focus.name]
    return (*others, focus.name), (OTHER_ROLE[focus.role],) * len(others) + (focus.role,)


def _stated_focus(session: Session, name: str, recording: str) -> FocusRole | None:
    """Return the target of a recording, or the pursuer of several targets, if it is stated."""
    of = {role: [n for n, r in session.roles.items() if r == role] for role in (TARGET, PURSUER)}
    if not of[TARGET]:
        return None if session.target is None else FocusRole(session.target, TARGET)
    role = PURSUER if len(of[TARGET]) > 1 else TARGET
    require(of[role], f"{name}: several targets but no pursuer in {recording}: name who pursues")
    return FocusRole(of[role][0], role)


def _named_by_role(recordings: Sequence[Tracks], focus: Sequence[FocusRole]) -> list[Tracks]:
    """Rename the animals of all recordings alike: ``pursuer_0``, ..., ``target``.

    Of several targets: ``target_0``, ..., ``pursuer``.
    """
    renamed = []
    for tracks, (last, role) in zip(recordings, focus, strict=True):
        others = [name for name in tracks.individuals if name != last]
        names = [f"{OTHER_ROLE[role]}_{i}" for i in range(len(others))]
        ordered = tracks.choose([*others, last])
        renamed.append(replace(ordered, individuals=(*names, role)))
    return renamed
