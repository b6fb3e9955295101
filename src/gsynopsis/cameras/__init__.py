"""Cameras for Gaussians that come without photos: given by a file, or found in the scene."""
