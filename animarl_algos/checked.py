"""Settings checked by pydantic, refused in one sentence: what is wrong, where, and what may be."""

from typing import Annotated, Any, Self

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError, model_validator
from pydantic_core import ErrorDetails

from animarl_envs.errors import InputError

PLAIN = ConfigDict(strict=True, allow_inf_nan=False)


class Checked(BaseModel):
    """Frozen settings; fields carry their default, range and, as a string below them, their prose.

    Whole numbers may be written as floats, and any as NumPy's. Raises InputError if one is unknown,
    missing or out of its range.
    """

    model_config = PLAIN | ConfigDict(
        frozen=True, extra="forbid", use_attribute_docstrings=True, arbitrary_types_allowed=True
    )

    def __init__(self, /, **given: Any) -> None:
        try:
            super().__init__(**given)
        except ValidationError as error:
            raise InputError(sentence(type(self), *error.errors())) from None

    @model_validator(mode="before")
    @classmethod
    def _as_plain_numbers(cls, given: dict[str, Any]) -> dict[str, Any]:
        fields = cls.model_fields
        return {
            name: plain(value, name in fields and "int" in str(fields[name].annotation))
            for name, value in given.items()
        }

    @classmethod
    def of(cls, given: dict[str, Any], place: str) -> Self:
        """Return ``given`` as settings; the sentence of an InputError starts with ``place``."""
        try:
            return cls(**given)
        except InputError as error:
            raise InputError(f"{place}{error}") from None

    @classmethod
    def read(cls, given: dict[str, Any], place: str) -> dict[str, Any]:
        """Return ``given`` with every value checked, as :meth:`of` does."""
        whole = cls.of(given, place)
        return {name: getattr(whole, name) for name in given}

    def changed(self, **values: Any) -> Self:
        """Return a copy with other values, checked."""
        return type(self)(**dict(self) | values)


class Range:
    """The finite numbers that an argument may be: a kind, and pydantic's ``ge``, ``gt``, ``le``."""

    def __init__(self, kind: Any = float, **bounds: float) -> None:
        self.whole = "int" in str(kind)
        self._adapter = TypeAdapter(Annotated[kind, Field(**bounds)], config=PLAIN)

    def check(self, name: str, value: Any) -> Any:
        """Return the value, a whole one as an int; one outside is refused, by ``name``."""
        number = plain(value, self.whole)
        try:
            self._adapter.validate_python(number)
        except ValidationError:
            may_be = described(self._adapter.json_schema())
            raise InputError(f"{name} is {value!r}: {may_be}") from None
        return number if self.whole else value


COUNT = Range(int, ge=1)
COUNT_OR_NONE = Range(Annotated[int, Field(ge=1)] | None)
NOT_NEGATIVE = Range(ge=0)
POSITIVE = Range(gt=0)
PROBABILITY = Range(ge=0, le=1)
SEED = Range(int, ge=0, le=2**32 - 1)


def plain(value: Any, counts: bool) -> Any:
    """Return a number as Python's own, a whole one as an int if it ``counts``."""
    value = value.item() if isinstance(value, np.generic) else value
    return int(value) if counts and isinstance(value, float) and value.is_integer() else value


def sentence(model: type[BaseModel], error: ErrorDetails, *more: ErrorDetails) -> str:
    """Say what is wrong with a field of a model; all unknown names at once."""
    name = str(error["loc"][0]) if error["loc"] else ""
    if error["type"] == "value_error":
        said = str(error["ctx"]["error"])
        return f"{name} is {error['input']!r}: {said}" if name else said
    if error["type"] == "extra_forbidden":
        unknown = [repr(one["loc"][0]) for one in (error, *more) if one["type"] == error["type"]]
        verb = "is" if len(unknown) == 1 else "are"
        known = ", ".join(sorted(model.model_fields))
        return f"{', '.join(unknown)} {verb} unknown: choose among {known}"
    shown = model.model_json_schema()["properties"][name]
    inside = shown.get("additionalProperties"), shown.get("items")
    if len(error["loc"]) > 1 and any(isinstance(one, dict) for one in inside):
        name = f"{name} of {error['loc'][1]}" if inside[0] else f"one of {name}"
        shown = inside[0] or inside[1]
    given = "missing" if error["type"] == "missing" else repr(error["input"])
    return f"{name} is {given}: {described(shown)}"


def prose(shown: dict[str, Any]) -> str:
    """Say what a part of a JSON schema means, and in brackets what it may be."""
    may_be = described(shown).removeprefix("give ").removeprefix("choose ")
    return f"{' '.join(shown['description'].split())} ({may_be})"


NAMES = {
    "integer": "a whole number",
    "number": "a number",
    "boolean": "true or false",
    "string": "a name",
    "object": "a table",
    "array": "a list",
}


def described(shown: dict[str, Any]) -> str:
    """Say what a part of a JSON schema allows."""
    options = shown.get("anyOf", [shown])
    optional = ", or none" if any(one.get("type") == "null" for one in options) else ""
    kinds = [one for one in options if one.get("type") != "null"]
    if "enum" in kinds[0]:
        *others, last = map(str, kinds[0]["enum"])
        return f"choose {', '.join(others)} or {last}{optional}"
    return f"give {' or '.join(_range(one) for one in kinds)}{optional}"


def _range(one: dict[str, Any]) -> str:
    said = NAMES.get(one.get("type", ""), "another value")
    if "minimum" in one:
        said += f" of at least {one['minimum']:g}"
    if "exclusiveMinimum" in one:
        said += f" above {one['exclusiveMinimum']:g}"
    if "maximum" in one:
        said += f" and at most {one['maximum']:.10g}"
    return said
