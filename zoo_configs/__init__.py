"""Settings of the learners per environment, as YAML data."""
