"""A `LevelSet` to bytes and back. NumPy and zlib only."""
