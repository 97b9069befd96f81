"""Regular expressions of recipes, tried on names within a limit of time."""

from __future__ import annotations

import re
from collections.abc import Sequence

from animarl_envs import wall
from animarl_envs.errors import InputError

SECONDS = 2  # of processor time; some expressions take longer than the universe
Groups = dict[str, str | None]  # by name and by number as text


def search_names(pattern: str, names: Sequence[str], place: str) -> list[Groups | None]:
    """Return the groups that ``pattern`` finds in each name, ``None`` where it does not fit.

    Raises
    ------
    InputError
        If it is no regular expression, or takes too long.
    """
    try:
        re.compile(pattern)
    except (re.error, OverflowError, RecursionError) as error:
        raise InputError(f"{place}: it is no regular expression ({error}): correct it") from None
    return list(
        wall.call(_search, pattern, list(names), what=place, seconds=SECONDS, remedy="simplify it")
    )


def _search(pattern: str, names: list[str]) -> list[Groups | None]:
    expression = re.compile(pattern)
    matches = (expression.search(name) for name in names)
    return [
        match
        and {str(i): text for i, text in enumerate(match.groups(), start=1)} | match.groupdict()
        for match in matches
    ]
