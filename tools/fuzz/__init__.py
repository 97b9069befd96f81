"""The project's own fuzzer; see ``__main__``."""
