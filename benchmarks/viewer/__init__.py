"""The viewer in Chromium and under node."""
