"""Commands of ``animarl``, one module each."""
