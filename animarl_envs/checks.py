"""Tests of numbers and names, and dataclass fields that are options of the command line."""

from collections.abc import Iterable
from dataclasses import field
from typing import Any

import numpy as np

from animarl_envs.errors import InputError, printable

__all__ = ["check_names", "is_number", "is_whole", "option", "option_metadata", "printable"]

LONGEST_NAME = 200  # characters
FORMULA = "=+-@"  # with which a spreadsheet begins to compute


def option(default: Any, name: str, prose: str) -> Any:
    """Return a field of a dataclass that a command offers as the option ``name``."""
    return field(default=default, metadata=option_metadata(name, prose))


def option_metadata(name: str, prose: str) -> dict[str, str]:
    """Return what :func:`option` notes: the option's name, ``on/off`` for two, and its help."""
    return {"option": name, "help": prose}


def is_number(value: object) -> bool:
    """Python's or NumPy's; truth values are none."""
    return isinstance(value, int | float | np.number) and not isinstance(value, bool)


def is_whole(value: object) -> bool:
    """A whole number, Python's or NumPy's; truth values are none."""
    return isinstance(value, int | np.integer) and not isinstance(value, bool)


def check_names(place: str, what: str, names: Iterable[object]) -> None:
    """Refuse what cannot be a name of an individual, a body part or a recording.

    A name is data from a file: it is shown, drawn, and written into tables and pages. It has 1 to
    200 characters that can be printed, does not begin as a formula does (a negative number is
    none), and no part of it between slashes is ``..``, or empty at its start.

    Raises
    ------
    InputError
        It shows the name with whatever cannot be printed written out.
    """
    for name in names:
        if not isinstance(name, str) or not name.strip():
            raise InputError(f"{place}: {what} has no name ({name!r:.80}): give it one")
        if len(name) > LONGEST_NAME:
            raise InputError(
                f"{place}: {what} has a name of {len(name):,} characters, {name[:20]!a}...: give "
                f"it at most {LONGEST_NAME}"
            )
        if not name.isprintable():
            raise InputError(
                f"{place}: {what} {name!a} has characters in its name that cannot be printed: "
                "rename it"
            )
        if name[0] in FORMULA and not _is_negative(name):
            raise InputError(
                f"{place}: {what} {name!r} begins as a formula of a spreadsheet: rename it"
            )
        parts = name.replace("\\", "/").split("/")
        if ".." in parts or not parts[0]:
            raise InputError(f"{place}: {what} {name!r} is a path to elsewhere: rename it")


def _is_negative(name: str) -> bool:
    return name[0] == "-" and name[1:].replace(".", "", 1).isdecimal()
