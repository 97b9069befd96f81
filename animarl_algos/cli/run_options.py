"""What ``animarl run`` and ``animarl train`` are asked alike: options and defaults, once."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer

from animarl_envs.scenario import PACKAGED

Command = Callable[..., None]


def _asked(
    context: typer.Context,
    file: Annotated[
        str,
        typer.Argument(
            help="A file of recorded episodes, or 'packaged': those that come with the species."
        ),
    ] = PACKAGED,
    env: Annotated[
        str | None,
        typer.Option(help="Environment id, such as AnimaRL/Fly-v0: another way to give --species."),
    ] = None,
    species: Annotated[
        str | None,
        typer.Option(help="agent, fly, newt, silkmoth or custom; by default what FILE says."),
    ] = None,
    algo: Annotated[
        str,
        typer.Option(
            help="soft-bc, iq-learn, bc, dqn, dqaas, dqdil, dqdil-pt, dqcil, dqcil-pt; "
            "qr-dqn and so on."
        ),
    ] = "soft-bc",
    preset: Annotated[
        str, typer.Option(help="Settings of zoo_configs: paper (the paper's) or default (tuned).")
    ] = "default",
    steps: Annotated[
        int | None,
        typer.Option(help="Environment steps, after the offline epochs; by default the preset's."),
    ] = None,
    seed: Annotated[int, typer.Option(help="Root of all randomness.")] = 0,
    out: Annotated[
        Path, typer.Option(help="Run folder; made if absent, continued if killed.")
    ] = Path("runs/run"),
    source: Annotated[
        str | None,
        typer.Option(help="Format of FILE ('animarl data sources'); by default recognised."),
    ] = None,
    copies: Annotated[
        int | None, typer.Option(help="Worlds simulated side by side; by default the preset's.")
    ] = None,
    focal: Annotated[
        str | None,
        typer.Option(help="Only this individual learns, the others replay; default: all."),
    ] = None,
    policy: Annotated[
        str | None,
        typer.Option(
            help="GruPolicy (with a memory) or MlpPolicy (without); by default the preset's."
        ),
    ] = None,
    device: Annotated[str | None, typer.Option(help="cpu (default) or cuda.")] = None,
    config: Annotated[
        Path | None, typer.Option(help="YAML file to read instead of zoo_configs/ALGO.yml.")
    ] = None,
    fit_method: Annotated[
        str | None,
        typer.Option(
            help="joint, onset (the paper's rule) or noise (for noisy tracks); by default "
            "the preset's."
        ),
    ] = None,
    thrusts: Annotated[
        str | None,
        typer.Option(help="Thrust magnitudes, 1 to 10, or auto: chosen on training data."),
    ] = None,
    acting: Annotated[
        str | None,
        typer.Option(
            help="How trained policies act: greedy, boltzmann:TEMPERATURE, epsilon:SHARE, or "
            "chosen (by rollouts, after training); by default the preset's."
        ),
    ] = None,
    settings: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            help="A setting of the learner, KEY=VALUE, such as learning_rate=0.001; may be "
            "repeated. Names: zoo_configs/ALGO.yml.",
        ),
    ] = None,
) -> None:
    """Only its signature is used, by :func:`with_run_options`."""


def with_run_options(*, before: str) -> Callable[[Command], Command]:
    """Decorator: ask for the shared options beside the command's own ones.

    The command's first parameter is the ``typer.Context``, in whose ``params`` all that was asked
    is found; the command itself is called with its own parameters only. These stand in the help
    before the shared one named ``before``.
    """
    shared = list(inspect.signature(_asked, eval_str=True).parameters.values())
    place = [parameter.name for parameter in shared].index(before)

    def decorate(command: Command) -> Command:
        _, *own = inspect.signature(command, eval_str=True).parameters.values()
        parameters = [*shared[:place], *own, *shared[place:]]

        @functools.wraps(command)
        def with_own(context: typer.Context, **given: Any) -> None:
            command(context, **{parameter.name: given[parameter.name] for parameter in own})

        with_own.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
        with_own.__annotations__ = {p.name: p.annotation for p in parameters}
        return with_own

    return decorate
