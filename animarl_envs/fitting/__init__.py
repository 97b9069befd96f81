"""Fitting damping d and thrust u of v' = (1 - d) v + u a dt to recorded episodes."""
