"""Poses as other programs write them: Metashape, OpenSfM (OpenDroneMap), RealityCapture."""
