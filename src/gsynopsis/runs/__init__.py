"""The run folder and its result."""
