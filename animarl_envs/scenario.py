"""A scenario: a species with the user's options applied, its demonstrations and its condition.

All views build their world from a scenario, so an option means the same everywhere.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from animarl_envs.array_types import Floats
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.joining import COUNTS, first_of_role
from animarl_envs.errors import InputError, also_list_options_of
from animarl_envs.focus import is_free, lone_pursuer
from animarl_envs.settings import CountOrZero, NotNegative, check_fields, is_whole
from animarl_envs.species import (
    CUSTOM,
    SPECIES,
    ChaseSpecies,
    Species,
    get_species,
    species_name,
)
from animarl_envs.species.options import with_options
from animarl_envs.tasks import find_task

Condition = Literal[0, 1, "demo"]
Demos = Demonstrations | str | Path | None
PACKAGED = "packaged"

ACTION, REPLAY, SCRIPTED, COASTING = 0, 1, 2, 3
SCALES_OF_CELLS = 3  # thrust magnitudes, whose smallest is the scale of observed velocities
DRIVERS = {"action": ACTION, "replay": REPLAY, "scripted": SCRIPTED, "coast": COASTING}
"""Who moves an individual: the caller's action, its demonstration, a rule, or nobody."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Scenario:
    """Everything a world is built from.

    Parameters
    ----------
    species
        The spec, options applied.
    demos
        Recorded episodes that episodes start from and are paired with; ``None`` for none.
    condition
        0, 1, or ``"demo"``: that of the paired demonstration (0 without one).
    start
        ``"demo"``: from the first frame of the paired demonstration; ``"uniform"``: as the species
        starts without one; or positions ``(individuals, 2)`` in the arena frame, at rest.
    drivers
        One of ``action``, ``replay``, ``scripted``, ``coast`` per individual.
    observation_noise
        Standard deviation of Gaussian noise on every observation component [its unit].
    observation_delay
        Age of the observation that is handed out [steps].
    split
        Which split the demonstrations are, for the record.
    all_splits
        The demonstrations before the split was selected.
    """

    species: Species
    demos: Demonstrations | None = None
    condition: Condition = "demo"
    start: str | Floats = "demo"
    drivers: tuple[str, ...]
    observation_noise: NotNegative = 0.0
    observation_delay: CountOrZero = 0
    split: str | None = None
    all_splits: Demonstrations | None = None

    def __post_init__(self) -> None:
        names, demos = self.species.individuals, self.demos
        if isinstance(self.condition, bool) or self.condition not in (0, 1, "demo"):
            raise InputError(f"condition is {self.condition!r}: choose 0, 1 or 'demo'")
        plainly = self.condition if self.condition == "demo" else int(self.condition)
        object.__setattr__(self, "condition", plainly)  # of NumPy's kinds or of Python's
        check_fields(self)
        if self.condition == 1 and not self.species.conditions:
            raise InputError(
                f"condition 1 is not defined for {self.species.name}, which has no conditions: "
                "leave the option out"
            )
        object.__setattr__(self, "start", self._checked_start())
        if demos is not None and demos.individuals != names:
            raise InputError(
                f"{demos.name}: it holds {', '.join(demos.individuals)} but the scenario needs "
                f"{', '.join(names)}: give matching demonstrations"
            )
        if demos is not None and not np.isclose(demos.dt, self.species.dt):
            raise InputError(
                f"{demos.name}: its dt is {demos.dt} s, that of {self.species.name} "
                f"{self.species.dt} s: resample it or pass dt="
            )
        for name, driver in zip(names, self.drivers, strict=True):
            if driver not in DRIVERS:
                raise InputError(
                    f"{name} is driven by {driver!r}: choose one of {', '.join(DRIVERS)}"
                )
            if driver == "replay" and not self.paired:
                raise InputError(
                    f"{name} cannot replay a demonstration, since episodes start without one: use "
                    "others='scripted' or start='demo'"
                )

    def _checked_start(self) -> str | Floats:
        species = self.species
        if isinstance(self.start, str):
            if self.start not in ("demo", "uniform"):
                raise InputError(
                    f"start is {self.start!r}: choose 'demo', 'uniform' or an array of positions"
                )
            if self.start == "demo" and self.demos is None:
                raise InputError("start is 'demo' but there are no demonstrations: give demos=")
            if self.start == "uniform" and isinstance(species, ChaseSpecies):
                species.check_uniform_starts()
            return self.start
        wanted = f"give x and y of {species.num_individuals} individuals"
        try:
            start = np.array(self.start, dtype=np.float64)
        except (TypeError, ValueError):
            raise InputError(f"start is no array of numbers: {wanted}") from None
        if start.shape != (species.num_individuals, 2) or not np.isfinite(start).all():
            raise InputError(f"start has shape {start.shape}: {wanted}")
        if not species.arena.contains(start).all():
            raise InputError(
                "start lies out of bounds: place every individual within "
                f"{species.arena.boundary:g} of the centre, and outside obstacles"
            )
        return start

    @property
    def paired(self) -> bool:
        """Whether every episode starts from a demonstration."""
        return isinstance(self.start, str) and self.start == "demo"

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the individuals."""
        return self.species.individuals


def make_scenario(
    species: Species | str,
    *,
    demos: Demos = "packaged",
    split: str | None = "train",
    condition: Condition = "demo",
    start: str | Any = None,
    drivers: Mapping[str, str] | None = None,
    observation_noise: float = 0.0,
    observation_delay: int = 0,
    **options: Any,
) -> Scenario:
    """Build a scenario from a species and options, each checked.

    Parameters
    ----------
    species
        A spec, or the name or id of one or of a task (:mod:`animarl_envs.tasks`); ``"custom"``:
        made from the demonstrations, by
        :func:`animarl_envs.fitting.custom_species.species_of`.
    demos
        ``"packaged"``, a file, a :class:`Demonstrations` or ``None``.
    split
        Which split of the demonstrations is used; ``None`` for all (evaluation does that).
    drivers
        Who moves an individual, by name; ``"action"`` for those not named.
    options
        What :func:`~animarl_envs.species.options.with_options` takes: ``num_pursuers``,
        ``num_targets``, ``arena``, ``contact_radius``, ``time_limit``, ``locomotion``, ``thrusts``,
        ...
        With fewer pursuers (or targets) than recorded, the first ones are used. With more, only
        the species is made from the recordings, and ``start`` must be ``"uniform"`` or positions.

    Raises
    ------
    InputError
        If an option is not valid, or the demonstrations do not fit the species.
    """
    task = find_task(species)
    if task is not None:
        species, start = task.species, task.start if start is None else start
    given = None if isinstance(species, str) and species_name(species) == CUSTOM else species
    spec = get_species(given) if isinstance(given, str) else given
    loaded, cells = _load_demos(demos, spec), options.pop("cells", None)
    if loaded is not None and spec is not None:
        refuse_other_species(loaded, spec.name)
    follows = start is None or (isinstance(start, str) and start == "demo")
    for key, role in COUNTS.items():
        count = options.get(key)
        if loaded is None or count is None:
            continue
        recorded = loaded.roles.count(role)
        if not follows and recorded > 0 and is_whole(count) and count > recorded:
            # More than recorded, where nobody follows a recording.
            spec, loaded = spec or _recorded_species(loaded, options), None
            options.setdefault("dt", spec.dt)
            continue
        if spec is not None:
            with_options(spec, **{key: count})  # refused as without demos
        loaded = first_of_role(loaded, key, options.pop(key))
        options.setdefault("individuals", loaded.individuals)
    if spec is None:
        if cells is not None:
            options.setdefault("thrusts", SCALES_OF_CELLS)
        spec = _recorded_species(loaded, options)
    if loaded is not None and not (isinstance(demos, str) and demos == PACKAGED):
        options.setdefault("dt", loaded.dt)
        options.setdefault("individuals", loaded.individuals)
        if lone_pursuer(loaded.roles):
            options.setdefault("lone_pursuer", True)
        if isinstance(spec, ChaseSpecies) and is_free(loaded.roles):
            options.setdefault("free", True)
    with also_list_options_of(make_scenario):
        spec = with_options(spec, **options)
    if cells is not None:
        from animarl_envs.fitting.cells import species_with_cells

        spec = species_with_cells(spec, loaded, cells)
    selected = loaded
    if loaded is not None and split is not None:
        selected = loaded.select(split=split)
    if start is None:
        start = "uniform" if loaded is None else "demo"
    drivers = dict(drivers or {})
    unknown = set(drivers) - set(spec.individuals)
    if unknown:
        raise InputError(
            f"individual {sorted(unknown)[0]!r} is unknown: choose among "
            f"{', '.join(spec.individuals)}"
        )
    return Scenario(
        species=spec,
        demos=selected,
        all_splits=loaded,
        condition=condition,
        start=start,
        drivers=tuple(drivers.get(name, "action") for name in spec.individuals),
        observation_noise=observation_noise,
        observation_delay=observation_delay,
        split=None if loaded is None else split,
    )


def _recorded_species(demos: Demonstrations | None, options: Mapping[str, Any]) -> Species:
    """Return the species made from demonstrations, with the options' thrust magnitudes."""
    from animarl_envs.fitting.custom_species import species_of

    if demos is None:
        raise InputError(
            "the custom species is made from demonstrations: give demos=, a file or a "
            "Demonstrations object"
        )
    thrusts = options.get("thrusts")
    return species_of(demos, thrusts=1 if thrusts is None else thrusts)


def refuse_other_species(demos: Demonstrations, species: str, option: str = "species") -> None:
    """Refuse demonstrations of another species of the package; names of one's own fit any.

    ``option`` is where the user named the species.

    Raises
    ------
    InputError
        If the demonstrations are of another species.
    """
    if demos.species != species and {demos.species, species} <= SPECIES.keys():
        raise InputError(
            f"{demos.name}: it holds demonstrations of {demos.species}, not of {species}: "
            f"give {option} {demos.species} or another file"
        )


def _load_demos(demos: Demos, species: Species | None) -> Demonstrations | None:
    if isinstance(demos, Demonstrations) or demos is None:
        return demos
    if isinstance(demos, str) and demos == PACKAGED:
        from animarl_envs.demos.packaged import load_packaged, packaged_names

        shipped = species is not None and species.name in packaged_names()
        return load_packaged(species.name) if species is not None and shipped else None
    if not isinstance(demos, str | Path):
        raise InputError(
            f"demos is {demos!r}: give 'packaged', a file, a published set by its name, a "
            "Demonstrations object or None"
        )
    from animarl_envs.importing.sets import read_named

    return read_named(demos)
