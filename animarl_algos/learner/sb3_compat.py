"""The networks' settings as users of stable-baselines3 write them, in this project's words."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from stable_baselines3.common.torch_layers import FlattenExtractor
from torch import nn

from animarl_envs.errors import InputError

AS_IT_IS = {
    "activation_fn": (
        nn.ReLU, "hidden layers are rectified here, so give torch.nn.ReLU or leave it out",
    ),
    "features_extractor_class": (
        FlattenExtractor,
        "observations are flattened here, so give FlattenExtractor, leave it out, or put the "
        "features into the observation with a wrapper",
    ),
    "features_extractor_kwargs": (None, "flattening takes none, so leave it out"),
}  # fmt: skip
"""Names of stable-baselines3 that may say what the networks do anyway, and why nothing else."""


def translate_policy_kwargs(policy_kwargs: Mapping[str, Any]) -> dict[str, Any]:
    """A table ``policy_kwargs`` without the names that only stable-baselines3 has.

    ``net_arch=[64, 64]`` becomes ``hidden=64, depth=2``: the layers that encode an observation, as
    many as are listed; the memory and the dueling head come on top. ``activation_fn=ReLU`` and
    ``features_extractor_class=FlattenExtractor`` are what the networks do anyway.

    Raises
    ------
    InputError
        If something else is asked for, or one thing in both ways.
    """
    table = dict(policy_kwargs)
    layers = table.pop("net_arch", None)
    if layers is not None:
        both = [name for name in ("hidden", "depth") if name in table]
        if both:
            raise InputError(
                f"policy_kwargs: net_arch and {both[0]} say the same thing: give hidden and depth, "
                "or net_arch alone"
            )
        table |= _widths(layers)
    for name, (usual, why) in AS_IT_IS.items():
        asked = table.pop(name, usual)
        if asked is not usual and asked != {}:
            raise InputError(f"policy_kwargs: {name} is {_name(asked)}: {why}")
    return table


def _widths(layers: Any) -> dict[str, int]:
    """``net_arch`` as the width of all layers and their number."""
    listed = isinstance(layers, list | tuple) and all(type(n) is int for n in layers)
    if listed and len(set(layers)) == 1:
        return {"hidden": layers[0], "depth": len(layers)}
    raise InputError(
        f"policy_kwargs: net_arch is {layers!r}: all hidden layers are of one width here, so give "
        "a list such as [64, 64], or hidden=64 and depth=2"
    )


def _name(value: Any) -> str:
    return str(getattr(value, "__name__", repr(value)))
