"""Phases of a training: the full model, joint levels, sequential levels."""
