"""Wrappers for each of the three views: the DTW reward and the condition flag."""

from animarl_envs.wrappers.condition_flag import (
    ConditionFlag,
    ConditionFlagParallel,
    ConditionFlagVector,
)
from animarl_envs.wrappers.dtw_reward import DTWReward, DTWRewardParallel, DTWRewardVector

__all__ = [
    "ConditionFlag", "ConditionFlagParallel", "ConditionFlagVector",
    "DTWReward", "DTWRewardParallel", "DTWRewardVector",
]  # fmt: skip
