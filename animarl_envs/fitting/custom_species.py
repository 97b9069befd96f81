"""Your own animals: a species made from their demonstrations.

What the file states is taken from it: names, roles, time step, arena, longest episode, contact
radius. What it does not state comes from the species it names, or for species ``custom`` from the
rules of :func:`species_of`. Every number can be replaced by the option of its name.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from animarl_envs.arena import Arena
from animarl_envs.array_types import Floats
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.episode import HEADING
from animarl_envs.demos.splits import learnable, training_episodes
from animarl_envs.errors import InputError
from animarl_envs.fitting.odour import fit_odour, shows_odour
from animarl_envs.fitting.turning import fit_turning
from animarl_envs.focus import distances_to_target, focus_directions, is_free, lone_pursuer
from animarl_envs.locomotion import Locomotion, check_thrusts
from animarl_envs.species import (
    CUSTOM,
    SILKMOTH,
    SPECIES,
    ChaseSpecies,
    Recording,
    Species,
    get_species,
)
from animarl_envs.species.options import with_options
from animarl_envs.species.traits import Traits, fit_traits
from animarl_envs.species.turning import Turning

SMALLEST_CONTACT = 0.001  # share of the arena's size
SIDED, MIN_SIDED = 4.0, 8  # standard errors from left and right alike, of so many recordings
CONTACT_QUANTILE = 0.9  # of the distances at which recorded contacts ended
BEYOND_WALLS, MAY_BE_BEYOND = 0.03, 0.02  # sizes; share of frames that tracking errors put there

STATED = "species"
"""Key of a provenance: options of the species that were measured of other recordings."""
MEASURED = ("contact_radius", "mirror_symmetric", "senses_past", "senses_time", "time_limit")

_FITS: dict[tuple[str, str, int], Any] = {}


def species_of(
    demos: Demonstrations,
    fit: Sequence[Locomotion] | None = None,
    base: str | None = None,
    thrusts: int = 1,
) -> Species:
    """Return the species that demonstrations show; test episodes are not used.

    ``fit`` is the locomotion of each individual, by default fitted with so many ``thrusts``
    (:func:`fitted_locomotion`). What the file does not state comes from the species ``base``, by
    default the one that it names. For ``"custom"``:

    - time limit: the longest episode, or what the import kept at most, if that is longer;
    - contact radius: :func:`contact_radius_of`; conditions: those that occur, as names only;
    - left and right are alike unless :func:`takes_sides`;
    - the edge of a disc or a square is a wall, unless recordings end because an animal left;
    - own velocity averaged over the last steps is seen by those with several thrusts: who has one
      is an artificial agent, mostly, that goes by the present;
    - the time since the start is seen where the import began every episode at a separation;
    - starts without a demonstration: in the inner half of the arena; no warm-up steps;
    - simulated animals differ from each other as recorded ones do (``species.traits``), unless
      they are synthetic;
    - tracks that stand for recordings state what was measured of these (:func:`stated_options`);
    - a searcher has the silkmoth's senses, plume and conditions. One that was recorded with its
      heading and its odour gets odour as recorded searchers did, and traits.

    Individuals whose headings are recorded turn as they do (:func:`fitted_turning`); those of a
    chase then see where everybody points, if one of them does not point where it walks.

    Raises InputError if the roles do not fit the species.
    """
    demos = learnable(demos)
    name = base or demos.species
    numbers = get_species(name) if name in SPECIES else _plain_species(demos)
    _check_roles(demos, numbers)
    longest = int(demos.lengths.max()) - 1
    locomotion = fitted_locomotion(demos, thrusts) if fit is None else tuple(fit)
    conditions = numbers.conditions
    if not conditions and (demos.condition == 1).any():
        named: Any = demos.provenance.get("conditions")
        known = isinstance(named, list | tuple) and len(named) == 2
        conditions = tuple(map(str, named)) if known else ("condition 0", "condition 1")
    own: dict[str, Any] = {"lone_pursuer": True} if lone_pursuer(demos.roles) else {}
    if "searcher" in numbers.roles and HEADING in demos.signals:
        own["turning"] = fitted_turning(demos)
        if shows_odour(demos):
            own["senses_past"] = True
            own["plume"] = fitted_once(fit_odour, demos, 0)
            own["traits"] = fitted_traits(demos)
    elif demos.headings() is not None:
        turning = [fitted_turning(demos, i) for i in range(demos.num_individuals)]
        own |= {"turning": turning, "senses_heading": any(one is not None for one in turning)}
    if numbers.name == CUSTOM and isinstance(numbers, ChaseSpecies):
        own["mirror_symmetric"] = not takes_sides(demos)
        own["senses_past"] = locomotion[0].thrusts > 1 or numbers.free
        if not demos.synthetic:
            own["traits"] = fitted_traits(demos)
        cutting = _cutting(demos)  # do all episodes begin at the same event?
        apart = (cutting.get("mode"), cutting.get("start")) == ("approach", "separation")
        own["senses_time"] = apart and _seconds(cutting.get("keep_last")) == math.inf
    own = {
        "arena": arena_of(demos, name),
        "time_limit": max(numbers.time_limit, longest, numbers.warmup + 1),
    } | own
    stated = dict(demos.provenance.get(STATED, {}))
    if "traits" in stated:
        arrays = {key: np.array(value, dtype=float) for key, value in stated["traits"].items()}
        stated["traits"] = Traits(**arrays)
    return with_options(
        numbers,
        individuals=demos.individuals,
        dt=demos.dt,
        locomotion=locomotion,
        conditions=conditions,
        **own | stated,
    )


def stated_options(species: ChaseSpecies) -> dict[str, Any]:
    """Return what :func:`species_of` measures of recordings, for the provenance of other tracks."""
    stated = {key: getattr(species, key) for key in MEASURED} | {"arena": dict(vars(species.arena))}
    if species.traits is not None:
        stated["traits"] = {key: value.tolist() for key, value in vars(species.traits).items()}
    return stated


def arena_of(demos: Demonstrations, base: str | None = None) -> Arena:
    """Return the arena of :func:`species_of`: the recorded field, with walls if its world has.

    Open for a searcher. Your own animals have walls, unless they left or were recorded beyond.
    """
    if "searcher" in demos.roles:
        return Arena("open", demos.arena.size)
    name = base or demos.species
    if demos.arena.shape == "open":
        return demos.arena
    if name in SPECIES:
        return replace(demos.arena, rebound=get_species(name).arena.rebound)
    left = demos.provenance.get("ends") == "left"
    return replace(demos.arena, rebound=not left and share_beyond(demos) <= MAY_BE_BEYOND)


def share_beyond(demos: Demonstrations) -> float:
    """Return the share of frames beyond a wall, of the individual that is there most often."""
    walls, seen = replace(demos.arena, rebound=True), learnable(demos).positions
    within = walls.contains(seen, margin=BEYOND_WALLS * demos.arena.size)
    return float(1.0 - within.mean(axis=0).min())


def fitted_locomotion(demos: Demonstrations, thrusts: int = 1) -> tuple[Locomotion, ...]:
    """Return the joint fit of every individual on the training episodes (or all, without any).

    Fitted once per content of the demonstrations, number of magnitudes and process.
    """
    from animarl_envs.fitting.joint import joint_locomotion

    check_thrusts(thrusts)  # before it is looked up: True would be found as 1, a list not at all
    fit: tuple[Locomotion, ...] = fitted_once(joint_locomotion, demos, thrusts)
    return fit


def fitted_turning(demos: Demonstrations, individual: int = 0) -> Turning | None:
    """Return the turning of one individual, fitted as :func:`fitted_locomotion` is.

    ``None`` where its body points where it walks, or no headings are recorded.
    """
    turning: Turning | None = fitted_once(fit_turning, demos, individual)
    return turning


def fitted_traits(demos: Demonstrations) -> Traits | None:
    """Return traits of the training animals (or all, without any); None if they are alike.

    Episodes of one recording are of the same animals. Those of a group stand for each other, so
    these are the traits of all of them.
    """
    training = training_episodes(demos)
    positions, lengths, condition = training.positions, training.lengths, training.condition
    animal = np.unique(training.recording, return_inverse=True)[1]
    if demos.is_group:
        alike, recordings = demos.num_individuals, int(animal.max()) + 1
        positions = positions.transpose(1, 0, 2).reshape(-1, 1, 2)
        lengths, condition = np.tile(lengths, alike), np.tile(condition, alike)
        animal = (animal + recordings * np.arange(alike)[:, None]).ravel()
    return fit_traits(positions, lengths, demos.dt, condition, animal)


def takes_sides(demos: Demonstrations) -> bool:
    """Return whether recorded individuals prefer the left or the right.

    Then no mirror image of a recording is possible. The mean turn of an individual, or the mean
    side of the focus on which it passes, is ``SIDED`` standard
    errors over training recordings away from none. Artificial agents often are: they learned one
    of two equally good ways. Fewer than ``MIN_TRAIT_EPISODES`` recordings cannot say so.
    """
    training = training_episodes(demos)
    step = np.diff(training.positions, axis=0)
    length = np.linalg.norm(step, axis=-1)
    course = step / np.where(length > 0, length, np.inf)[..., None]
    beside = [course[:-1], course[1:]]  # of each turn
    sides = [_sine(*beside)]
    if training.has_goal:
        sides.append(_sine(focus_directions(training.positions, training.roles)[:-2], beside[0]))
    names, recording = np.unique(training.recording, return_inverse=True)
    of_step = np.repeat(recording, training.lengths)[:-2]
    inside = np.ones(len(of_step), dtype=bool)
    inside[(training.offsets[1:-1, None] - [1, 2]).ravel()] = False  # into the next episode
    size = np.bincount(of_step[inside], minlength=len(names))
    if (size > 0).sum() < MIN_SIDED:
        return False
    for side in (each for pair in sides for each in pair.T):
        total = np.bincount(of_step[inside], side[inside], minlength=len(names))
        mean = total[size > 0] / size[size > 0]
        if abs(mean.mean()) > SIDED * mean.std(ddof=1) / np.sqrt(len(mean)):
            return True
    return False


def _sine(first: Floats, second: Floats) -> Floats:
    return np.asarray(first[..., 0] * second[..., 1] - first[..., 1] * second[..., 0])


def fitted_once(fit: Callable[..., Any], demos: Demonstrations, number: int) -> Any:
    """Return ``fit`` of the training episodes, made once per content, number and process."""
    key = fit.__name__, demos.fingerprint(), number
    if key not in _FITS:
        _FITS[key] = fit(training_episodes(demos), number)
    return _FITS[key]


def contact_radius_of(demos: Demonstrations) -> float:
    """Return the contact radius that the demonstrations state or show [arena unit].

    It is that of the provenance, or the distance at which the import ended episodes, else that at
    which recorded contacts ended (their 0.9 quantile), else a thousandth of the arena's size: where
    no recorded episode ended by contact, none should that is simulated.
    """
    demos = learnable(demos)
    cutting = _cutting(demos)
    ended_at = "closer_than" if cutting.get("mode") == "approach" else "contact"
    stated = (demos.provenance.get("contact_radius"), cutting.get(ended_at))
    for value in stated:
        if isinstance(value, int | float) and 0 < value < math.inf:
            return float(value)
    touched = np.flatnonzero(demos.outcome > 0)
    least = SMALLEST_CONTACT * demos.arena.size
    if not len(touched):
        return least
    distance = distances_to_target(demos.positions, demos.roles)
    distances = distance[demos.offsets[1:][touched] - 1, demos.outcome[touched] - 1]
    return max(float(np.quantile(distances, CONTACT_QUANTILE)), least)


def _plain_species(demos: Demonstrations) -> Species:
    """Return the species ``custom`` before fits and options of :func:`species_of`."""
    from animarl_envs.fitting.result import default_onset_threshold

    longest = int(demos.lengths.max()) - 1
    kept = min(_seconds(_cutting(demos).get(key)) for key in ("longest", "keep_last"))
    if kept < math.inf:
        longest = max(longest, round(kept / demos.dt))
    synthetic = "synthetic: " if demos.synthetic else ""
    common: dict[str, Any] = {
        "name": CUSTOM,
        "title": "Recorded animals" if not demos.synthetic else "Synthetic animals",
        "contact_radius": contact_radius_of(demos),
        "time_limit": longest,
        "recording": Recording(
            frame_rate=1.0 / demos.dt, onset_threshold=default_onset_threshold(demos)
        ),
        "source": f"{synthetic}{demos.provenance['source']}",
        "version_history": ("v0: as the demonstrations",),
        "warmup": 0,
    }
    if "searcher" in demos.roles:
        return replace(SILKMOTH, **common)
    still = (Locomotion(1.0, 1.0),) * demos.num_individuals  # until the fit takes its place
    return ChaseSpecies(
        individuals=demos.individuals,
        locomotion=still,
        arena=arena_of(demos, CUSTOM),
        dt=demos.dt,
        start_half_side=max(
            (0.7 if demos.arena.obstacles else 0.5) * demos.arena.size, common["contact_radius"]
        ),
        free=is_free(demos.roles),
        neighbours=seen if (seen := _recipe(demos).get("neighbours")) is not None else 4,
        senses_compass=not is_free(demos.roles),
        **common,
    )


def _check_roles(demos: Demonstrations, species: Species) -> None:
    searching = "searcher" in demos.roles
    if searching and demos.num_individuals > 1:
        raise InputError(
            f"{demos.name}: it holds {demos.num_individuals} searchers, a search has one: "
            "import each of them alone"
        )
    if searching != ("searcher" in species.roles):
        roles = ", ".join(demos.roles)
        raise InputError(
            f"{demos.name}: its roles are {roles}, which do not fit {species.name}: choose the "
            "species custom, or import with other roles"
        )
    if is_free(demos.roles) != is_free(species.roles):
        raise InputError(
            f"{demos.name}: its roles are {', '.join(demos.roles)}, which do not fit "
            f"{species.name}: choose the species custom, or import it with --target NAME, "
            "--target auto or --target none"
        )


def _recipe(demos: Demonstrations) -> dict[str, Any]:
    """Return the recipe of the import; empty if the provenance has none."""
    recipe = demos.provenance.get("recipe")
    return recipe if isinstance(recipe, dict) else {}


def _cutting(demos: Demonstrations) -> dict[str, Any]:
    """Return how the import cut the episodes; empty if unknown."""
    cutting = _recipe(demos).get("cutting")
    return cutting if isinstance(cutting, dict) else {}


def _seconds(value: Any) -> float:
    """Return a limit of the recipe [s]: infinite if it is text or absent."""
    return float(value) if isinstance(value, int | float) and value > 0 else math.inf
