"""Cases of a test that only ``make slow`` runs."""

from typing import Any

import pytest


def slowly(*cases: Any) -> list[Any]:
    """Return the cases, marked; a tuple is the values of several arguments."""
    several = (case if isinstance(case, tuple) else (case,) for case in cases)
    return [pytest.param(*case, marks=pytest.mark.slow) for case in several]
