"""Three views of one world: a single individual, many copies, all individuals."""

from animarl_envs.views.parallel import AnimalParallelEnv
from animarl_envs.views.single import AnimalEnv
from animarl_envs.views.vector import AnimalVectorEnv

__all__ = ["AnimalEnv", "AnimalParallelEnv", "AnimalVectorEnv"]
