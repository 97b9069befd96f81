"""Cut recordings into episodes, and find the pursued individual.

All distances are in arena units, after scaling; cuts and outcomes are decided at the recorded rate.
"""

import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Literal

import numpy as np

from animarl_envs.array_types import Bools, Floats
from animarl_envs.demos.episode import PURSUER_OUT, TARGET_OUT, UNFINISHED
from animarl_envs.errors import InputError, require
from animarl_envs.focus import distances_to_target
from animarl_envs.importing.cleaning import runs
from animarl_envs.importing.tables import read_rows
from animarl_envs.settings import Checked, NotNegative, PositiveOrInfinite, option

FEWEST_PIECES = 10
FEWEST_ENDS = 5  # recordings that say how recordings end
MOST_END = 0.5  # at least this share of recordings ends within the distance
AT_LAST = 0.95  # at least this share of those that come within it do so in their last frame
APPROACH_PARTS = 10  # of recordings; in each the most approached animal is looked for
SHORTEST_APPROACH_PART = 20  # [frames]
LARGEST_CHASE = 4  # individuals, up to which a target is found by itself
MOSTLY = 0.6  # more parts than that tell the same
SLACK = 1e-6  # relative, beyond the farthest contact
NEEDED = {"recording", "start", "end"}
MOST_LISTED = 10  # recordings
ROUNDING = 1e-9  # relative difference of distances that a change of unit makes


@dataclass(frozen=True, kw_only=True)
class Cutting(Checked):
    """Where episodes begin and end, by the distance of the nearest pursuer to the target."""

    mode: Literal["whole", "approach", "events"] = option(
        "whole",
        "cut",
        "whole: each stretch without gaps; approach: from --farther-than to "
        "--closer-than; events: by the table of --events.",
    )
    farther_than: float | None = option(
        None, "farther_than", "Distance at which an approach starts, in arena units."
    )
    closer_than: float | None = option(
        None, "closer_than", "Distance at which an approach ends, in arena units."
    )
    start: Literal["separation", "approach"] = option(
        "separation",
        "start",
        "approach: start at the separation (first frame that far away since "
        "the last contact) or at the approach (the last such frame).",
    )
    contact: NotNegative | None = option(
        None,
        "contact",
        "whole, events: distance of contact, in arena units; 0: no contact; "
        "default: found from how recordings end.",
    )
    ends: Literal["auto", "contact", "left", "film"] = option(
        "auto",
        "ends",
        "whole, events: what the end of a recording means: contact; left: an "
        "animal left the field; film: nothing, it was stopped; default: contact where most "
        "recordings end within one distance, left where some end farther out than others come, "
        "else film.",
    )
    piece: PositiveOrInfinite | None = option(
        None,
        "piece",
        "whole: cut into pieces of so many seconds; inf: never.",
    )
    longest: PositiveOrInfinite = option(math.inf, "longest", "Leave longer episodes out, s.")
    keep_last: PositiveOrInfinite = option(math.inf, "keep_last", "Keep only the last seconds.")
    shortest: NotNegative = option(0.0, "shortest", "Leave shorter ones out, s.")
    events: str | None = option(
        None, "events", "Table: recording, start, end [s]; optional: condition, outcome."
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        far, near = self.farther_than, self.closer_than
        if self.mode == "approach":
            if far is None or near is None:
                raise InputError(
                    "cutting by approach needs farther_than and closer_than: give both"
                )
            require(
                0 < near < far,
                f"farther_than is {far} and closer_than {near}: the first must be the larger, both "
                "positive",
            )
        require(
            self.ends == "auto" or self.mode != "approach",
            f"ends is {self.ends!r} but an approach ends by contact: leave --ends out",
        )
        require(
            not (self.contact and self.ends in ("left", "film")),
            f"contact is {self.contact} and ends {self.ends!r}: give one of them",
        )
        given = self.mode != "events" or self.events is not None
        require(given, "cutting by events needs a table: give its path")


@dataclass(frozen=True)
class Cut:
    """One episode: frames ``start`` to ``stop - 1`` of a recording."""

    start: int
    stop: int
    outcome: int = UNFINISHED
    condition: int | None = None


def cut_episodes(
    bodies: Floats,
    roles: Sequence[str],
    frame_rate: float,
    settings: Cutting,
    recording: str = "",
    first_frame: int = 0,
) -> list[Cut]:
    """Return the episodes of one recording.

    ``bodies`` are ``(frames, individuals, 2)`` [arena unit], NaN where not tracked, ``roles`` those
    of the individuals, the target last, ``frame_rate`` is in Hz. Times of events count from frame
    0, of which ``first_frame`` is the first in ``bodies``.
    """
    cuts: list[Cut] = []
    distance = distances_to_target(bodies, roles)
    require(
        settings.ends != "contact" or np.isfinite(distance).any(),
        f"{recording}: its end is no contact without a target: name the target, or give --ends "
        "left or film",
    )
    if settings.mode == "events":
        cuts = _cut_at_events(bodies, distance, roles, frame_rate, settings, recording, first_frame)
    else:
        for start, stop in runs(np.isfinite(bodies).all(axis=(1, 2))):
            if settings.mode == "approach":
                cuts += _approaches(distance[start:stop], settings, start, recording)
            else:
                cuts.append(_until_contact(distance[start:stop], settings.contact, start))
        if cuts and cuts[-1].outcome == UNFINISHED:
            last = cuts[-1].stop - 1
            end = outcome_at_end(settings.ends, bodies[last], distance[last], roles)
            cuts[-1] = replace(cuts[-1], outcome=end)
    kept = []
    for cut in cuts:
        duration = (cut.stop - cut.start - 1) / frame_rate
        if duration > settings.longest or cut.stop - cut.start < 2:
            continue
        if duration > settings.keep_last:
            cut = replace(cut, start=cut.stop - 1 - round(settings.keep_last * frame_rate))
            duration = settings.keep_last
        if duration >= settings.shortest:
            kept.append(cut)
    return kept


def in_pieces(
    cuts: Sequence[Cut], frame_rate: float, piece: float, every: float = 1.0
) -> list[Cut]:
    """Cut episodes into pieces of at most ``piece`` seconds.

    Neighbours share a frame and begin at decisions (each ``every`` frames), so no step is lost.
    """
    pieces = []
    for cut in cuts:
        steps = cut.stop - 1 - cut.start
        count = max(1, math.ceil(steps / frame_rate / piece - 1e-9)) if piece < math.inf else 1
        decisions = np.linspace(0, steps / every, count + 1).round()
        edges = (cut.start + (decisions * every).round().astype(int)).tolist()
        edges[-1] = cut.stop - 1
        for first, last in pairwise(edges):
            ends = last == cut.stop - 1
            outcome = cut.outcome if ends else UNFINISHED
            pieces.append(Cut(first, last + 1, outcome, cut.condition))
    return [cut for cut in pieces if cut.stop - cut.start >= 2]


def _approaches(distance: Floats, settings: Cutting, offset: int, recording: str) -> list[Cut]:
    require(
        np.isfinite(distance).all(),
        f"{recording}: cutting by approach needs a target: name the pursuers and the target",
    )
    assert settings.farther_than is not None and settings.closer_than is not None
    nearest = distance.min(axis=1)
    far, near = nearest > settings.farther_than, _closer(nearest, settings.closer_than)
    cuts, begin = [], -1
    for t in range(len(nearest)):
        if far[t] and (begin < 0 or settings.start == "approach"):
            begin = t
        elif near[t] and begin >= 0:
            cuts.append(Cut(offset + begin, offset + t + 1, _contact_outcome(distance[t])))
            begin = -1
    return cuts


def _until_contact(distance: Floats, contact: float | None, offset: int) -> Cut:
    touching = np.flatnonzero(_closer(distance.min(axis=1), contact or 0.0))
    if len(touching):
        t = int(touching[0])
        return Cut(offset, offset + t + 1, _contact_outcome(distance[t]))
    return Cut(offset, offset + len(distance), UNFINISHED)


def outcome_at_end(ends: str, positions: Floats, distance: Floats, roles: Sequence[str]) -> int:
    """Return the outcome of a recording by its last frame, as ``ends`` interprets it.

    Whoever is farthest from the centre then is taken for the one that left.
    """
    if ends == "contact":
        return _contact_outcome(distance)
    if ends != "left":
        return UNFINISHED
    farthest = int(np.linalg.norm(positions, axis=1).argmax())
    return TARGET_OUT if roles[farthest] == "target" else PURSUER_OUT


def _closer(distance: Floats, limit: float) -> Bools:
    """Return which distances are smaller, by more than rounding."""
    return np.asarray(distance < limit * (1 - ROUNDING))


def _contact_outcome(distance: Floats) -> int:
    """Return the outcome code of contact by the nearest pursuer of one frame ``(pursuers,)``.

    Of several as near, whatever the unit rounds them to, the first.
    """
    return int(np.argmax(distance <= distance.min() * (1 + ROUNDING))) + 1


def _cut_at_events(
    bodies: Floats,
    distance: Floats,
    roles: Sequence[str],
    frame_rate: float,
    settings: Cutting,
    recording: str,
    first_frame: int,
) -> list[Cut]:
    assert settings.events is not None
    path, cuts = Path(settings.events), []
    for number, row in read_rows(path, NEEDED)[0]:
        if row["recording"] != recording:
            continue
        try:
            start = round(float(row["start"]) * frame_rate) - first_frame
            stop = round(float(row["end"]) * frame_rate) + 1 - first_frame
            condition, outcome = (
                int(row[key]) if row.get(key) else None for key in ("condition", "outcome")
            )
        except (TypeError, ValueError, OverflowError) as error:
            raise InputError(
                f"{path}: line {number} is not numbers ({error}): correct it"
            ) from None
        require(
            0 <= start < stop - 1 < len(bodies),
            f"{path}: line {number} lies outside {recording} ({first_frame / frame_rate:.3f} to "
            f"{(first_frame + len(bodies)) / frame_rate:.3f} s): correct start and end",
        )
        require(
            np.isfinite(bodies[start:stop]).all(),
            f"{path}: line {number} spans a gap in {recording}: allow longer gaps to be filled",
        )
        require(
            condition in (None, 0, 1) and UNFINISHED <= (outcome or 0) <= len(roles),
            f"{path}: line {number}: condition is {condition} and outcome {outcome}: give 0 or 1, "
            f"and {UNFINISHED} to {len(roles)}",
        )
        if outcome is None:
            outcome = _until_contact(distance[stop - 1 : stop], settings.contact, 0).outcome
        if outcome == UNFINISHED:
            outcome = outcome_at_end(settings.ends, bodies[stop - 1], distance[stop - 1], roles)
        cuts.append(Cut(start, stop, outcome, condition))
    return cuts


def most_approached(bodies: Sequence[Floats]) -> int:
    """Return the individual that the others approach most while it approaches them least.

    For each individual the mean velocity component towards each other one is taken over all
    recordings ``(frames, individuals, 2)``; the target has the lowest mean.
    """
    num = bodies[0].shape[1]
    require(num > 1, "roles by approach need two individuals or more: name the roles")
    approach, count = np.zeros(num), np.zeros(num)
    for track in bodies:
        step = np.diff(track, axis=0)
        for i, j in ((i, j) for i in range(num) for j in range(num) if i != j):
            towards = track[:-1, j] - track[:-1, i]
            length = np.linalg.norm(towards, axis=1)
            with np.errstate(invalid="ignore", divide="ignore"):
                along = (step[:, i] * towards).sum(axis=1) / length
            along = along[np.isfinite(along)]
            approach[i] += along.sum()
            count[i] += len(along)
    return int(np.argmin(approach / np.maximum(count, 1)))


def pursued_individual(bodies: Sequence[Floats]) -> int | None:
    """Return the most approached of up to ``LARGEST_CHASE`` animals, of several if throughout.

    The same one is approached most in most parts of the recordings where it is pursued, as prey or
    a female; among animals that go their own ways it is now one and now another. But the foremost
    of a shoal is approached by all others for long, so of larger groups it is none.
    """
    num = bodies[0].shape[1]
    if num > LARGEST_CHASE:
        return None
    target = most_approached(bodies)
    if num == 2:
        return target
    length = max(SHORTEST_APPROACH_PART, sum(map(len, bodies)) // APPROACH_PARTS)
    parts = [track[at : at + length] for track in bodies for at in range(0, len(track), length)]
    approached = [most_approached([part]) for part in parts if len(part) > 1]
    return target if approached.count(target) > MOSTLY * len(approached) else None


def find_boundary(outermost: Sequence[Floats]) -> float | None:
    """Return how far out animals are when they leave and so end recordings, or None.

    As :func:`find_contact_distance`: nearly nobody comes that far before the last frame, and
    ``FEWEST_ENDS`` recordings or more end so. ``outermost`` ``(frames,)`` of each recording is how
    far out its outermost individual is.
    """
    limit = _limit_of_ends([-one for one in outermost], least=FEWEST_ENDS)
    return None if limit is None else -limit


def find_contact_distance(nearest: Sequence[Floats]) -> float | None:
    """Return the largest distance of contact that ends recordings, where nobody states it, or None.

    Some recordings are stopped, by hand or by the program, as soon as the target is reached. Then
    there is a distance within which nearly nobody comes before the last frame, and within which
    most recordings end. Chance leaves no such distance: the last frame is the nearest one rarely.
    ``nearest`` ``(frames,)`` of each recording is how far the nearest pursuer is from the target.
    """
    return _limit_of_ends(nearest, share=MOST_END)


def _limit_of_ends(values: Sequence[Floats], share: float = 0.0, least: int = 1) -> float | None:
    """Return the largest value below which enough recordings come, and do so in the last frame."""
    known = [one for one in values if len(one) > 1 and np.isfinite(one).all()]
    if len(known) < FEWEST_ENDS:
        return None
    last = np.array([one[-1] for one in known])
    before = np.array([one[:-1].min() for one in known])  # until the last frame
    for limit in sorted(set(last.tolist()), reverse=True):
        ends, came = last <= limit, before <= limit
        if ends.sum() < max(least, share * len(known)):
            return None
        if (ends & ~came).sum() >= AT_LAST * (ends | came).sum():
            return float(limit) + abs(float(limit)) * SLACK
    return None


def check_events(path: Path, recordings: Sequence[str]) -> None:
    """Warn of events whose recordings are not imported: misspelt, or of files left out.

    Raises InputError if all are.
    """
    rows, _ = read_rows(path, NEEDED)
    strange = [(line, row["recording"]) for line, row in rows if row["recording"] not in recordings]
    if not strange:
        return
    line, name = strange[0]
    known = ", ".join(recordings[:MOST_LISTED]) + ", ..." * (len(recordings) > MOST_LISTED)
    if len(strange) == len(rows):
        raise InputError(
            f"{path}: line {line} is of recording {name!r} and no line is of any that is imported "
            f"({known}): correct the names"
        )
    warnings.warn(
        f"{path}: {len(strange)} of {len(rows)} events are of recordings that are not imported, "
        f"the first on line {line} ({name!r}; imported: {known})",
        stacklevel=2,
    )
