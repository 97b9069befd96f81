"""Learners for the environments of ``animarl_envs``: data, recipes, evaluation, command line."""
