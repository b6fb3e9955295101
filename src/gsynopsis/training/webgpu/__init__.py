"""Whole training steps on a GPU through WGSL: from anchors to moved parameters."""
