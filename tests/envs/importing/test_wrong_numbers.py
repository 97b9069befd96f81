"""No wrong number: what would be read as other numbers, or at other times, is refused and said."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from refusals import refuses

from animarl_envs.errors import InputError
from animarl_envs.importing.cutting import Cutting
from animarl_envs.importing.import_recipe import ImportRecipe
from animarl_envs.importing.readers import follow, read, read_tracks
from tools.fuzz.layouts import (
    BODIES,
    KINDS,
    write_authors_silkmoth,
    write_dlc_csv,
    write_dlc_h5,
    write_termites,
    write_wide,
)

Lines = Callable[[list[str]], list[str]]

SHIFTED: dict[str, tuple[Lines, str]] = {
    "gap": (lambda rows: rows[:10] + rows[11:], "line 15 is of frame 11, not 10"),
    "repeat": (lambda rows: rows[:10] + rows[9:], "line 15 is of frame 9, not 10"),
    "swap": (lambda rows: [*rows[:5], rows[6], rows[5], *rows[7:]], "of frame 6, not 5"),
    "first": (lambda rows: rows[1:], "line 5 is of frame 1, not 0"),
    "no frame": (lambda rows: ["," + row.partition(",")[2] for row in rows], "of frame nan, not 0"),
    "names": (lambda rows: [f"img{row}" for row in rows], "is no number"),
}  # fmt: skip


@pytest.mark.parametrize("source", ["deeplabcut", "movement"])
@pytest.mark.parametrize("kind", SHIFTED)
def test_wrong_number_of_a_deeplabcut_frame_is_refused(
    kind: str, source: str, tmp_path: Path
) -> None:
    change, message = SHIFTED[kind]
    path = write_dlc_csv(tmp_path)
    lines = path.read_text().splitlines()
    path.write_text("\n".join([*lines[:4], *change(lines[4:])]) + "\n")
    refuses(message, read_tracks, path, source, fps=25.0)


def test_wrong_number_of_a_frame_in_deeplabcut_hdf5_is_refused(tmp_path: Path) -> None:
    import h5py

    path = write_dlc_h5(tmp_path)
    with h5py.File(path, "r+") as file:
        table = file["df_with_missing/table"]
        rows = table[()]
        rows["index"][7] = 70
        table[...] = rows
    refuses("of frame 70, not 7", read_tracks, path)


@pytest.mark.parametrize("lost", ["x", "y"])
def test_wrong_number_of_coordinates_of_a_body_part_is_refused(lost: str, tmp_path: Path) -> None:
    path = write_dlc_csv(tmp_path)
    lines = path.read_text().splitlines()
    place = lines[3].split(",").index(lost)
    path.write_text(
        "\n".join(
            ",".join(cell for i, cell in enumerate(line.split(",")) if i != place) for line in lines
        )
        + "\n"
    )
    refuses("not x, y and likelihood", read_tracks, path)


@pytest.mark.parametrize("lost", ["x_male", "y_male", "x_female", "y_female"])
@pytest.mark.parametrize("style", ["{0}_{1}", "{1}_{0}", "{0}{1}", "{0}.{1}"])
def test_wrong_number_of_coordinates_in_a_wide_table_is_refused(
    lost: str, style: str, tmp_path: Path
) -> None:
    """An animal with one of its two columns was left out in silence."""
    path = write_wide(tmp_path)
    lines = path.read_text().splitlines()
    names = lines[0].split(",")
    other = names.index(lost)
    lines[0] = ",".join(
        "z" if i == other else style.format(*name.split("_")) for i, name in enumerate(names)
    )
    path.write_text("\n".join(lines) + "\n")
    refuses("and no '", read_tracks, path, "wide-table")


@pytest.mark.parametrize("kind", ["gap", "repeat", "swap"])
def test_rows_of_a_wide_table_are_of_the_frames_that_they_name(kind: str, tmp_path: Path) -> None:
    path = write_wide(tmp_path)
    head, *rows = path.read_text().splitlines()
    rows = [f"{t + 5},{row}" for t, row in enumerate(rows)]
    path.write_text("\n".join([f"frame,{head}", *rows]) + "\n")
    (tracks,) = read_tracks(path)
    np.testing.assert_array_equal(tracks.bodies[5:], BODIES)
    assert np.isnan(tracks.bodies[:5]).all()
    kept = SHIFTED[kind][0](rows)
    path.write_text("\n".join([f"frame,{head}", *kept]) + "\n")
    if kind == "repeat":
        refuses("has two rows", read_tracks, path)
        return
    seen = np.isin(rows, kept)
    (tracks,) = read_tracks(path)
    np.testing.assert_array_equal(tracks.bodies[5:], np.where(seen[:, None, None], BODIES, np.nan))


TEXTS = sorted(name for name, kind in KINDS.items() if kind.guard == "text")


@pytest.mark.parametrize("name", TEXTS)
def test_wrong_number_at_the_end_of_a_cut_text_is_refused(name: str, tmp_path: Path) -> None:
    """Cut anywhere in the last number, and right behind it."""
    kind = KINDS[name]
    path = kind.write(tmp_path)
    whole = path.read_bytes().rstrip(b"\r\n")
    for lost in range(4):
        path.write_bytes(whole[: len(whole) - lost])
        refuses(r"its last line does not end|cells, the header", read_tracks, path, kind.source)


def test_wrong_number_at_the_end_of_tables_beside_is_refused(tmp_path: Path) -> None:
    path = write_termites(tmp_path)
    index = tmp_path / "index.csv"
    index.write_text(index.read_text().rstrip("\n")[:-1])
    refuses("last line does not end", read_tracks, path)
    events = tmp_path / "events.csv"
    events.write_text("recording,start,end\nwide,0,1.5")
    recipe = ImportRecipe(frame_rate=20.0, cutting=Cutting(mode="events", events=str(events)))
    refuses("last line does not end", follow, recipe, [write_wide(tmp_path)])


def test_wrong_number_of_rows_without_a_header_is_refused(tmp_path: Path) -> None:
    """A table of numbers alone lost its first row to the header."""
    path = write_authors_silkmoth(tmp_path)
    other = path.rename(tmp_path / "other.csv")
    first = other.read_text().splitlines()[0].split(",")
    pair = {"moth": [first[1], first[3]]}
    refuses("first line holds numbers, not names", read_tracks, other, "wide-table", columns=pair)
    with pytest.raises(InputError, match="first line holds numbers, not names"):
        read_tracks(other, "movement", software="Anipose")


@pytest.mark.parametrize("kind", ["gap", "repeat", "swap"])
def test_wrong_number_of_a_frame_of_the_authors_moths_is_refused(kind: str, tmp_path: Path) -> None:
    path = write_authors_silkmoth(tmp_path)
    rows = path.read_text().splitlines()
    assert len(read(path).positions) == 4
    path.write_text("\n".join(SHIFTED[kind][0](rows)) + "\n")
    refuses(r"line \d+ is at .* give every frame", read_tracks, path)
    path.write_text("\n".join(rows[3:]) + "\n")
    refuses(r"line 1 is at 0\.1 s", read_tracks, path)


def test_wrong_number_kinds_of_matlab_are_refused(tmp_path: Path) -> None:
    """Doubles whose bits are said to be whole numbers; whole ones stored as doubles are right."""
    path = KINDS["mat"].write(tmp_path)
    raw = path.read_bytes()
    data = raw.index(b"bodies") + 8
    assert raw[data] == 9  # the tag of doubles
    path.write_bytes(raw[:data] + bytes([12]) + raw[data + 1 :])
    refuses("the position exceeds", read_tracks, path)
    flags = raw.index(bytes([6, 0, 0, 0, 8, 0, 0, 0])) + 8
    assert raw[flags] == 6  # the class of doubles
    path.write_bytes(raw[:flags] + bytes([14]) + raw[flags + 1 :])
    np.testing.assert_array_equal(read_tracks(path)[0].bodies, BODIES)


@pytest.mark.parametrize(
    "table, field, message",
    [
        ("instances", "instance_id", "two of its instances have one number"),
        ("frames", "frame_id", "two of its frames have one number"),
        ("instances", "frame_id", "an instance is of no frame"),
    ],
)
def test_wrong_number_of_a_sleap_instance_is_refused(
    table: str, field: str, message: str, tmp_path: Path
) -> None:
    import h5py

    path = KINDS["slp"].write(tmp_path)
    with h5py.File(path, "r+") as file:
        rows = file[table][()]
        rows[field][30] = rows[field][0] if "two" in message else 10**6
        file[table][...] = rows
    refuses(message, read_tracks, path)


# -- times, signs and truth values of tables -------------------------------------------------------


def long_table(path: Path, clocks: list[str], x: list[str], head: str = "time;id;x;y") -> Path:
    rows = [f"{clock};a;{value};2" for clock, value in zip(clocks, x, strict=True)]
    path.write_text("\n".join([head, *rows]) + "\n")
    return path


def test_wrong_number_of_seconds_of_a_clock_with_decimal_commas(tmp_path: Path) -> None:
    """``0:00:00,040`` was read as 40 s."""
    clocks = [f"0:00:0{t // 25},{t % 25 * 40:03d}" for t in range(50)]
    x = [f"{t / 4}" for t in range(50)]
    (tracks,) = read_tracks(long_table(tmp_path / "t.csv", clocks, x))
    assert tracks.frame_rate == 25.0 and len(tracks) == 50
    (wide,) = read_tracks(long_table(tmp_path / "w.csv", clocks, x, "time;z;x_a;y_a"))
    assert wide.frame_rate == 25.0
    isos = [f"2024-05-01T10:{clock[2:]}" for clock in clocks]
    (tracks,) = read_tracks(long_table(tmp_path / "i.csv", isos, x, "timestamp;id;x;y"))
    assert tracks.frame_rate == 25.0 and tracks.start == 36_000.0


@pytest.mark.parametrize("separator", [";", "\t", "|", " "])
def test_wrong_number_of_thousands_is_refused(separator: str, tmp_path: Path) -> None:
    """``1,000`` beside ``996`` became 1.0."""
    path, clocks = tmp_path / "t.csv", [str(t) for t in range(12)]

    def write(x: list[str]) -> None:
        long_table(path, clocks, x, "frame;id;x;y")
        path.write_text(path.read_text().replace(";", separator))

    write([f"{980 + 4 * t:,}" for t in range(12)])
    refuses(r"1,000 may be 1000 or 1\.000: write", read_tracks, path, "long-table")
    (tracks,) = read_tracks(path, "long-table", decimal=",")
    assert tracks.bodies[5, 0, 0] == 1.0
    write([f"{1000 + 4 * t:,}" for t in range(12)])
    refuses("may be 1000 or", read_tracks, path, "long-table")
    write([f"{980 + 4 * t:,}".replace(",", ".") for t in range(12)])
    refuses(r"1\.000 may be 1000 or", read_tracks, path, "long-table")
    write([f"{t + 0.125:.3f}".replace(".", ",") for t in range(12)])  # 0,125 parts no thousands
    (tracks,) = read_tracks(path, "long-table")
    assert tracks.bodies[1, 0, 0] == 1.125


def test_wrong_number_of_times_that_go_back_is_refused(tmp_path: Path) -> None:
    """Past midnight and at the end of daylight saving they were sorted, hours apart."""
    x = [f"{t / 4}" for t in range(50)]
    midnight = [f"{(86_390 + t) % 86_400 // 3600}:{(86_390 + t) // 60 % 60:02d}:{t % 60:02d}"
                for t in range(50)]  # fmt: skip
    saving = [f"2024-10-27 02:{59 - (t >= 30)}:{t % 30 + 10:02d}" for t in range(50)]
    for clocks in (midnight, saving):
        path = long_table(tmp_path / "t.csv", clocks, x)
        refuses("is earlier than the one before", read_tracks, path)


def test_wrong_number_of_truth_values_is_refused(tmp_path: Path) -> None:
    clocks = [str(t) for t in range(12)]
    path = long_table(tmp_path / "t.csv", clocks, ["True", "False"] * 6, "frame;id;x;y")
    refuses("line 2, column 'x' holds 'True', which is no number", read_tracks, path)
    (tracks,) = read_tracks(long_table(path, clocks, ["1", "0"] * 6, "frame;id;x;y"))
    assert tracks.bodies[:2, 0, 0].tolist() == [1.0, 0.0]


def test_short_stretches_are_counted_and_do_not_hide_the_contact(tmp_path: Path) -> None:
    """Thirteen of one step each were dropped without a word, and no contact was found."""
    rng, lines = np.random.default_rng(0), ["recording,frame,id,x,y"]
    for number in range(8):
        near = np.concatenate([rng.uniform(20, 90, 29), [5.0]])
        for t, gap in enumerate(near):
            lines += [f"r{number},{t},hare,0,0", f"r{number},{t},hunter,{gap},{t % 3}"]
        for start in (40, 50):  # two frames in which both are seen
            for t in (start, start + 1):
                lines += [f"r{number},{t},hare,0,0", f"r{number},{t},hunter,70,{t % 3}"]
    path = tmp_path / "t.csv"
    path.write_text("\n".join(lines) + "\n")
    demos = read(path, frame_rate=25.0, target="hare")
    assert demos.num_episodes == 8 and (demos.outcome == 1).all()
    assert all(one["too_short"] == 2 for one in demos.provenance["cleaning"].values())
