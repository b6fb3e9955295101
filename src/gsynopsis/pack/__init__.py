"""A `LevelSet` to bytes and back. NumPy and zlib only."""

from gsynopsis.pack.assembler import Assembler, Partial
from gsynopsis.pack.edit import annotated, check_file, cut_file, split_file
from gsynopsis.pack.info import FileInfo, LevelInfo, PartInfo, describe
from gsynopsis.pack.pieces import PartSize
from gsynopsis.pack.reader import decode, read_gsyn
from gsynopsis.pack.sizes import LevelSizes, measure
from gsynopsis.pack.writer import SizeAccount, encode, write_gsyn

__all__ = [
    "Assembler",
    "FileInfo",
    "LevelInfo",
    "LevelSizes",
    "PartInfo",
    "PartSize",
    "Partial",
    "SizeAccount",
    "annotated",
    "check_file",
    "cut_file",
    "decode",
    "describe",
    "encode",
    "measure",
    "read_gsyn",
    "split_file",
    "write_gsyn",
]
