"""Files of strangers run no code, point nowhere, and ask for no more than they may.

A planted pickle writes a marker file when it is opened; none may be there afterwards.
"""

import base64
import io
import json
import os
import pickle
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import yaml
from refusals import refused, refuses

from animarl_algos.learner.checkpoint import load_tensors
from animarl_algos.learner.presets import read_file
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.files import parse_yaml, read_npz, read_yaml
from animarl_envs.importing.import_recipe import ImportRecipe
from animarl_envs.importing.plain_pickle import load_plain
from animarl_envs.importing.readers import available_readers, read, read_tracks
from tools.fuzz.layouts import (
    write_analysis,
    write_authors_newt,
    write_dlc_csv,
    write_dlc_h5,
    write_idtracker_h5,
    write_mat73,
    write_minari,
    write_native,
    write_termites,
)


class Planted:
    """Touches a file when it is unpickled."""

    def __init__(self, marker: Path) -> None:
        self.marker = marker

    def __reduce__(self) -> tuple[Any, ...]:
        return Path.touch, (self.marker,)


@pytest.fixture
def marker(tmp_path: Path) -> Any:
    place = tmp_path / "the code ran"
    pickle.loads(pickle.dumps(Planted(place)))
    assert place.exists(), "the plant does not work"
    place.unlink()
    yield place
    assert not place.exists(), "code of the file has run"


@pytest.mark.parametrize("attribute", ["TITLE", "info", "non_index_axes"])
@pytest.mark.parametrize("source", ["deeplabcut", "movement", None])
def test_a_pickle_in_an_attribute_of_foreign_hdf5_does_not_run(
    attribute: str, source: str | None, tmp_path: Path, marker: Path
) -> None:
    path = write_dlc_h5(tmp_path)
    raw = pickle.dumps(Planted(marker), protocol=0)
    with h5py.File(path, "r+") as file:
        file["df_with_missing"].attrs[attribute] = np.bytes_(raw)
    if source == "movement":
        assert "deeplabcut" in refused(path, source, fps=25.0)
    elif attribute == "non_index_axes":
        assert "pickle" in refused(path, source, fps=25.0)
    else:
        (tracks,) = read_tracks(path, source, fps=25.0)  # nobody looks at them
        assert tracks.individuals == ("male", "female")


@pytest.mark.parametrize("name", ["track.h5", "track.hdf5", "track.nwb", "track.slp", "t.csv"])
def test_no_foreign_hdf5_goes_through_movement(name: str, tmp_path: Path) -> None:
    write_analysis(tmp_path).rename(tmp_path / name)
    for software in ("DeepLabCut", "SLEAP", "NWB", "Anipose", "LightningPose", "VIA-tracks"):
        assert "only .csv" in refused(tmp_path / name, "movement", software=software)


def test_movement_takes_no_other_software_for_a_foreign_table(tmp_path: Path) -> None:
    path = write_dlc_csv(tmp_path)
    for software in ("NWB", "SLEAP", "nonsense"):
        assert "writes no table" in refused(path, "movement", software=software)


def planted_npy(marker: Path) -> bytes:
    stream = io.BytesIO()
    np.save(stream, np.array([Planted(marker)], dtype=object), allow_pickle=True)
    return stream.getvalue()


@pytest.mark.parametrize("source", [None, *(r.name for r in available_readers())])
def test_a_pickle_in_a_foreign_array_does_not_run(
    source: str | None, tmp_path: Path, marker: Path
) -> None:
    """Through every reader, whatever the file is called."""
    raw = planted_npy(marker)
    for name in ("trajectories.npy", "state_m1_data0.npz", "data.npz", "demos.npz", "a.csv"):
        path = tmp_path / name
        if path.suffix == ".npz":
            with zipfile.ZipFile(path, "w") as archive:
                for member in ("states", "actions", "rewards", "pos", "frame", "X", "meta"):
                    archive.writestr(f"{member}.npy", raw)
        else:
            path.write_bytes(raw)
        refused(path, source)
    refuses("pickle", Demonstrations.load, tmp_path / "demos.npz")
    refuses("pickle", read_npz, tmp_path / "demos.npz")


@pytest.mark.parametrize("protocol", range(6))
def test_a_foreign_pickle_does_not_run(protocol: int, tmp_path: Path, marker: Path) -> None:
    for raw in (
        pickle.dumps(Planted(marker), protocol),
        pickle.dumps({"a": [Planted(marker)]}, protocol),
        pickle.dumps(np.array([Planted(marker)], dtype=object), protocol),
    ):
        refuses("pickle", load_plain, raw, "file")
        (tmp_path / "model.zip").write_bytes(raw)
        refused(tmp_path / "model.zip")


def test_foreign_metadata_of_minari_names_no_code(tmp_path: Path, marker: Path) -> None:
    """Neither its environment nor its spaces are made; its format is not followed."""
    path = write_minari(tmp_path)
    clean = read(path).fingerprint()
    file = path.parent / "metadata.json"
    record = json.loads(file.read_text())
    record["env_spec"] = json.dumps({"id": "x", "entry_point": "os:system"})
    record |= {"data_format": "arrow", "observation_space": "{", "requirements": ["nonsense"]}
    file.write_text(json.dumps(record))
    assert read(path).fingerprint() == clean


def test_a_zip_of_a_model_is_no_foreign_data(tmp_path: Path, marker: Path) -> None:
    """As stable-baselines3 writes them; opened as a model it would run (see SECURITY.md)."""
    entry = base64.b64encode(pickle.dumps(Planted(marker))).decode()
    for name in ("model.zip", "model.npz"):
        with zipfile.ZipFile(tmp_path / name, "w") as archive:
            archive.writestr("data", json.dumps({"policy_class": {":serialized:": entry}}))
            archive.writestr("pytorch_variables.pth", pickle.dumps(Planted(marker)))
        for source in (None, "animarl", "numpy", "agents", "trex"):
            refused(tmp_path / name, source)


def test_tensors_of_a_foreign_checkpoint_run_nothing(tmp_path: Path, marker: Path) -> None:
    import torch

    file = tmp_path / "model.pt"
    torch.save({"weights": Planted(marker)}, file)
    with pytest.raises(ValueError, match="no whole archive of tensors"):
        load_tensors(file)


EVIL_YAML = "a: !!python/object/apply:pathlib.Path.touch [!!python/object/apply:pathlib.Path [{}]]"


def test_foreign_yaml_runs_nothing(tmp_path: Path, marker: Path) -> None:
    file = tmp_path / "evil.yml"
    file.write_text(EVIL_YAML.format(yaml.safe_dump(str(marker)).splitlines()[0]))
    for opened in (ImportRecipe.load, read_yaml, read_file):
        refuses("not valid YAML", opened, file)


def test_foreign_yaml_stays_as_small_as_it_is(tmp_path: Path) -> None:
    lines = ["a0: &a0 [x, x]"]
    lines += [f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]" for i in range(1, 30)]
    for text in ("\n".join(lines), "[" * 100_000, "a: 1e999999999999", "? [a]\n: 1", "a: 1" * 99):
        (tmp_path / "r.yaml").write_text(text)
        refuses("", ImportRecipe.load, tmp_path / "r.yaml")
    (tmp_path / "r.yaml").write_text("#" * 2**20)
    refuses("longer than", read_yaml, tmp_path / "r.yaml")
    assert parse_yaml("a: &x [1]\nb: *x", "t") == {"a": [1], "b": [1]}


def test_foreign_yaml_gives_each_key_once() -> None:
    for text, said in (
        ("a: 1\nb: 2\na: 3", "t: line 3: key 'a' was given in line 1 already"),
        ("a: [{b: 1,\n 'b': 2}]", "t: line 2: key 'b' was given in line 1 already"),
    ):
        refuses(said, parse_yaml, text, "t")
    merged = parse_yaml("a: &a {x: 1, y: 2}\nb: &b {<<: *a, x: 3}\nc: {<<: *b, y: 4}", "t")
    assert merged["b"] == {"x": 3, "y": 2} and merged["c"] == {"x": 3, "y": 4}
    assert parse_yaml("", "t") is None


def header_of_many_columns(path: Path) -> None:
    names = ",".join(f"x_{i},y_{i}" for i in range(50_000))
    path.with_suffix(".csv").write_text(names + "\n" + ",".join("0" * 100_000) + "\n")


def parquet_of_many_columns(path: Path) -> None:
    column = pa.array([0.0])
    table = pa.table({f"x_{i}": column for i in range(20_000)})
    pq.write_table(table, path.with_suffix(".parquet"))


def parquet_dictionary(path: Path) -> None:
    """A text of a megabyte, said once, to which 4,000 rows refer."""
    rows = 4000
    ids = pa.DictionaryArray.from_arrays(pa.array([0] * rows, pa.int32()), ["a" * 700_000])
    columns = {"frame": np.arange(rows), "id": ids, "x": np.zeros(rows), "y": np.zeros(rows)}
    pq.write_table(pa.table(columns), path.with_suffix(".parquet"), compression="none")


def hdf5_of_nothing(path: Path) -> None:
    with h5py.File(path.with_suffix(".h5"), "w") as file:
        shape = (200_000_000, 1, 2)
        file.create_dataset("trajectories", shape, "i1", chunks=(2**20, 1, 2), compression="gzip")


def npz_bomb(path: Path) -> None:
    with zipfile.ZipFile(path.with_suffix(".npz"), "w", zipfile.ZIP_DEFLATED) as archive:
        stream = io.BytesIO()
        np.save(stream, np.zeros(40_000_000))
        archive.writestr("positions.npy", stream.getvalue())
        for name in ("lengths", "initial_velocity", "meta"):
            archive.writestr(f"{name}.npy", stream.getvalue()[:64])


BOMBS = (
    header_of_many_columns, parquet_of_many_columns, parquet_dictionary, hdf5_of_nothing, npz_bomb,
)  # fmt: skip


@pytest.mark.parametrize("write", BOMBS, ids=lambda write: write.__name__)
def test_foreign_files_ask_for_no_more_than_they_may(
    write: Callable[[Path], None], tmp_path: Path
) -> None:
    write(tmp_path / "bomb.x")
    (path,) = tmp_path.glob("bomb.*")
    if path.suffix == ".npz":
        refuses("times the file", Demonstrations.load, path)
    refused(path)


def circle(path: Path) -> None:
    path.symlink_to(path.with_name("other"))
    path.with_name("other").symlink_to(path)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no named pipes")
@pytest.mark.parametrize(
    "make", [lambda path: os.mkfifo(path), circle, lambda path: path.symlink_to("/dev/zero")]
)
@pytest.mark.parametrize("suffix", [".npz", ".npy", ".csv", ".parquet", ".h5", ".mat", ".yaml"])
def test_pipes_devices_and_endless_links_are_no_foreign_files(
    make: Callable[[Path], None], suffix: str, tmp_path: Path
) -> None:
    path = tmp_path / f"track{suffix}"
    make(path)
    message = "circle" if make is circle else "pipe or a device"
    assert message in refused(path)
    for opened in (Demonstrations.load, ImportRecipe.load):
        refuses(message, opened, path)


def test_pipes_beside_foreign_files_are_refused(tmp_path: Path) -> None:
    """Tables that a reader looks for by itself."""
    path = write_termites(tmp_path)
    assert read(path, "termites").provenance["files"] == [path.name]  # without its folder
    (tmp_path / "index.csv").unlink()
    os.mkfifo(tmp_path / "index.csv")
    assert "pipe" in refused(path)
    path = write_authors_newt(tmp_path)
    (tmp_path / "reward_m1_data0.npz").unlink()
    os.mkfifo(tmp_path / "reward_m1_data0.npz")
    assert "pipe" in refused(path)
    refuses("is a folder", Demonstrations.load, tmp_path)
    native = write_native(tmp_path)
    assert Demonstrations.load(native).num_episodes == 3


def external_link(file: Any, elsewhere: Path) -> None:
    file["more"] = h5py.ExternalLink(str(elsewhere), "/bodies")


def soft_link(file: Any, elsewhere: Path) -> None:
    file["more"] = h5py.SoftLink("/bodies")


def external_storage(file: Any, elsewhere: Path) -> None:
    file.create_dataset("more", (4, 2, 2), "f8", external=[(str(elsewhere), 0, 128)])


def virtual(file: Any, elsewhere: Path) -> None:
    layout = h5py.VirtualLayout((40, 2, 2), "f8")
    layout[:] = h5py.VirtualSource(str(elsewhere), "bodies", (40, 2, 2))
    file.create_virtual_dataset("more", layout)


def strange_float(file: Any, elsewhere: Path) -> None:
    kind = h5py.h5t.IEEE_F64LE.copy()
    kind.set_fields(63, 53, 10, 0, 53)  # a mantissa of one bit more
    kind.set_ebias(511)
    space = h5py.h5s.create_simple((4,))
    h5py.h5d.create(file.id, b"more", kind, space)


def strange_filter(file: Any, elsewhere: Path) -> None:
    file.create_dataset("more", (40, 2), "i4", chunks=(4, 2), scaleoffset=4)


POINTING: dict[str, tuple[Callable[[Any, Path], None], str]] = {
    "external link": (external_link, "link to elsewhere"),
    "soft link": (soft_link, "link to elsewhere"),
    "external storage": (external_storage, "stored in another file"),
    "virtual": (virtual, "virtual dataset"),
    "wrong_number": (strange_float, "numbers laid out unusually"),
    "filter": (strange_filter, "unusual filter"),
}


@pytest.mark.parametrize("kind", POINTING)
@pytest.mark.parametrize("write", [write_mat73, write_idtracker_h5, write_dlc_h5, write_analysis])
def test_foreign_hdf5_is_not_followed(
    kind: str, write: Callable[[Path], Path], tmp_path: Path
) -> None:
    secret = write_mat73(tmp_path).rename(tmp_path / "secret.h5")
    path = write(tmp_path)
    change, message = POINTING[kind]
    with h5py.File(path, "r+") as file:
        change(file, secret)
    source = {"new.mat": "matlab", "trajectories.h5": "idtracker", "dlc.h5": "deeplabcut"}
    assert message in refused(path, source.get(path.name, "sleap"))
