"""Demonstrations of your own are an environment at once."""

import gymnasium as gym

import animarl_envs
from animarl_envs.demos.packaged import load_packaged

demos = load_packaged("fly")  # in your case demos = "demos.npz", which 'animarl import' wrote

env = gym.make("AnimaRL/Custom-v0", demos=demos)
observation, info = env.reset(seed=0)
print(info["scenario"]["individuals"], info["scenario"]["locomotion"])

many = gym.make_vec("AnimaRL/Custom-v0", num_envs=64, demos=demos, contact_radius=0.1)
alone = animarl_envs.parallel_env("custom", demos=demos, num_pursuers=1)  # the first of the males
