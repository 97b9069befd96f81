"""What the recurrent state of a replayed piece starts from."""

from __future__ import annotations

import enum

from animarl_envs.errors import InputError


class StateMode(enum.StrEnum):
    """The choices; see Kapturowski et al. 2019, section 3."""

    RECOMPUTE = "recompute"  # zeros before the burn-in prefix, which then rebuilds it
    STORED = "stored"  # the acting network's state before the prefix
    ZERO = "zero"  # zeros at the first trained step; no prefix


def check_state_mode(
    mode: StateMode | str, sequence_length: int | None, burn_in: int, state_size: int
) -> StateMode:
    """The mode, if it fits the other settings of a piece."""
    try:
        mode = StateMode(mode)
    except ValueError:
        raise InputError(
            f"state_mode {mode!r} is unknown: choose one of {', '.join(StateMode)}"
        ) from None
    if sequence_length is None:
        if burn_in or mode is not StateMode.RECOMPUTE:
            raise InputError(
                f"burn_in {burn_in} and state_mode {mode.value!r} are for pieces: "
                "set sequence_length, or leave them out for whole episodes"
            )
    elif not 0 <= burn_in < sequence_length:
        raise InputError(
            f"burn_in {burn_in} does not fit sequence_length {sequence_length}: "
            "it must be at least 0 and smaller"
        )
    if mode is StateMode.ZERO and burn_in:
        raise InputError(
            f"state_mode 'zero' starts without a prefix but burn_in is {burn_in}: set it to 0"
        )
    if mode is StateMode.STORED and state_size < 1:
        raise InputError("state_mode 'stored' needs state_size, the size of the recurrent state")
    return mode
