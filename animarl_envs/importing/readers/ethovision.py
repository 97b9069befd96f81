"""EthoVision exports, text or Excel: header lines with what the trial was, then names, units, rows.

A file or sheet holds one subject in one arena. Points (``X center``, ``X nose``, ``X tail``) become
keypoints; what was not found is ``-``. Files and sheets of one trial are merged by its name.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from animarl_envs.errors import InputError
from animarl_envs.importing.readers.clocks import even_rate
from animarl_envs.importing.readers.registry import register_track_reader
from animarl_envs.importing.readers.tables import (
    EXTENSIONS,
    PARQUET,
    Progress,
    Table,
    is_workbook,
    open_table,
    sheet_names,
)
from animarl_envs.importing.tracks import Tracks

FIRST_CELL = "Number of header lines:"
CLOCKS = ("Trial time", "Recording time")


def _is_ethovision(path: Path) -> bool:
    if path.suffix.lower() in PARQUET:
        return False
    try:
        sheet = sheet_names(path)[0] if is_workbook(path) else None
        first = open_table(path, sheet=sheet).layout.before[:1]
    except (InputError, ImportError, OSError, LookupError, ValueError):
        return False
    return bool(first) and first[0][:1] == (FIRST_CELL,)


@register_track_reader(
    "ethovision",
    "EthoVision exports (text, Excel): a subject per file or sheet, merged by the trial's name",
    sniff=_is_ethovision,
    extensions=EXTENSIONS,
)
def read_ethovision(
    path: Path, encoding: str | None = None, progress: Progress = None
) -> list[Tracks]:
    """All subjects of the file; unit and frame rate are in it. In EthoVision y grows upwards."""
    sheets: list[str | None] = [None]
    if is_workbook(path):
        sheets = list(sheet_names(path))
    return [_read(open_table(path, encoding, sheet), progress) for sheet in sheets]


def _read(table: Table, progress: Progress) -> Tracks:
    path, layout = table.path, table.layout
    said = {row[0].rstrip(":").lower(): row[1] for row in layout.before if len(row) > 1}
    points = {name[2:]: (name, "Y" + name[1:]) for name in layout.names if re.match(r"X .", name)}
    clock = next((name for name in CLOCKS if name in layout.names), None)
    lacking = [y for _, y in points.values() if y not in layout.names]
    if clock is None or not points or lacking:
        what = "a time" if clock is None else (lacking or ["X center"])[0]
        raise InputError(f"{path}: it lacks the column {what!r}: export it with time, X and Y")
    units = {layout.units[layout.names.index(name)] for pair in points.values() for name in pair}
    if len(units) != 1:
        raise InputError(f"{path}: its points have several units: export them in one")
    wanted = [clock, *(name for pair in points.values() for name in pair)]
    number, _ = table.columns(wanted, progress=progress)
    positions = np.stack(
        [np.column_stack([number[x], number[y]]) for x, y in points.values()], axis=1
    )
    return Tracks(
        recording=said.get("trial name") or path.stem,
        individuals=(said.get("subject name") or table.sheet or "subject",),
        keypoints=tuple(points),
        positions=positions[:, None],
        frame_rate=even_rate(path, number[clock], table.place),
        start=float(number[clock][0]),
        unit=units.pop() or "px",
        provenance={"file": path.name, "tracker": "EthoVision", "read_as": table.description},
    )
