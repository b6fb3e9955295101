"""A scene and an anchor model in, a better anchor model out."""
