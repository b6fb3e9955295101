"""Levels in other programs' formats, and their cost."""
