"""Recorded episodes: the container, readers, cleaning, cutting, splits."""
