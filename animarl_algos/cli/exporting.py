"""``animarl export``: a run's trained policy as a small folder to give away."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from animarl_algos.cli.screen import PlainConsole


def export_command(
    run: Annotated[Path, typer.Argument(help="Run folder, trained and evaluated.")],
    out: Annotated[Path, typer.Option(help="Folder of the model.")],
    demonstrations: Annotated[
        bool,
        typer.Option(
            "--with-demonstrations",
            help="Copy the recordings too: whoever loads the model needs them.",
        ),
    ] = False,
) -> None:
    """Write a run's trained policy with a model card: weights as safetensors, the rest as JSON.

    The folder loads like the run: animarl watch --model FOLDER, or in Python
    animarl_algos.load_pretrained(FOLDER).

    Example:

      animarl export out/demo --out out/agent-model
    """
    from animarl_algos.runs.pretrained import CARD, export_run
    from animarl_algos.runs.run_folder import RunFolder

    folder = export_run(RunFolder(run), out, with_demonstrations=demonstrations)
    size = sum(file.stat().st_size for file in folder.rglob("*") if file.is_file())
    PlainConsole().print(
        f"Wrote {folder} ({size / 1e6:.2f} MB); read {folder / CARD}",
        highlight=False, soft_wrap=True,
    )  # fmt: skip
