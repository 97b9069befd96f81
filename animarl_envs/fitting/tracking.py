"""Closed-loop tracking: how near the actions of a locomotion model can stay to recorded tracks.

From the *simulated* state each individual takes, step by step, the action whose next state is
nearest to the recorded one. The result estimates what a learner of those actions can do at best:
a floor for comparisons of a simulation with its recordings, and labels that suit the states which a
simulation visits.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from animarl_envs.arena import Arena
from animarl_envs.array_types import Floats, Ints
from animarl_envs.cells import COURSE_TIME, CellLocomotion
from animarl_envs.compiling import jit
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.errors import InputError
from animarl_envs.fitting.transitions import action_frames, step_frames
from animarl_envs.focus import averaged, focus_direction, focus_table, share_of
from animarl_envs.kinematics import next_velocity, rebound
from animarl_envs.locomotion import Locomotion, apply_actions, infer_actions

CELL_HORIZON = 10.0  # steps within which a miss is corrected by cells: faster would be jitter


@dataclass(frozen=True, eq=False)
class Tracking:
    """Recorded episodes as the locomotion model can follow them.

    ``positions`` and ``velocities`` are ``(frames, K, 2)`` in the arena frame [arena unit; arena
    unit / s], ``actions`` ``(frames, K)`` int64: the action taken at each frame, -1 at last frames.
    """

    positions: Floats
    velocities: Floats
    actions: Ints


def track(
    demos: Demonstrations,
    locomotion: Sequence[Locomotion],
    arena: Arena | None = None,
    *,
    horizon: float = 1.0,
) -> Tracking:
    """Follow every recorded episode from its first state, all K individuals together.

    Each step takes the action that minimises ``|p' - p_rec'|^2 / (h dt)^2 + |v' - v_rec'|^2``
    (ties: the lower number); focus directions are those of the simulated positions. Walls of the
    ``arena`` hold, by default those of ``demos``, if it has ``rebound``. ``horizon`` is h, the
    number of steps within which a miss of the position is corrected. 1 stays nearest; but each
    correction is a push and then one back, so a larger h keeps pushes smooth. Of cells it is
    ``CELL_HORIZON`` steps at least: each takes the cell of the velocity that minimises the same
    sum, and draws a recorded velocity of it.

    Raises InputError if there are not K sets of parameters with equally many thrust magnitudes, or
    the horizon is below a step.
    """
    _check(demos, locomotion)
    if not horizon >= 1.0:
        raise InputError(f"horizon is {horizon}: give 1 step or more")
    arena = demos.arena if arena is None else arena
    if isinstance(locomotion[0], CellLocomotion):
        return _track_by_cells(demos, locomotion, arena, horizon)
    recorded, velocity = np.ascontiguousarray(demos.positions), demos.velocities()
    starts = demos.offsets.astype(np.int64)
    position_now, velocity_now = (
        np.ascontiguousarray(a[starts[:-1]].transpose(1, 2, 0)) for a in (recorded, velocity)
    )
    paths, speeds = np.empty_like(recorded), np.empty_like(velocity)
    actions = np.full(recorded.shape[:2], -1, dtype=np.int64)
    course, table = velocity_now.copy(), focus_table(demos.roles, demos.dt)
    damping = np.array([own.damping for own in locomotion])
    thrust = np.array([own.thrust for own in locomotion])
    pushes = np.stack([own.action_vectors for own in locomotion])
    for t in range(int(demos.lengths.max())):
        _follow(
            t,
            starts,
            recorded,
            velocity,
            table,
            damping,
            thrust,
            pushes,
            demos.dt,
            float(horizon),
            position_now,
            velocity_now,
            paths,
            speeds,
            actions,
            course,
        )
        if arena.walled:
            rebound(arena.field, position_now, velocity_now)
    return Tracking(paths, speeds, actions)


def _track_by_cells(
    demos: Demonstrations, locomotion: Sequence[Locomotion], arena: Arena, horizon: float
) -> Tracking:
    """Return :func:`track` of individuals whose actions are cells; draws are seeded with 0."""
    rng, dt = np.random.default_rng(0), demos.dt
    recorded, recorded_velocity = demos.positions, demos.velocities()
    paths, speeds = recorded.copy(), recorded_velocity.copy()
    actions = np.full(recorded.shape[:2], -1, dtype=np.int64)
    share, weight = share_of(COURSE_TIME, dt), 1.0 / max(horizon, CELL_HORIZON) ** 2
    course = speeds[demos.offsets[:-1]]
    for t in range(int(demos.lengths.max()) - 1):
        going = np.flatnonzero(demos.lengths > t + 1)
        now = demos.offsets[going] + t
        wanted = recorded_velocity[now + 1]
        wanted = wanted * (1.0 - weight / (1.0 + weight))
        wanted += weight / (1.0 + weight) * (recorded[now + 1] - paths[now]) / dt
        position, velocity = np.empty_like(wanted), np.empty_like(wanted)
        for i, own in enumerate(locomotion):
            assert isinstance(own, CellLocomotion)
            length = np.linalg.norm(course[going, i], axis=1, keepdims=True)
            ahead = np.where(
                length > 0.0, course[going, i] / np.maximum(length, 1e-300), [1.0, 0.0]
            )
            cell = infer_actions(speeds[now, i], wanted[:, i], ahead, own, dt)
            drawn = own.drawn_steps[cell, rng.integers(own.drawn_steps.shape[1], size=len(cell))]
            x, y = ahead[:, 0], ahead[:, 1]
            velocity[:, i, 0] = own.thrust * (drawn[:, 0] * x - drawn[:, 1] * y)
            velocity[:, i, 1] = own.thrust * (drawn[:, 0] * y + drawn[:, 1] * x)
            actions[now, i] = cell
        position = paths[now] + velocity * dt
        if arena.walled:
            held = [np.ascontiguousarray(each.transpose(1, 2, 0)) for each in (position, velocity)]
            rebound(arena.field, *held)
            position, velocity = (each.transpose(2, 0, 1) for each in held)
        paths[now + 1], speeds[now + 1] = position, velocity
        course[going] += max(share, 1.0 / (2.0 + t)) * (velocity - course[going])
    return Tracking(paths, speeds, actions)


def one_step_misses(
    demos: Demonstrations, locomotion: Sequence[Locomotion], tracking: Tracking | None = None
) -> Floats:
    """Return how far each action leads from the next recorded state, ``(frames, K, 12 M + 1)``.

    The smallest miss is that of the action which inverse dynamics infers, for both compare the same
    vectors. The states are those of ``tracking``, by default the recorded ones. A miss is
    ``dt sqrt((|p' - p_rec'|^2 / dt^2 + |v' - v_rec'|^2) / 2)`` [arena unit]: from a recorded state,
    where both terms are equal, the distance from the next recorded position. Zero at last frames.
    """
    _check(demos, locomotion)
    steps, dt = step_frames(demos), demos.dt
    recorded, recorded_velocity = demos.positions, demos.velocities()
    positions = recorded if tracking is None else tracking.positions
    velocities = recorded_velocity if tracking is None else tracking.velocities
    focus = action_frames(demos, locomotion[0].course_time, positions, velocities)
    misses = np.zeros((*positions.shape[:2], locomotion[0].num_actions))
    for i, own in enumerate(locomotion):
        for action in range(own.num_actions):
            taken = np.full(len(steps), action)
            reached = apply_actions(velocities[steps, i], taken, focus[steps, i], own, dt)
            ahead = positions[steps, i] + reached * dt - recorded[steps + 1, i]
            faster = reached - recorded_velocity[steps + 1, i]
            squares = np.sum(ahead**2, axis=1) + dt**2 * np.sum(faster**2, axis=1)
            misses[steps, i, action] = np.sqrt(squares / 2)
    return misses


def tracking_errors(demos: Demonstrations, tracking: Tracking) -> Floats:
    """Return the median distance from the recorded position, ``(K,)`` [arena unit]."""
    reached = step_frames(demos) + 1
    apart = tracking.positions[reached] - demos.positions[reached]
    return np.asarray(np.median(np.hypot(apart[..., 0], apart[..., 1]), axis=0))


def speed_distances(demos: Demonstrations, tracking: Tracking) -> Floats:
    """Return the distance of tracked from recorded speeds in mean recorded speeds, ``(K,)``.

    It is the Wasserstein distance, zero for an individual that moves neither in the recording nor
    in the tracking.
    """
    reached = step_frames(demos) + 1
    speeds = [
        np.sort(np.hypot(v[reached, :, 0], v[reached, :, 1]), axis=0)
        for v in (tracking.velocities, demos.velocities())
    ]
    distance, mean = np.abs(speeds[0] - speeds[1]).mean(axis=0), speeds[1].mean(axis=0)
    still = (distance == 0) & (mean == 0)
    with np.errstate(divide="ignore"):
        return np.asarray(distance / np.where(still, 1.0, mean))


def _check(demos: Demonstrations, locomotion: Sequence[Locomotion]) -> None:
    if len(locomotion) != demos.num_individuals or len({own.thrusts for own in locomotion}) != 1:
        counts = [own.thrusts for own in locomotion]
        raise InputError(
            f"{demos.name}: locomotion parameters with {counts} thrust magnitudes for "
            f"{demos.num_individuals} individuals: give one set each, all with the same number"
        )


@jit
def _follow(  # type: ignore[no-untyped-def]
    t,
    starts,
    recorded,
    recorded_velocity,
    table,
    damping,
    thrust,
    pushes,
    dt,
    horizon,
    position,
    velocity,
    paths,
    speeds,
    actions,
    course,
):
    """Record state ``t`` of every episode and advance it to the next, ``(K, 2, episodes)``.

    ``course`` ``(K, 2, episodes)`` is where they have been going.
    """
    K = position.shape[0]
    towards = np.empty((K, 2))
    for b in range(len(starts) - 1):
        frame = starts[b] + t
        if frame >= starts[b + 1]:
            continue
        for i in range(K):
            for x in range(2):
                paths[frame, i, x] = position[i, x, b]
                speeds[frame, i, x] = velocity[i, x, b]
        if frame + 1 == starts[b + 1]:
            continue
        for i in range(K):  # all look before anyone moves
            for x in range(2):
                course[i, x, b] = averaged(course[i, x, b], velocity[i, x, b], table.share, t)
            towards[i, 0], towards[i, 1] = focus_direction(
                i, b, table, position, course[i, 0, b], course[i, 1, b]
            )
        for i in range(K):
            least, action, best_x, best_y = np.inf, 0, 0.0, 0.0
            for k in range(pushes.shape[1]):
                ahead, left = pushes[i, k, 0], pushes[i, k, 1]
                ax = ahead * towards[i, 0] - left * towards[i, 1]
                ay = ahead * towards[i, 1] + left * towards[i, 0]
                vx = next_velocity(velocity[i, 0, b], ax, damping[i], thrust[i], dt)
                vy = next_velocity(velocity[i, 1, b], ay, damping[i], thrust[i], dt)
                px = (position[i, 0, b] + vx * dt - recorded[frame + 1, i, 0]) / (horizon * dt)
                py = (position[i, 1, b] + vy * dt - recorded[frame + 1, i, 1]) / (horizon * dt)
                qx = vx - recorded_velocity[frame + 1, i, 0]
                qy = vy - recorded_velocity[frame + 1, i, 1]
                cost = px * px + py * py + qx * qx + qy * qy
                if cost < least:
                    least, action, best_x, best_y = cost, k, vx, vy
            actions[frame, i] = action
            velocity[i, 0, b] = best_x
            velocity[i, 1, b] = best_y
            position[i, 0, b] += best_x * dt
            position[i, 1, b] += best_y * dt
