"""The scales in which individuals perceive motion and place, and how a policy keeps its own.

Inputs such as ``tanh(v / (u dt))`` or ``1 / (distance + 0.1 size)`` have a scale. It comes from the
world in which a policy is trained. If it followed the world in a what-if question, the same motion
would look different there, and the answer would be an artefact.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

from animarl_envs.locomotion import Locomotion

Reading = Literal["habit", "knows"]
"""How a trained policy perceives a changed world. ``"habit"``: in the scales it was trained with,
so the same places and velocities give the same inputs. ``"knows"``: individuals know their changed
bodies, so all inputs about their own motion are in units of the new thrust."""


@dataclass(frozen=True)
class SenseScales:
    """Scales of observations.

    Parameters
    ----------
    locomotion
        Of each individual: its velocity is measured in what this thrust adds in a step, and its
        acceleration is what this damping leaves unexplained, in multiples of this thrust.
    dt
        The step that goes with it [s].
    arena_size
        Scale of distances, to the others and to walls [arena unit].
    time_limit
        Longest time since the start that is perceived [steps].
    own_velocity
        Of each individual: factor on the inputs that are its own velocity without a scale.
    """

    locomotion: tuple[Locomotion, ...]
    dt: float
    arena_size: float
    time_limit: int
    own_velocity: tuple[float, ...]

    def with_bodies(self, locomotion: tuple[Locomotion, ...], dt: float) -> SenseScales:
        """Return the same scales for individuals that know the bodies they have."""
        return replace(
            self,
            locomotion=locomotion,
            dt=dt,
            own_velocity=tuple(
                factor * (old.thrust * self.dt) / (new.thrust * dt)
                for factor, old, new in zip(
                    self.own_velocity, self.locomotion, locomotion, strict=True
                )
            ),
        )

    def select(self, individuals: Sequence[int]) -> SenseScales:
        """Return the scales of these individuals, in this order."""
        return replace(
            self,
            locomotion=tuple(self.locomotion[i] for i in individuals),
            own_velocity=tuple(self.own_velocity[i] for i in individuals),
        )
