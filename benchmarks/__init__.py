"""Benchmarks: what makes the figures of docs/results, and what is too long for the tests."""
