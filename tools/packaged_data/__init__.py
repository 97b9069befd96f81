"""Generators of the packaged demonstrations, and the plume's calibration."""
