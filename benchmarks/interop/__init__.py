"""Levels in other programs' formats: what they cost."""
