"""Progress of a training, as people and programs read it."""
