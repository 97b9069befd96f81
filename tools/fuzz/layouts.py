"""Files as trackers and the paper's authors write them, made from tracks whose values are known.

Not a test module: :data:`KINDS` names every layout, who writes it, which reader is to find it, and
how far damage to it can be noticed. Tests of readers and of imports share it.
"""

from __future__ import annotations

import json
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

import benchmarks.paper_readers  # noqa: F401  (one of the layouts is of its reader)
from animarl_envs.arena import Arena
from animarl_envs.demos.demonstrations import Demonstrations

BODIES = np.cumsum(np.random.default_rng(0).normal(0, 1.0, (40, 2, 2)), axis=0) + [
    [50, 50],
    [70, 60],
]
POSE = BODIES[:, :, None] + np.array([[0.0, 0.0], [2.0, -1.0]])  # (frames, individuals, nodes, 2)
NAMES, NODES = ("male", "female"), ("head", "thorax")


def write_native(folder: Path) -> Path:
    recording = np.array(["a", "b", "c"])
    demos = Demonstrations(
        species="custom", individuals=NAMES, roles=("pursuer", "target"), dt=0.1,
        arena=Arena("open"), positions=BODIES[:36], lengths=np.full(3, 12),
        initial_velocity=np.zeros((3, 2, 2)), condition=np.zeros(3, np.int8),
        outcome=np.zeros(3, np.int8), split=np.array(["train", "val", "test"]),
        recording=recording,
        provenance={"source": "test", "licence": "none", "synthetic": True},
    )  # fmt: skip
    return demos.save(folder / "demos.npz")


def agents_arrays() -> dict[str, NDArray[Any]]:
    steps = np.array([5, 3, 9], dtype=np.int16)
    rng = np.random.default_rng(1)
    meta = {"cond": "c2ae/reward_share", "dt": 0.1, "damping": 0.25}
    return {
        "pos": rng.uniform(-0.9, 0.9, (int((steps + 1).sum()), 3, 2)).astype(np.float32),
        "actions": rng.integers(13, size=(int(steps.sum()), 3)).astype(np.int8),
        "n_steps": steps,
        "outcome": np.array([1, -1, 0], dtype=np.int8),
        "meta": np.array(json.dumps(meta)),
    }


def write_agents(folder: Path) -> Path:
    np.savez(folder / "episodes.npz", **agents_arrays())  # type: ignore[arg-type]
    return folder / "episodes.npz"


def write_slp(folder: Path, pose: NDArray[np.float64] = POSE) -> Path:
    import sleap_io as sio

    skeleton = sio.Skeleton(list(NODES))
    tracks = [sio.Track(name) for name in NAMES]
    video = sio.Video("clip.mp4", open_backend=False)
    frames = [
        sio.LabeledFrame(
            video=video, frame_idx=t,
            instances=[
                sio.Instance.from_numpy(pose[t, i], skeleton=skeleton, track=tracks[i])
                for i in range(2)
            ],
        )
        for t in range(len(pose))
    ]  # fmt: skip
    labels = sio.Labels(frames, videos=[video], skeletons=[skeleton], tracks=tracks)
    labels.save(str(folder / "clip.slp"), verbose=False)
    return folder / "clip.slp"


def write_analysis(folder: Path) -> Path:
    import h5py

    with h5py.File(folder / "clip.analysis.h5", "w") as file:
        file["tracks"] = POSE.transpose(1, 3, 2, 0)
        file["track_names"] = [name.encode() for name in NAMES]
        file["node_names"] = [name.encode() for name in NODES]
        file["point_scores"] = np.ones(POSE.shape[:3]).transpose(1, 2, 0)
    return folder / "clip.analysis.h5"


def dlc_frame() -> Any:
    import pandas as pd

    columns = pd.MultiIndex.from_tuples(
        [("net", a, n, c) for a in NAMES for n in NODES for c in ("x", "y", "likelihood")],
        names=["scorer", "individuals", "bodyparts", "coords"],
    )
    likely = np.full((*POSE.shape[:3], 1), 0.9)
    return pd.DataFrame(
        np.concatenate([POSE, likely], axis=3).reshape(len(POSE), -1), columns=columns
    )


def write_dlc_csv(folder: Path) -> Path:
    dlc_frame().to_csv(folder / "dlc.csv")
    return folder / "dlc.csv"


def write_dlc_h5(folder: Path) -> Path:
    path = folder / "dlc.h5"
    dlc_frame().to_hdf(path, key="df_with_missing", format="table", mode="w")
    return path


def write_long(folder: Path) -> Path:
    rows = ["frame,id,x,y"]
    for t in range(len(BODIES)):
        rows += [f"{t},{n},{BODIES[t, i, 0]!r},{BODIES[t, i, 1]!r}" for i, n in enumerate(NAMES)]
    text = "\n".join(rows).replace("np.float64(", "").replace(")", "")
    (folder / "long.csv").write_text(text + "\n")
    return folder / "long.csv"


def write_wide(folder: Path) -> Path:
    import pandas as pd

    frame = pd.DataFrame(
        BODIES.reshape(-1, 4), columns=["x_male", "y_male", "x_female", "y_female"]
    )
    frame.to_csv(folder / "wide.csv", index=False)
    return folder / "wide.csv"


def write_npy(folder: Path) -> Path:
    np.save(folder / "bodies.npy", BODIES)
    return folder / "bodies.npy"


def write_mat(folder: Path) -> Path:
    from scipy.io import savemat

    savemat(folder / "bodies.mat", {"bodies": BODIES})
    return folder / "bodies.mat"


def write_packed_mat(folder: Path) -> Path:
    from scipy.io import savemat

    savemat(folder / "packed.mat", {"bodies": BODIES}, do_compression=True)
    return folder / "packed.mat"


def write_mat73(folder: Path) -> Path:
    import h5py

    with h5py.File(folder / "new.mat", "w", userblock_size=512) as file:
        file["bodies"] = BODIES.T  # MATLAB's order
    return folder / "new.mat"


def write_trex(folder: Path) -> Path:
    for i in range(2):
        arrays: dict[str, Any] = {
            "X#wcentroid": BODIES[:, i, 0],
            "Y#wcentroid": BODIES[:, i, 1],
            "frame": np.arange(len(BODIES)),
            "frame_rate": np.array(25.0),
        }
        np.savez(folder / f"video_fish{i}.npz", **arrays)
    return folder / "video_fish0.npz"


def write_idtracker_h5(folder: Path) -> Path:
    import h5py

    with h5py.File(folder / "trajectories.h5", "w") as file:
        file["trajectories"] = BODIES
        file.attrs["frames_per_second"] = 25.0
    return folder / "trajectories.h5"


def write_idtracker_csv(folder: Path) -> Path:
    table = np.column_stack([np.arange(len(BODIES)) / 25.0, BODIES.reshape(-1, 4)])
    np.savetxt(
        folder / "trajectories.csv", table, delimiter=",", header="time,x1,y1,x2,y2", comments=""
    )
    return folder / "trajectories.csv"


def write_mothvr(folder: Path) -> Path:
    lines = ["Time,X,Y,Theta,Odor,Wind"]
    for t in range(91):
        x = 300 - 250.0 * t / 90
        lines.append(f"{t / 30},{x},1.0,3.1,{'NRLB'[t % 4]},{'FRLB'[t // 4 % 4]}")
    (folder / "case1.csv").write_text("\n".join(lines) + "\n")
    return folder / "case1.csv"


def _objects(nested: Any, shape: tuple[int, ...]) -> NDArray[Any]:
    out = np.empty(shape, dtype=object)
    for index in np.ndindex(*shape):
        entry = nested
        for i in index:
            entry = entry[i]
        out[index] = entry
    return out


def write_authors_agents(folder: Path) -> Path:
    scaled = BODIES / 200
    lists = [
        [[tuple(p) for p in (scaled[:, 0] + 0.1 * k).tolist()] for k in range(3)] for _ in range(2)
    ]
    lists.append([[(0.0, 0.1 * k)] for k in range(3)])  # one frame: left out
    path = folder / "pos_val_rep_2on1_share_equal_K_0.npz"
    np.savez(path, pos=_objects(lists, (3, 3))[None], allow_pickle=True)
    with zipfile.ZipFile(path) as archive:
        raw = archive.read("pos.npy")
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("pos.npy", raw)
    return path


def write_authors_fly(folder: Path) -> Path:
    body = np.concatenate([BODIES, BODIES], axis=2)[:, :1] / 200  # (frames, 1, 4)
    states = [[body + 0.1 * k, body[:4] + 0.1 * k] for k in range(3)]
    rewards = [[np.array([0.0, float(k == 1)]), np.zeros(2)] for k in range(3)]
    arrays = {
        "states": _objects(states, (3, 2)), "actions": _objects(rewards, (3, 2)),
        "rewards": _objects(rewards, (3, 2)),
    }  # fmt: skip
    path = folder / "data.npz"
    np.savez(path, **arrays)  # type: ignore[arg-type]
    return path


def write_authors_newt(folder: Path) -> Path:
    rng = np.random.default_rng(3)
    smooth = np.cumsum(rng.normal(0, 1e-3, (2000, 3, 2)), axis=0) + [[0.1, 0], [0.3, 0], [-0.3, 0]]
    episode = np.zeros((2000, 6, 2))
    episode[:, ::2] = smooth
    early, late = episode[:300].copy(), episode[:300].copy()
    early[:50] += 5.0
    late[200:] += 5.0
    np.savez(
        folder / "state_m1_data0.npz",
        ep0=episode,
        ep1=early,
        ep2=late,
        ep3=episode[:44],
    )
    for name, won in (("m1", 0.0), ("m2", 1.0)):
        arrays = {f"ep{i}": np.array([0, won]) for i in range(4)}
        np.savez(folder / f"reward_{name}_data0.npz", **arrays)  # type: ignore[arg-type]
    return folder / "state_m1_data0.npz"


def write_authors_silkmoth(folder: Path) -> Path:
    place = folder / "Odoronly" / "Movie2"
    place.mkdir(parents=True, exist_ok=True)
    table = np.zeros((61, 8))
    table[:, 0], table[:, 1] = np.arange(61) / 30, 300 - np.arange(61)
    table[::2, 4], table[:, 7] = 1, 3
    np.savetxt(place / "trial1_mod.csv", table, delimiter=",")
    return place / "trial1_mod.csv"


def write_long_parquet(folder: Path) -> Path:
    import pandas as pd

    table = pd.read_csv(write_long(folder))
    (folder / "long.csv").unlink()
    table.to_parquet(folder / "long.parquet", row_group_size=32)
    return folder / "long.parquet"


def write_wide_parquet(folder: Path) -> Path:
    import pandas as pd

    table = pd.read_csv(write_wide(folder))
    (folder / "wide.csv").unlink()
    table.to_parquet(folder / "wide.parquet")
    return folder / "wide.parquet"


def write_tsv(folder: Path) -> Path:
    text = write_long(folder).read_text()
    (folder / "long.csv").unlink()
    (folder / "long.tsv").write_text(text.replace(",", "\t"))
    return folder / "long.tsv"


def write_npz(folder: Path) -> Path:
    np.savez(folder / "bodies.npz", bodies=BODIES)
    return folder / "bodies.npz"


def write_minari(folder: Path) -> Path:
    from animarl_envs.importing.minari_io import export_minari

    native = write_native(folder)
    demos = Demonstrations.load(native)
    native.unlink()
    return export_minari(demos, folder / "set-v0") / "data" / "main_data.hdf5"


def write_termites(folder: Path) -> Path:
    """Female x, y, male x, y in (pixel - offset) * 50; the scale is in index.csv."""
    pixels = np.concatenate([BODIES[:, 1], BODIES[:, 0]], axis=1)
    path = folder / "tracks_30fps_int16.npz"
    np.savez(path, Cf_pair_1=np.rint(pixels * 50).astype(np.int16))
    (folder / "index.csv").write_text(
        "key,species,mm_per_px_est\nCf_pair_1,Coptotermes formosanus,0.45\n"
    )
    return path


def write_fly_groups(folder: Path) -> Path:
    """Positions times 100 of every fly, in units of which 120 make the arena."""
    path = folder / "tracks_24fps_int16.npz"
    arrays: dict[str, Any] = {
        "CsCh_1__xy": np.rint(BODIES * 100).astype(np.int16),
        "CsCh_1__ori": np.zeros(BODIES.shape[:2], dtype=np.int16),
    }
    np.savez(path, **arrays)
    return path


def write_gray_bats(folder: Path) -> Path:
    """Rows of frame, bat, x, y, z."""
    from scipy.io import savemat

    path, frames = folder / "9_24_obsref.mat", np.arange(len(BODIES), dtype=np.float64)
    rows = [
        np.column_stack([frames, np.full_like(frames, bat), BODIES[:, bat], frames])
        for bat in range(2)
    ]
    savemat(path, {"batsS": np.concatenate(rows), "wall": np.zeros((5, 3))})
    return path


def write_ethovision(folder: Path) -> Path:
    head = ['"Number of header lines:","5"', '"Trial name","Trial 1"', '"Subject name","male"']
    head += ["Trial time,X center,Y center", "s,cm,cm"]
    rows = [f"{t / 25},{x!r},{y!r}" for t, (x, y) in enumerate(BODIES[:, 0].tolist())]
    (folder / "raw_data.txt").write_text("\n".join([*head, *rows]) + "\n")
    return folder / "raw_data.txt"


def write_trex_csv(folder: Path) -> Path:
    rows = [f"{t},{x!r},{y!r},{t / 25},0" for t, (x, y) in enumerate(BODIES[:, 0].tolist())]
    head = "frame,X#wcentroid (cm),Y#wcentroid (cm),time,missing"
    (folder / "video_fish0.csv").write_text("\n".join([head, *rows]) + "\n")
    return folder / "video_fish0.csv"


def write_sleap_csv(folder: Path) -> Path:
    head = ",".join(f"{node}.{part}" for node in NODES for part in ("score", "x", "y"))
    rows = [f"track,frame_idx,instance.score,{head}"]
    for t, pose in enumerate(POSE.tolist()):
        for name, nodes in zip(NAMES, pose, strict=True):
            cells = ",".join(f"0.9,{x!r},{y!r}" for x, y in nodes)
            rows.append(f"{name},{t},0.9,{cells}")
    (folder / "clip.csv").write_text("\n".join(rows) + "\n")
    return folder / "clip.csv"


def write_trx(folder: Path) -> Path:
    """The second fly appears one frame later than the first."""
    from scipy.io import savemat

    trx = np.zeros((1, 2), [(name, "O") for name in ("x", "y", "theta", "firstframe", "fps")])
    for i in range(2):
        x, y = BODIES[i:, i].T[:, None]
        trx[0, i] = x, y, np.zeros_like(x), [[i + 1.0]], [[25.0]]
    savemat(folder / "trx.mat", {"trx": trx})
    return folder / "trx.mat"


def write_flytracker(folder: Path) -> Path:
    from scipy.io import savemat

    names = np.array(["pos x", "pos y", "ori"], dtype=object)[None]
    data = np.concatenate([BODIES, np.zeros((len(BODIES), 2, 1))], axis=2).transpose(1, 0, 2)
    chambers = np.empty((1, 2), dtype=object)
    chambers[0] = [np.array([[1.0]]), np.array([[2.0]])]
    trk = {"names": names, "data": data, "flies_in_chamber": chambers}
    savemat(folder / "clip-track.mat", {"trk": trk})
    return folder / "clip-track.mat"


def write_netcdf(folder: Path) -> Path:
    """As xarray writes a dataset of movement."""
    import h5py

    with h5py.File(folder / "clip.nc", "w") as file:
        scales = {"time": np.arange(len(POSE)) / 25, "space": [b"x", b"y"]}
        scales |= {axis: [name.encode() for name in names]
                   for axis, names in (("keypoints", NODES), ("individuals", NAMES))}  # fmt: skip
        for axis, values in scales.items():
            file[axis] = values
            file[axis].make_scale(axis)
        values = {"position": POSE.transpose(0, 3, 2, 1), "confidence": np.full((40, 2, 2), 0.9)}
        for name, array in values.items():
            file[name] = array
            axes = [axis for axis in scales if axis != "space" or name == "position"]
            for place, axis in enumerate(axes):
                file[name].dims[place].attach_scale(file[axis])
        file.attrs["time_unit"] = "seconds"
    return folder / "clip.nc"


def write_nwb(folder: Path) -> Path:
    """As pynwb writes poses: a container for each animal, soft links to its skeleton."""
    import h5py

    with h5py.File(folder / "clip.nwb", "w") as file:
        behavior = file.create_group("processing/behavior")
        behavior.create_group("Skeletons/mouse")
        for i, name in enumerate(NAMES):
            container = behavior.create_group(f"track={name}")
            container.attrs["neurodata_type"] = "PoseEstimation"
            container["skeleton"] = h5py.SoftLink("/processing/behavior/Skeletons/mouse")
            for k, node in enumerate(NODES):
                series = container.create_group(node)
                series.attrs["neurodata_type"] = "PoseEstimationSeries"
                series["data"], series["confidence"] = POSE[:, i, k], np.full(len(POSE), 0.9)
                series["data"].attrs["unit"] = "pixels"
                series["starting_time"] = 2.0
                series["starting_time"].attrs["rate"] = 25.0
    return folder / "clip.nwb"


@dataclass(frozen=True)
class Kind:
    """One layout.

    ``holds``: two ``bodies``, their ``poses``, or something ``else``. ``guard`` says what shows
    damage: a ``checksum`` over the values, the ``text`` itself, which a second parser can read, or
    nothing but the ``structure`` around raw numbers. ``beside`` are further files that it needs.
    """

    write: Callable[[Path], Path]
    source: str
    holds: Literal["bodies", "poses", "else"]
    guard: Literal["checksum", "text", "structure"]
    beside: tuple[str, ...] = ()


KINDS: dict[str, Kind] = {
    "long": Kind(write_long, "long-table", "bodies", "text"),
    "tsv": Kind(write_tsv, "long-table", "bodies", "text"),
    "long_parquet": Kind(write_long_parquet, "long-table", "bodies", "structure"),
    "wide": Kind(write_wide, "wide-table", "bodies", "text"),
    "wide_parquet": Kind(write_wide_parquet, "wide-table", "bodies", "structure"),
    "npy": Kind(write_npy, "numpy", "bodies", "structure"),
    "npz": Kind(write_npz, "numpy", "bodies", "checksum"),
    "mat": Kind(write_mat, "matlab", "bodies", "structure"),
    "packed_mat": Kind(write_packed_mat, "matlab", "bodies", "checksum"),
    "mat73": Kind(write_mat73, "matlab", "bodies", "structure"),
    "idtracker_h5": Kind(write_idtracker_h5, "idtracker", "bodies", "structure"),
    "idtracker_csv": Kind(write_idtracker_csv, "idtracker", "bodies", "text"),
    "slp": Kind(write_slp, "sleap", "poses", "structure"),
    "analysis": Kind(write_analysis, "sleap", "poses", "structure"),
    "dlc_csv": Kind(write_dlc_csv, "deeplabcut", "poses", "text"),
    "dlc_h5": Kind(write_dlc_h5, "deeplabcut", "poses", "structure"),
    "sleap_csv": Kind(write_sleap_csv, "sleap", "else", "text"),
    "netcdf": Kind(write_netcdf, "netcdf", "poses", "structure"),
    "nwb": Kind(write_nwb, "nwb", "else", "structure"),
    "ctrax": Kind(write_trx, "ctrax", "else", "structure"),
    "flytracker": Kind(write_flytracker, "flytracker", "else", "structure"),
    "movement": Kind(write_dlc_csv, "movement", "poses", "text"),
    "native": Kind(write_native, "animarl", "else", "checksum"),
    "minari": Kind(write_minari, "minari", "else", "structure", ("metadata.json",)),
    "agents": Kind(write_agents, "agents", "else", "checksum"),
    "ethovision": Kind(write_ethovision, "ethovision", "else", "text"),
    "trex": Kind(write_trex, "trex", "else", "checksum"),
    "trex_csv": Kind(write_trex_csv, "trex", "else", "text"),
    "mothvr": Kind(write_mothvr, "mothvr", "else", "text"),
    "termites": Kind(write_termites, "termites", "else", "checksum", ("index.csv",)),
    "fly_groups": Kind(write_fly_groups, "fly-groups", "else", "checksum"),
    "gray_bats": Kind(write_gray_bats, "gray-bats", "else", "structure"),
    "authors_agents": Kind(write_authors_agents, "authors-agents", "else", "checksum"),
    "authors_fly": Kind(write_authors_fly, "authors-fly", "else", "checksum"),
    "authors_newt": Kind(
        write_authors_newt, "authors-newt", "else", "checksum",
        ("reward_m1_data0.npz", "reward_m2_data0.npz"),
    ),
    "authors_silkmoth": Kind(write_authors_silkmoth, "authors-silkmoth", "else", "text"),
}  # fmt: skip
