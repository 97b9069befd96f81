"""The odour plume: model, movies, stand-ins."""
