"""Made-up scenes with known cameras, by a ray tracer."""
