"""A packed scene and held-out photos in, rows of numbers and images out."""
