"""Dropout masks of a whole minibatch, drawn before the networks see it.

One mask per sequence and layer, the same at all its steps (Gal & Ghahramani 2016): a memory then
reads every step through the same thinned network. An individual's masks come from a generator of
its own, so that training it with others is training it alone; who asks for none gets the whole
network, which is how everybody acts.
"""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch

from animarl_algos.networks.gru import Packing


@dataclass(frozen=True)
class DropoutMasks:
    """Factors 0 or ``1 / (1 - share)`` for every hidden layer.

    Attributes
    ----------
    masks : Tensor (layers, K, batch, H)
    """

    masks: torch.Tensor

    def to(self, device: torch.device | str) -> DropoutMasks:
        """The same masks on ``device``."""
        return DropoutMasks(self.masks.to(device))

    def thin(self, features: torch.Tensor, layer: int, packing: Packing) -> torch.Tensor:
        """Packed ``features`` (K, row, H) of a layer, times the mask of each row's sequence."""
        mask = self.masks[layer]
        if packing.is_full:
            mask = mask.repeat(1, packing.time, 1)
        else:
            mask = mask.index_select(1, packing.rows % packing.batch)
        return features * mask


class DropoutDraws:
    """Draws masks, each individual's from its own generator.

    Parameters
    ----------
    share
        Of the units that are left out, below 1.
    seeds
        Root of the draws, whole numbers; with an individual's name they seed its generator.
    individuals
        Names of the K individuals.
    """

    def __init__(self, share: float, seeds: Sequence[int], individuals: Sequence[str]) -> None:
        self.share = share
        self._generators = [
            np.random.default_rng([*seeds, zlib.crc32(name.encode())]) for name in individuals
        ]

    def masks(self, layers: int, batch: int, units: int) -> DropoutMasks | None:
        """For ``batch`` sequences of every individual, or None where nothing is left out."""
        if not self.share:
            return None
        shape = (layers, batch, units)
        kept = np.stack(
            [g.random(shape, dtype=np.float32) >= self.share for g in self._generators], axis=1
        )
        return DropoutMasks(torch.from_numpy(kept).float().div_(1.0 - self.share))
