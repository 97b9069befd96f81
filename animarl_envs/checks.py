"""Tests of numbers and names, and dataclass fields that are options of the command line."""

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import field, fields, is_dataclass
from functools import cache
from typing import Annotated, Any, Literal, get_args, get_origin, get_type_hints

import numpy as np

from animarl_envs.errors import InputError, require

LONGEST_NAME = 200  # characters
FORMULA = "=+-@"  # with which a spreadsheet begins to compute


def is_number(value: object) -> bool:
    """Python's or NumPy's; truth values are none."""
    return isinstance(value, int | float | np.number) and not isinstance(value, bool)


def is_whole(value: object) -> bool:
    """A whole number, Python's or NumPy's; truth values are none."""
    return isinstance(value, int | np.integer) and not isinstance(value, bool)


ALLOWED: dict[str, Callable[[float], bool]] = {
    "a number": lambda value: -math.inf < value < math.inf,
    "a positive number": lambda value: 0 < value < math.inf,
    "positive": lambda value: value > 0,  # infinity is
    "zero or positive": lambda value: 0 <= value < math.inf,
    "from 0 to 1": lambda value: 0 <= value <= 1,
    "from 0 to below 1": lambda value: 0 <= value < 1,
    "above 0, at most 1": lambda value: 0 < value <= 1,
    "from 0 to 90 degrees": lambda value: 0 <= value <= 90,
    "above 0 and below pi": lambda value: 0 < value < math.pi,
    "from -pi to below pi": lambda value: -math.pi <= value < math.pi,
    "a whole number": is_whole,
    "a whole number, 0 or more": lambda value: is_whole(value) and value >= 0,
    "a whole number, 1 or more": lambda value: is_whole(value) and value >= 1,
}
USUAL = {float: "a positive number", int: "a whole number"}
"""What a number must be whose field does not say it."""
AnyNumber = Annotated[float, "a number"]
ZeroOrPositive = Annotated[float, "zero or positive"]
CountingNumber = Annotated[int, "a whole number, 1 or more"]
ZeroOrMore = Annotated[int, "a whole number, 0 or more"]
"""Types of fields that :func:`check_options` looks at; the texts are of :data:`ALLOWED`."""


def option(default: Any, name: str, prose: str, allowed: str = "", unit: str = "") -> Any:
    """Return a field of a dataclass that a command offers as the option ``name``.

    ``name`` is ``on/off`` for two, empty for none. ``allowed`` is one of :data:`ALLOWED`, for
    :func:`check_options`. A callable ``default`` makes it.
    """
    notes = {"option": name, "help": prose, "allowed": allowed, "unit": unit and f" {unit}"}
    if callable(default):
        return field(default_factory=default, metadata=notes)
    return field(default=default, metadata=notes)


def check_options(settings: Any, whose: str = "") -> None:
    """Refuse values of a dataclass that are not allowed, or none of the choices.

    Fields with a choice, truth values and numbers are looked at; ``float`` alone is a positive one,
    ``Annotated[float, text]`` what the text says. NumPy's numbers become Python's own, of which
    kernels have compiled forms. ``whose`` is put before names in messages.
    """
    kind: Any = type(settings)
    hints = _hints(kind)
    for one in fields(settings):
        name, value, hint = whose + one.name, getattr(settings, one.name), hints[one.name]
        hint, usual = get_args(hint) if get_origin(hint) is Annotated else (hint, USUAL.get(hint))
        allowed = one.metadata.get("allowed") or usual
        if get_origin(hint) is Literal:
            known = ", ".join(map(str, get_args(hint)))
            require(value in get_args(hint), f"{name} {value!r} is unknown: choose one of {known}")
        elif hint is bool:
            require(isinstance(value, bool), f"{name} is {value!r}: choose True or False")
        elif allowed and (value is not None or hint in USUAL):
            said = f"{name} is {value!r}{one.metadata.get('unit', '')}: it must be {allowed}"
            require(is_number(value) and ALLOWED[allowed](value), said)
            if hint in USUAL:
                object.__setattr__(settings, one.name, hint(value))


@cache
def _hints(kind: Any) -> dict[str, Any]:
    return get_type_hints(kind, include_extras=True)


def plain(value: Any) -> Any:
    """Convert to numbers, texts, lists and dictionaries; an array of frames becomes its shape."""
    if isinstance(value, np.ndarray):
        return plain(value.tolist()) if value.ndim <= 2 else f"array of shape {value.shape}"
    if is_dataclass(value) and not isinstance(value, type):
        return {field.name: plain(getattr(value, field.name)) for field in fields(value)}
    if isinstance(value, Mapping):
        return {str(key): plain(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [plain(entry) for entry in value]
    if isinstance(value, np.generic):
        return plain(value.item())
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    return value if isinstance(value, str | int | float | None) else str(value)


def check_names(place: str, what: str, names: Iterable[object]) -> None:
    """Refuse what cannot be a name of an individual, a body part or a recording.

    A name is data from a file: it is shown, drawn, and written into tables and pages. It has 1 to
    200 characters that can be printed, does not begin as a formula does (a negative number is
    none), and no part of it between slashes is ``..``, or empty at its start. Raises InputError: it
    shows the name with whatever cannot be printed written out.
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
