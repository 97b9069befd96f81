"""Settings are checked in one place: what passes, what is refused, and in which words."""

import math
import sys
from dataclasses import FrozenInstanceError, dataclass, field
from typing import Annotated, Any, Literal

import numpy as np
import pytest
from annotated_types import Ge, Lt
from pages import python
from refusals import refuses

from animarl_envs.settings import (
    Checked,
    Count,
    Positive,
    PositiveOrInfinite,
    Seed,
    check_value,
    describe_fields,
)


@dataclass(frozen=True, kw_only=True)
class Part(Checked):
    """A nested table."""

    size: Positive = 1.0


@dataclass(frozen=True, kw_only=True)
class Example(Checked):
    """One field of each kind."""

    steps: Count
    """How many."""
    rate: Positive = 1.0
    angle: Annotated[float, Ge(-1), Lt(1)] = 0.0
    limit: PositiveOrInfinite | None = None
    mode: Literal["fast", "slow"] = "fast"
    on: bool = False
    counts: dict[str, Count] = field(default_factory=dict)
    names: tuple[str, ...] = ()
    part: Part = field(default_factory=Part)
    anything: Any = None


def test_numbers_become_pythons_own() -> None:
    made = Example(steps=np.int64(3), rate=np.float32(0.5), angle=-1, limit=np.inf)
    assert made == Example(steps=3, rate=0.5, angle=-1.0, limit=math.inf)
    kinds = [type(one) for one in (made.steps, made.rate, made.angle, made.limit)]
    assert kinds == [int, float, float, float]
    assert Example.of({"steps": 2.0, "limit": "inf", "names": ["a"], "part": {"size": 2}}) == (
        Example(steps=2, limit=math.inf, names=("a",), part=Part(size=2.0))
    )
    assert made.changed(mode="slow").mode == "slow"
    with pytest.raises(FrozenInstanceError):
        made.steps = 4  # type: ignore[misc]


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({}, "f: steps is missing: give a whole number of at least 1"),
        ({"steps": 0}, "f: steps is 0: give a whole number of at least 1"),
        ({"steps": True}, "f: steps is True: give a whole number"),
        ({"steps": 1.5}, "f: steps is 1.5: give a whole number"),
        ({"steps": 1, "rate": math.inf}, "f: rate is inf: give a number above 0"),
        ({"steps": 1, "rate": "1"}, "f: rate is '1': give a number above 0"),
        ({"steps": 1, "angle": 1}, "f: angle is 1: give a number of at least -1 and below 1"),
        ({"steps": 1, "limit": math.nan}, "f: limit is nan: give a number above 0, or none"),
        ({"steps": 1, "mode": "fats"}, "f: mode is 'fats': choose fast or slow"),
        ({"steps": 1, "on": 1}, "f: on is 1: give true or false"),
        ({"steps": 1, "counts": {"a": 0}}, "f: counts of a is 0: give a whole number of"),
        ({"steps": 1, "names": [3]}, "f: one of names is 3: give a name"),
        ({"steps": 1, "part": {"size": 0}}, "f: part: size is 0: give a number above 0"),
        ({"steps": 1, "part": 3}, "f: part: it is 3: give names and values"),
        ({"step": 1, "rat": 1}, "f: 'step', 'rat' are unknown: choose among angle, "),
    ],
)
def test_refusals_name_the_place_the_value_and_what_may_be(
    given: dict[str, Any], words: str
) -> None:
    refuses(words, Example.of, given, "f: ")


def test_a_value_alone_and_the_prose_of_fields() -> None:
    assert check_value("seed", np.uint8(7), Seed) == 7
    refuses("seed is -1: give a whole number of at least 0 and at most 4294", check_value, "seed",
            -1, Seed)  # fmt: skip
    assert describe_fields(Example)["steps"] == "How many. (a whole number of at least 1)"
    assert describe_fields(Example, ranges=False)["steps"] == "How many."


def test_right_numbers_pass_without_pydantic() -> None:
    program = "import sys; from animarl_envs.arena import Arena; Arena(size=2, boundary=3.0)"
    said = python(f"{program}; print('pydantic' in sys.modules)").stdout
    assert said.split() == ["False"] and "pydantic" in sys.modules
