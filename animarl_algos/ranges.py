"""What settings may be: numbers within a range, keywords that are known."""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, replace
from numbers import Real
from typing import Any

from animarl_envs.errors import InputError


@dataclass(frozen=True, kw_only=True)
class Range:
    """The finite numbers that a setting may be.

    Attributes
    ----------
    least, most
        Its ends, which belong to it.
    above
        An end at the bottom that does not belong to it, instead of ``least``.
    whole
        Whether only whole numbers do.
    optional
        Whether it may be None.
    """

    least: float = 0.0
    most: float = math.inf
    above: float | None = None
    whole: bool = False
    optional: bool = False

    def check(self, name: str, value: Any) -> Any:
        """The value, a whole one as an int; one outside is refused, by ``name``."""
        if value is None and self.optional:
            return None
        number = isinstance(value, Real) and not isinstance(value, bool) and math.isfinite(value)
        if not number or not self._holds(float(value)):
            raise InputError(f"{name} is {value!r}: give {self}")
        return int(value) if self.whole else value

    def _holds(self, number: float) -> bool:
        enough = number >= self.least if self.above is None else number > self.above
        return enough and number <= self.most and (not self.whole or number.is_integer())

    def __str__(self) -> str:
        kind = "a whole number" if self.whole else "a number"
        low = f"of at least {self.least:g}" if self.above is None else f"above {self.above:g}"
        high = "" if self.most == math.inf else f" and at most {self.most:.10g}"
        return f"{kind} {low}{high}" + (", or none" if self.optional else "")


WHOLE = Range(whole=True)
COUNT = Range(least=1, whole=True)
COUNT_OR_NONE = replace(COUNT, optional=True)
NOT_NEGATIVE = Range()
POSITIVE = Range(above=0.0)
PROBABILITY = Range(most=1.0)
POSITIVE_OR_NONE = replace(POSITIVE, optional=True)
SEED = Range(most=2**32 - 1, whole=True)
SHARE = Range(above=0.0, most=1.0)


def refuse_unknown(
    name: str, given: Mapping[str, Any], callee: Callable[..., Any], taken: Collection[str] = ()
) -> None:
    """Refuse keywords that ``callee`` does not know, or that are ``taken``: given by the caller.

    Raises
    ------
    InputError
        If there is one; the sentence starts with ``name``.
    """
    parameters = inspect.signature(callee).parameters
    if any(p.kind is inspect.Parameter.VAR_KEYWORD for p in parameters.values()):
        return
    known = [key for key in parameters if key not in taken]
    for key in given:
        if key not in known:
            raise InputError(f"{name}: {key!r} is unknown: choose among {', '.join(sorted(known))}")
