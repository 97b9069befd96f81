"""The tasks for reinforcement learning: what each changes of its animals' world.

``AnimaRL/FlyTask-v0`` is the world of ``AnimaRL/Fly-v0`` with the changes of :data:`TASKS`, which
make it worth learning: no constant action solves it. In a task the individuals that nobody controls
follow their script. Options of the caller come on top: ``arena=1.5`` keeps the walls of a task, and
``locomotion={"predator_0": 1.1}`` the thrust of its prey.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from animarl_envs.species import AGENT, COMPACT, FLY, NEWT, SILKMOTH, Species, species_name
from animarl_envs.species.options import with_options

SHARED_CHANGES: Mapping[str, Any] = {"observation": COMPACT, "time_cost": 0.5}
"""Changes of all tasks; ``time_cost`` is that of a whole episode [captures]."""


@dataclass(frozen=True)
class Task:
    """A task: the world of ``base`` with ``changes``, which are options of an environment."""

    base: Species
    changes: Mapping[str, Any]

    @property
    def species(self) -> Species:
        """The base species with all changes that are its fields."""
        return with_options(self.base, **{k: v for k, v in self.changes.items() if k != "start"})

    @property
    def start(self) -> str | None:
        """How episodes start; None: as those of the base."""
        return self.changes.get("start")


def _task(base: Species, **changes: Any) -> Task:
    return Task(base, {**SHARED_CHANGES, **changes})


_AROUND: dict[str, Any] = {"start": "uniform", "start_region": (-0.1, 0.4, 0.25)}
TASKS: Mapping[str, Task] = {
    # Targets are as much faster as in simple_tag. Walls keep agents in; a dish has none, for along
    # them a female gets away from pursuers by always turning to one side.
    "AgentTask": _task(AGENT, rebound=True, locomotion={"prey": 1.3}),
    "FlyTask": _task(
        FLY,
        contact_radius=0.1,
        rebound=False,
        boundary_penalty=-2.0,
        locomotion={"female": 1.3},
    ),
    "NewtTask": _task(NEWT, locomotion={"female": 1.3}),
    "SilkmothTask": _task(SILKMOTH, **_AROUND),
    # Nothing but the odour is observed: a task for policies with a memory.
    "SilkmothMemory": _task(SILKMOTH, **_AROUND | {"observation": "odour"}),
}
"""By name: ``"FlyTask"`` is ``AnimaRL/FlyTask-v0``. A factor in ``locomotion`` is on the thrust."""


def find_task(species: Species | str) -> Task | None:
    """Return the task of a name or an id, None if it is none."""
    name = species_name(species) if isinstance(species, str) else ""
    return next((task for key, task in TASKS.items() if key.lower() == name), None)
