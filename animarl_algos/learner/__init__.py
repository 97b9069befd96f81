"""The learner: one stable-baselines3 algorithm, and the parts that it holds."""
