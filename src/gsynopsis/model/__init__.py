"""The learnt representation: anchors, grids, codebook, heads. No files, no loops."""
