"""The choice of slots and rounding of each level."""
