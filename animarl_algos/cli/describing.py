"""Demonstrations and recipes in words, with units: what commands say of them, and hints."""

import math
import re
import shlex
from collections import Counter
from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.table import Table
from rich.text import Text

from animarl_algos.cli.shared import PlainConsole
from animarl_envs.arena import format_obstacle
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.episode import PURSUER_OUT, SPLITS, TARGET_OUT
from animarl_envs.demos.summary import (
    RESTING_SHARE,
    condition_name,
    episode_table,
    outcome_name,
    persistence,
    tracking_counts,
    unit_of,
)
from animarl_envs.errors import printable
from animarl_envs.fitting.custom_species import MAY_BE_BEYOND, share_beyond
from animarl_envs.importing.import_recipe import ImportRecipe
from animarl_envs.importing.readers import available_readers
from animarl_envs.importing.sessions import GROUPS
from animarl_envs.importing.tracks import TOGETHER_AT_MOST, TRACKS
from animarl_envs.species import CUSTOM

Row = tuple[str, str]
UNLIKE = 1.02  # ratio of the scales of recordings that is said aloud
STEADY, OFTEN = 0.85, 5.0  # persistence of animals seen so often [Hz]; less is of noisy tracks
SMOOTH = 2.0  # cutoff against such noise [Hz]
MOST_COLUMNS = 8
CM = {"mm": 0.1, "cm": 1.0, "m": 100.0}
FAST_LENGTHS, FAST_CM = 8.0, 1500.0  # a second; few animals are faster, unless they fly
MOST_DOUBTS = 4
COMPARED = 1000  # frames by which individuals are compared
CONSTANT = 0.05  # spread of a distance by its mean: that of parts of one body is less
MOST_POINTS = 20_000  # by which the shape of the ground is judged
CORRIDOR = 0.25  # width by length; wider is no corridor
RING, SECTORS = 0.45, 36  # inner by outer radius; all directions from the middle are visited
ROUND, NEAR_RIM = 1.06, 0.9  # of the radius: no track lies beyond, or all directions are reached
SAME_SIZE, MOVED = 0.15, 0.3  # of the width of recordings: how it deviates, how far they lie apart
FEWEST_TESTED = 5  # episodes, below which an evaluation is warned of


def demonstrations_at_a_glance(demos: Demonstrations) -> list[Row]:
    """Return what a set of demonstrations holds, line by line."""
    provenance, unit = demos.provenance, unit_of(demos)
    scale, speed_unit = unit.per_arena_unit, f"{unit.name}/s"
    seconds = (demos.lengths - 1) * demos.dt
    rows = {
        "species": demos.species,
        "individuals": _individuals(demos),
        "kind": "SYNTHETIC, not recorded animals" if demos.synthetic else "recorded animals",
        "source": provenance["source"],
        "made by": provenance.get("command"),
        "licence": provenance["licence"],
        "episodes": f"{len(demos)} from {counted(len(np.unique(demos.recording)), 'recording')}",
        "splits": ", ".join(f"{(demos.split == split).sum()} {split}" for split in SPLITS),
        "time step": f"{demos.dt:.4g} s ({1 / demos.dt:.4g} Hz), {demos.lengths.sum()} frames",
        "duration": f"{seconds.min():.3g} to {seconds.max():.4g} s, median "
        f"{np.median(seconds):.3g} s",
        "in total": f"{seconds.sum():.1f} s ({seconds.sum() / 60:.1f} min)",
        "arena": _arena(demos),
    }
    rows["keypoints"] = _keypoints(demos)
    speeds = scale * np.linalg.norm(demos.velocities(), axis=2)
    for name, own in zip(demos.kinds, np.split(speeds, len(demos.kinds), axis=1), strict=True):
        top = np.quantile(own, 0.99)
        rows[f"speed of {name}"] = (
            f"median {np.median(own):.3g}, 99th percentile {top:.3g} {speed_unit}, at rest "
            f"{(own <= RESTING_SHARE * top).mean():.0%} of the time"
        )
    if "target" in demos.roles or "searcher" in demos.roles:
        targets = demos.roles.count("target")
        to = "source" if not targets else "target" if targets == 1 else "nearest target"
        table = episode_table(demos)
        first, least = (
            scale * float(np.median([row[f"{key}_distance"] for row in table]))
            for key in ("first", "least")
        )
        rows[f"distance to the {to}"] = (
            f"first {first:.3g}, least {least:.3g} {unit.name} (medians)"
        )
    for condition in np.unique(demos.condition):
        outcome = demos.outcome[demos.condition == condition]
        codes, counts = np.unique(outcome, return_counts=True)
        rows[f"outcomes, {condition_name(condition, demos)}"] = ", ".join(
            f"{outcome_name(code, demos)}: {count} ({count / len(outcome):.3f})"
            for code, count in zip(codes[::-1].tolist(), counts[::-1].tolist())
        )
    tracking = [
        f"{count} {key.removesuffix('s') if count == 1 else key}"
        for key, count in tracking_counts(demos).items()
    ]
    rows["signals"] = ", ".join(demos.signals) or None
    rows["frames flagged"] = ", ".join(tracking) or None
    rows["fingerprint"] = demos.fingerprint()
    return [(name, str(words)) for name, words in rows.items() if words is not None]


def _keypoints(demos: Demonstrations) -> str | None:
    """Return which keypoints there are, and which is the position; None where there is one."""
    keypoints = demos.provenance.get("keypoints", [])
    used = {str(one.get("keypoint")) for one in _cleaning(demos).values()}
    return f"{', '.join(keypoints)}; used: {', '.join(used)}" if len(keypoints) > 1 else None


def _individuals(demos: Demonstrations) -> str:
    names = demos.individuals
    if demos.is_group:
        return f"{len(names)} that are alike, {names[0]} to {names[-1]}"
    if demos.has_goal:
        return ", ".join(f"{name} ({role})" for name, role in zip(names, demos.roles))
    return ", ".join(names)


def imported_at_a_glance(demos: Demonstrations) -> list[Row]:
    """Return what an import understood in six lines; guesses name the option that changes them."""
    recipe: Mapping[str, Any] = demos.provenance.get("recipe", {})
    scaling = recipe.get("scaling", {})
    seconds, recordings = (demos.lengths - 1) * demos.dt, np.unique(demos.recording)
    guesses = {
        "animals": recipe.get("target") == "auto"
        and demos.num_individuals > 1
        and not demos.provenance.get("roles_stated")
        and "--target NAME or none",
        "unit": _unit_name(demos) == "px" and "--px-per-cm NUMBER gives cm",
        "arena": not scaling.get("width")
        and not scaling.get("units_per_arena_unit")
        and "--arena square, disc, open, ring=0.6 or rectangle=0.5, --arena-width LENGTH",
        "split": recipe.get("splitting", {}).get("by") == "auto" and "--split-by",
    }
    rate = f"{describe_frame_rate(demos)}; an animal decides anew every {demos.dt:.4g} s"
    if recipe.get("decision_rate") is None:
        rate += " (--decision-rate HZ: less often, which is faster to learn)"
    outside = float((~demos.arena.contains(demos.positions)).mean())
    rows = {
        "animals": f"{_individuals(demos)}; {counted(len(demos), 'episode')} of "
        f"{counted(len(recordings), 'recording')}, {seconds.sum():.0f} s in all"
        + (f"; keypoints {points} (--keypoint)" if (points := _keypoints(demos)) else ""),
        "rate": rate,
        "unit": f"{_unit_name(demos)}; {_median_speeds(demos)}; simulations count in arena units, "
        "half the arena's width",
        "arena": f"{_arena(demos)}; {100 * outside:.2g} % of positions lie outside",
        "conditions": _conditions(demos),
        "split": "; ".join(f"{split} {_episodes_by_condition(demos, split)}" for split in SPLITS),
    }
    return [
        (name, f"{words} (guessed: {guesses[name]})" if guesses.get(name) else words)
        for name, words in rows.items()
    ]


def _median_speeds(demos: Demonstrations) -> str:
    unit = unit_of(demos)
    speeds = unit.per_arena_unit * np.linalg.norm(demos.velocities(), axis=2)
    each = zip(demos.kinds, np.split(speeds, len(demos.kinds), axis=1), strict=True)
    medians = ", ".join(f"{np.median(own):.3g} ({name})" for name, own in each)
    return f"median speed {medians} {unit.name}/s"


def _conditions(demos: Demonstrations) -> str:
    present = np.unique(demos.condition).tolist()
    if len(present) == 1 and "conditions" not in demos.provenance:
        files = Counter(name.partition("/")[0] for name in np.unique(demos.recording))
        pattern = "PATTERN"
        if len(files) == 2 and min(files.values()) > 1:  # recordings of two files or folders
            pattern = shlex.quote(f"(?P<condition>{'|'.join(map(re.escape, files))})")
        return f"one (--metadata TABLE or --name-pattern {pattern} states two)"
    return ", ".join(
        f"{condition_name(one, demos)}: "
        + counted(len(np.unique(demos.recording[demos.condition == one])), "recording")
        for one in present
    )


def _episodes_by_condition(demos: Demonstrations, split: str) -> str:
    """Return how many episodes a split has, and of which conditions and named animals."""
    own, present = demos.split == split, np.unique(demos.condition).tolist()
    parts = [
        f"{(own & (demos.condition == one)).sum()} of {condition_name(one, demos)}"
        for one in present
        if len(present) > 1
    ]
    animals = demos.provenance.get("animals", {})
    if animals:
        parts.append(counted(len({animals.get(one) for one in demos.recording[own]}), "animal"))
    return counted(int(own.sum()), "episode") + (f" ({', '.join(parts)})" if parts else "")


def describe_ground(demos: Demonstrations) -> list[str]:
    """Return whether tracks keep to a corridor, ring, disc or rectangle, or the camera moved."""
    unit, points = unit_of(demos), demos.positions.reshape(-1, 2)
    if moved := _describe_moved_camera(demos):
        return [moved]
    points = points[:: len(points) // MOST_POINTS + 1]
    _, axes = np.linalg.eigh(np.cov(points.T))
    low, high = np.quantile(points @ axes, (0.005, 0.995), axis=0)
    short, long = sorted((unit.per_arena_unit * (high - low)).tolist())
    if short < CORRIDOR * long:
        return [
            f"the tracks fill a corridor of {long:.3g} by {short:.3g} {unit.name}: simulated "
            "animals have the whole arena, and may leave the corridor: --arena rectangle=... puts "
            "walls around it"
        ]
    from_middle = points - (points.min(axis=0) + points.max(axis=0)) / 2
    inner, outer = np.quantile(np.linalg.norm(from_middle, axis=1), (0.01, 0.99))
    angles = np.arctan2(from_middle[:, 1], from_middle[:, 0])
    length = np.linalg.norm(from_middle, axis=1)
    around = np.histogram(angles, SECTORS, (-math.pi, math.pi))[0].all()
    if inner > RING * outer and around and not demos.arena.obstacles:
        share = math.floor(100 * inner / length.max()) / 100
        inner, outer = unit.per_arena_unit * inner, unit.per_arena_unit * outer
        return [
            f"the tracks keep to a ring, {inner:.3g} to {outer:.3g} {unit.name} from its middle: "
            f"if nobody can enter its hole, give --arena ring={share:g}; simulated animals may "
            "cross the middle otherwise"
        ]
    wide = np.ptp(points, axis=0) / 2
    outside = from_middle[length > NEAR_RIM * wide.mean()]
    sectors = np.histogram(np.arctan2(*outside.T), SECTORS, (-math.pi, math.pi))[0]
    in_corners = from_middle[(np.abs(from_middle) > NEAR_RIM * wide).all(axis=1)]
    oblong = len(np.unique(np.sign(in_corners), axis=0)) == 4 and wide.min() < NEAR_RIM * wide.max()
    in_disc = length.max() < ROUND * wide.mean() and wide.min() > NEAR_RIM * wide.max()
    if demos.arena.shape == "square" and in_disc and sectors.all():
        return ["the tracks fill a disc: if the arena is round, give --arena disc"]
    if demos.arena.shape == "square" and oblong and not demos.arena.obstacles:
        return [
            "the tracks fill a rectangle: if walls stand around it, give --arena "
            f"rectangle={wide[1] / wide[0]:.3g}"
        ]
    return []


def _describe_moved_camera(demos: Demonstrations) -> str:
    """Return that recordings of one size lie in several places; empty if they do not."""
    names, number = np.unique(np.repeat(demos.recording, demos.lengths), return_inverse=True)
    if len(names) < 3:
        return ""
    extents = [
        (own.min(axis=0), own.max(axis=0))
        for one in range(len(names))
        for own in [demos.positions[number == one].reshape(-1, 2)]
    ]
    low, high = (np.array(side) for side in zip(*extents))
    size, middle = (high - low).max(axis=1), (low + high) / 2
    apart = float(np.ptp(middle, axis=0).max())
    if size.std() > SAME_SIZE * size.mean() or apart < MOVED * size.mean():
        return ""
    unit, scale = unit_of(demos), unit_of(demos).per_arena_unit
    return (
        f"each recording is about {scale * size.mean():.3g} {unit.name} wide, and they lie up to "
        f"{scale * apart:.3g} {unit.name} apart: if the camera was moved between them, give "
        "--centre-each"
    )


def describe_recipe(recipe: ImportRecipe, source: str, files: Sequence[Path]) -> list[Row]:
    """Return what an import is going to do: all that its recipe says, part by part."""

    def in_words(value: Any) -> str:
        return ", ".join(map(str, value)) if isinstance(value, list) else str(value)

    def listed(entries: Mapping[str, Any]) -> str:
        given = {key: value for key, value in entries.items() if value not in (None, {}, "inf")}
        return "; ".join(
            f"{key.replace('_', ' ')} {in_words(value)}"
            for key, value in given.items()
            if value is not False
        )

    record = recipe.to_dict()
    parts = {name: record.pop(name) for name in ("cleaning", "scaling", "cutting", "splitting")}
    rows = {"read as": f"{source}, {counted(len(files), 'file')}", "recipe": listed(record)}
    return list((rows | {name: listed(part) for name, part in parts.items()}).items())


def describe_frame_rate(demos: Demonstrations) -> str:
    """Return the frame rate of the recordings, and what says so."""
    stated = demos.provenance.get("frame_rate", {"hz": [1 / demos.dt], "from": "the file"})
    rates, slow = stated["hz"], max(stated["hz"]) < 1
    limits = [f"{1 / rate if slow else rate:.6g}" for rate in (min(rates), max(rates))]
    span = " to ".join(dict.fromkeys(limits))
    return f"{f'one frame every {span} s' if slow else f'{span} frames/s'}, from {stated['from']}"


def _arena(demos: Demonstrations) -> str:
    arena, sizes = demos.arena, sorted(_unit_sizes(demos))
    words = {"square": "square, half side 1", "disc": "disc, radius 1", "open": "open field"}
    text = words[arena.shape]
    if math.isfinite(arena.boundary):
        text += f", boundary {arena.boundary:g}"
    if arena.obstacles:
        text += f"; obstacles (x,y,radius) {' and '.join(map(format_obstacle, arena.obstacles))}"
    if arena.landmarks:
        text += f"; landmarks {', '.join(name for name, *_ in arena.landmarks)}"
    if sizes:
        span = " to ".join(dict.fromkeys(f"{size:.4g}" for size in (sizes[0], sizes[-1])))
        text += f"; an arena unit is {span} {_unit_name(demos)}"
    return text


def counted(number: int, noun: str) -> str:
    """Return so many of them, with a plural's s."""
    return f"{number} {noun}{'s' * (number != 1)}"


# -- hints ----------------------------------------------------------------------------------------


def hints(demos: Demonstrations) -> list[str]:
    """Return what somebody who looks at the result may have missed."""
    from animarl_algos.evaluation.prepared import WINDOW

    provenance, counts = demos.provenance, {s: int((demos.split == s).sum()) for s in SPLITS}
    sentences = []
    if set(demos.roles) == {"pursuer"} and demos.num_individuals > 1:
        sentences.append(
            "nobody is pursued, so these are simulated as animals that go their own ways and see "
            "each other; if one is pursued name it by --target NAME, or the pursuer of all others "
            "by --pursuer NAME"
        )
    sizes = _unit_sizes(demos)
    if sizes and max(sizes) > UNLIKE * min(sizes):
        sentences.append(
            f"SCALES DIFFER: an arena unit is {min(sizes):.4g} to {max(sizes):.4g} "
            f"{_unit_name(demos)}, by recording, so speeds of different recordings do not compare: "
            "leave --scale-each out, or give one --arena-width"
        )
    if question := _question_speed(demos):
        sentences.append(question)
    if ignored := provenance.get("metadata_ignored"):
        sentences.append(f"columns about recordings that were not used: {', '.join(ignored)}")
    sentences += provenance.get("notes", [])
    if unused := provenance.get("columns_not_used"):
        beside = sorted({name.lower() for name in unused} & set(GROUPS))
        sentences.append(
            f"columns that were not used: {', '.join(unused[:MOST_COLUMNS])}"
            + ", ..." * (len(unused) > MOST_COLUMNS)
            + (f" ({', '.join(beside)} belongs in a --metadata table)" if beside else "")
        )
    if counts["test"] < FEWEST_TESTED:
        sentences.append(
            f"split test has {counted(counts['test'], 'episode')}, fewer than {FEWEST_TESTED}, so "
            "that an evaluation says little: record more, or cut shorter pieces by --piece SECONDS"
        )
    for split, count in counts.items():
        there = demos.condition[demos.split == split]
        known = np.unique(demos.condition)
        missing = [condition_name(one, demos) for one in known if one not in there]
        if count and missing:
            dealt = len(np.unique(demos.recording[demos.split == split]))
            again = "deal again by another --split-seed, or " if dealt >= len(known) else ""
            sentences.append(
                f"split {split} has no episode of {', '.join(missing)}: {again}say the splits in a "
                "--metadata table"
            )
    if unfilled := _total(demos, "untracked") - _total(demos, "filled"):
        sentences.append(
            f"{unfilled} gaps of one frame and individual cut the recordings: fill short ones by "
            "--max-gap SECONDS"
        )
    if short := _total(demos, "too_short"):
        sentences.append(
            f"{counted(short, 'piece')} of fewer than two decisions were left out: "
            "fill gaps by --max-gap, or choose a higher --decision-rate"
        )
    if (median := float(np.median(demos.lengths - 1)) * demos.dt) < WINDOW:
        sentences.append(
            f"episodes last {median:.3g} s (median), less than the {WINDOW:g} s that a verdict "
            "looks at: it takes each as a whole, and sees no order beyond"
        )
    flags = [
        f"{' and '.join(flag['individuals'])} at {flag['time']:g} s of {recording}"
        for recording, one in _cleaning(demos).items()
        for flag in [*one.get("first_jumps", []), *one.get("first_swaps", [])]
    ]
    jumps, swaps = _total(demos, "jumps"), _total(demos, "identity_swaps")
    kept = jumps and not _total(demos, "jumps_dropped")
    if kept or swaps:
        recordings = sum(
            bool(one.get("jumps") or one.get("identity_swaps")) for one in _cleaning(demos).values()
        )
        sentences.append(
            f"{counted(jumps, 'jump')} and {counted(swaps, 'swap')} of identities flagged in "
            f"{counted(recordings, 'recording')}, first {flags[0]}: look there"
            + ", or take jumps out by --drop-jumps" * bool(kept)
            + "; tracks stay exchanged after a swap: correct it in the tracker" * bool(swaps)
        )
    smoothing = [one.get("smoothing", {}) for one in _cleaning(demos).values()]
    smoothed = any(one.get("cutoff_hz", np.inf) <= SMOOTH for one in smoothing)
    if not (demos.synthetic or smoothed or 1.0 / demos.dt < OFTEN):
        shares = zip(demos.kinds, persistence(demos), strict=True)
        jumpy = [f"{name}: {100 * share:.0f} %" for name, share in shares if share < STEADY]
        if jumpy:
            sentences.append(
                "velocities are hardly kept from one step to the next "
                f"({', '.join(jumpy)}): probably tracking noise, which makes simulated animals too "
                f"slow: consider --smoothing {SMOOTH:g}, in Hz, above the fastest movement that "
                "matters"
            )
    return sentences


def _doubtful_individuals(demos: Demonstrations) -> list[str]:
    """Return which individuals may be none: one that never moves, or parts of one body.

    Parts of a body keep their distance while they move farther than that.
    """
    names, bodies = demos.individuals, demos.positions[:: len(demos.positions) // COMPARED + 1]
    bodies = np.asarray(bodies, dtype=np.float64)
    travel = np.ptp(bodies, axis=0).max(axis=1)
    sentences = [
        f"{name} never moves, so it may be a landmark: leave it out by --individuals "
        f"{','.join(names[:at] + names[at + 1 :])}"
        for at, name in enumerate(names)
        if travel[at] == 0 and len(names) > 1
    ]
    for at, name in enumerate(names):
        distance = np.linalg.norm(bodies[:, at + 1 :] - bodies[:, [at]], axis=2)
        mean, spread = distance.mean(axis=0), distance.std(axis=0)
        farther = np.minimum(travel[at + 1 :], travel[at]) > mean
        for other in at + 1 + np.flatnonzero(farther & (mean > 0) & (spread < CONSTANT * mean)):
            left = names[:other] + names[other + 1 :]
            sentences.append(
                f"{name} and {names[other]} keep their distance, so they may be parts of one body: "
                f"if they are, take one by --individuals {','.join(left)}"
            )
    return sentences[:MOST_DOUBTS]


def automatic_decisions(demos: Demonstrations) -> list[str]:
    """Return what an import decided because nobody stated it."""
    sentences = []
    recipe: Mapping[str, Any] = demos.provenance.get("recipe", {})
    stated = demos.provenance.get("roles_stated")
    if recipe.get("target") == "auto" and "target" in demos.roles and not stated:
        others = ", ".join(demos.individuals[:-1])
        sentences.append(
            f"{demos.individuals[-1]} is taken for the target, since it is approached most, by "
            f"{others}: otherwise name who is pursued by --target NAME, or --target none"
        )
    if not recipe.get("individuals") and not demos.synthetic:
        sentences += _doubtful_individuals(demos)
    scaling, options = recipe.get("scaling", {}), recipe.get("options", {})
    in_pixels = scaling.get("px_per_cm") or demos.provenance.get("unit") == "px"
    sources = {reader.name for reader in available_readers() if "y_down" in reader.options}
    if in_pixels and recipe.get("source") in sources and "y_down" not in options:
        sentences.append(
            "y is taken to grow upwards; in images it grows downwards, and left and right would be "
            "exchanged: if it does, give --option y_down=true"
        )
    contact, sizes = demos.provenance.get("contact_radius"), _unit_sizes(demos)
    if contact is not None and not recipe.get("cutting", {}).get("contact"):
        own = f" ({contact * sizes[0]:.4g} {_unit_name(demos)})" if len(set(sizes)) == 1 else ""
        sentences.append(
            f"coming within {contact:.3g} arena units of the target{own} "
            "ends most recordings, so it is taken for contact: otherwise give --contact DISTANCE, "
            "or --contact 0 for none"
        )
    if left := demos.provenance.get("left_beyond"):
        out = int(np.isin(demos.outcome, (TARGET_OUT, PURSUER_OUT)).sum())
        sentences.append(
            f"{out} recordings end where an animal is farther out than {left:.3g} arena "
            "units, where hardly any is before: it is taken to have left, so no wall stands there: "
            "otherwise give --ends film"
        )
    elif demos.provenance.get("ends") == "film" and recipe.get("cutting", {}).get("ends") == "auto":
        contact_too = "--ends contact, or " if demos.has_goal else ""
        sentences.append(
            "the end of a recording is taken for the end of the film, after which the animals "
            f"went on: otherwise give {contact_too}--ends left if an animal left the field"
        )
    holes, edged = demos.arena.obstacles, demos.species == CUSTOM and "searcher" not in demos.roles
    if edged and (beyond := share_beyond(demos)) > MAY_BE_BEYOND:
        sentences.append(
            f"{100 * beyond:.1f} % of the frames of an animal lie clearly beyond the arena's edge"
            f"{' or in an obstacle' * bool(holes)}, "
            "so no wall stands there, and leaving the boundary ends a simulated episode: "
            f"otherwise give a {'smaller obstacle' if holes else 'wider --arena-width'}"
        )
    if lost := demos.provenance.get("lost"):
        marks = ", ".join(f"{place} ({counted(n, 'point')})" for place, n in lost.items())
        sentences.append(
            f"positions that trackers write of lost animals are taken for gaps: {marks}: correct "
            "them in the file if an animal was there"
        )
    names = demos.provenance.get("lone_animals")
    if names:
        sentences.append(
            f"{', '.join(names[:MOST_COLUMNS])}{', ...' * (len(names) > MOST_COLUMNS)} are each "
            f"alone in their recording, and taken for animals that are alike: if the files are of "
            "one recording, give --merge-individuals"
        )
    tracks, together = (demos.provenance.get(key) for key in (TRACKS, TOGETHER_AT_MOST))
    if tracks:
        sentences.append(
            f"{tracks} tracks come and go, up to {together} at a time, so each is taken for a "
            f"recording of one animal that sees no other ({len(np.unique(demos.recording))} are "
            "long enough): if they are fragments of the tracks of a group, join them in the "
            "tracker, or name animals that are there throughout by --individuals"
        )
    most, used = (demos.provenance.get(key) for key in ("animals_tracked", "share_used"))
    keep_more = "fill gaps by --max-gap, or choose a shorter --piece, to keep more"
    share = f"{100 * used:.0f} % of what was tracked is used" if used else ""
    if most:
        sentences.append(
            f"animals come and go: each episode holds {demos.num_individuals} of up to {most}, who "
            f"are there throughout, and nothing is seen of the others ({share}): {keep_more}"
        )
    elif used and not demos.has_goal:
        sentences.append(f"{share}, as recordings are cut where anybody is missing: {keep_more}")
    least = [one.get("confidence_of_at_least") for one in _cleaning(demos).values()]
    limits = [one for one in least if one is not None]
    below = _total(demos, "below_confidence")
    if below and limits and recipe.get("cleaning", {}).get("min_confidence") is None:
        sentences.append(
            f"{counted(below, 'point')} of a likelihood below {max(limits):g} were not used: "
            "otherwise give --min-confidence, 0 for all points"
        )
    return sentences


def _cleaning(demos: Demonstrations) -> Mapping[str, Any]:
    """Return what was done to the tracks, by recording."""
    done: Mapping[str, Any] = demos.provenance.get("cleaning", {})
    return done


def _total(demos: Demonstrations, key: str) -> int:
    return sum(one.get(key, 0) for one in _cleaning(demos).values())


def _unit_sizes(demos: Demonstrations) -> list[float]:
    """Return the length of an arena unit in each recording."""
    return [float(scale["unit"]) for scale in demos.provenance.get("scales", {}).values()]


def _unit_name(demos: Demonstrations) -> str:
    return str(demos.provenance.get("unit", "units of the file"))


def _question_speed(demos: Demonstrations) -> str | None:
    """Ask about speeds that hardly any animal of that size reaches."""
    unit, length = unit_of(demos), demos.provenance.get("body_length", math.nan)
    speed = float(np.quantile(np.linalg.norm(demos.velocities(), axis=2), 0.99))
    scale, lengths = unit.per_arena_unit, speed / length
    if not (lengths > FAST_LENGTHS or speed * scale * CM.get(unit.name, math.nan) > FAST_CM):
        return None
    size = f" ({lengths:.3g} body lengths of {length * scale:.3g} {unit.name})"
    size *= math.isfinite(lengths)
    return (
        f"IS THE FRAME RATE RIGHT? The fastest hundredth of steps reaches {speed * scale:.3g} "
        f"{unit.name}{size} a second at {describe_frame_rate(demos)}: films that are played faster "
        "or slower than they were recorded say a wrong rate; give the right one by --fps"
    )


# -- the terminal ---------------------------------------------------------------------------------


def report(demos: Demonstrations, out: Path | None) -> None:
    """Show the demonstrations; write them if ``out`` is given."""
    show(demos)
    if out is not None:
        demos.save(out)
        wide_console().print(f"Wrote {out}")


def report_import(demos: Demonstrations, out: Path | None, plan: ImportRecipe) -> None:
    """Say what was understood, and what may have been missed; write results if ``out`` is given.

    The results are the demonstrations, their picture, and the recipe that made them.
    """
    show_rows(demos.name, imported_at_a_glance(demos))
    console = wide_console()
    for hint in [*automatic_decisions(demos), *describe_ground(demos), *hints(demos)]:
        console.print(f"hint: {hint}")
    if out is None:
        return
    from animarl_envs.drawing.summary_figure import plot_summary

    demos.save(out)
    recipe = plan.save(out.with_suffix(".recipe.yaml"))
    written = f"Wrote {out}; {recipe.name}, which repeats it"
    if find_spec("matplotlib") is not None:
        picture = plot_summary(demos, out.with_suffix(".png"))
        written += f"; {picture.name}, its tracks: look at it"
    console.print(written)
    console.print(f"Next: animarl run {shlex.quote(str(out))} --out runs/{shlex.quote(out.stem)}")


def show(demos: Demonstrations) -> None:
    """Print what demonstrations hold."""
    show_rows(demos.name, demonstrations_at_a_glance(demos))


def show_rows(title: str, rows: list[Row]) -> None:
    """Print a table of names and words."""
    title_text = Text(printable(title))
    table = Table(title=title_text, show_header=False, box=SIMPLE_HEAD, title_justify="left")
    table.add_column(no_wrap=True)
    table.add_column(overflow="fold")
    for name, words in rows:
        table.add_row(name, Text(printable(words)))
    wide_console().print(table)


def wide_console() -> PlainConsole:
    """Return a console in which tables have room."""
    return PlainConsole(least_width=100)
