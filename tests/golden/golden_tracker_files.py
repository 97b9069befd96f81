# ruff: noqa: E501  (a case a line)
"""Damaged files of trackers, and files that are imported to the end, for the golden table."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from golden_table_files import RATE, ROUNDED, Case, Write, archive, text

from tools.fuzz.layouts import (
    KINDS,
    POSE,
    agents_arrays,
    dlc_frame,
    write_analysis,
    write_authors_silkmoth,
    write_dlc_csv,
    write_dlc_h5,
    write_idtracker_h5,
    write_mothvr,
    write_slp,
)


def lines_changed(make: Write, change: Callable[[list[str]], list[str]]) -> Write:
    def write(folder: Path) -> Path:
        path = make(folder)
        path.write_text("\n".join(change(path.read_text().splitlines())) + "\n")
        return path

    return write


def hdf_changed(make: Write, change: Callable[[Any], None]) -> Write:
    def write(folder: Path) -> Path:
        path = make(folder)
        with h5py.File(path, "r+") as file:
            change(file)
        return path

    return write


def without(column: str, header: int) -> Callable[[list[str]], list[str]]:
    """Drop the first column of this name in a line of the header."""

    def change(rows: list[str]) -> list[str]:
        cells = [row.split(",") for row in rows]
        at = cells[header].index(column)
        return [",".join(row[:at] + row[at + 1 :]) for row in cells]

    return change


def set_field(key: str, column: str, value: int | None, row: int = 30) -> Callable[[Any], None]:
    """Write a value into a row of a table, by default that of its first row."""

    def change(file: Any) -> None:
        rows = file[key][()]
        rows[column][row] = rows[column][0] if value is None else value
        file[key][...] = rows

    return change


def single_animal(folder: Path) -> Path:
    single = dlc_frame()["net"]["male"]
    lines = [
        "scorer," + ",".join(["net"] * 6), "bodyparts," + ",".join(p for p, _ in single.columns),
        "coords," + ",".join(c for _, c in single.columns),
        *(f"{t}," + ",".join(map(repr, row)) for t, row in enumerate(single.to_numpy().tolist())),
    ]  # fmt: skip
    return text("\n".join(lines) + "\n", "pose.csv")(folder)


def anipose(folder: Path) -> Path:
    header = "head_x,head_y,head_z,head_score,head_error,head_ncams,fnum"
    rows = [f"{x!r},{y!r},0,0.9,0.1,2,{t}" for t, (x, y) in enumerate(ROUNDED[:, 0].tolist())]
    return text("\n".join([header, *rows]) + "\n", "anipose.csv")(folder)


def of_trackers() -> Iterator[Case]:
    yield Case("deeplabcut, one animal", single_animal)
    yield Case(
        "LightningPose", single_animal, "movement", {"software": "LightningPose", "fps": 25.0}
    )
    yield Case("Anipose", anipose, "movement", {"software": "Anipose", "fps": 25.0})
    for word, change in {
        "a frame missing": lambda rows: rows[:14] + rows[15:],
        "a frame twice": lambda rows: rows[:14] + rows[13:],
        "frames swapped": lambda rows: [*rows[:9], rows[10], rows[9], *rows[11:]],
        "the first frame missing": lambda rows: rows[:4] + rows[5:],
        "no frames": lambda rows: rows[:4] + ["," + row.partition(",")[2] for row in rows[4:]],
        "names of frames": lambda rows: rows[:4] + [f"img{row}" for row in rows[4:]],
        "gaps": lambda rows: [*rows[:9], "5" + "," * 12, *rows[10:]],
        "a word": lambda rows: [*rows[:9], rows[9].replace(".", "x", 1), *rows[10:]],
        "truth values": lambda rows: [*rows[:9], "5" + ",True" * 12, *rows[10:]],
    }.items():
        for source in ("deeplabcut", "movement"):
            options = {"fps": 25.0}
            yield Case(f"{source}, {word}", lines_changed(write_dlc_csv, change), source, options)
    for lost in ("x", "y"):
        yield Case(f"deeplabcut, no {lost}", lines_changed(write_dlc_csv, without(lost, 3)))
    for table, column, value in (
        ("instances", "instance_id", None), ("frames", "frame_id", None), ("instances", "frame_id", 10**6)
    ):  # fmt: skip
        yield Case(
            f"slp, {column} of {table} {value or 'twice'}",
            hdf_changed(write_slp, set_field(table, column, value)),
        )
    yield Case(
        "dlc h5, a frame of another number",
        hdf_changed(write_dlc_h5, set_field("df_with_missing/table", "index", 70, 7)),
    )
    scores = {"other": np.ones((2, 2)), "one": np.ones((2, 2, 39)), "words": np.array([b"a"])}
    for word, wrong in scores.items():

        def replace_scores(file: Any, wrong: Any = wrong) -> None:
            del file["point_scores"]
            file["point_scores"] = wrong

        yield Case(f"analysis, {word} scores", hdf_changed(write_analysis, replace_scores))
    yield Case(
        "analysis, no scores", hdf_changed(write_analysis, lambda file: file.pop("point_scores"))
    )
    yield Case("slp, few frames", lambda folder: write_slp(folder, POSE[:3]))
    yield Case("slp, gaps", lambda folder: write_slp(folder, with_gap(POSE)))

    def links(file: Any) -> None:
        file["more"] = h5py.ExternalLink("secret.h5", "/bodies")

    yield Case("hdf5, a link", hdf_changed(write_idtracker_h5, links))
    yield Case(
        "hdf5, no rate", hdf_changed(write_idtracker_h5, lambda file: file.attrs.pop("frames_per_second"))
    )  # fmt: skip
    yield Case(
        "dlc h5, other key",
        hdf_changed(write_dlc_h5, lambda file: file.move("df_with_missing", "tracks")),
    )
    yield Case(
        "mothvr, a frame missing", lines_changed(write_mothvr, lambda rows: rows[:9] + rows[10:])
    )
    for word, change in {
        "a frame missing": lambda rows: rows[:9] + rows[10:],
        "a frame twice": lambda rows: rows[:10] + rows[9:],
        "frames swapped": lambda rows: [*rows[:5], rows[6], rows[5], *rows[7:]],
        "begun late": lambda rows: rows[3:],
    }.items():
        yield Case(f"authors-silkmoth, {word}", lines_changed(write_authors_silkmoth, change))
    agents = agents_arrays()
    gap = agents["pos"].copy()
    gap[8, 1] = np.nan
    empty = {key: agents[key][:0] for key in ("pos", "actions", "n_steps", "outcome")}
    for word, changes in {
        "dt": {"meta": np.array('{"cond": "x_share", "dt": 0}')}, "action": {"actions": np.full((17, 3), 99)},
        "steps": {"n_steps": np.array([0, 8, 9])}, "frames": {"pos": np.zeros((19, 3, 2))},
        "gap": {"pos": gap}, "no frames": empty, "one individual": {"pos": agents["pos"][:, :1]},
        "outside": {"pos": agents["pos"] * 100}, "twice": {"pos": agents["pos"][:, [0, 0, 2]]},
        "meta": {"meta": np.array("x")}, "pickle": {"pos": np.array([{"a": 1}], dtype=object)},
    }.items():  # fmt: skip
        yield Case(f"agents, {word}", archive(**(agents | changes)), "agents")


def with_gap(pose: Any) -> Any:
    out = pose.copy()
    out[7:9, 0] = np.nan
    return out


def chases(folder: Path) -> Path:
    """Six recordings that end by contact, one of which jumps and one of which has a gap."""
    rng = np.random.default_rng(4)
    lines = ["recording,frame,id,x,y"]
    for number_of_recording in range(6):
        hare = 300 + np.cumsum(rng.normal(0, 2, (40, 2)), axis=0)
        hunter = hare + np.linspace(90, 8, 40)[:, None] * [np.cos(number_of_recording), 0.5]
        for t in range(40):
            for who, (x, y) in (("hunter", hunter[t]), ("hare", hare[t])):
                lost = number_of_recording == 2 and 10 <= t < 12 and who == "hare"
                cells = ",," if lost else f",{x:.4f},{y:.4f}"
                lines.append(f"sham_{number_of_recording},{t},{who}{cells}")
    return text("\n".join(lines) + "\n", "chases.csv")(folder)


RECIPES: dict[str, dict[str, Any]] = {
    "plain": {}, "target": {"target": "hare"}, "auto": {"target": "auto"},
    "pursuer": {"pursuer": "hunter"}, "thinned": {"target": "hare", "decision_rate": 10.0},
    "resampled": {"target": "hare", "decision_rate": 7.0},
    "smoothed": {"target": "hare", "cleaning": {"smoothing_cutoff": 2.0}},
    "filled": {"target": "hare", "cleaning": {"max_gap": 0.2}},
    "jumps": {"target": "hare", "cleaning": {"drop_jumps": True}},
    "approach": {"target": "hare", "cutting": {"mode": "approach", "farther_than": 0.3, "closer_than": 0.2}},
    "contact": {"target": "hare", "cutting": {"contact": 0.2}},
    "pieces": {"target": "hare", "cutting": {"piece": 0.5}},
    "short": {"target": "hare", "cutting": {"shortest": 1.2, "keep_last": 1.3}},
    "disc": {"target": "hare", "scaling": {"shape": "disc", "each": True}},
    "centimetres": {"target": "hare", "scaling": {"shape": "open", "px_per_cm": 10.0}},
    "names": {"name_pattern": r"sham_(?P<condition>[01])", "target": "hare"},
    "chosen": {"individuals": ["hare", "hunter"], "rename": {"hare": "prey"}, "target": "prey"},
    "kept": {"target": "hare", "decision_rate": 5.0, "keep_last_frame": True},
    "nobody": {"target": "cat"}, "one pattern": {"name_pattern": "(?P<condition>x)"},
}  # fmt: skip


def of_recipes() -> Iterator[Case]:
    for word, entries in RECIPES.items():
        yield Case(f"recipe, {word}", chases, None, {"frame_rate": RATE} | entries, whole=True)
    for name, kind in KINDS.items():
        if name not in ("native", "minari", "agents"):
            options = {"frame_rate": RATE} if kind.source != "trex" else {}
            yield Case(f"import of {name}", kind.write, kind.source, options, whole=True)
