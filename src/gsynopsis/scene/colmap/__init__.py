"""COLMAP models: read, as binary or text, with their lenses."""
