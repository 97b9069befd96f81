"""The user's options applied to a species, each checked and refused by name."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields, replace
from typing import Any, get_args

from animarl_envs.arena import Arena, parse_shape
from animarl_envs.errors import InputError, UnknownOptionError
from animarl_envs.locomotion import Locomotion, check_thrusts, fixed_multiples
from animarl_envs.settings import is_number, is_whole
from animarl_envs.species import ChaseSpecies, Species
from animarl_envs.species.base import Reading

COUNTS = ("num_pursuers", "num_targets")
"""Options that set how many individuals of a role there are; of the other role there is one."""
OF_THE_ARENA = ("rebound", "boundary", "landmarks", "obstacles")
"""Options that are fields of the arena."""


def with_options(species: Species, **options: Any) -> Species:
    """Return the species with options applied, each checked and refused by name.

    ``num_pursuers`` sets the number of pursuers of a chase, renamed ``<kind>_0, <kind>_1, ...``,
    and ``num_targets`` that of the targets of one pursuer, who comes last. ``arena`` is an
    :class:`Arena`, its fields by name, a shape name, or a size, with which the boundary and the
    square of starts grow; ``rebound``, ``boundary``, ``landmarks`` (places by name) and
    ``obstacles`` (x, y and radius of each) apply to it. ``locomotion`` is one
    :class:`Locomotion` for all, or by name ``{"female": Locomotion(...)}``, ``{"female": {"thrust":
    0.19}}`` (also ``damping``, ``magnitudes``) or ``{"female": 1.2}`` (a factor on the thrust).
    ``thrusts`` is the number of thrust magnitudes of every individual, M: who has another number
    gets fixed multiples of its thrust (:func:`~animarl_envs.locomotion.fixed_multiples`). Others
    are fields of the species spec: ``contact_radius``, ``time_limit``, ``dt``, ``warmup``, ...
    """
    species = _with_members(species, options)
    seen: Any = options.get("neighbours")
    animals = species.num_individuals
    fewer = is_whole(seen) and seen >= animals and seen != getattr(species, "neighbours", seen)
    if getattr(species, "free", False) and fewer:
        raise InputError(
            f"neighbours is {seen} but there are {animals} animals: give {animals - 1} or fewer"
        )
    if isinstance(species, ChaseSpecies) and is_number(options.get("arena")):
        scaled = species.start_half_side * float(options["arena"]) / species.arena.size
        options.setdefault("start_half_side", scaled)
    arena = _arena(species.arena, options)
    given = options.pop("locomotion", None)
    locomotion = _with_thrusts(_locomotion(species, given), options.pop("thrusts", None), given)
    known = {f.name for f in fields(species)} - {"name", "individuals", "recording", "locomotion"}
    for key in options:
        if key not in known:
            more = {*COUNTS, "locomotion", "thrusts", *OF_THE_ARENA}
            raise UnknownOptionError.of(key, species.name, known | more)
    try:
        return replace(species, arena=arena, locomotion=locomotion, **options)
    except TypeError as error:
        raise InputError(f"an option of {species.name} has the wrong type ({error})") from error


def change_world(species: Species, reading: Reading = "habit", **options: Any) -> Species:
    """Return ``species`` with options applied, observed by policies that were trained before.

    ``options`` are those of :func:`with_options`, ``reading`` says what the policies perceive.

    Raises InputError if an option is not valid, or there is no such reading.
    """
    if reading not in get_args(Reading):
        raise InputError(f"reading is {reading!r}: choose 'habit' or 'knows'")
    changed = with_options(replace(species, sense_scales=species.scales), **options)
    if reading == "knows":
        return replace(
            changed, sense_scales=changed.scales.with_bodies(changed.locomotion, changed.dt)
        )
    return changed


def _with_members(species: Species, options: dict[str, Any]) -> Species:
    """Return the species with the individuals that options ask for."""
    counts = {key: options.pop(key, None) for key in COUNTS}
    given = options.pop("individuals", None)
    if not isinstance(given, Iterable | None) or isinstance(given, str):
        raise InputError(f"individuals is {given!r}: give a name to each, in a list")
    names = None if given is None else tuple(given)
    free = isinstance(species, ChaseSpecies) and bool(options.get("free", species.free))
    for key, count in counts.items():
        if count is None:
            continue
        if not isinstance(species, ChaseSpecies) or (free and key == "num_targets"):
            raise InputError(f"{key} does not apply to {species.name}, which has none: drop it")
        if not (is_whole(count) and count >= 1):
            raise InputError(f"{key} is {count!r}: it must be a whole number, 1 or more")
        if names is not None and count != len(names) - (not free):
            raise InputError(
                f"{key} is {count} but individuals names {', '.join(names)}: give one of the two"
            )
    if not isinstance(species, ChaseSpecies):
        if names is not None and len(names) != 1:
            raise InputError(
                f"{species.name} has one individual but {len(names)} were given: {names}"
            )
        return species if names is None else replace(species, individuals=names)
    if options.get("lone_pursuer") is True and not species.lone_pursuer:
        species = _with_targets(species, species.num_individuals - 1)
    pursuers, targets = counts.values()
    if free:
        return _with_animals(species, names, pursuers)
    if names is not None:
        resized = len(names) != species.num_individuals
        species = _with_many(species, len(names) - 1) if resized else species
        return replace(species, individuals=names)
    if species.lone_pursuer or targets not in (None, 1):
        if pursuers not in (None, 1):
            raise InputError(
                f"num_pursuers is {pursuers} but several targets have one pursuer: leave one of "
                "num_pursuers and num_targets out"
            )
        return species if targets is None else _with_targets(species, int(targets))
    return species if pursuers is None else _with_many(species, int(pursuers))


def _with_animals(
    species: ChaseSpecies, names: tuple[str, ...] | None, count: int | None
) -> ChaseSpecies:
    """Return the species with free animals, which are all alike."""
    if names is None and count in (None, species.num_individuals):
        names = species.individuals
    elif names is None:
        kind = species.individuals[0].rpartition("_")[0] or "animal"
        names = tuple(f"{kind}_{i}" for i in range(int(count or 1)))
    chosen = [i % species.num_individuals for i in range(len(names))]
    return species.of_individuals(chosen, names, free=True)


def _with_targets(species: ChaseSpecies, count: int) -> ChaseSpecies:
    """Return the species with one pursuer (placed last) and ``count`` targets."""
    if not species.lone_pursuer:
        names = (f"{species.individuals[-1]}_0", species.individuals[0])
        species = species.of_individuals((-1, 0), names, lone_pursuer=True)
    return _with_many(species, count)


def _with_many(species: ChaseSpecies, count: int) -> ChaseSpecies:
    """Return the species with ``count`` individuals before the last one."""
    kind = species.individuals[0].rpartition("_")[0] or species.roles[0]
    last = species.num_individuals - 1
    names = (*(f"{kind}_{i}" for i in range(count)), species.individuals[last])
    return species.of_individuals([*(i % last for i in range(count)), last], names)


def _arena(arena: Arena, options: dict[str, Any]) -> Arena:
    given = options.pop("arena", None)
    changes = {key: options.pop(key) for key in OF_THE_ARENA if key in options}
    if isinstance(given, Mapping):
        unknown = set(given) - {*(f.name for f in fields(Arena)), "inner"}
        if unknown:
            raise InputError(
                f"arena has no {sorted(map(str, unknown))[0]!r}: give shape, size, boundary, "
                "rebound, landmarks, obstacles or inner"
            )
        given = replace(arena, **given)
    if isinstance(given, Arena):
        arena = given
    elif isinstance(given, str):
        shape, made = parse_shape(given)
        obstacles = tuple((arena.size * x, arena.size * y, arena.size * r) for x, y, r in made)
        arena = replace(arena, shape=shape, obstacles=obstacles)
        if "obstacles" in changes:
            changes["obstacles"] = (*arena.obstacles, *changes["obstacles"])
    elif is_number(given):
        arena = arena.scaled(float(given))
    elif given is not None:
        raise InputError(f"arena is {given!r}: give an Arena, a shape or a size")
    if arena.shape == "open" and (changes.get("rebound") or "boundary" in changes):
        which = "rebound" if changes.get("rebound") else "boundary"
        raise InputError(f"{which} contradicts an open arena, which has no boundary: drop it")
    return replace(arena, **changes) if changes else arena


def _locomotion(species: Species, given: Any) -> tuple[Locomotion, ...]:
    if given is None:
        return species.locomotion
    if isinstance(given, Locomotion):
        return (given,) * species.num_individuals
    if isinstance(given, Sequence) and len(given) == species.num_individuals:
        given = dict(zip(species.individuals, given))
    if not isinstance(given, Mapping):
        raise InputError(
            f"locomotion is {given!r}: give one Locomotion, one per individual, or a mapping by "
            "name"
        )
    unknown = set(given) - set(species.individuals)
    if unknown:
        raise InputError(
            f"locomotion names {sorted(unknown)[0]!r}: choose among "
            f"{', '.join(species.individuals)}"
        )
    return tuple(
        _one_locomotion(old, given.get(name), name)
        for name, old in zip(species.individuals, species.locomotion, strict=True)
    )


def _one_locomotion(old: Locomotion, new: Any, name: str) -> Locomotion:
    if new is None:
        return old
    if isinstance(new, Locomotion):
        return new
    if isinstance(new, Mapping) and set(new) <= {"damping", "thrust", "magnitudes"}:
        return replace(old, **new)
    if is_number(new):
        return replace(old, thrust=old.thrust * new)
    raise InputError(
        f"locomotion of {name} is {new!r}: give a Locomotion, its damping, thrust or magnitudes, "
        "or a factor on the thrust"
    )


def _with_thrusts(
    locomotion: tuple[Locomotion, ...], thrusts: Any, given: Any
) -> tuple[Locomotion, ...]:
    """Set the number of magnitudes; refuse if ``given``, the option ``locomotion``, sets them."""
    if thrusts is None:
        return locomotion
    check_thrusts(thrusts)
    if _says_magnitudes(given):
        raise InputError(
            f"thrusts is {thrusts} but locomotion gives magnitudes: leave one of the two out"
        )
    return tuple(
        own if own.thrusts == thrusts else replace(own, magnitudes=fixed_multiples(int(thrusts)))
        for own in locomotion
    )


def _says_magnitudes(given: Any) -> bool:
    if isinstance(given, Locomotion):
        return given.magnitudes != fixed_multiples(1)
    if isinstance(given, Mapping):
        return "magnitudes" in given or any(map(_says_magnitudes, given.values()))
    return isinstance(given, Sequence) and any(map(_says_magnitudes, given))
