"""Two published collections in compact form: termite pairs and groups of fruit flies.

Both are an ``.npz`` of int16 arrays, one per recording, beside an ``index.csv`` with their scales.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from animarl_envs.errors import InputError
from animarl_envs.files import npz_members, read_npz
from animarl_envs.importing.readers.registry import register_track_reader
from animarl_envs.importing.rows import read_rows
from animarl_envs.importing.tracks import Tracks

TERMITE_STEPS = 50.0  # stored as (pixel - offset) * 50
FLY_STEPS = 100.0  # stored as position * 100
FLY_ARENA = 120.0  # diameter of the arena [unit of the file]

TERMITE_DEFAULTS = {
    "target": "female",
    "decision_rate": 10.0,
    "licence": "MIT",
    "cleaning": {"smoothing_cutoff": 2.0},
    "scaling": {"shape": "disc", "each": True},  # dishes filmed one by one
}
FLY_DEFAULTS = {
    "target": "auto",
    "decision_rate": 12.0,
    "licence": "none stated: ask before redistributing",
    "cleaning": {"smoothing_cutoff": 2.0},
    "scaling": {
        "shape": "disc", "width": FLY_ARENA, "centre": (FLY_ARENA / 2, FLY_ARENA / 2),
        "boundary": 1.3,
    },
}  # fmt: skip


def _scale_of(path: Path, row: dict[str, str]) -> float:
    """Millimetres per pixel, which the key's row gives."""
    try:
        scale = float(row["mm_per_px_est"])
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"{path.parent / 'index.csv'}: a scale is no number ({error})") from None
    if not 0 < scale < np.inf:
        raise InputError(f"{path.parent / 'index.csv'}: a scale is {scale}: correct it")
    return scale


@register_track_reader(
    "termites",
    "termite tandem pairs (tracks_30fps_int16.npz with index.csv)",
    sniff=lambda path: path.name == "tracks_30fps_int16.npz",
    extensions=(".npz",),
    defaults=TERMITE_DEFAULTS,
)
def read_termites(
    path: Path, kind: str | None = None, recordings: list[str] | None = None
) -> list[Tracks]:
    """Male and female in mm; ``kind`` ``"Cf"`` or ``"Rs"`` takes one species."""
    rows, _ = read_rows(path.parent / "index.csv", {"key"})
    index = {row["key"]: row for _, row in rows}
    found = []
    for key, array in read_npz(path).items():
        if (kind and not key.startswith(kind)) or (recordings and key not in recordings):
            continue
        if array.ndim != 2 or array.shape[1] != 4 or key not in index:
            raise InputError(f"{path}: {key} has shape {array.shape} or no index: check the file")
        mm = _scale_of(path, index[key])
        pixels = array.astype(np.float64) / TERMITE_STEPS
        female, male = pixels[:, :2] * mm, pixels[:, 2:] * mm
        found.append(
            Tracks(
                recording=key, individuals=("male", "female"),
                positions=np.stack([male, female], axis=1)[:, :, None], frame_rate=30.0,
                unit="mm", y_down=True,
                provenance={
                    "source": "nobuaki-mzmt/SexMovementAfterSeparation",
                    "citation": "Mizumoto N, Dobata S (2019) Science Advances 5(6):eaau6108",
                },
            )
        )  # fmt: skip
    if not found:
        raise InputError(f"{path}: no recording of kind {kind!r}: choose Cf or Rs")
    return found


@register_track_reader(
    "fly-groups",
    "groups of fruit flies in a round arena (tracks_24fps_int16.npz with index.csv)",
    sniff=lambda path: any(name.endswith("__xy.npy") for name in npz_members(path)),
    extensions=(".npz",),
    defaults=FLY_DEFAULTS,
)
def read_fly_groups(path: Path) -> list[Tracks]:
    """All flies of each recording; the arena is 120 units wide."""
    found = []
    for key, array in read_npz(path).items():
        if not key.endswith("__xy"):
            continue
        if array.ndim != 3 or array.shape[2] != 2:
            raise InputError(f"{path}: {key} has shape {array.shape}: check the file")
        found.append(
            Tracks(
                recording=key.removesuffix("__xy"),
                individuals=tuple(f"fly_{i + 1}" for i in range(array.shape[1])),
                positions=array.astype(np.float64)[:, :, None] / FLY_STEPS, frame_rate=24.0,
                unit="1/120 of the arena", y_down=True,
                provenance={
                    "source": "milanXpetrovic/drosophila-social-interaction-criteria",
                    "citation": "Schneider J, Levine JD (2014) Biol Lett 10:20140749 (method)",
                },
            )
        )  # fmt: skip
    return found
