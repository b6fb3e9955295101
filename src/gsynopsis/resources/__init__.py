"""Memory and time that a training takes."""
