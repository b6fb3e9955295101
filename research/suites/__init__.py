"""Suites of trainings that are compared: scenes × methods × seeds, each cell a process."""
