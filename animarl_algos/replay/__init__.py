"""The replay memory: sequences of steps, prioritised or uniform."""
