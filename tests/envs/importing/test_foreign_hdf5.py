"""HDF5 files of strangers point nowhere, and hold nothing that the library stumbles over."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from refusals import refused

from tools.fuzz.layouts import write_analysis, write_dlc_h5, write_idtracker_h5, write_mat73


def external_link(file: Any, elsewhere: Path) -> None:
    import h5py

    file["more"] = h5py.ExternalLink(str(elsewhere), "/bodies")


def soft_link(file: Any, elsewhere: Path) -> None:
    import h5py

    file["more"] = h5py.SoftLink("/bodies")


def external_storage(file: Any, elsewhere: Path) -> None:
    file.create_dataset("more", (4, 2, 2), "f8", external=[(str(elsewhere), 0, 128)])


def virtual(file: Any, elsewhere: Path) -> None:
    import h5py

    layout = h5py.VirtualLayout((40, 2, 2), "f8")
    layout[:] = h5py.VirtualSource(str(elsewhere), "bodies", (40, 2, 2))
    file.create_virtual_dataset("more", layout)


def strange_float(file: Any, elsewhere: Path) -> None:
    import h5py

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
    "wrong_number": (strange_float, "floats that are not IEEE"),
    "filter": (strange_filter, "unusual filter"),
}


@pytest.mark.parametrize("kind", POINTING)
@pytest.mark.parametrize("write", [write_mat73, write_idtracker_h5, write_dlc_h5, write_analysis])
def test_foreign_hdf5_is_not_followed(
    kind: str, write: Callable[[Path], Path], tmp_path: Path
) -> None:
    import h5py

    secret = write_mat73(tmp_path).rename(tmp_path / "secret.h5")
    path = write(tmp_path)
    change, message = POINTING[kind]
    with h5py.File(path, "r+") as file:
        change(file, secret)
    source = {"new.mat": "matlab", "trajectories.h5": "idtracker", "dlc.h5": "deeplabcut"}
    assert message in refused(path, source.get(path.name, "sleap"))
