"""What an individual may look like in pictures; :mod:`animarl_envs.drawing.bodies` draws them."""

from __future__ import annotations

from typing import Any

from animarl_envs.errors import InputError

PLAIN_BODY = "animal"
BODIES = (PLAIN_BODY, "predator", "prey", "fly", "newt", "moth")


def checked_bodies(given: Any) -> tuple[str, ...]:
    """One or two names of :data:`BODIES` as a tuple.

    Raises
    ------
    InputError
        If they are none.
    """
    bodies = (given,) if isinstance(given, str) else tuple(given)
    if not 1 <= len(bodies) <= 2 or not set(bodies) <= set(BODIES):
        raise InputError(
            f"bodies is {given!r}: give one of {', '.join(BODIES)} for all, or two of them, the "
            "second for the target"
        )
    return bodies


def body_of_each(bodies: tuple[str, ...], roles: tuple[str, ...]) -> tuple[str, ...]:
    """The body of each individual: the last name is the target's, the first everybody else's."""
    return tuple(bodies[-1] if role == "target" else bodies[0] for role in roles)
