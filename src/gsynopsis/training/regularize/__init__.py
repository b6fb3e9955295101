"""Dropout, jitter, exposure and floaters."""
