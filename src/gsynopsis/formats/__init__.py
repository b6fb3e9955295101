"""Other programs' files of plain Gaussians, read and written: PLY, SPZ, SOG, glTF, USD."""
