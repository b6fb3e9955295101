"""Photos in, one progressive 3D Gaussian splatting file out."""

__version__ = "0.1.0"

__all__ = ["__version__"]
