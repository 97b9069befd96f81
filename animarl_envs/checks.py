"""What counts as a number where options are checked."""

import numpy as np


def is_number(value: object) -> bool:
    """Python's or NumPy's; truth values are none."""
    return isinstance(value, int | float | np.number) and not isinstance(value, bool)


def is_whole(value: object) -> bool:
    """A whole number, Python's or NumPy's; truth values are none."""
    return isinstance(value, int | np.integer) and not isinstance(value, bool)
