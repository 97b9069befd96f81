"""What learners learn from: worlds as a VecEnv of slots, demonstrations as datasets."""
