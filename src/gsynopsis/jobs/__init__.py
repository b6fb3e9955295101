"""The whole road as functions: scene and recipe → run → file → pictures and figures.

What `gsynopsis` exports comes from here; the command line only parses, calls and prints.
"""
