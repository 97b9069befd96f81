"""The learners: their recipes, made of loss terms, and their names."""
