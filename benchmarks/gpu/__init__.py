"""The CUDA backend on a machine that has a GPU."""
