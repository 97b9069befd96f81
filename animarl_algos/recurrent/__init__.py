"""Recurrent dueling Q-networks, one per individual, and their memory."""
