"""Small files that were once read wrongly or refused without need: what each is read as today.

A row of ``CASES`` is the command ``animarl import FILE ... OPTIONS`` and what comes of it; or, in
``REFUSED``, the words of the sentence by which it ends.
"""

import shlex
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from commands import animarl

from animarl_envs.errors import InputError
from animarl_envs.importing.readers import read

FILES = Path(__file__).parents[4] / "shared" / "cases" / "import"
pytestmark = [
    pytest.mark.realdata,
    pytest.mark.skipif(not FILES.is_dir(), reason=f"the small files are not found at {FILES}"),
]


@dataclass(frozen=True, kw_only=True)
class Expected:
    """What demonstrations hold; what is ``None`` is not checked.

    ``extent`` is half the width of the arena in ``unit``; ``prints`` are words of the report.
    """

    individuals: str
    rate: float
    recordings: int = 1
    frames: int | None = None
    extent: float | None = None
    unit: str | None = None
    prints: tuple[str, ...] = ()


CASES: dict[str, Expected] = {
    "tracks_key.h5 --fps 30": Expected(individuals="individual_0", rate=30, frames=450),
    "d_part.csv --fps 30": Expected(
        individuals="individual_0", rate=30, frames=299, extent=97.64, unit="px"
    ),
    "d_excel_de.csv --fps 30": Expected(
        individuals="individual_0", rate=30, frames=299, extent=97.64, unit="px"
    ),
    "d_corners.csv --fps 30": Expected(
        individuals="mouse1 mouse2", rate=30, frames=299,
        prints=("corner1 (a unique body part)", "keypoints nose, tail;"),
    ),
    "s_standard.h5 --fps 30": Expected(individuals="m1 m0", rate=30, frames=299, extent=211.4),
    "s_sleap.csv --fps 30": Expected(individuals="m1 m0", rate=30, frames=299, extent=211.4),
    "s_untracked.slp --fps 30": Expected(individuals="individual_0", rate=30, frames=299),
    "ev_arenas.xlsx": Expected(individuals="Subject 1", rate=25, recordings=2, unit="cm"),
    "ev_manual.xlsx": Expected(
        individuals="Subject 1", rate=25, unit="cm", prints=("sheet Manual scoring-Arena 1",)
    ),
    "trexb_fish0.csv trexb_fish1.csv --merge-individuals": Expected(
        individuals="fish0 fish1", rate=25, unit="cm", extent=8.494,
        prints=("25 frames/s, from the column time",),
    ),
    "trx.mat": Expected(individuals="1 2", rate=30, unit="mm", prints=("theta",)),
    "ft-track.mat --fps 30": Expected(individuals="1 2", rate=30, frames=399, unit="px"),
    "ctrax.mat": Expected(individuals="0 1", rate=30, unit="px", prints=("angle",)),
    **{
        f"late_{first}.csv --fps 30": Expected(
            individuals="fish0 fish1 fish2 fish3", rate=30, prints=("10 episodes of 1 recording",)
        )
        for first in (0, 5000, 7000)
    },
    "solo0.csv solo1.csv solo2.csv --fps 25 --target none": Expected(
        individuals="individual_0", rate=25, recordings=3,
        prints=("larva0, larva1, larva2 are each alone",),
    ),
    "fs_whole.csv --target none": Expected(
        individuals="a0 a1", rate=25, prints=("25 frames/s, from the column time",)
    ),
    "fs_tenth60.csv --target none": Expected(individuals="a0 a1", rate=60),
    "slow_4h.csv --target none": Expected(
        individuals="0 1", rate=1 / 14400, prints=("one frame every 14400 s, from the column",)
    ),
    "ft_min.csv --target none --option time_unit=min": Expected(individuals="a0 a1", rate=25),
    "ms500.csv --option time_unit=ms": Expected(individuals="m", rate=500),
    "epoch_ms240.csv --option time_unit=ms": Expected(individuals="m", rate=240),
    "time_is_frames.csv --option frame=time --fps 25": Expected(individuals="m", rate=25),
    "d_minus1.csv --fps 30": Expected(
        individuals="animal0", rate=30, extent=97.64, prints=("(-1, -1) (10 points)",)
    ),
    "miss_9999.csv --fps 25": Expected(
        individuals="0 1", rate=25, extent=169.9, prints=("(9999, 9999) (60 points)",)
    ),
    "zeros.csv --fps 25": Expected(
        individuals="a b", rate=25, prints=("(0, 0) (60 points)",)
    ),
    "box1.csv --fps 25": Expected(
        individuals="individual_0", rate=25, extent=169.873, prints=("the edges of a box",)
    ),
    "box2.csv --fps 25": Expected(
        individuals="individual_0", rate=25, extent=169.873, prints=("the edges of a box",)
    ),
    "s_points.csv --fps 30 --target none": Expected(
        individuals="m0 m1", rate=30, extent=211.427, prints=("individual: head, tail",)
    ),
    "s_frames.csv --fps 30 --target none": Expected(
        individuals="m0 m1", rate=30, extent=211.427, prints=("individual: head, tail",)
    ),
    "parts.csv --fps 30": Expected(
        individuals="individual_0", rate=30, extent=169.873, prints=("nose, tailbase",)
    ),
    "arena_long2.csv --fps 25 --target none": Expected(
        individuals="animal_0 animal_1", rate=25, recordings=2, extent=33.9745
    ),
    "dash_pairs.csv --fps 25 --target none --arena rectangle=.5": Expected(
        individuals="a c", rate=25, prints=("wall at 0,0.5 and wall at ",)
    ),
    "dash_pairs.csv --fps 25 --target none --arena ring=0.1 --obstacle .5,0,.2 "
    "--landmark a=0,1 --landmark b=.5,.2": (
        Expected(
            individuals="a c", rate=25, prints=(" 0,0,0.1 and 0.5,0,0.2", "landmarks a, b")
        )
    ),
    "dash_pairs.csv --fps 25 --target none": Expected(individuals="a c", rate=25, extent=29.25),
    "mate.csv --fps 25 --target none": Expected(
        individuals="individual_0 mate", rate=25, extent=29.25
    ),
    "german_blank_line.csv --fps 25": Expected(individuals="m", rate=25, extent=29.5),
    "velocity_columns.csv --fps 25 --target none": Expected(
        individuals="male female", rate=25, prints=("not used: vel_x, vel_y",)
    ),
    "spread_columns.csv --fps 25 --target none": Expected(
        individuals="male female", rate=25, prints=("not used: x_std, y_std",)
    ),
    "gps.csv --target none": Expected(
        individuals="lion0 lion1 lion2", rate=1 / 60, unit="m", extent=277.988,
        prints=("degrees: projected to metres", "not used: event-id"),
    ),
}  # fmt: skip
REFUSED: dict[str, tuple[str, ...]] = {
    "ft-track.mat": ("frame rate", "--fps"),
    "once_each.csv --fps 25": ("no animal is seen in two frames",),
    "ft_min.csv": ("1500 frames/s", "--option time_unit=min (25 frames/s)"),
    "ms500.csv": ("0.5 frames/s", "--option time_unit=ms (500 frames/s)"),
    "epoch_ms240.csv": ("no unit is stated", "--option time_unit=ms (239.8 frames/s)"),
    "time_is_frames.csv": ("1 frames/s", "--option frame=time --fps"),
}


def run_import(command: str, out: Path) -> tuple[int, str]:
    """Return the exit code of an import and what it printed, blanks as one."""
    words = shlex.split(command)
    words = [str(FILES / word) if (FILES / word).is_file() else word for word in words]
    try:
        return 0, " ".join(animarl("import", *words, "--out", out).split())
    except InputError as error:  # of which main makes the sentence and exit code 2
        return 2, str(error)


@pytest.mark.parametrize("command", CASES)
def test_small_files_are_read_as_what_they_are(command: str, tmp_path: Path) -> None:
    expected = CASES[command]
    code, printed = run_import(command, tmp_path / "demos.npz")
    assert code == 0, printed
    demos = read(tmp_path / "demos.npz")
    assert " ".join(demos.individuals) == expected.individuals
    assert 1 / demos.dt == pytest.approx(expected.rate, rel=1e-9)
    scales = demos.provenance["scales"]
    assert len(scales) == expected.recordings
    if expected.extent is not None:
        extents = [scale["unit"] for scale in scales.values()]
        np.testing.assert_allclose(extents, expected.extent, rtol=1e-3)
    assert expected.unit in (None, demos.provenance["unit"])
    assert expected.frames in (None, demos.lengths.sum())
    for words in expected.prints:
        assert words in printed


@pytest.mark.parametrize("command", REFUSED)
def test_small_files_are_refused_with_a_remedy(command: str, tmp_path: Path) -> None:
    code, printed = run_import(command, tmp_path / "demos.npz")
    assert code == 2 and not (tmp_path / "demos.npz").exists()
    for words in REFUSED[command]:
        assert words in printed
