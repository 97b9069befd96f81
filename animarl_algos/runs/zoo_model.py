"""A model that rl_zoo3's ``train`` wrote, with the world that it was trained in."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from animarl_algos.data.vec_env import OWN_OPTIONS, FocalPolicy
from animarl_algos.networks.acting_rule import Acting, Kind
from animarl_algos.recipes.registry import RECIPES, named_recipe
from animarl_envs.errors import InputError


@dataclass(frozen=True)
class ZooModel:
    """A trained policy, the id of its environment, the options of its world, and its individual."""

    policy: Any
    env: str
    options: dict[str, Any]
    focal: str | None

    @classmethod
    def of(cls, folder: Path, acting: str | None, seed: int) -> ZooModel | None:
        """Return the best model in ``folder``, else the last one; None if rl_zoo3 wrote none.

        The file holds pickles, which can run code. ``acting`` is a rule by which it acts; by
        default it acts as it was scored, so that one that explores by epsilon is greedy.

        Raises InputError if the model is of another project.
        """
        described = next(folder.glob("*/args.yml"), None)
        if described is None:
            return None
        saved = yaml.safe_load(described.read_text(encoding="utf-8"))
        settings = yaml.safe_load((described.parent / "config.yml").read_text(encoding="utf-8"))
        if saved["algo"] not in RECIPES:
            raise InputError(
                f"{folder}: {saved['algo']!r} is no learner of this project: load the model with "
                "rl_zoo3 itself"
            )
        files = [folder / "best_model.zip", folder / f"{described.parent.name}.zip"]
        file = next((file for file in files if file.exists()), None)
        if file is None:
            raise InputError(f"{folder}: it holds no model yet: wait until training has saved one")
        model = named_recipe(saved["algo"]).algorithm.load(file, device="cpu")
        policy = model.policy
        policy.seed(seed)
        if acting is not None:
            policy.acting = Acting.parse(acting)
        elif policy.acting.kind is Kind.EPSILON:
            policy.acting = Acting()
        options = dict(settings.get("env_kwargs") or {})
        focal = options.get("focal")
        world = {key: value for key, value in options.items() if key not in OWN_OPTIONS}
        return cls(model, saved["env"], world, focal)

    def as_joint_policy(self, names: Sequence[str]) -> Any:
        """Return a policy that acts for all individuals, even if only one of them learned."""
        return self.policy if self.focal is None else FocalPolicy(self.policy, names, self.focal)
