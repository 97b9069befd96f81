"""Pursuers and a target."""
