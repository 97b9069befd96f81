"""Episodes as NWB, where the package ``pynwb`` is installed."""

import json
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path

from animarl_envs.demos.episode import Episodes
from animarl_envs.demos.summary import Unit
from animarl_envs.errors import require_extra
from animarl_envs.files import write_then_rename

UNDATED = datetime(1970, 1, 1, tzinfo=UTC)  # NWB requires a time; episodes have none


def write_nwb(
    out: Path, episodes: Episodes, heads: Sequence[Mapping[str, object]], unit: Unit
) -> None:
    """Write each episode as a ``Position`` of the module ``behavior``, a series per individual.

    ``heads`` are notes on each episode, its ``recording`` among them; they stand as JSON in the
    comments of its series. Positions are in ``unit``, from the middle of the arena.
    """
    with require_extra("writing NWB", "nwb"):
        import h5py
        from pynwb import NWBHDF5IO, NWBFile
        from pynwb.behavior import Position, SpatialSeries
    file = NWBFile(
        session_description=f"{len(episodes)} episodes of {', '.join(episodes.individuals)}",
        identifier=out.stem,
        session_start_time=UNDATED,
        source_script_file_name="animarl",
        source_script="AnimaRL",
    )
    behavior = file.create_processing_module("behavior", "positions of individuals")
    for number, head in enumerate(heads):
        path = unit.per_arena_unit * episodes.path(number)
        series = [
            SpatialSeries(
                name=name,
                data=path[:, i],
                unit=unit.name,
                rate=1.0 / episodes.dt,
                starting_time=0.0,
                reference_frame="the middle of the arena is (0, 0), x to the right and y up",
                comments=json.dumps(head),
            )
            for i, name in enumerate(episodes.individuals)
        ]
        behavior.add(Position(name=f"episode_{number:04d}", spatial_series=series))
    with (
        write_then_rename(out) as part,
        h5py.File(part, "w", locking=False) as content,  # the part is locked already
        NWBHDF5IO(file=content, mode="w") as target,
    ):
        target.write(file)
