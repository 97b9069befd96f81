"""Compiled forms of the networks: forward, backward and acting."""
