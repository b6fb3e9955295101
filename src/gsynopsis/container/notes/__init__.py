"""Notes of the manifest that readers may ignore."""
