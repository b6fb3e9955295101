"""The file: its bytes, and the speed of packing and decoding."""
