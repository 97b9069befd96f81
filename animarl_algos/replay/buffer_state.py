"""Saving and restoring the replay memory, so that an interrupted run goes on exactly."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from animarl_algos.replay.sequence_buffer import SequenceReplayBuffer
from animarl_envs.errors import InputError

_SETTINGS = (
    "buffer_size", "observation_dim", "num_individuals", "num_actions", "max_episode_steps",
    "stride", "burn_in", "state_size", "prioritized", "max_episodes",
)  # fmt: skip
"""What must be equal for a state to fit a buffer."""


def buffer_state(buffer: SequenceReplayBuffer) -> dict[str, Any]:
    """Arrays (copies) and plain numbers: the used part of the ring and the running episodes."""
    rows, slots = buffer.ring.used_rows, buffer.ring.used_slots
    state: dict[str, Any] = {name: getattr(buffer, name) for name in _SETTINGS}
    state["num_copies"] = buffer.num_copies
    state["cursor"] = buffer.ring.cursor.copy()
    state["streams"] = buffer.streams.copy()
    state["max_priority"] = buffer.ring.max_priority.copy()
    state["priorities"] = buffer.trees.priorities[:, slots if buffer.prioritized else slots[:0]]
    for name, array in buffer.ring.frames._asdict().items():
        state[f"ring_{name}"] = array[rows]
    for name, array in buffer.ring.sequences._asdict().items():
        state[f"sequence_{name}"] = array[slots]
    if buffer.num_copies:
        running = buffer.staging.used_rows
        state["step_count"] = buffer.staging.step_count.copy()
        state["staged_state"] = buffer.staging.state.copy()
        for name, array in buffer.staging.frames._asdict().items():
            state[f"staging_{name}"] = array[running]
    return state


def restore_buffer(buffer: SequenceReplayBuffer, state: Mapping[str, Any]) -> None:
    """Go on from the :func:`buffer_state` of a buffer with the same settings.

    Raises
    ------
    InputError
        If a setting differs or the state is damaged.
    """
    for name in _SETTINGS:
        if name not in state:
            raise InputError(f"the saved replay memory lacks {name!r}: start the run anew")
        if state[name] != getattr(buffer, name):
            raise InputError(
                f"the saved replay memory has {name} {state[name]}, this run has "
                f"{getattr(buffer, name)}: resume with the settings it was saved with"
            )
    try:
        buffer.ring.cursor[:] = state["cursor"]
        buffer.streams[:] = state["streams"]
        buffer.ring.max_priority[:] = state["max_priority"]
        rows, slots = buffer.ring.used_rows, buffer.ring.used_slots
        for name, array in buffer.ring.frames._asdict().items():
            array[rows] = state[f"ring_{name}"]
        for name, array in buffer.ring.sequences._asdict().items():
            array[slots] = state[f"sequence_{name}"]
        if buffer.prioritized:
            buffer.trees.restore(slots, state["priorities"])
        if copies := int(state["num_copies"]):
            buffer.allocate_staging(copies)
            buffer.staging.step_count[:] = state["step_count"]
            buffer.staging.state[:] = state["staged_state"]
            running = buffer.staging.used_rows
            for name, array in buffer.staging.frames._asdict().items():
                array[running] = state[f"staging_{name}"]
    except (KeyError, IndexError, TypeError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(
            f"the saved replay memory is damaged ({type(error).__name__}: {error}): "
            "start the run anew"
        ) from error
