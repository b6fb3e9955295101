"""Cameras around scenes and splats."""
