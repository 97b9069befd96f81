"""The user's options applied to a species, each checked and refused by name."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from typing import Any

from animarl_envs.arena import Arena
from animarl_envs.errors import InputError, UnknownOptionError
from animarl_envs.locomotion import Locomotion
from animarl_envs.species import ChaseSpecies, Species


def with_options(species: Species, **options: Any) -> Species:
    """The species with options applied, each checked and refused by name.

    Parameters
    ----------
    num_pursuers
        Number of pursuers of a chase; they are renamed ``<kind>_0, <kind>_1, ...``.
    arena
        An :class:`Arena`, its fields by name, a shape name, or a size, with which the boundary and
        the square of starts grow; ``rebound`` and ``boundary`` apply to it.
    locomotion
        One :class:`Locomotion` for all, or by name ``{"female": Locomotion(...)}`` or
        ``{"female": {"thrust": 0.19}}`` (also ``damping``, ``magnitudes``) or
        ``{"female": 1.2}`` (a factor on the thrust).
    others
        Any field of the species spec: ``contact_radius``, ``time_limit``, ``dt``, ``warmup``, ...
    """
    count = options.pop("num_pursuers", None)
    if "individuals" in options:
        names = tuple(options.pop("individuals"))
        if count is not None and count != len(names) - 1:
            raise InputError(
                f"num_pursuers is {count!r} but individuals names {len(names) - 1} pursuers and a "
                "target: give one of the two"
            )
        species = _with_individuals(species, names)
    elif count is not None:
        species = _with_pursuers(species, count)
    if isinstance(species, ChaseSpecies) and _is_size(options.get("arena")):
        scaled = species.start_half_side * float(options["arena"]) / species.arena.size
        options.setdefault("start_half_side", scaled)
    arena = _arena(species.arena, options)
    locomotion = _locomotion(species, options.pop("locomotion", None))
    known = {f.name for f in fields(species)} - {"name", "individuals", "recording", "locomotion"}
    for key in options:
        if key not in known:
            more = {"num_pursuers", "locomotion", "rebound", "boundary"}
            raise UnknownOptionError.of(key, species.name, known | more)
    try:
        return replace(species, arena=arena, locomotion=locomotion, **options)
    except TypeError as error:
        raise InputError(f"an option of {species.name} has the wrong type ({error})") from error


def _with_individuals(species: Species, names: tuple[str, ...]) -> Species:
    if names == species.individuals:
        return species
    resized = species
    if len(names) != species.num_individuals:
        if not isinstance(species, ChaseSpecies):
            raise InputError(
                f"{species.name} has one individual but {len(names)} were given: {names}"
            )
        resized = _with_pursuers(species, len(names) - 1)
    return replace(resized, individuals=names)


def _with_pursuers(species: Species, count: Any) -> ChaseSpecies:
    if not isinstance(species, ChaseSpecies):
        raise InputError(f"num_pursuers does not apply to {species.name}, which has none: drop it")
    if isinstance(count, bool) or not isinstance(count, int) or count < 1:
        raise InputError(f"num_pursuers is {count!r}: it must be a whole number, 1 or more")
    kind = species.individuals[0].rpartition("_")[0] or "pursuer"
    pursuers, target = species.locomotion[:-1], species.locomotion[-1]
    return replace(
        species,
        individuals=(*(f"{kind}_{i}" for i in range(count)), species.individuals[-1]),
        locomotion=(*(pursuers[i % len(pursuers)] for i in range(count)), target),
    )


def _arena(arena: Arena, options: dict[str, Any]) -> Arena:
    given = options.pop("arena", None)
    changes = {key: options.pop(key) for key in ("rebound", "boundary") if key in options}
    if isinstance(given, Mapping):
        unknown = set(given) - {f.name for f in fields(Arena)}
        if unknown:
            raise InputError(
                f"arena has no {sorted(map(str, unknown))[0]!r}: give shape, size, boundary or "
                "rebound"
            )
        given = replace(arena, **given)
    if isinstance(given, Arena):
        arena = given
    elif isinstance(given, str):
        arena = replace(arena, shape=given)  # type: ignore[arg-type]
    elif _is_size(given):
        margin = arena.boundary / arena.size
        arena = replace(arena, size=float(given), boundary=float(given) * margin)
    elif given is not None:
        raise InputError(f"arena is {given!r}: give an Arena, a shape or a size")
    if arena.shape == "open" and (changes.get("rebound") or "boundary" in changes):
        which = "rebound" if changes.get("rebound") else "boundary"
        raise InputError(f"{which} contradicts an open arena, which has no boundary: drop it")
    return replace(arena, **changes) if changes else arena


def _is_size(given: Any) -> bool:
    return isinstance(given, int | float) and not isinstance(given, bool)


def _locomotion(species: Species, given: Any) -> tuple[Locomotion, ...]:
    if given is None:
        return species.locomotion
    if isinstance(given, Locomotion):
        return (given,) * species.num_individuals
    if isinstance(given, Mapping):
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
    if isinstance(given, Sequence) and len(given) == species.num_individuals:
        return tuple(
            _one_locomotion(old, new, name)
            for name, old, new in zip(species.individuals, species.locomotion, given, strict=True)
        )
    raise InputError(
        f"locomotion is {given!r}: give one Locomotion, one per individual, or a mapping by name"
    )


def _one_locomotion(old: Locomotion, new: Any, name: str) -> Locomotion:
    if new is None:
        return old
    if isinstance(new, Locomotion):
        return new
    if isinstance(new, Mapping) and set(new) <= {"damping", "thrust", "magnitudes"}:
        return replace(old, **new)
    if isinstance(new, int | float) and not isinstance(new, bool):
        return replace(old, thrust=old.thrust * new)
    raise InputError(
        f"locomotion of {name} is {new!r}: give a Locomotion, its damping, thrust or magnitudes, "
        "or a factor on the thrust"
    )
