"""``animarl data merge``: several files of demonstrations become one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from animarl_algos.cli.reading import load, refuse_overwriting
from animarl_algos.cli.showing import report
from animarl_envs.demos import Demonstrations
from animarl_envs.demos.joining import join
from animarl_envs.errors import InputError
from animarl_envs.importing.sessions import conditions_of


def merged(files: Sequence[Path], conditions: str | None = None) -> Demonstrations:
    """The demonstrations of several files, in their order.

    Parameters
    ----------
    files
        Two or more.
    conditions
        Of each file, such as ``0,1`` or ``control,drug``; by default those of their episodes.

    Raises
    ------
    InputError
        If the sets do not fit together, or conditions are not one for each file.
    """
    if len(files) < 2:
        raise InputError(f"{files[0]}: there is nothing to merge it with: give two files or more")
    parts = [load(str(file)) for file in files]
    if conditions is None:
        return join(parts, " and ".join(map(str, files)))
    words = [word.strip() for word in conditions.split(",")]
    if len(words) != len(files) or not all(words):
        raise InputError(
            f"conditions are {conditions!r} for {len(files)} files: give one for each, as "
            f"{','.join(str(i % 2) for i in range(len(files)))}"
        )
    names = conditions_of(words, "--conditions")
    told = [
        replace(part, condition=np.full(len(part), names.index(word), dtype=np.int8))
        for part, word in zip(parts, words, strict=True)
    ]
    found = join(told, " and ".join(map(str, files)))
    if len(names) < 2:
        return found
    return replace(found, provenance={**found.provenance, "conditions": list(names)})


def merge_command(
    files: Annotated[list[Path], typer.Argument(help="Two files of demonstrations or more.")],
    out: Annotated[Path, typer.Option("--out", help="Demonstrations to write (.npz).")],
    conditions: Annotated[
        str | None,
        typer.Option(help="Of each file: 0,1 or two words, as control,drug; default: as they are."),
    ] = None,
) -> None:
    """Put files of demonstrations of the same animals in the same arena together.

    Splits stay as they are; 'animarl data split' deals again.

    Examples:

      animarl data merge monday.npz tuesday.npz --out week.npz

      animarl data merge sham.npz lesion.npz --conditions sham,lesion --out both.npz
    """
    if out.suffix != ".npz":
        raise InputError(f"{out}: demonstrations end in .npz: rename it")
    refuse_overwriting(out, *files)
    report(merged(files, conditions), out, None)
