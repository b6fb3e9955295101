"""A `LevelSet` to bytes and back. NumPy and zlib only."""

from gsynopsis.pack.info import FileInfo, LevelInfo, PartInfo, describe
from gsynopsis.pack.reader import Assembler, decode, read_gsyn
from gsynopsis.pack.sizes import LevelSizes, measure
from gsynopsis.pack.writer import PartSize, SizeAccount, encode, write_gsyn

__all__ = [
    "Assembler",
    "FileInfo",
    "LevelInfo",
    "LevelSizes",
    "PartInfo",
    "PartSize",
    "SizeAccount",
    "decode",
    "describe",
    "encode",
    "measure",
    "read_gsyn",
    "write_gsyn",
]
