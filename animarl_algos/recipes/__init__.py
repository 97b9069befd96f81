"""What each learner minimises: one file per recipe, and their names."""
