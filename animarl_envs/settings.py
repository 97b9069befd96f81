"""Settings: frozen dataclasses whose values are checked, and refused in one sentence.

A field's type holds its range (:data:`Positive`), and the string below it says what it means.
Values are checked by pydantic. Python's own numbers and texts, if they are within their range, pass
without it: it takes 0.15 s to import, and an environment of the package needs none of that.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import MISSING, Field, dataclass, field, fields, is_dataclass, replace
from functools import cache
from types import NoneType
from typing import Annotated, Any, ClassVar, Literal, Self, get_args, get_origin, get_type_hints

import numpy as np
from annotated_types import Ge, Gt, Le, Lt

from animarl_envs.errors import InputError

LONGEST_NAME = 200  # characters
FORMULA = "=+-@"  # with which a spreadsheet begins to compute
INFINITE = "may be infinite"

Positive = Annotated[float, Gt(0)]
PositiveOrInfinite = Annotated[float, Gt(0), INFINITE]
NotNegative = Annotated[float, Ge(0)]
Probability = Annotated[float, Ge(0), Le(1)]
Count = Annotated[int, Ge(1)]
CountOrZero = Annotated[int, Ge(0)]
Seed = Annotated[int, Ge(0), Le(2**32 - 1)]
"""Types of fields; all but :data:`PositiveOrInfinite` are finite."""


def is_number(value: object) -> bool:
    """Return True for Python's and NumPy's numbers, False for truth values."""
    return isinstance(value, int | float | np.number) and not isinstance(value, bool)


def is_whole(value: object) -> bool:
    """Return True for Python's and NumPy's integers, False for truth values."""
    return isinstance(value, int | np.integer) and not isinstance(value, bool)


# -- models ---------------------------------------------------------------------------------------


def option(default: Any, name: str, prose: str) -> Any:
    """Return a field of a dataclass that a command offers as the option ``name``.

    ``name`` is ``on/off`` for two flags, empty for none. A callable ``default`` makes the default.
    """
    notes = {"option": name, "help": prose}
    if callable(default):
        return field(default_factory=default, metadata=notes)
    return field(default=default, metadata=notes)


@dataclass(frozen=True)
class Checked:
    """Base of frozen settings; whole numbers may be written as floats, and any as NumPy's.

    Raises InputError if a value is out of its range.
    """

    __pydantic_config__: ClassVar[Any] = {"use_attribute_docstrings": True}

    def __post_init__(self) -> None:
        check_fields(self)
        for name, hint in field_types(type(self)).items():
            if get_origin(hint) is tuple and get_args(hint)[1:] == (...,):
                object.__setattr__(self, name, check_value(name, getattr(self, name), hint))

    @classmethod
    def check(cls, given: Mapping[str, Any], place: str = "") -> dict[str, Any]:
        """Return ``given`` with every value checked; a refusal begins with ``place``.

        Raises InputError if a name is unknown or a value out of its range.
        """
        if not isinstance(given, Mapping):
            raise InputError(f"{place}it is {given!r:.80}: give names and values")
        known = {one.name for one in fields(cls)}
        if unknown := [repr(name) for name in given if name not in known]:
            verb = "is" if len(unknown) == 1 else "are"
            raise InputError(
                f"{place}{', '.join(unknown)} {verb} unknown: choose among "
                f"{', '.join(sorted(known))}"
            )
        hints = field_types(cls)
        with refused_at(place):
            return {key: check_value(key, value, hints[key]) for key, value in given.items()}

    @classmethod
    def of(cls, given: Mapping[str, Any], place: str = "") -> Self:
        """Return ``given`` as settings; a refusal begins with ``place``."""
        checked = cls.check(given, place)
        needed = (one for one in fields(cls) if _is_required(one))
        if missing := next((one.name for one in needed if one.name not in checked), None):
            raise InputError(f"{place}{missing} is missing: {describe(field_types(cls)[missing])}")
        with refused_at(place):
            return cls(**checked)

    def changed(self, **values: Any) -> Self:
        """Return a copy with other values, checked."""
        return replace(self, **values)


@contextmanager
def refused_at(place: str) -> Iterator[None]:
    """Let the sentence of an InputError begin with ``place``."""
    try:
        yield
    except InputError as error:
        raise InputError(f"{place}{error}") from None


def _is_required(one: Field[Any]) -> bool:
    return one.init and one.default is MISSING and one.default_factory is MISSING


def field_types(kind: Any) -> dict[str, Any]:
    """Return the types of a dataclass's fields with their ranges, by name."""
    return _field_types(kind)


@cache
def _field_types(kind: Any) -> dict[str, Any]:
    hints = get_type_hints(kind, include_extras=True)
    return {one.name: hints[one.name] for one in fields(kind)}


# -- values ---------------------------------------------------------------------------------------

KINDS = (int, float, bool, str, NoneType, Any, dict, list)
"""What a field is made of that :func:`check_fields` looks at."""


def check_fields(settings: Any, place: str = "") -> None:
    """Check the fields of a dataclass that are numbers, texts, choices, or lists or tables of them.

    They are set to Python's own numbers, of which kernels have compiled forms. A refusal begins
    with ``place`` and the name of the field.
    """
    for name, hint in field_types(type(settings)).items():
        if hint is not Any and _is_simple(hint):
            value = check_value(place + name, getattr(settings, name), hint)
            object.__setattr__(settings, name, value)


def check_value(name: str, value: Any, hint: Any) -> Any:
    """Return a value as its type wants it, or refuse it by ``name``.

    Raises InputError.
    """
    if isinstance(hint, type) and issubclass(hint, Checked):
        return value if isinstance(value, hint) else hint.of(value, f"{name}: ")
    kind, limits = _kind_and_limits(hint)
    number = _as_python(value, kind)
    if _is_within(number, kind, limits) or (number is None and NoneType in get_args(hint)):
        return number
    from pydantic import ValidationError

    try:
        return _adapter(hint).validate_python(number)
    except ValidationError as error:
        raise InputError(_sentence(name, value, hint, error)) from None


@cache
def _is_simple(hint: Any) -> bool:
    if get_origin(hint) is Annotated:
        return _is_simple(get_args(hint)[0])
    parts = [part for part in get_args(hint) if part is not ...]
    if get_origin(hint) is tuple or hint is tuple:
        return False
    return get_origin(hint) is Literal or (all(map(_is_simple, parts)) if parts else hint in KINDS)


@cache
def _kind_and_limits(hint: Any) -> tuple[Any, tuple[Any, ...]]:
    """Return the type that is annotated or optional, and its limits."""
    kinds = [part for part in get_args(hint) if part is not NoneType]
    if NoneType in get_args(hint) and len(kinds) == 1:
        return _kind_and_limits(kinds[0])
    return (hint.__origin__, hint.__metadata__) if get_origin(hint) is Annotated else (hint, ())


def _as_python(value: Any, kind: Any) -> Any:
    """Return a number as Python's own, of the kind wanted where it is as large."""
    value = value.item() if isinstance(value, np.generic) else value
    if kind is float and (type(value) is int or value in ("inf", "-inf")):
        return float(value)
    if kind is int and isinstance(value, float) and value.is_integer():
        return int(value)
    if get_origin(kind) is tuple and isinstance(value, list):
        return tuple(value)
    return value


def _is_within(value: Any, kind: Any, limits: Iterable[Any]) -> bool:
    """Return whether a value is plainly right; False may mean that pydantic has to look."""
    if get_origin(kind) is Literal:
        return type(value) in (int, str) and value in get_args(kind)
    if type(value) is not kind or kind not in (int, float, bool, str):
        return False
    if kind is float and not math.isfinite(value) and INFINITE not in limits:
        return False
    return all(_admits(limit, value) for limit in limits if limit != INFINITE)


def _admits(limit: Any, value: Any) -> bool:
    match limit:
        case Gt():
            return bool(value > limit.gt)
        case Ge():
            return bool(value >= limit.ge)
        case Lt():
            return bool(value < limit.lt)
        case Le():
            return bool(value <= limit.le)
    return False


@cache
def _adapter(hint: Any) -> Any:
    from pydantic import ConfigDict, TypeAdapter

    infinite = INFINITE in _kind_and_limits(hint)[1]
    config = ConfigDict(strict=True, allow_inf_nan=infinite, arbitrary_types_allowed=True)
    return TypeAdapter(hint, config=config)


# -- sentences ------------------------------------------------------------------------------------


def _sentence(name: str, value: Any, hint: Any, error: Any) -> str:
    """Return what is wrong with a value, in one sentence."""
    first = error.errors()[0]
    if first["type"] == "value_error":
        return f"{name} is {value!r}: {first['ctx']['error']}"
    schema = _adapter(hint).json_schema()
    inside = schema.get("additionalProperties"), schema.get("items")
    if first["loc"] and any(isinstance(one, dict) for one in inside):
        name = f"{name} of {first['loc'][0]}" if inside[0] else f"one of {name}"
        return f"{name} is {first['input']!r}: {_describe_schema(inside[0] or inside[1])}"
    return f"{name} is {value!r:.80}: {_describe_schema(schema)}"


def describe(hint: Any) -> str:
    """Return what a type allows: ``"give a number above 0"``."""
    return _describe_schema(_adapter(hint).json_schema())


@cache
def describe_fields(kind: type[Checked], ranges: bool = True) -> dict[str, str]:
    """Return what each field of a model means, with ``ranges`` also in brackets what it may be."""
    from pydantic import TypeAdapter

    described = {}
    for name, schema in TypeAdapter(kind).json_schema()["properties"].items():
        may_be = _describe_schema(schema).removeprefix("give ").removeprefix("choose ")
        meaning = " ".join(schema.get("description", "").split())
        described[name] = f"{meaning} ({may_be})" if ranges else meaning
    return described


NAMES = {
    "integer": "a whole number",
    "number": "a number",
    "boolean": "true or false",
    "string": "a name",
    "object": "a table",
    "array": "a list",
}
BOUNDS = {
    "minimum": " of at least {:g}",
    "exclusiveMinimum": " above {:g}",
    "exclusiveMaximum": " and below {:.10g}",
    "maximum": " and at most {:.10g}",
}


def _describe_schema(schema: dict[str, Any]) -> str:
    choices = schema.get("anyOf", [schema])
    optional = ", or none" if any(one.get("type") == "null" for one in choices) else ""
    kinds = [one for one in choices if one.get("type") != "null"]
    if "enum" in kinds[0]:
        *others, last = map(str, kinds[0]["enum"])
        return f"choose {', '.join(others)} or {last}{optional}"
    return f"give {' or '.join(map(_range, kinds))}{optional}"


def _range(schema: dict[str, Any]) -> str:
    limits = (text.format(schema[key]) for key, text in BOUNDS.items() if key in schema)
    return NAMES.get(schema.get("type", ""), "another value") + "".join(limits)


# -- data -----------------------------------------------------------------------------------------


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
