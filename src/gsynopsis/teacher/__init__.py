"""A finished splat as the teacher of a training: its renders are the photos (methods.md §2.18)."""
