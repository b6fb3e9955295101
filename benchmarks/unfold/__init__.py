"""Finished splats into trained levels: cameras, quality by bytes, rivals."""
