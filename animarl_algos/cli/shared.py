"""What commands share: their options, what they read and write, and the terminal.

Names and texts from files are shown as they are, never obeyed.
"""

import csv
import inspect
import re
import shlex
import sys
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any, get_type_hints

import typer
from rich.console import Console

from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.episode import SPLITS, Episodes
from animarl_envs.demos.packaged import load_packaged, packaged_names
from animarl_envs.demos.summary import RECORDED_SCALE, Unit
from animarl_envs.errors import InputError, printable
from animarl_envs.files import write_then_rename
from animarl_envs.importing.netcdf_io import write_netcdf
from animarl_envs.importing.nwb_io import write_nwb
from animarl_envs.importing.sets import published_sets, read_named

CONTEXT = inspect.Parameter("context", inspect.Parameter.KEYWORD_ONLY, annotation=typer.Context)
ALL = "all"
TRACK_FILES = (".csv", ".parquet", ".nc", ".nwb")
SOURCE = "--source"
DECIMAL_SIGNS = {",", "."}
OPTION = re.compile(r"(?<![\w-])--[a-z][a-z-]*")
Command = Callable[..., None]


class PlainConsole(Console):
    """A console without markup (``[/red]`` is a name like any other) or terminal escapes."""

    def __init__(self, least_width: int = 0, **options: Any) -> None:
        super().__init__(markup=False, emoji=False, highlight=False, **options)
        self.width = max(self.width, least_width)

    def print(self, *objects: Any, **options: Any) -> None:
        """Print without wrapping sentences; escape unprintable characters."""
        if objects and all(isinstance(o, str) for o in objects):
            options = {"soft_wrap": True} | options
        super().print(*(printable(o) if isinstance(o, str) else o for o in objects), **options)


# -- options made from a model or a table ---------------------------------------------------------


def option(name: str, kind: Any, default: Any, info: Any) -> inspect.Parameter:
    """Return a parameter as typer reads it; ``info`` is its help, or typer's Option or Argument."""
    info = typer.Option(help=info) if isinstance(info, str) else info
    default = inspect.Parameter.empty if default is ... else default
    annotation = Annotated[kind, info]
    keyword = inspect.Parameter.KEYWORD_ONLY
    return inspect.Parameter(name, keyword, default=default, annotation=annotation)


def with_options(parameters: Iterable[inspect.Parameter]) -> Callable[[Command], Command]:
    """Decorate a command that takes ``**given``: typer sees these parameters."""
    listed = list(parameters)

    def decorate(command: Command) -> Command:
        command.__signature__ = inspect.Signature(listed)  # type: ignore[attr-defined]
        command.__annotations__ = {one.name: one.annotation for one in listed}
        return command

    return decorate


def with_help(**texts: Any) -> Callable[[Command], Command]:
    """Decorate a command: its parameters get a help text, or typer's Option or Argument.

    With a text alone a parameter without a default is an argument, any other an option.
    """

    def decorate(command: Command) -> Command:
        kinds, listed = get_type_hints(command), []
        for name, one in inspect.signature(command).parameters.items():
            if kinds[name] is typer.Context:
                listed.append(one.replace(annotation=typer.Context))
                continue
            info = texts[name]
            if isinstance(info, str):
                of = typer.Argument if one.default is one.empty else typer.Option
                info = of(help=info)
            listed.append(one.replace(annotation=Annotated[kinds[name], info]))
        return with_options(listed)(command)

    return decorate


def parse_settings(given: list[str] | None, flag: str = "--set", sign: str = "=") -> dict[str, Any]:
    """Return ``KEY=VALUE`` pairs; values are read as YAML data, but for a sign alone (, or .).

    Raises InputError if there is no ``sign``, or the value is not valid YAML.
    """
    import yaml  # of another extra than the command line

    parsed: dict[str, Any] = {}
    for pair in given or []:
        key, there, value = (part.strip() for part in pair.partition(sign))
        if not there or not key:
            raise InputError(f"{flag} {pair}: write KEY{sign}VALUE")
        try:
            parsed[key] = value if value in DECIMAL_SIGNS else yaml.safe_load(value)
        except yaml.YAMLError as error:
            raise InputError(f"{flag} {pair}: the value is not valid YAML ({error})") from None
    return parsed


def command_line() -> str:
    """Return the command as it was given, for what it makes."""
    return shlex.join(["animarl", *sys.argv[1:]])


# -- files ----------------------------------------------------------------------------------------


def load(file: str, source: str | None = None, *, takes: Collection[str] = ()) -> Demonstrations:
    """Return a packaged or published set by its name, or the demonstrations of a file.

    ``takes`` is as in :func:`suggest_import_on_error`.
    """
    path = Path(file)
    if file in packaged_names() and not path.exists():
        return load_packaged(file)
    if not path.exists() and file not in published_sets():
        raise InputError(
            f"{file}: there is no such file, packaged are {', '.join(packaged_names())}, and "
            f"published sets are {', '.join(published_sets())}: check the path"
        )
    with suggest_import_on_error(file, takes):
        return read_named(file, source)


@contextmanager
def suggest_import_on_error(file: str | Path, takes: Collection[str] = ()) -> Iterator[None]:
    """Where a file is refused, say how ``animarl import`` reads it.

    Readers name options of that command; those in ``takes`` the command at hand has too.
    """
    try:
        yield
    except InputError as error:
        message = str(error)
        lacking = [name for name in dict.fromkeys(OPTION.findall(message)) if name not in takes]
        if not lacking or "animarl " in message:
            raise
        place = "" if message.startswith(str(file)) else f"{file}: "
        options = " ".join(f"{name} ..." for name in lacking)
        raise InputError(
            f"{place}{message}, as in 'animarl import {shlex.quote(str(file))} {options} --out "
            "demos.npz', and take what that writes"
        ) from None


def named_split(split: str) -> str | None:
    """Return what ``--split`` names; ``None``: all episodes."""
    if split not in (*SPLITS, ALL):
        raise InputError(f"--split is {split!r}: choose one of {', '.join((*SPLITS, ALL))}")
    return None if split == ALL else split


def refuse_overwriting(out: Path, *read_from: str | Path) -> None:
    """Refuse to write a result over a file that it is made from."""
    for file in map(Path, read_from):
        if out.exists() and file.exists() and out.samefile(file):
            raise InputError(f"{out}: it is the file that is read: name another --out")


def track_rows(
    episodes: Episodes, heads: Sequence[Mapping[str, object]], unit: Unit = RECORDED_SCALE
) -> Iterator[dict[str, object]]:
    """Yield a row per frame and individual, as the long-table reader takes it.

    ``heads`` are the first columns of each episode. Positions are in ``unit``; a physical one is
    named by the columns (``x_cm``).
    """
    x, y = ("x", "y") if unit is RECORDED_SCALE else (f"x_{unit.name}", f"y_{unit.name}")
    for number, head in enumerate(heads):
        for frame, places in enumerate((unit.per_arena_unit * episodes.path(number)).tolist()):
            for individual, (east, north) in zip(episodes.individuals, places, strict=True):
                row = {"frame": frame, "time_s": frame * episodes.dt, "id": individual}
                yield {**head, **row, x: east, y: north}


def write_tracks(
    out: Path, episodes: Episodes, heads: Sequence[Mapping[str, object]], unit: Unit
) -> None:
    """Write episodes as a table, .csv or .parquet, as movement's netCDF, .nc, or as NWB, .nwb.

    Raises InputError if the suffix is another.
    """
    if out.suffix == ".nc":
        write_netcdf(out, episodes, heads, unit)
    elif out.suffix == ".nwb":
        write_nwb(out, episodes, heads, unit)
    elif out.suffix == ".csv":
        write_csv(out, track_rows(episodes, heads, unit))
    elif out.suffix == ".parquet":
        import pandas as pd

        with write_then_rename(out) as part:
            pd.DataFrame(track_rows(episodes, heads, unit)).to_parquet(part)
    else:
        raise InputError(f"{out}: the suffix says the format: choose {', '.join(TRACK_FILES)}")


def write_csv(out: Path, rows: Iterable[Mapping[str, object]]) -> None:
    """Write a table of at least one row; None is an empty cell."""
    whole = list(rows)
    with write_then_rename(out) as part, part.open("w", newline="") as file:
        writer = csv.DictWriter(file, list(whole[0]))
        writer.writeheader()
        writer.writerows(whole)
