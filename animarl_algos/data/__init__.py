"""Data for learners: worlds as a VecEnv of slots, demonstrations as datasets."""
