"""``animarl fit``: locomotion parameters of recorded individuals, as in the paper's Table 1."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal, get_args

import typer
from rich.box import SIMPLE_HEAD
from rich.table import Table
from rich.text import Text

from animarl_algos.cli.reading import SOURCE, load, named_split, refuse_overwriting, write_csv
from animarl_algos.cli.screen import PlainConsole
from animarl_algos.ranges import SEED
from animarl_envs.demos import Demonstrations
from animarl_envs.demos.splits import learnable
from animarl_envs.demos.units import RECORDED_SCALE, unit_of
from animarl_envs.errors import InputError
from animarl_envs.fitting import IndividualFit, LocomotionFit, fit_locomotion
from animarl_envs.fitting.noise import fit_with_noise
from animarl_envs.fitting.result import Method, doubts
from animarl_envs.species import get_species

QUICK_STEPS = 800  # of a noise estimate, per individual
MATTERS = 0.1  # relative difference of thrusts that is worth a warning
TABLE_WIDTH = 112  # a narrower terminal wraps lines rather than losing digits


MethodChoice = Literal["joint", "onset", "noise", "both"]
"""What ``--method`` takes."""


def fit_command(
    file: Annotated[
        str, typer.Argument(help="Demonstrations, a file that a reader knows, or a packaged set.")
    ],
    source: Annotated[
        str | None, typer.Option(help="Reader; by default found by a look at the file.")
    ] = None,
    species: Annotated[
        str | None, typer.Option(help="Take the onset threshold of this species.")
    ] = None,
    method: Annotated[
        MethodChoice,
        typer.Option(help="joint (default), onset (the paper's), both, or noise: noisy tracks."),
    ] = "joint",
    thrusts: Annotated[
        str | None,
        typer.Option(help="Compare numbers of thrust magnitudes, such as 1,2,3,5 (joint fit)."),
    ] = None,
    split: Annotated[
        str, typer.Option(help="Episodes the parameters come from: train, val, test or all.")
    ] = "train",
    bootstrap: Annotated[int, typer.Option(help="Resamples of episodes for the intervals.")] = 1000,
    seed: Annotated[int, typer.Option(help="Of the resampling.")] = 0,
    out: Annotated[
        Path | None, typer.Option(help="Save the table: .csv, or .json to use it again.")
    ] = None,
) -> None:
    """Fit damping d and thrust u of v' = (1 - d) v + u a dt to recorded episodes.

    Examples:

      animarl fit demos.npz

      animarl fit demos.npz --thrusts 1,2,3,5

      animarl fit demos.npz --method noise

      animarl fit episodes_share.npz --method both --split all --out fit.csv
    """
    if out is not None and out.suffix not in {".csv", ".json"}:
        raise InputError(f"{out}: the suffix says how to save: use .csv or .json")
    if out is not None:
        refuse_overwriting(out, file)
    seed, chosen = SEED.check("seed", seed), named_split(split)
    compared = _compared(thrusts, method)
    demos = load(file, source, takes=(SOURCE,))
    onset_threshold = None
    if species is not None:
        onset_threshold = get_species(species).recording.onset_threshold
    console = PlainConsole(least_width=TABLE_WIDTH)
    if compared:
        compare_thrusts(demos, compared, chosen, seed, console, out)
        return
    fits: list[LocomotionFit] = []
    methods = list(get_args(Method))[:2] if method == "both" else [method]
    for name in methods:
        try:
            fit = fit_locomotion(
                demos,
                name,  # type: ignore[arg-type]
                onset_threshold=onset_threshold,
                split=chosen,
                bootstrap=bootstrap,
                seed=seed,
            )
        except InputError as error:
            if method != "both" or not fits:
                raise
            console.print(f"{name}: {error}", highlight=False, soft_wrap=True)
            continue
        fits.append(fit)
        console.print(format_fit_table(fit, demos))
        for sentence in [*doubts(fit, demos), *noise_warnings(fit, demos)]:
            console.print(sentence, style="yellow", highlight=False, soft_wrap=True)
    if out is not None:
        save_fits(fits, out)
        console.print(f"Saved {out}", highlight=False, soft_wrap=True)


def _compared(thrusts: str | None, method: MethodChoice) -> tuple[int, ...]:
    """The numbers of thrust magnitudes to compare; none, to fit one."""
    if thrusts is None:
        return ()
    from animarl_algos.cli.thrusts import parse_thrusts

    if method != "joint":
        raise InputError(f"--thrusts goes with the joint fit: leave --method {method} out")
    return parse_thrusts(thrusts)


def compare_thrusts(
    demos: Demonstrations,
    numbers: tuple[int, ...],
    split: str | None,
    seed: int,
    console: PlainConsole,
    out: Path | None,
) -> None:
    """Fit each number of thrust magnitudes and print how closely it follows the episodes.

    Also says which number ``animarl run`` chooses, among those that it tries.
    """
    from animarl_algos.cli.thrusts import format_thrust_table, save_thrust_rows, thrust_rows
    from animarl_algos.evaluation.thrust_choice import thrusts_and_reason

    if out is not None and out.suffix == ".json" and len(numbers) > 1:
        raise InputError(f"{out}: a .json holds one fit: give one --thrusts, or save a .csv")
    seen = demos if split is None else demos.select(split=split)
    fits = [
        fit_locomotion(demos, thrusts=number, split=split, bootstrap=0, seed=seed)
        for number in numbers
    ]
    rows = thrust_rows(fits, seen, seed=seed)
    console.print(format_thrust_table(rows, seen, split or "all"))
    if len(numbers) > 1:
        chosen, reason = thrusts_and_reason(demos, seed=seed)
        console.print(
            f"Chosen on training episodes: {chosen}, {reason}", highlight=False, soft_wrap=True
        )
    if out is not None:
        if out.suffix == ".json":
            fits[0].save(out)
        else:
            save_thrust_rows(rows, out)
        console.print(f"Saved {out}", highlight=False, soft_wrap=True)


def format_fit_table(fit: LocomotionFit, demos: Demonstrations | None = None) -> Table:
    """The paper's Table 1: one row per individual, parameters with their 95 % intervals.

    The terminal speed u dt / d is beside the recorded top speed, as a check: the onset rule makes
    them equal, the joint fit keeps the terminal speed from being too low.
    """
    kind = "" if demos is None else (" synthetic" if demos.synthetic else " recorded")
    caption = (
        f"v' = (1 - d) v + u a dt, dt = {fit.dt:g} s; {fit.individuals[0].steps} steps of "
        f"{fit.episodes}{kind} episodes ({fit.fitted_on}); velocity RMSE on "
        f"{fit.validation_episodes} ({fit.validated_on}); 95 % intervals over {fit.bootstrap} "
        "resamples of episodes. Lengths in " + _lengths(demos)
    )
    title = f"Locomotion of {fit.species}, {fit.method} fit"
    if fit.onset_threshold is not None:
        title += f" (th_acc = {fit.onset_threshold:.3g})"
    table = Table(title=title, caption=caption, box=SIMPLE_HEAD, padding=(0, 1))
    table.add_column("individual", no_wrap=True)
    last = ["onsets"] if fit.method == "onset" else ["terminal\nspeed"]
    if fit.method == "noise":
        last.append("tracking\nnoise")
    for heading in (
        "d (95 % CI)", "u (95 % CI)", "velocity\nRMSE", "braking\ntime, s", "top\nspeed", *last
    ):  # fmt: skip
        table.add_column(heading, justify="right", no_wrap=True)
    for one in fit.individuals:
        table.add_row(
            Text(one.name),
            _with_interval(one.damping, one.damping_interval),
            _with_interval(one.thrust, one.thrust_interval),
            f"{one.velocity_rmse:.2g}",
            f"{one.braking_time:.3g}",
            f"{one.top_speed:.3g}",
            str(one.onsets) if fit.method == "onset" else f"{one.terminal_speed:.3g}",
            *([] if one.tracking_noise is None else [f"{one.tracking_noise:.2g}"]),
        )
    return table


def _lengths(demos: Demonstrations | None) -> str:
    """The unit of the table, and what it is of the recordings' own."""
    unit = RECORDED_SCALE if demos is None else unit_of(demos)
    if unit == RECORDED_SCALE:
        return "arena units."
    return f"arena units of {unit.per_arena_unit:.4g} {unit.name}."


def noise_warnings(fit: LocomotionFit, demos: Demonstrations) -> list[str]:
    """Of a joint fit: who is tracked so noisily that it is not to be believed.

    By a quick fit that knows of noise, on some training episodes.
    """
    if fit.method != "joint" or demos.synthetic:
        return []
    seen, warned = learnable(demos), []
    for i, one in enumerate(fit.individuals):
        noisy = fit_with_noise(seen, i, most_steps=QUICK_STEPS, intervals=False)
        if abs(one.thrust - noisy.thrust) > MATTERS * noisy.thrust:
            warned.append(
                f"{one.name}: tracking noise of about {noisy.noise:.2g} arena units "
                f"({noisy.share_of_step:.0%} of a median step), with which u is about "
                f"{noisy.thrust:.3g} and d {noisy.damping:.2g}: see --method noise"
            )
    return warned


def save_fits(fits: list[LocomotionFit], out: Path) -> None:
    """Write ``.json`` (one fit, as ``LocomotionFit.load`` reads it) or ``.csv`` (all rows)."""
    if out.suffix == ".json":
        if len(fits) != 1:
            raise InputError(f"{out}: a .json holds one fit: choose one --method, or save a .csv")
        fits[0].save(out)
        return
    write_csv(out, [_csv_row(fit.method, one) for fit in fits for one in fit.individuals])


def _csv_row(method: str, one: IndividualFit) -> dict[str, object]:
    d_low, d_high = one.damping_interval or (None, None)
    u_low, u_high = one.thrust_interval or (None, None)
    interval = {"d": one.damping, "d_low": d_low, "d_high": d_high}
    interval |= {"u": one.thrust, "u_low": u_low, "u_high": u_high}
    others = ("velocity_rmse", "top_speed", "terminal_speed", "braking_time", "steps", "onsets",
              "tracking_noise")  # fmt: skip
    named = {"method": method, "individual": one.name}
    return named | interval | {name: getattr(one, name) for name in others}


def _with_interval(value: float, interval: tuple[float, float] | None) -> str:
    digits = 3 if abs(value) >= 0.1 else 4
    if interval is None:
        return f"{value:.{digits}f}"
    return f"{value:.{digits}f} ({interval[0]:.{digits}f}, {interval[1]:.{digits}f})"
