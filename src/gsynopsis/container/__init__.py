"""A `LevelSet` to bytes and back. NumPy and zlib only."""

from gsynopsis.container.assembler import Assembler, Partial
from gsynopsis.container.edit import annotated, check_file, cut_file, split_file
from gsynopsis.container.encode_level import PartSize
from gsynopsis.container.info import FileInfo, LevelInfo, PartInfo, describe
from gsynopsis.container.reader import decode, read_gsyn
from gsynopsis.container.sizes import LevelSizes, measure
from gsynopsis.container.writer import SizeAccount, encode, write_gsyn

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
