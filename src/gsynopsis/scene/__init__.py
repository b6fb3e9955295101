"""Photos and poses in, a `Scene` out. No torch here."""
