"""Q-networks, one per individual, and the policies that act with them."""
