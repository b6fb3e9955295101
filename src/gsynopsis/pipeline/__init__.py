"""Whole jobs: what a command, a notebook or a script calls."""
