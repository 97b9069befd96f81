"""Changes of a world in the words of its user: ``prey.speed=+20%``, ``arena=x1.5``."""

import itertools
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from animarl_algos.whatif.absent import can_remove
from animarl_envs.arena import Arena, as_obstacle, format_obstacle
from animarl_envs.array_types import Floats
from animarl_envs.cells import CellLocomotion
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.summary import Unit, unit_of
from animarl_envs.errors import InputError
from animarl_envs.species import ChaseSpecies, SearchSpecies, Species
from animarl_envs.species.traits import LARGEST, TRAITS, Traits

NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
FACTOR = re.compile(rf"x({NUMBER})")
PERCENT = re.compile(rf"({NUMBER})%")
ABSOLUTE = re.compile(rf"({NUMBER})\s*([A-Za-z/]*)")
SWEEP = re.compile(r"(.+?)\.\.(.+?)/(\d+)")
MAX_SCENARIOS = 50

BODY = ("speed", "thrust", "damping")
TRAIT_COLUMNS = {name.replace(" ", "_"): column for column, name in enumerate(TRAITS)}
"""Columns of the traits of species whose individuals differ, by what a user writes [sd]."""
OPTION_NAMES = {"arena": "size", "contact": "contact_radius", "time_limit": "time_limit"}
CONDITION = "condition"
PLUME = "plume"
PLUMES = ("model", "continuous", "off")
AIR = {"wind": "advection_speed", "odour": "threshold"}
"""Constants of the plume model; the threshold goes down as the source's odour goes up."""
LANDMARK = "landmark.remove"
OBSTACLE, CLEARED = "obstacle", "obstacle.remove"
REMOVE, ADD, START, UNIFORM = "remove", "add", "start", "uniform"
PLACE = re.compile(rf"({NUMBER})\s*,\s*({NUMBER})\s*([A-Za-z]*)")


@dataclass(frozen=True)
class Amount:
    """How much: a factor on what is there, or a value with its unit (empty: the arena's)."""

    value: float
    is_factor: bool
    unit: str = ""

    def of(self, before: float, scales: Mapping[str, float], what: str) -> float:
        """Return the new value; ``scales`` say how much one of each unit is."""
        if self.is_factor:
            return before * self.value
        if self.unit and self.unit not in scales:
            raise InputError(
                f"{what} is given in {self.unit!r}: use {', '.join(sorted(scales)) or 'no unit'}, "
                "a factor (x1.2) or a change (+20%)"
            )
        return self.value * scales.get(self.unit, 1.0)


@dataclass(frozen=True)
class Change:
    """One thing that is changed.

    Parameters
    ----------
    individuals
        Those whose body, trait or start is changed; empty for the world.
    what
        ``speed``, ``thrust``, ``damping``, ``arena``, ``contact``, ``time_limit``, ``condition``,
        ``plume``, ``wind``, ``odour``, ``remove``, ``landmark.remove``, ``obstacle``,
        ``obstacle.remove``, ``start``, a trait (``own_speed``) or another number of the species.
    amount
        How much; of a condition, a plume or a landmark its name, of a start ``uniform`` or a place,
        of an obstacle x, y and radius.
    text
        As the user wrote it.
    """

    individuals: tuple[str, ...]
    what: str
    amount: Amount | str
    text: str


@dataclass(frozen=True)
class ChangedWorld:
    """Changes that are made together."""

    changes: tuple[Change, ...]

    @property
    def name(self) -> str:
        """The changes as the user wrote them."""
        return ", ".join(change.text for change in self.changes)

    @property
    def speeds(self) -> tuple[Change, ...]:
        """Changes of achieved speed, for which thrusts must be found."""
        return tuple(change for change in self.changes if change.what == "speed")

    @property
    def moves_bodies(self) -> bool:
        """Whether a body is changed."""
        return any(change.what in BODY for change in self.changes)

    @property
    def condition(self) -> str | None:
        """Name of the condition, if it is changed."""
        named = (str(change.amount) for change in self.changes if change.what == CONDITION)
        return next(named, None)

    @property
    def removed(self) -> tuple[str, ...]:
        """Individuals that are removed."""
        return tuple(name for one in self.changes if one.what == REMOVE for name in one.individuals)

    def move_starts(self, demos: Demonstrations, species: Species) -> Demonstrations:
        """Return the recordings with the changed starts, at rest.

        Raises
        ------
        InputError
            If a start lies outside the field.
        """
        positions, velocity = demos.positions.copy(), demos.initial_velocity.copy()
        first, rng = demos.offsets[:-1], np.random.default_rng(0)
        for change in self.changes:
            if change.what != START:
                continue
            indices = [species.individuals.index(name) for name in change.individuals]
            place = _place(str(change.amount), unit_of(demos), change.text)
            if place is None:
                assert isinstance(species, ChaseSpecies)
                species.check_uniform_starts()
                half = species.start_half_side
                places = rng.uniform(-half, half, (len(demos), len(indices), 2))
            else:
                places = np.broadcast_to(place, (len(demos), len(indices), 2))
                if not species.arena.contains(places).all():
                    raise InputError(f"{change.text!r}: it lies outside the field: start inside")
            positions[first[:, None], indices], velocity[:, indices] = places, 0.0
        return replace(demos, positions=positions, initial_velocity=velocity)

    def options(
        self, species: Species, unit: Unit, thrusts: Mapping[str, float] | None = None
    ) -> dict[str, Any]:
        """Return the options of the species for all changes but condition and removal.

        Parameters
        ----------
        thrusts
            Factors on thrusts with which wanted speeds are achieved, by individual.
        """
        lengths = {unit.name: 1.0 / unit.per_arena_unit}
        bodies = dict(zip(species.individuals, species.locomotion, strict=True))
        for name, factor in (thrusts or {}).items():
            bodies[name] = replace(bodies[name], thrust=bodies[name].thrust * factor)
        options: dict[str, Any] = {}
        for change in sorted(self.changes, key=lambda one: one.what != PLUME):
            if isinstance(change.amount, str):
                options |= {PLUME: change.amount} if change.what == PLUME else {}
                # Warming up would lead back to the recorded start.
                options |= {"warmup": 0} if change.what == START else {}
            elif change.what == "speed":
                continue
            elif change.what in BODY:
                for name in change.individuals:
                    old = getattr(bodies[name], change.what)
                    new = change.amount.of(old, {}, change.text)
                    what: dict[str, Any] = {change.what: new}
                    bodies[name] = replace(bodies[name], **what)
            elif change.what in TRAIT_COLUMNS:
                indices = [species.individuals.index(name) for name in change.individuals]
                traits = options.get("traits", species.traits)
                assert traits is not None  # else there is no such name
                options["traits"] = _shift_traits(traits, indices, change)
            elif change.what in AIR:
                plume = options.get(PLUME, getattr(species, PLUME))
                options[PLUME] = _change_air(plume, change)
            elif change.what == "arena":
                options["arena"] = change.amount.of(species.arena.size, lengths, change.text)
            elif change.what == "time_limit":
                seconds = change.amount.of(
                    species.time_limit * species.dt, {"s": 1.0, "min": 60.0}, change.text
                )
                options["time_limit"] = max(1, round(seconds / species.dt))
            else:
                field = OPTION_NAMES.get(change.what, change.what)
                before = float(getattr(species, field))
                options[field] = change.amount.of(before, lengths | {"s": 1.0}, change.text)
        arena = species.arena.scaled(options.get("arena", species.arena.size))
        for change in self.changes:
            if change.what == LANDMARK:
                arena = arena.without_landmark(str(change.amount))
                options["landmarks"] = arena.landmarks
            elif change.what in (OBSTACLE, CLEARED):
                arena = _change_obstacles(arena, change, unit, species.arena.size)
                options["obstacles"] = arena.obstacles
        if bodies != dict(zip(species.individuals, species.locomotion)):
            options["locomotion"] = bodies
        return options


def parse_scenarios(
    texts: Sequence[str], species: Species, *, separately: bool = False
) -> list[ChangedWorld]:
    """Return the scenarios that ``--change`` options describe.

    Parameters
    ----------
    texts
        Each ``NAME=VALUE``. All hold together; a sweep (``prey.speed=-20%..+20%/5``) makes as many
        scenarios as it has points, several sweeps all their combinations.
    species
        Of the run.
    separately
        Whether every text is a question of its own.

    Raises
    ------
    InputError
        If a name or a value is unknown, or one thing is changed twice.
    """
    if not texts:
        raise InputError("nothing is changed: give --change NAME=VALUE, " + known(species))
    each = [parse_change(text, species) for text in texts]
    if separately:
        scenarios = [ChangedWorld((change,)) for points in each for change in points]
    else:
        scenarios = [ChangedWorld(changes) for changes in itertools.product(*each)]
    if len(scenarios) > MAX_SCENARIOS:
        raise InputError(f"{len(scenarios)} scenarios are asked for: ask {MAX_SCENARIOS} at most")
    for scenario in scenarios:
        _check_once(scenario.changes)
    return scenarios


def parse_change(text: str, species: Species) -> list[Change]:
    """Return the change that a text describes; of a sweep, that of each of its points."""
    name, equals, value = (part.strip() for part in text.partition("="))
    if not (name and equals and value):
        raise InputError(f"{text!r} is no change: give NAME=VALUE, " + known(species))
    if name == ADD:
        raise InputError(
            f"{text!r}: a trained run takes no further individual: import recordings of as many, "
            "or train with num_pursuers one higher, and ask that run"
        )
    named = subjects(species)
    if name not in named:
        raise InputError(f"{text!r}: {name!r} cannot be changed, {known(species)}")
    individuals, what = named[name]
    if isinstance(species.locomotion[0], CellLocomotion):
        what = _body_of_cells(what, value, text)
    if what in (CONDITION, PLUME, REMOVE, START, LANDMARK, OBSTACLE, CLEARED):
        chosen = _choice(what, value, species, text)
        return [Change((chosen,) if what == REMOVE else individuals, what, chosen, text)]
    sweep = SWEEP.fullmatch(value)
    if sweep is None:
        return [Change(individuals, what, _amount(value, text), text)]
    first, last = (_amount(end, text) for end in sweep.groups()[:2])
    if (first.is_factor, first.unit) != (last.is_factor, last.unit):
        raise InputError(f"{text!r}: both ends of a sweep are of one kind, as in -20%..+20%/5")
    number = int(sweep[3])
    if not 2 <= number <= MAX_SCENARIOS:
        raise InputError(f"{text!r}: a sweep has 2 to {MAX_SCENARIOS} points")
    points = np.linspace(first.value, last.value, number).tolist()
    amounts = [replace(first, value=point) for point in points]
    return [Change(individuals, what, one, f"{name}={_format_amount(one)}") for one in amounts]


def _body_of_cells(what: str, value: str, text: str) -> str:
    """Return what is changed in an animal that moves by cells: its thrust scales every step."""
    if what in ("thrust", "damping"):
        raise InputError(
            f"{text!r}: {what} belongs to pushes, and these animals move by cells of recorded "
            "velocities: change their speed"
        )
    if what == "speed" and not ("x" in value or "%" in value):
        raise InputError(
            f"{text!r}: the speed of animals that move by cells is changed by a factor on each "
            "step: give x1.2 or +20%"
        )
    return "thrust" if what == "speed" else what


def known(species: Species) -> str:
    """Return a sentence that lists what can be changed."""
    return f"where NAME is one of {', '.join(subjects(species))}"


def subjects(species: Species) -> dict[str, tuple[tuple[str, ...], str]]:
    """Return all names of what can be changed, with the individuals and the field of each.

    Individuals go by name, by kind (``predators``) and by role (``pursuers``), and ``speed`` alone
    is of all; traits can be changed where training animals differed in them.
    """
    groups: dict[str, tuple[str, ...]] = {name: (name,) for name in species.individuals}
    for name, role in zip(species.individuals, species.roles, strict=True):
        for plural in (f"{name.rpartition('_')[0] or name}s", f"{role}s"):
            groups[plural] = tuple(dict.fromkeys((*groups.get(plural, ()), name)))
    groups |= {"all": species.individuals}
    own = [*BODY, START]
    if species.traits is not None:
        differ = np.isfinite(species.traits.scale)
        own += [name for name, column in TRAIT_COLUMNS.items() if differ[:, column].any()]
    named = {
        f"{group}.{what}": (members, what)
        for group, members in groups.items()
        for what in own
        if len(members) > 1 or group in species.individuals
    }
    world = ["time_limit"]
    if isinstance(species, ChaseSpecies):
        world += ["arena"] * (species.arena.shape != "open") + ["contact"] * (not species.free)
        arena = species.arena  # the open field has no walls to perceive before it has obstacles
        world += [REMOVE] * can_remove(species) + [LANDMARK] * bool(arena.landmarks)
        world += [OBSTACLE] * (arena.shape != "open" or arena.walled)
        world += [CLEARED] * bool(arena.obstacles)
    if isinstance(species, SearchSpecies):
        fields_of_search = {field.name for field in fields(SearchSpecies)}
        numbers = fields_of_search - {field.name for field in fields(Species)}
        numbers = {name for name in numbers if isinstance(getattr(species, name), float)}
        world = ["contact", "time_limit", PLUME, *AIR, *sorted(numbers)]
    world += [CONDITION] if species.conditions else []
    named |= {what: (species.individuals, what) for what in own}
    return named | {what: ((), what) for what in world}


def _place(value: str, unit: Unit, text: str) -> Floats | None:
    """Return a place [arena unit]; None for places that are drawn at random."""
    if value == UNIFORM:
        return None
    match = PLACE.fullmatch(value)
    if match is None or match[3] not in ("", unit.name):
        raise InputError(
            f"{text!r}: {value!r} is no place: give {UNIFORM} or x,y such as 0.2,-0.1 (in arena "
            f"units, or with {unit.name} behind)"
        )
    place = np.array([float(match[1]), float(match[2])])
    return place / unit.per_arena_unit if match[3] else place


def _change_obstacles(arena: Arena, change: Change, unit: Unit, size: float) -> Arena:
    """Return the arena with one obstacle more or less; ``size`` is that of the unchanged one."""
    text = str(change.amount)
    if change.what == CLEARED:
        factor = arena.size / size
        names = [
            format_obstacle((x / factor, y / factor, r / factor)) for x, y, r in arena.obstacles
        ]
        return arena.without_obstacle(arena.obstacles[names.index(text)])
    numbers = text.removesuffix(unit.name).strip()
    per_unit = 1.0 if numbers == text else 1.0 / unit.per_arena_unit
    x, y, radius = as_obstacle(numbers)
    new = per_unit * x, per_unit * y, per_unit * radius
    return replace(arena, obstacles=(*arena.obstacles, new))


def _choice(what: str, value: str, species: Species, text: str) -> str:
    """Check the name of a condition, a plume or an individual, or a start, and return it."""
    if what == START and value == UNIFORM and not isinstance(species, ChaseSpecies):
        raise InputError(f"{text!r}: starts of {species.name} are not drawn: give a place x,y")
    names = {
        REMOVE: species.individuals,
        CONDITION: species.conditions,
        PLUME: PLUMES,
        LANDMARK: tuple(name for name, _, _ in species.arena.landmarks),
        CLEARED: tuple(map(format_obstacle, species.arena.obstacles)),
    }.get(what)
    if names is not None and value not in names:
        raise InputError(f"{text!r}: there is no {value!r}: choose one of {', '.join(names)}")
    return value


def _shift_traits(traits: Traits, individuals: Sequence[int], change: Change) -> Traits:
    """Return traits of training animals, shifted for some individuals by a number of sd."""
    assert isinstance(change.amount, Amount)
    if change.amount.is_factor or change.amount.unit != "sd":
        raise InputError(
            f"{change.text!r}: a trait is changed by standard deviations between the training "
            "animals, as in +1sd"
        )
    table, alike = traits.table.copy(), traits.table.shape[1]
    rows, column = sorted({i % alike for i in individuals}), TRAIT_COLUMNS[change.what]
    shifted = table[:, rows, column] + change.amount.value
    table[:, rows, column] = np.clip(shifted, -LARGEST, LARGEST)
    return replace(traits, table=table)


def _change_air(plume: Any, change: Change) -> Any:
    """Return the model plume with another wind [m/s] or a stronger source."""
    from animarl_envs.worlds.plume.plume import ModelPlume, as_plume

    plume = as_plume(plume)
    if not isinstance(plume, ModelPlume):
        raise InputError(
            f"{change.text!r}: only the model plume has a wind and a strength: simulate with "
            "plume=model, or give another movie"
        )
    assert isinstance(change.amount, Amount)
    if change.what == "odour":
        if not change.amount.is_factor:
            raise InputError(f"{change.text!r}: odour is changed by a factor, as in odour=x2")
        model = replace(plume.model, threshold=plume.model.threshold / change.amount.value)
    else:
        speed = change.amount.of(plume.model.advection_speed, {"m/s": 1.0}, change.text)
        model = replace(plume.model, advection_speed=speed)
    return replace(plume, model=model)


def _amount(value: str, text: str) -> Amount:
    value = value.strip()
    if match := FACTOR.fullmatch(value):
        amount = Amount(float(match[1]), True)
    elif match := PERCENT.fullmatch(value):
        amount = Amount(1.0 + float(match[1]) / 100.0, True)
    elif match := ABSOLUTE.fullmatch(value):
        amount = Amount(float(match[1]), False, match[2])
    else:
        raise InputError(
            f"{text!r}: {value!r} is no amount: give a factor (x1.2), a change (+20%), a value "
            "with its unit (60s) or a sweep (-20%..+20%/5)"
        )
    if not (np.isfinite(amount.value) and (amount.value > 0 or amount.unit == "sd")):
        raise InputError(f"{text!r}: {value!r} leaves nothing: give more than zero")
    return amount


def _format_amount(amount: Amount) -> str:
    if not amount.is_factor:
        signed = "+" if amount.unit == "sd" else ""
        return f"{amount.value:{signed}g}{amount.unit}"
    return f"{100 * (amount.value - 1):+.3g}%"


def _check_once(changes: Iterable[Change]) -> None:
    """Refuse two changes of one thing; speed and thrust of an individual are one thing."""
    seen: dict[tuple[str, str], str] = {}
    changes = list(changes)
    gone = {name for one in changes if one.what == REMOVE for name in one.individuals}
    for change in changes:
        what = "thrust" if change.what == "speed" else change.what
        what += f" {change.amount}" * (what in (LANDMARK, OBSTACLE, CLEARED))
        for name in change.individuals or ("",):
            if name in gone and what in BODY:
                raise InputError(f"{change.text!r} changes {name}, who is removed: leave one out")
            if (name, what) in seen:
                raise InputError(
                    f"{seen[name, what]!r} and {change.text!r} change the same thing: give one"
                )
            seen[name, what] = change.text
