"""The command line ``animarl``."""
