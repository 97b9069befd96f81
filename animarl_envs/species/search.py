"""The spec of a species that searches an odour source."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar

import numpy as np
from annotated_types import Ge, Le, Lt

from animarl_envs.errors import InputError
from animarl_envs.settings import NotNegative, Positive, is_number, is_whole
from animarl_envs.species.base import Species
from animarl_envs.species.turning import Turning, as_turning


@dataclass(frozen=True, kw_only=True)
class SearchSpecies(Species):
    """One searcher and an odour source at the origin; upwind is the direction -x.

    What the senses tell is in ``docs/plume.md`` ("What the moth senses").
    """

    world: ClassVar[str] = "search"
    script: ClassVar[str] = "programmed moth"
    length_unit: ClassVar[str] = "metre"
    condition_is_sensed: ClassVar[bool] = True
    observations: ClassVar[tuple[str, ...]] = (*Species.observations, "odour")

    metres_per_unit: Positive = 1.0  # the plume is in metres
    start_distance: Positive = 0.3  # downwind of the source [arena unit]
    start_region: tuple[float, ...] = ()  # or anywhere: lowest and highest x, and highest |y|
    antenna_length: Positive = 0.013  # ahead of the body centre [arena unit]
    antenna_angle: Annotated[float, Ge(0), Le(90)] = 19.0  # to either side [deg]
    antenna_radius: NotNegative = 0.0025  # within which it senses the plume [arena unit]
    odour_decay: Positive = 1.96  # time constant after the last hit [s]
    odour_baseline: Annotated[float, Ge(0), Lt(1)] = 0.07
    trace_decay: Positive = 10.0  # time constant of the slow trace of hits [s]
    flow_threshold: NotNegative = 0.1  # yaw rates below it give no visual flow [rad/s]
    flow_limit: Positive = 1.2  # visual flow is clipped here [rad/s]
    senses_past: bool = False  # adds its turning and its way averaged over the last seconds
    turning: Turning | None = None  # of the body; None: it points where it walks
    rest_speed: NotNegative = 1e-4  # slower bodies keep their heading [arena unit / s]
    plume: Any = "model"  # "model", "off", "continuous" or a worlds.plume.Plume
    train_plumes: tuple[int, ...] = (0, 1, 2)  # the five fixed patterns: training ...
    test_plumes: tuple[int, ...] = (3, 4)  # ... and held out

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.arena.shape != "open":
            raise InputError(
                f"arena is a {self.arena.shape} but a search is in the open: give a size to draw, "
                "or Arena('open', size)"
            )
        if self.arena.landmarks or self.arena.obstacles:
            raise InputError(
                "a searcher perceives no landmarks and meets no obstacles: leave them out"
            )
        object.__setattr__(self, "turning", as_turning(self.turning, "turning"))
        object.__setattr__(self, "start_region", self._checked_region())
        for name in ("train_plumes", "test_plumes"):
            chosen = getattr(self, name)
            listed = isinstance(chosen, Sequence | np.ndarray) and not isinstance(chosen, str)
            if not listed or len(chosen) == 0 or not all(is_whole(p) for p in chosen):
                raise InputError(
                    f"{name} is {chosen!r}: name one or more plume patterns, 0 to 4, as a list"
                )
            object.__setattr__(self, name, tuple(int(p) for p in chosen))
        if self.plume != "model":
            from animarl_envs.worlds.plume.plume import as_plume  # the model is made when needed

            as_plume(self.plume)

    def _checked_region(self) -> tuple[float, ...]:
        given: Any = self.start_region
        listed = isinstance(given, Sequence | np.ndarray) and not isinstance(given, str)
        if listed and len(given) == 0:
            return ()
        if listed and len(given) == 3 and all(map(is_number, given)):
            low, high, width = map(float, given)
            farthest = math.hypot(max(abs(low), abs(high)), width)
            if low < high and 0.0 < width < math.inf and 2.0 * self.contact_radius < farthest < 1e6:
                return low, high, width
        raise InputError(
            f"start_region is {given!r}: give the lowest and the highest x and the highest |y| of "
            f"starts, some of them farther than {2.0 * self.contact_radius:g} from the source"
        )

    @property
    def roles(self) -> tuple[str, ...]:
        """Role of each individual: all are searchers."""
        return ("searcher",) * self.num_individuals

    @property
    def goal(self) -> str:
        """What searchers try to reach, in words."""
        return "the source"
