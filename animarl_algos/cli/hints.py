"""What somebody may have missed in demonstrations that were imported: hints of the command line."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from animarl_algos.cli.describing import counted
from animarl_envs.demos import Demonstrations
from animarl_envs.demos.episode import SPLITS
from animarl_envs.demos.summary import persistence

UNLIKE = 1.02  # ratio of the scales of recordings that is said aloud
STEADY, OFTEN = 0.85, 5.0  # persistence of animals seen so often [Hz]; less is of noisy tracks
SMOOTH = 2.0  # cutoff against such noise [Hz]
FEWEST_TESTED = 5  # episodes, below which an evaluation is warned of


def hints(demos: Demonstrations) -> list[str]:
    """What somebody who looks at the result may have missed."""
    found = []
    if set(demos.roles) == {"pursuer"} and demos.num_individuals > 1:
        found.append(
            "nobody is the target: name who is pursued by --target NAME, or --target auto for the "
            "one whom the others approach, or who pursues all others by --pursuer NAME"
        )
    sizes = [float(scale["unit"]) for scale in demos.provenance.get("scales", {}).values()]
    if sizes and max(sizes) > UNLIKE * min(sizes):
        found.append(
            f"SCALES DIFFER: an arena unit is {min(sizes):.4g} to {max(sizes):.4g} "
            f"{demos.provenance.get('unit', 'units of the file')}, by recording, so speeds of "
            "different recordings do not compare: leave --scale-each out, or give one --arena-width"
        )
    ignored = demos.provenance.get("metadata_ignored", [])
    if ignored:
        found.append(f"columns of the metadata that were not used: {', '.join(ignored)}")
    found += _thin_splits(demos)
    unfilled = sum(
        one.get("untracked", 0) - one.get("filled", 0) for one in _cleaning(demos).values()
    )
    if unfilled:
        found.append(
            f"{unfilled} gaps of one frame and individual cut the recordings: fill short ones by "
            "--max-gap SECONDS"
        )
    short = sum(one.get("too_short", 0) for one in _cleaning(demos).values())
    if short:
        found.append(
            f"{counted(short, 'piece')} of fewer than two decisions were left out: "
            "fill gaps by --max-gap, or choose a higher --decision-rate"
        )
    return found + _flags(_cleaning(demos)) + _jitter(demos)


def _jitter(demos: Demonstrations) -> list[str]:
    smoothing = [one.get("smoothing", {}) for one in _cleaning(demos).values()]
    smoothed = any(one.get("cutoff_hz", np.inf) <= SMOOTH for one in smoothing)
    if demos.synthetic or smoothed or 1.0 / demos.dt < OFTEN:
        return []
    kept = zip(demos.individuals, persistence(demos))
    jumpy = [f"{name} {100 * share:.0f} %" for name, share in kept if share < STEADY]
    if not jumpy:
        return []
    return [
        f"of a step little is made in the next one too ({', '.join(jumpy)}), as where tracks jump "
        "to and fro; such noise hides how long somebody goes on, and simulated animals slow down: "
        f"smooth it by --smoothing {SMOOTH:g}, in Hz"
    ]


def found_by_itself(demos: Demonstrations) -> list[str]:
    """What an import decided because nobody stated it."""
    found = []
    recipe: Mapping[str, Any] = demos.provenance.get("recipe", {})
    if recipe.get("target") == "auto" and "target" in demos.roles:
        others = ", ".join(demos.individuals[:-1])
        found.append(
            f"{demos.individuals[-1]} is taken for the target, since {others} approach it most: "
            "otherwise name who is pursued by --target NAME, or --target none"
        )
    contact = demos.provenance.get("contact_radius")
    if contact is not None and not recipe.get("cutting", {}).get("contact"):
        found.append(
            f"coming within {contact:.3g} arena units of the target{_in_units(demos, contact)} "
            "ends most recordings, so it is taken for contact: otherwise give --contact DISTANCE, "
            "or --contact 0 for none"
        )
    below = sum(one.get("below_confidence", 0) for one in _cleaning(demos).values())
    limits = {one["confidence_of_at_least"] for one in _cleaning(demos).values()
              if "confidence_of_at_least" in one}  # fmt: skip
    if limits and recipe.get("cleaning", {}).get("min_confidence") is None:
        found.append(
            f"{counted(below, 'point')} of a likelihood below {max(limits):g} were not used: "
            "otherwise give --min-confidence, 0 for all points"
        )
    return found


def _in_units(demos: Demonstrations, length: float) -> str:
    """The same length in the recordings' unit, in brackets; nothing where they differ in scale."""
    sizes = {float(scale["unit"]) for scale in demos.provenance.get("scales", {}).values()}
    if len(sizes) != 1:
        return ""
    return f" ({length * sizes.pop():.4g} {demos.provenance.get('unit', 'units of the file')})"


def _cleaning(demos: Demonstrations) -> Mapping[str, Any]:
    done: Mapping[str, Any] = demos.provenance.get("cleaning", {})
    return done


def _thin_splits(demos: Demonstrations) -> list[str]:
    """Splits from which little can be said, each by name."""
    found = []
    counts = {split: int((demos.split == split).sum()) for split in SPLITS}
    tested = counts["test"]
    if tested < FEWEST_TESTED:
        found.append(
            f"split test has {counted(tested, 'episode')}, fewer than {FEWEST_TESTED}, so that an "
            "evaluation says little: record more, or cut shorter pieces by --piece SECONDS"
        )
    conditions = np.unique(demos.condition)
    for split, count in counts.items():
        there = np.unique(demos.condition[demos.split == split])
        missing = [str(one) for one in conditions if one not in there]
        if count and missing:
            found.append(
                f"split {split} has no episode of condition {', '.join(missing)}: deal again by "
                "another --split-seed, or say the splits in a --metadata table"
            )
    return found


def _flags(cleaning: Mapping[str, Any]) -> list[str]:
    """Jumps and swaps in words, with the first of them, unless jumps were taken out."""
    jumps = sum(one.get("jumps", 0) for one in cleaning.values())
    swaps = sum(one.get("identity_swaps", 0) for one in cleaning.values())
    if not jumps + swaps or any(one.get("jumps_dropped") for one in cleaning.values()):
        return []
    recording, first = next(
        (recording, flag)
        for recording, one in cleaning.items()
        for flag in [*one.get("first_jumps", []), *one.get("first_swaps", [])]
    )
    return [
        f"{counted(jumps, 'jump')} and {counted(swaps, 'swap')} of identities flagged in "
        f"{counted(sum(bool(one.get('jumps')) for one in cleaning.values()), 'recording')}, first "
        f"{' and '.join(first['individuals'])} at {first['time']:g} s of {recording}: look there, "
        "or take jumps out by --drop-jumps"
    ]
