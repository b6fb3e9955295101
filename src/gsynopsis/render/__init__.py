"""Gaussians and a camera in, an image out: reference, cpu and cuda backends."""
