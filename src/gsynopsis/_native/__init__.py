"""The C++ extension: rasteriser, hash grid and whatever else is hot."""
