"""``python tests/golden/golden_tables.py``: what is read of foreign files, written to a JSON.

Of each file stands what its tracks are called, their rate, unit and start, and a hash of their
numbers, or the sentence by which it is refused. A commit that changes the JSON says why.
"""

import hashlib
import json
import os
import sys
import tempfile
import warnings
from pathlib import Path
from typing import Any

import numpy as np

sys.path[:0] = [str(Path(__file__).resolve().parents[n]) for n in (0, 2)]

from golden_table_files import Case, table_cases  # noqa: E402
from golden_tracker_files import of_recipes, of_trackers  # noqa: E402

from animarl_envs.demos.demonstrations import Demonstrations  # noqa: E402
from animarl_envs.errors import InputError  # noqa: E402
from animarl_envs.importing.readers import find_reader, get_reader, read, read_tracks  # noqa: E402
from animarl_envs.importing.tracks import Tracks  # noqa: E402

RESULTS = Path(__file__).with_name("tables.json")


def hash_of(array: Any) -> str:
    """Of kind, shape and numbers; all that are no number are alike."""
    array = np.asarray(array)
    if array.dtype.kind == "f":
        array = np.where(np.isnan(array), np.nan, array) + 0.0
    whole = f"{array.dtype.str}{array.shape}".encode() + np.ascontiguousarray(array).tobytes()
    return hashlib.sha256(whole).hexdigest()[:16]


def described(found: Demonstrations | list[Tracks]) -> Any:
    """What is in demonstrations or tracks, as plain values."""
    if isinstance(found, Demonstrations):
        return {
            "individuals": found.individuals, "roles": found.roles, "dt": round(found.dt, 9),
            "lengths": found.lengths.tolist(), "outcome": found.outcome.tolist(),
            "condition": found.condition.tolist(),
            "recording": sorted(set(found.recording.tolist())),
            "positions": hash_of(np.round(found.positions, 9)),
            "signals": {key: hash_of(value) for key, value in sorted(found.signals.items())},
        }  # fmt: skip
    return [
        {
            "recording": one.recording, "individuals": one.individuals, "keypoints": one.keypoints,
            "frames": len(one), "rate": one.frame_rate, "start": one.start_time, "unit": one.unit,
            "y_down": one.y_down, "positions": hash_of(one.positions),
            "confidence": None if one.confidence is None else hash_of(one.confidence),
            "signals": {key: hash_of(value) for key, value in sorted(one.signals.items())},
            "condition": one.condition, "outcome": one.outcome,
        }
        for one in found
    ]  # fmt: skip


def result_of(case: Case) -> Any:
    """What is read of a case, or the sentence by which it is refused."""
    here = Path.cwd()
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        path = case.write(Path(folder)).relative_to(folder)
        os.chdir(folder)  # names of recordings then hold no folder
        try:
            reader = get_reader(case.source) if case.source else find_reader(path)
            whole = case.whole or reader.finished
            found = (read if whole else read_tracks)(path, case.source, **case.options)
        except InputError as error:
            return {"refused": str(error).replace(folder, "")}
        except Exception as error:  # a fault, which stands in the JSON until it is put right
            return {"fault": type(error).__name__}
        finally:
            os.chdir(here)
        return json.loads(json.dumps(described(found)))


def results() -> dict[str, Any]:
    found: dict[str, Any] = {}
    for case in (*table_cases(), *of_trackers(), *of_recipes()):
        assert case.name not in found, case.name
        found[case.name] = result_of(case)
    return found


if __name__ == "__main__":
    text = ",\n".join(f"{json.dumps(k)}: {json.dumps(v)}" for k, v in results().items())
    RESULTS.write_text("{\n" + text + "\n}\n")
    print(f"{text.count(chr(10)) + 1} files: {RESULTS}")
