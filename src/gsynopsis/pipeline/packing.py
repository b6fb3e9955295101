"""The file format as training sees it."""

from gsynopsis.pack.rounding import rounded
from gsynopsis.pack.writer import encode_with_account
from gsynopsis.records import LevelSet, Sensitivity


class FilePacker:
    """What training asks of the file format, in the coding of the result."""

    def sizes(self, levels: LevelSet) -> tuple[int, ...]:
        """Bytes of the file up to the end of each level."""
        return encode_with_account(levels)[1].ends

    def rounded(self, levels: LevelSet, sensitivity: Sensitivity, loss: float) -> LevelSet:
        """These levels with values that a file holds exactly; images lose about `loss` dB."""
        return rounded(levels, sensitivity, loss)
