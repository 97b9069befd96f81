"""Frames, pictures and clips."""
