"""``animarl fit``: locomotion parameters of recorded individuals, as in the paper's Table 1."""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.table import Table
from rich.text import Text

from animarl_algos.cli import shared
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.summary import RECORDED_SCALE, unit_of
from animarl_envs.errors import InputError, require
from animarl_envs.fitting.custom_species import arena_of
from animarl_envs.fitting.joint import FAST
from animarl_envs.fitting.result import LocomotionFit, doubts, fit_locomotion, fits_by_kind
from animarl_envs.fitting.tracking import speed_distances, track, tracking_errors
from animarl_envs.locomotion import MOST_THRUSTS
from animarl_envs.settings import Seed, check_value
from animarl_envs.species import get_species

TABLE_WIDTH = 112  # a narrower terminal wraps lines rather than losing digits
MethodChoice = Literal["joint", "onset", "both"]
"""What ``--method`` takes."""
THRUST_COLUMNS: dict[str, tuple[str, Callable[[Any], str]]] = {
    "thrusts": ("thrusts", str),
    "individual": ("individual", str),
    "damping": ("d", "{:.4f}".format),
    "thrust": ("u", "{:.3g}".format),  # [arena unit / s^2]
    "magnitudes": ("multiples of u", lambda each: " ".join(f"{one:.2f}" for one in each)),
    "tracking_error": ("tracking\nerror", "{:.2g}".format),
    "speed_distance": ("speed\ndistance", "{:.1%}".format),
    "terminal_speed": ("terminal\nspeed", "{:.3g}".format),
    "fast_speed": ("99 %\nspeed", "{:.3g}".format),
    "floor": ("floor\n(AUC)", lambda floor: f"{floor:.2f}" if math.isfinite(floor) else "-"),
}
"""Columns of ``--thrusts``: name in the file, heading in the terminal, and format of a value."""


@shared.with_help(
    file="Demonstrations, a file that a reader knows, or a packaged set.",
    source="Reader; by default found by content.",
    species="Use the onset threshold of this species.",
    method="joint (default), onset (the paper's), or both.",
    thrusts="Compare numbers of thrust magnitudes, such as 1,2,3,5 (joint fit).",
    split="Episodes to fit: train, val, test or all.",
    bootstrap="Resamples of episodes for the intervals.",
    seed="Seed of the resampling.",
    out="File for the table (.csv).",
)
def fit_command(
    file: str,
    source: str | None = None,
    species: str | None = None,
    method: MethodChoice = "joint",
    thrusts: str | None = None,
    split: str = "train",
    bootstrap: int = 1000,
    seed: int = 0,
    out: Path | None = None,
) -> None:
    """Fit damping d and thrust u of v' = (1 - d) v + u a dt to recorded episodes.

    Examples:

      animarl fit demos.npz

      animarl fit demos.npz --thrusts 1,2,3,5

      animarl fit episodes_share.npz --method both --split all --out fit.csv
    """
    if out is not None:
        require(out.suffix == ".csv", f"{out}: a table ends in .csv: rename it")
        shared.refuse_overwriting(out, file)
    seed, chosen = check_value("seed", seed, Seed), shared.named_split(split)
    numbers = parse_numbers("--thrusts", thrusts, MOST_THRUSTS)
    if numbers and method != "joint":
        raise InputError(f"--thrusts goes with the joint fit: leave --method {method} out")
    demos = shared.load(file, source, takes=(shared.SOURCE,))
    console = shared.PlainConsole(TABLE_WIDTH)
    if numbers:
        rows = _compare_thrusts(demos, numbers, chosen, seed, console)
    else:
        threshold = None if species is None else get_species(species).recording.onset_threshold
        fits: list[LocomotionFit] = []
        for name in ("joint", "onset") if method == "both" else (method,):
            try:
                fit = fit_locomotion(
                    demos,
                    name,
                    onset_threshold=threshold,
                    split=chosen,
                    bootstrap=bootstrap,
                    seed=seed,
                )
            except InputError as error:
                if method != "both" or not fits:
                    raise
                console.print(f"{name}: {error}")
                continue
            fits.append(fit)
            console.print(format_fit_table(fit, demos))
            for sentence in doubts(fit, demos):
                console.print(sentence, style="yellow")
        rows = _fit_rows(fits)
    if out is not None:
        shared.write_csv(out, rows)
        console.print(f"Saved {out}")


def format_fit_table(fit: LocomotionFit, demos: Demonstrations) -> Table:
    """Return the paper's Table 1: a row per individual, parameters with their 95 % intervals.

    The terminal speed u dt / d is beside the recorded top speed, as a check: the onset rule makes
    them equal, the joint fit keeps the terminal speed from being too low.
    """
    kind, unit = "synthetic" if demos.synthetic else "recorded", unit_of(demos)
    scale = "" if unit == RECORDED_SCALE else f" of {unit.per_arena_unit:.4g} {unit.name}"
    title = f"Locomotion of {fit.species}, {fit.method} fit"
    if fit.onset_threshold is not None:
        title += f" (th_acc = {fit.onset_threshold:.3g})"
    caption = (
        f"v' = (1 - d) v + u a dt, dt = {fit.dt:g} s; {fit.individuals[0].steps} steps of "
        f"{fit.episodes} {kind} episodes ({fit.fitted_on}); velocity RMSE on "
        f"{fit.validation_episodes} ({fit.validated_on}); 95 % intervals over {fit.bootstrap} "
        f"resamples of episodes. Lengths in arena units{scale}."
    )
    if fit.cells:
        cells = len(fit.cells[0].centres)
        caption += (
            f" Actions are {cells} cells of recorded velocities, for which d and u are scales."
        )
    rows = []
    for one in fits_by_kind(fit, demos):
        row = {
            "individual": one.name,
            "d (95 % CI)": _with_interval(one.damping, one.damping_interval),
            "u (95 % CI)": _with_interval(one.thrust, one.thrust_interval),
            "velocity\nRMSE": f"{one.velocity_rmse:.2g}",
            "braking\ntime, s": f"{one.braking_time:.3g}",
            "top\nspeed": f"{one.top_speed:.3g}",
        }
        if fit.method == "onset":
            row["onsets"] = str(one.onsets)
        else:
            row["terminal\nspeed"] = f"{one.terminal_speed:.3g}"
        rows.append(row)
    return _table(title, caption, rows)


def _table(title: str, caption: str, rows: Sequence[Mapping[str, str]]) -> Table:
    """Return a table for the terminal; each row has its values by their headings."""
    table = Table(title=title, caption=caption, box=SIMPLE_HEAD, padding=(0, 1))
    for heading in rows[0]:
        side: Any = "left" if heading == "individual" else "right"
        table.add_column(heading, justify=side, no_wrap=True)
    for row in rows:
        table.add_row(*map(Text, row.values()))
    return table


def _with_interval(value: float, interval: tuple[float, float] | None) -> str:
    """Return a value and its interval, with three digits after the point or four."""
    digits = 3 if abs(value) >= 0.1 else 4
    if interval is None:
        return f"{value:.{digits}f}"
    return f"{value:.{digits}f} ({interval[0]:.{digits}f}, {interval[1]:.{digits}f})"


def _fit_rows(fits: Iterable[LocomotionFit]) -> list[dict[str, object]]:
    """Return the rows of the table in the file, one for each fit and individual."""
    numbers = ["velocity_rmse", "top_speed", "terminal_speed", "braking_time", "steps", "onsets"]
    rows = []
    for fit in fits:
        for one in fit.individuals:
            d_low, d_high = one.damping_interval or (None, None)
            u_low, u_high = one.thrust_interval or (None, None)
            row: dict[str, object] = {"method": fit.method, "individual": one.name}
            row |= {"d": one.damping, "d_low": d_low, "d_high": d_high}
            row |= {"u": one.thrust, "u_low": u_low, "u_high": u_high}
            rows.append(row | {name: getattr(one, name) for name in numbers})
    return rows


# -- numbers of thrust magnitudes -----------------------------------------------------------------


def parse_numbers(option: str, given: str | None, most: int) -> tuple[int, ...]:
    """Return the numbers in a text such as ``1,2,3``, each once, in order.

    Without a text there are none. Raises InputError unless all are whole numbers from 1 to
    ``most``.
    """
    texts = [] if given is None else [text.strip() for text in given.split(",")]
    if not all(text.isdecimal() and 1 <= int(text) <= most for text in texts):
        raise InputError(
            f"{option} is {given!r}: give whole numbers from 1 to {most}, such as 1,2,3"
        )
    return tuple(sorted({int(text) for text in texts}))


def _compare_thrusts(
    demos: Demonstrations,
    numbers: tuple[int, ...],
    split: str | None,
    seed: int,
    console: shared.PlainConsole,
) -> list[dict[str, object]]:
    """Fit each number of thrust magnitudes and print how closely it follows the episodes.

    Also says which number ``animarl run`` chooses, among those that it tries.
    """
    from animarl_algos.evaluation.thrust_choice import choose_thrusts, tracking_floor

    seen = demos if split is None else demos.select(split=split)
    fits = [
        fit_locomotion(demos, thrusts=number, split=split, bootstrap=0, seed=seed)
        for number in numbers
    ]
    steps = np.delete(np.arange(len(seen.positions)), seen.offsets[:-1])
    fast = np.quantile(np.linalg.norm(seen.velocities()[steps], axis=2), FAST, axis=0)
    rows: list[dict[str, Any]] = []
    for fit in fits:
        tracking = track(seen, fit.locomotion, arena_of(seen))
        errors, speeds = tracking_errors(seen, tracking), speed_distances(seen, tracking)
        floor = tracking_floor(seen, fit.locomotion, seed=seed).estimate
        for i, one in enumerate(fit.individuals):
            rows.append(
                {
                    "thrusts": len(one.magnitudes),
                    "individual": one.name,
                    "damping": one.damping,
                    "thrust": one.thrust,
                    "magnitudes": one.magnitudes,
                    "tracking_error": float(errors[i]),
                    "speed_distance": float(speeds[i]),
                    "terminal_speed": one.terminal_speed,
                    "fast_speed": float(fast[i]),
                    "floor": floor,
                }
            )
    kind = "synthetic" if seen.synthetic else "recorded"
    caption = (
        f"{len(seen)} {kind} episodes ({split or 'all'}) followed in closed loop. Tracking error: "
        "median distance over steps. Speed distance: Wasserstein distance of tracked and recorded "
        "speeds over the mean recorded speed. Floor: how often a classifier ranks tracked motion "
        "above recorded motion (0.5: cannot tell them apart). Lengths in arena units."
    )
    table_rows = [
        {heading: show(row[name]) for name, (heading, show) in THRUST_COLUMNS.items()}
        for row in rows
    ]
    console.print(_table(f"Thrust magnitudes of {seen.species}", caption, table_rows))
    if len(numbers) > 1:
        best, reason = choose_thrusts(demos, seed=seed)
        console.print(f"Chosen on training episodes: {best}, {reason}")
    return [row | {"magnitudes": " ".join(map(str, row["magnitudes"]))} for row in rows]
