"""The packaged chases of the agents: trained here, rolled out, and compared with what is known."""
