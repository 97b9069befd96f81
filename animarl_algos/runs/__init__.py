"""A run: its settings, its folder, and the stages from recordings to a page."""
