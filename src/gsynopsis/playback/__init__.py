"""Playback of a file while it streams: what a viewer would have seen."""
