"""AnimaRL environments: recorded animals as a Gymnasium environment suite."""
