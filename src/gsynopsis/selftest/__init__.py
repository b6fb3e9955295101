"""A device's rasterizer, training step and training, compared with the CPU's and timed."""
