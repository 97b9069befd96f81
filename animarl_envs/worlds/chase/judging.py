"""How a step of a chase ends and what it pays, as loops over copies.

Arrays as in :mod:`animarl_envs.worlds.chase.kernels`.
"""

from __future__ import annotations

from animarl_envs.arena import SHAPE_CODES
from animarl_envs.compiling import part
from animarl_envs.demos.episode import PURSUER_OUT, TARGET_OUT, TIME_OUT

SQUARE, DISC = SHAPE_CODES["square"], SHAPE_CODES["disc"]
TOUCH, ELAPSED, BOUNDARY = 0, 1, 2


@part
def judge(  # type: ignore[no-untyped-def]
    position, sharing, field, walled, lone, contact_radius, dt, penalty, nearest, code, components,
    reward,
):  # fmt: skip
    """Contact, then boundary (where there are no walls), then rewards.

    ``code`` ``(B,)`` int64 becomes the outcome; ``nearest`` is scratch, ``(B,)``. ``lone``: the
    last individual is no target but the pursuer of all others.
    """
    K, _, B = position.shape
    last = K - 1
    touching = contact_radius * contact_radius
    for b in range(B):
        nearest[b] = touching
        code[b] = TIME_OUT
    for i in range(last):  # the nearest of those in contact is the outcome (ties: lower index)
        for b in range(B):
            dx = position[last, 0, b] - position[i, 0, b]
            dy = position[last, 1, b] - position[i, 1, b]
            squared = dx * dx + dy * dy
            components[i, TOUCH, b] = 1.0 if squared < touching else 0.0
            code[b] = i + 1 if squared < nearest[b] else code[b]
            nearest[b] = min(nearest[b], squared)
    for i in range(last):
        for b in range(B):  # shared reward: a capture is everybody's
            shared = sharing[b] == 1 and code[b] > 0
            components[i, TOUCH, b] = 1.0 if shared else components[i, TOUCH, b]
    if not walled:
        for j in range(K):  # targets first: their leaving is named before a pursuer's
            i = j if lone else last - j
            _leave(i, position, field, penalty, components)
            left = TARGET_OUT if (i == last) != lone else PURSUER_OUT
            for b in range(B):
                out = components[i, BOUNDARY, b] != 0.0
                code[b] = left if out and code[b] == TIME_OUT else code[b]
    if lone:
        _pay_many(code, dt, components)
    else:
        for b in range(B):  # the target is paid for every step that it lasts
            lost = code[b] > 0 or code[b] == TARGET_OUT
            components[last, ELAPSED, b] = 0.0 if lost else dt
    for i in range(K):
        for b in range(B):
            reward[i, b] = (
                components[i, TOUCH, b] + components[i, ELAPSED, b] + components[i, BOUNDARY, b]
            )


@part
def _pay_many(code, dt, components):  # type: ignore[no-untyped-def]
    """A touch is the lone pursuer's; each target is paid for every step that it lasts."""
    K, _, B = components.shape
    last = K - 1
    for b in range(B):
        components[last, TOUCH, b] = 1.0 if code[b] > 0 else 0.0
    for i in range(last):
        for b in range(B):
            lost = components[i, TOUCH, b] != 0.0 or components[i, BOUNDARY, b] != 0.0
            components[i, ELAPSED, b] = 0.0 if lost else dt
            components[i, TOUCH, b] = 0.0


@part
def _leave(i, position, field, penalty, components):  # type: ignore[no-untyped-def]
    """The penalty for being out of bounds."""
    shape, _, boundary = field
    B = position.shape[2]
    if shape == SQUARE:
        for b in range(B):
            farthest = max(abs(position[i, 0, b]), abs(position[i, 1, b]))
            components[i, BOUNDARY, b] = penalty if farthest > boundary else 0.0
    elif shape == DISC:
        for b in range(B):
            x = position[i, 0, b]
            y = position[i, 1, b]
            components[i, BOUNDARY, b] = penalty if x * x + y * y > boundary * boundary else 0.0
