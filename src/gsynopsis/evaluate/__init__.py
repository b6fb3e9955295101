"""A packed scene and held-out photos in, rows of numbers and pictures out."""
