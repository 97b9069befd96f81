"""Turn tracks into demonstrations by a recipe: clean, scale, cut, thin and split them."""

import math
import warnings
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from animarl_envs.array_types import Floats
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.episode import HEADING, INTERVAL, UNFINISHED
from animarl_envs.errors import FaultCollector, InputError, require
from animarl_envs.focus import distances_to_target
from animarl_envs.importing.cleaning import clean, resample, runs, scales_of
from animarl_envs.importing.cutting import (
    FEWEST_PIECES,
    Cut,
    Cutting,
    check_events,
    cut_episodes,
    find_boundary,
    find_contact_distance,
    in_pieces,
    outcome_at_end,
)
from animarl_envs.importing.import_recipe import NOT_STATED, ImportRecipe
from animarl_envs.importing.lost_animals import default_confidence, mark_lost
from animarl_envs.importing.sessions import (
    AUTO,
    TARGET,
    Sessions,
    apply_names,
    assign_focus,
    assign_roles,
    load_sessions,
)
from animarl_envs.importing.tracks import (
    RATE_FROM,
    TOGETHER_AT_MOST,
    TRACKS,
    Tracks,
    body_length,
    in_groups,
    split_individuals,
    trim,
    with_common_names,
)
from animarl_envs.locomotion import shorter_turn

FEWEST_EPISODES = 3  # with fewer, a recording is cut in pieces
SHORTEST_PIECE = 10  # decisions
NEARLY_ALL = 0.99  # of what was tracked of free animals is used, or it is said how much
SAME_RATE = 0.01  # relative, by which the rate of a file may differ from one that is stated
FEWEST_SAMPLES = 2  # of an episode, besides the one that makes its first velocity


def demonstrations_from_tracks(
    recordings: Sequence[Tracks], recipe: ImportRecipe, name: str = "tracks"
) -> Demonstrations:
    """Turn recordings into demonstrations: clean, scale, cut, resample and split.

    Raises InputError: one sentence that names the file, the place and the remedy.
    """
    _check_frames(recordings, recipe, name)
    sessions = load_sessions(recordings, recipe.metadata, recipe.name_pattern)
    marked, lost = mark_lost(recordings)
    named, notes = _named(marked, recipe, sessions, name)
    cleaned, done = _cleaned(named, recipe, sessions)
    cleaned, focus = assign_focus(cleaned, recipe, sessions, name)
    scales = scales_of(cleaned, recipe.scaling, recipe.searcher)
    tracked = sum(int(one.tracked.sum()) for one in cleaned)
    if focus is None and not recipe.searcher and recipe.cutting.mode == "whole":
        pieces = in_groups(cleaned, recipe.cutting.piece, FEWEST_PIECES)
        scales = [scale for scale, some in zip(scales, pieces, strict=True) for _ in some]
        cleaned = [one for some in pieces for one in some]
    individuals, roles = assign_roles(cleaned, focus, recipe, name)
    others = "all others, as one is pursued" if focus else f"{len(individuals) - 1} others at most"
    require(
        recipe.neighbours is None or (focus is None and recipe.neighbours < len(individuals)),
        f"{name}: neighbours is {recipe.neighbours} but each sees {others}: leave it out, or give "
        "fewer",
    )
    scaled = [
        scale.apply(one.choose(individuals)) for scale, one in zip(scales, cleaned, strict=True)
    ]
    cutting, arena, boundary = recipe.cutting, recipe.scaling.arena, None
    if all(tracks.outcome is None for tracks in scaled):
        boundary = _boundary(scaled, roles, recipe)
        stayed = [one for one in scaled if not _left(one.bodies[-1], boundary, arena.shape)]
        cutting = replace(cutting, contact=_contact(stayed, roles, recipe))
    episodes = _episodes(scaled, roles, replace(recipe, cutting=cutting), done, boundary)
    if not episodes:
        arena_unit = f"{scales[0].unit:.4g} {cleaned[0].unit}"
        raise InputError(f"{name}: {_why_none(scaled, roles, cutting, arena_unit)}")

    def joined(key: str, kind: Any = None) -> NDArray[Any]:
        return np.array([one[key] for one in episodes], dtype=kind)

    animals = sessions.animals([one.recording for one in cleaned])
    condition = joined("condition", np.int8)
    length = body_length(marked)
    per_cm = sessions.of(named[0].recording).px_per_cm or recipe.scaling.px_per_cm or 1.0
    rate = recipe.decision_rate or scaled[0].frame_rate
    assert rate is not None
    most = max(len(tracks.individuals) for tracks in named)
    used = len(individuals) * int(joined("frames").sum())
    return Demonstrations(
        species=recipe.species,
        individuals=individuals,
        roles=roles,
        dt=1.0 / rate,
        arena=arena if boundary is None else replace(arena, boundary=boundary),
        positions=np.concatenate([one["positions"] for one in episodes]),
        lengths=np.array([len(one["positions"]) for one in episodes]),
        initial_velocity=joined("initial_velocity"),
        condition=condition,
        outcome=joined("outcome", np.int8),
        split=sessions.splits(joined("recording"), recipe.splitting, condition, animals),
        recording=joined("recording"),
        signals={
            key: np.concatenate([one["signals"][key] for one in episodes])
            for key in episodes[0]["signals"]
        },
        provenance=_origin(recordings, recipe, name)
        | {
            "unit": cleaned[0].unit,
            "keypoints": list(recordings[0].keypoints),
            "recipe": recipe.to_dict(),
            "scales": {
                one.recording: asdict(scale) for one, scale in zip(cleaned, scales, strict=True)
            },
            "cleaning": done,
            "ends": "left" if boundary else _ends(cutting, scaled, joined("outcome")),
            "frame_rate": _stated_rates(recordings, recipe),
            **notes,
            **({"animals": animals} if animals else {}),
            **({} if length is None else {"body_length": length / (scales[0].unit * per_cm)}),
            **({"lost": dict(total)} if (total := sum(map(Counter, lost), Counter())) else {}),
            **({} if most == len(individuals) else {"animals_tracked": most}),
            **({} if used >= NEARLY_ALL * tracked else {"share_used": used / tracked}),
            **({} if cutting == recipe.cutting else {"contact_radius": cutting.contact}),
            **({} if boundary is None else {"left_beyond": boundary}),
            **sessions.provenance(),
        },
        name=name,
    )


def _check_frames(recordings: Sequence[Tracks], recipe: ImportRecipe, name: str) -> None:
    """Refuse an import without frames; warn where a file has another rate than is stated."""
    require(recordings, f"{name}: there is no recording in it: give at least one")
    require(
        any(len(tracks) > 1 for tracks in recordings),
        f"{name}: its recordings have one frame each, an episode needs two or more: check it",
    )
    for one in recordings:
        if recipe.frame_rate and not math.isclose(
            recipe.frame_rate, one.frame_rate or recipe.frame_rate, rel_tol=SAME_RATE
        ):
            warnings.warn(
                f"{one.recording}: its file says {one.frame_rate:g} frames a second, taken are the "
                f"{recipe.frame_rate:g} of --fps: leave it out if the file is right",
                stacklevel=3,
            )
            break


def _named(
    recordings: Sequence[Tracks], recipe: ImportRecipe, sessions: Sessions, name: str
) -> tuple[list[Tracks], dict[str, Any]]:
    """Return recordings with the animals and names of the recipe, and notes for the provenance.

    Where nobody is pursued, animals that come and go become recordings of their own.
    """
    named = [trim(sessions.apply(apply_names(tracks, recipe))) for tracks in recordings]
    several = any(len(tracks.individuals) > 2 for tracks in named)
    free = recipe.target is None or (recipe.target == AUTO and several)
    free = free and not sessions.state_roles
    if free and recipe.pursuer is None and recipe.individuals is None and not recipe.searcher:
        named = [alone for tracks in named for alone in split_individuals(tracks)]
        require(
            named,
            f"{name}: no animal is seen in two frames or more, so none of them moves: check the "
            "column of individuals, which should name the same animal in every frame",
        )
    kept = (TRACKS, TOGETHER_AT_MOST)
    notes = {key: one.provenance[key] for one in named for key in kept if key in one.provenance}
    if free or all(len(tracks.individuals) == 1 for tracks in named):
        alike = with_common_names(named)
        if len(alike[0].individuals) == 1 and alike != named:
            notes["lone_animals"] = list(dict.fromkeys(one.individuals[0] for one in named))
        named = alike
    return named, notes


def _cleaned(
    named: Sequence[Tracks], recipe: ImportRecipe, sessions: Sessions
) -> tuple[list[Tracks], dict[str, dict[str, Any]]]:
    """Return clean recordings, in cm where their scale is known, and what was done to each."""
    cleaned, done, faults = [], {}, FaultCollector()
    likely = default_confidence(named)
    for tracks in named:
        with faults.collect():
            tracks, steps = clean(tracks, recipe.cleaning, likely)
            done[tracks.recording] = steps | {"episodes": 0, "too_short": 0}
            per_cm = sessions.of(tracks.recording).px_per_cm or recipe.scaling.px_per_cm
            if per_cm is not None:
                require(
                    tracks.unit == "px",
                    f"{tracks.recording}: it is in {tracks.unit}, not in pixels: leave px_per_cm "
                    "out",
                )
                tracks = replace(tracks, positions=tracks.positions / per_cm, unit="cm")
            cleaned.append(tracks)
    faults.refuse()
    return cleaned, done


def _stated_rates(recordings: Sequence[Tracks], recipe: ImportRecipe) -> dict[str, Any]:
    """Return the frame rates [Hz] of the recordings, and where they come from."""
    if recipe.frame_rate is not None:
        return {"hz": [recipe.frame_rate], "from": "--fps"}
    rates = {one.frame_rate for one in recordings if one.frame_rate is not None}
    return {"hz": sorted(rates), "from": recordings[0].provenance.get(RATE_FROM, "the file")}


def _origin(recordings: Sequence[Tracks], recipe: ImportRecipe, name: str) -> dict[str, Any]:
    """Return source and licence of the recordings, from the recipe or from their files."""
    first = {k: v for k, v in recordings[0].provenance.items() if k != "file"}
    stated = {} if recipe.licence == NOT_STATED else {"licence": recipe.licence}
    return {
        "source": recipe.source or "found by the file",
        "licence": recipe.licence,
        "synthetic": recipe.synthetic,
        **first,
        **stated,
        "files": sorted({Path(one.provenance.get("file", name)).name for one in recordings}),
    }


def _why_none(
    recordings: Sequence[Tracks], roles: tuple[str, ...], cutting: Cutting, arena_unit: str
) -> str:
    """Return a sentence that says why there is no episode, and how to fix it."""
    contact = cutting.contact
    if contact and cutting.mode == "whole" and TARGET in roles:
        distances = [distances_to_target(one.bodies, roles).min(axis=1) for one in recordings]
        first = np.concatenate([one[np.isfinite(one)][:1] for one in distances])
        if len(first) and (first < contact).all():
            return (
                f"all recordings begin within contact, {contact:g} arena units of {arena_unit}: "
                "give a smaller --contact"
            )
    seen = [tracks.tracked for tracks in recordings]
    if any(stop - start > 1 for own in seen for start, stop in runs(own.all(axis=1))):
        return "the cut leaves no episode: loosen the distances or the length limits"
    for tracks, own in zip(recordings, seen, strict=True):
        for individual, name in enumerate(tracks.individuals):
            if not own[:, individual].any():
                return (
                    f"{name} is never tracked in recording {tracks.recording}: leave it out by "
                    "--individuals, or lower --min-confidence"
                )
    return (
        "no two frames in a row have all individuals: choose some by --individuals, or fill gaps "
        "by --max-gap"
    )


def _contact(
    scaled: Sequence[Tracks], roles: tuple[str, ...], recipe: ImportRecipe
) -> float | None:
    """Return the contact distance as stated, or the distance that ends whole recordings.

    Stretches too short for an episode say nothing about how recordings end.
    """
    cutting = recipe.cutting
    stated = cutting.contact is not None or cutting.piece is not None or cutting.ends != "auto"
    if cutting.mode != "whole" or stated or TARGET not in roles:
        return cutting.contact
    stretches = []
    for tracks in scaled:
        rate = tracks.frame_rate or 1.0
        shortest = FEWEST_SAMPLES * rate / (recipe.decision_rate or rate)  # steps
        distance = distances_to_target(tracks.bodies, roles).min(axis=1)
        stretches += [
            distance[start:stop]
            for start, stop in runs(np.isfinite(distance))
            if stop - start - 1 >= shortest
        ]
    return find_contact_distance(stretches)


def _boundary(
    scaled: Sequence[Tracks], roles: tuple[str, ...], recipe: ImportRecipe
) -> float | None:
    """Return how far out animals of a chase end recordings by leaving, where nobody states it."""
    cutting, shape = recipe.cutting, recipe.scaling.arena.shape
    stated = cutting.piece is not None or cutting.ends != "auto" or shape == "open"
    if cutting.mode != "whole" or stated or TARGET not in roles:
        return None
    limit = find_boundary([_outermost(tracks.bodies, shape) for tracks in scaled])
    return limit if limit is not None and limit >= recipe.scaling.arena.size else None


def _outermost(bodies: Floats, shape: str) -> Floats:
    """Return how far out the outermost individual is, of ``(frames, individuals, 2)``."""
    out = np.abs(bodies).max(axis=-1) if shape == "square" else np.linalg.norm(bodies, axis=-1)
    return np.asarray(out.max(axis=-1))


def _left(last: Floats, boundary: float | None, shape: str) -> bool:
    """Return whether somebody of the last frame ``(individuals, 2)`` is beyond the boundary."""
    return boundary is not None and bool(_outermost(last[None], shape)[0] >= boundary)


def _ends(cutting: Cutting, recordings: Sequence[Tracks], outcome: NDArray[Any]) -> str:
    """Return what the ends of recordings mean: as stated, by the files, or as was found."""
    if any(tracks.outcome is not None for tracks in recordings):
        return "as the files say"
    if cutting.ends != "auto":
        return cutting.ends
    return "contact" if (outcome > 0).any() else "film"


def _episodes(
    scaled: Sequence[Tracks],
    roles: tuple[str, ...],
    recipe: ImportRecipe,
    done: dict[str, dict[str, Any]],
    boundary: float | None,
) -> list[dict[str, Any]]:
    """Return the episodes of all recordings at the decision rate, and count them in ``done``.

    A recording that ends beyond the ``boundary`` ends because somebody left.
    """
    events = recipe.cutting.events
    if recipe.cutting.mode == "events" and events is not None:
        check_events(Path(events), [tracks.recording for tracks in scaled])
    episodes = []
    for tracks, cuts in zip(scaled, _cuts(scaled, roles, recipe), strict=True):
        last = tracks.bodies[cuts[-1].stop - 1] if cuts else tracks.bodies[-1]
        left = _left(last, boundary, recipe.scaling.arena.shape)
        if left and cuts and cuts[-1].outcome == UNFINISHED:
            cuts[-1] = replace(cuts[-1], outcome=outcome_at_end("left", last, last[:, 0], roles))
        made = [_episode(tracks, cut, recipe) for cut in cuts]
        long_enough = [one for one in made if len(one["positions"]) >= FEWEST_SAMPLES]
        done[tracks.recording]["episodes"] += len(long_enough)
        done[tracks.recording]["too_short"] += len(made) - len(long_enough)
        episodes += long_enough
    return episodes


def _cuts(
    scaled: Sequence[Tracks], roles: tuple[str, ...], recipe: ImportRecipe
) -> list[list[Cut]]:
    """Return the episodes of each recording; a lone long recording is cut in pieces.

    The outcome that a file states is that of its recording if this is one episode.
    """
    cutting, piece = recipe.cutting, recipe.cutting.piece
    rates = [tracks.frame_rate or 1.0 for tracks in scaled]
    all_cuts = [
        cut_episodes(tracks.bodies, roles, rate, cutting, tracks.recording, tracks.start)
        for tracks, rate in zip(scaled, rates, strict=True)
    ]
    if cutting.mode != "whole":
        return all_cuts
    if piece is None and 0 < sum(map(len, all_cuts)) < FEWEST_EPISODES:
        seconds = sum(
            (cut.stop - cut.start) / rate
            for cuts, rate in zip(all_cuts, rates, strict=True)
            for cut in cuts
        )
        decisions = seconds * (recipe.decision_rate or rates[0])
        if decisions >= FEWEST_PIECES * SHORTEST_PIECE:
            piece = seconds / FEWEST_PIECES
    if piece is not None:
        all_cuts = [
            in_pieces(cuts, rate, piece, rate / (recipe.decision_rate or rate))
            for cuts, rate in zip(all_cuts, rates, strict=True)
        ]
    return [
        [replace(cuts[0], outcome=tracks.outcome)]
        if len(cuts) == 1 and tracks.outcome is not None
        else cuts
        for tracks, cuts in zip(scaled, all_cuts, strict=True)
    ]


def _episode(tracks: Tracks, cut: Cut, recipe: ImportRecipe) -> dict[str, Any]:
    """Return an episode at the decision rate; its first sample only makes the first velocity.

    Events are united over the frames of the step that led to each sample.
    """
    frame_rate = tracks.frame_rate or 1.0
    rate = recipe.decision_rate or frame_rate
    every = frame_rate / rate
    frames = slice(cut.start, cut.stop)
    body = tracks.bodies[frames]
    require(
        every >= 1 - 1e-9,
        f"{tracks.recording}: it has {frame_rate:g} frames a second: choose a decision rate no "
        "higher than that",
    )
    even = abs(every - round(every)) < 1e-9
    require(
        even or not recipe.keep_last_frame,
        f"{tracks.recording}: the last frame can be kept only if the decision rate divides "
        f"{frame_rate:g} Hz: choose another rate",
    )
    if even:
        index = np.arange(0, len(body), round(every))
        if recipe.keep_last_frame:
            index = np.union1d(index, len(body) - 1)
        samples = body[index]
    else:
        samples = resample(body, frame_rate, rate)
        index = np.round(np.arange(len(samples)) * every).astype(np.int64)
    signals = {}
    for key, value in tracks.signals.items():
        taken = value[frames][index][1:]
        if key in tracks.events and len(index) > 1:
            taken = np.maximum.reduceat(value[frames][: index[-1] + 1], index[:-1] + 1)
        if key == HEADING and taken.ndim > 1 and not even:
            taken = resample(value[frames], frame_rate, rate, shorter_turn)[1:]
        signals[key] = taken
    if recipe.keep_last_frame:
        signals[INTERVAL] = np.diff(index) / frame_rate
    condition = tracks.condition if cut.condition is None else cut.condition
    first = (samples[1] - samples[0]) * rate if len(samples) > 1 else np.zeros_like(samples[0])
    return {
        "frames": len(body),
        "positions": samples[1:],
        "initial_velocity": first,
        "condition": condition if recipe.condition is None else recipe.condition,
        "outcome": cut.outcome,
        "recording": tracks.recording,
        "signals": signals,
    }
