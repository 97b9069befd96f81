"""``monitor.csv``: a row per training episode, as rl_zoo3's plots read it.

Other environments have stable-baselines3's ``Monitor`` write it. Slots share a world and have none,
and an episode of the world, in which all of them act, is one row.
"""

from __future__ import annotations

import time
from pathlib import Path

from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.monitor import ResultsWriter


class EpisodeLog(BaseCallback):
    """Writes return, length [steps] and time [s] of each training episode.

    The return is the ``episode`` entry of the infos: of a
    :class:`~animarl_algos.data.vec_env.SlotVecEnv` the task return, a mean over the pursuers that
    learn.

    Parameters
    ----------
    folder
        Where ``0.monitor.csv`` goes.
    env_id
        Is noted in its first line.
    """

    def __init__(self, folder: Path, env_id: str) -> None:
        super().__init__()
        self.folder, self.env_id = folder, env_id
        self._writer: ResultsWriter | None = None

    def _on_training_start(self) -> None:
        self._began = time.time()
        header: dict[str, float | str] = {"t_start": self._began, "env_id": self.env_id}
        self._writer = ResultsWriter(str(self.folder / "0.monitor.csv"), header=header)

    def _on_step(self) -> bool:
        assert self._writer is not None
        for info in self.locals["infos"]:
            if "episode" in info:
                since = round(time.time() - self._began, 6)
                self._writer.write_row(info["episode"] | {"t": since})
        return True

    def _on_training_end(self) -> None:
        if self._writer is not None:
            self._writer.close()
