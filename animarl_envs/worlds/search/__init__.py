"""A searcher and an odour source."""
