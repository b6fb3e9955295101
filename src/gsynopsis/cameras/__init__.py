"""Cameras for Gaussians that come without photos: given by a file, or found in the scene."""

from gsynopsis.cameras.viewpoints import Viewpoints, for_splats

__all__ = ["Viewpoints", "for_splats"]
