"""The beginning of a stream: one request for index, directories and, as a rule, the base.

A client that asked for the index alone would pay a round trip for it before it could ask for the
base. So the first request reaches further, and its bytes are used as they come in.
"""

from gsynopsis.container import Assembler
from gsynopsis.container.index import check_length
from gsynopsis.container.layout import INDEX_BYTES_MAX, ChunkEntry, Kind
from gsynopsis.errors import SourceError, TruncatedError
from gsynopsis.stream.fetch import FetchedRange, Fetcher

FIRST_BYTES = 1 << 16
"""Length of the first request (ours: index, directories and a base for links of 0.5 Mbit/s; on
those, what comes behind a smaller base is the next second's work in any order)."""
FIRST = "first bytes"
"""Name of the first request."""


class Bootstrap:
    """The first bytes of a file, as far as received, and their contents.

    Attributes:
        data: The bytes so far, from the beginning of the file.
        time: Time of the last of them, seconds.
        assembler: Index and directories; None while too little of the index is there.
        levels: Number of levels that the file holds whole: a prefix has fewer than its tables list.
            0 while its end is not known.
        cut: Reason to refuse the file once all whole levels are there; None if it is sound.
    """

    def __init__(self, fetcher: Fetcher, name: str, length: int = FIRST_BYTES) -> None:
        """Nothing is asked for yet.

        Args:
            fetcher: The session's.
            name: What messages call the file.
            length: Of the first request, bytes; at least those that an index may have.
        """
        self._fetcher, self._name = fetcher, name
        self._length = max(length, INDEX_BYTES_MAX)
        self._lacks: list[ChunkEntry] = []
        self._late: dict[ChunkEntry, bytes] = {}
        self._begun = self._whole = False
        self.data = b""
        self.time = 0.0
        self.assembler: Assembler | None = None
        self.levels = 0
        self.cut: SourceError | None = None

    @property
    def open(self) -> bool:
        """Index, manifest and the directories of all levels that the file holds are there.

        Of directories in pages their tables.
        """
        return self.levels > 0 and not self._lacks

    @property
    def whole(self) -> bool:
        """All that the first request brings is there."""
        return self._whole

    @property
    def stop(self) -> int:
        """End of the first request: its length, or the end of the file."""
        if self._whole or self.assembler is None:
            return len(self.data) if self._whole else self._length
        end = self.assembler.index.levels[-1].end
        return min(self._length, end, self._fetcher.size or end)

    @property
    def late(self) -> int:
        """Bytes of directories that did not come with the first request."""
        return sum(len(data) for data in self._late.values())

    def ask(self) -> None:
        """Ask for the first bytes; then for directories that are not within them."""
        if not self._begun:
            self._begun = True
            self._fetcher.request(FIRST, 0, self._length, clip=True)
            return
        for chunk in self._lacks:
            end = chunk.offset + chunk.stored
            known = end <= self.stop or chunk in self._late or chunk in self._fetcher.keys
            if not known and self._fetcher.free > 0:
                self._fetcher.request(chunk, max(chunk.offset, self.stop), end)

    def take(self, completed: FetchedRange) -> bool:
        """Take a range if it is one that was asked for here; whether it was.

        Raises:
            FormatError: index or directories break a promise of the format.
        """
        if completed.key == FIRST:
            self._whole = True
            self._grow(completed.data, completed.ended)
            return True
        if isinstance(completed.key, ChunkEntry):
            self._late[completed.key] = completed.data
            self.time = max(self.time, completed.ended)
            self._add_directories()
            return True
        return False

    def look(self) -> None:
        """Use what has come so far of the first bytes.

        Raises:
            FormatError: index or directories break a promise of the format.
        """
        if not self._whole and FIRST in self._fetcher.keys:
            data, time = self._fetcher.received_so_far(FIRST)
            if len(data) > len(self.data):
                self._grow(data, time)

    def _grow(self, data: bytes, time: float) -> None:
        self.data, self.time = data, time
        if self.assembler is None:
            try:
                self.assembler = Assembler(data, self._name)
            except TruncatedError:
                if self._whole:
                    raise
                return
        if not self.levels:
            self._count_levels(self.assembler)
        self._add_directories()

    def _count_levels(self, assembler: Assembler) -> None:
        """From the file's length: what lies behind its end is never asked for.

        Raises:
            TruncatedError: no level is whole, or the file goes on behind its last level.
        """
        size = self._fetcher.size
        if size is None:
            # Hosts that hide it show it by an answer that is shorter than the request.
            if not self._whole:
                return
            size = len(self.data) if len(self.data) < self._length else None
        levels = assembler.index.levels
        held = sum(size is None or level.end <= size for level in levels)
        if size is not None and size not in [level.end for level in levels]:
            if not held or size > levels[-1].end:
                check_length(assembler.index, size, self._name)
            found = f"a file that ends within level {held}, after {size} bytes"
            expected = f"{levels[held].end} bytes"
            self.cut = SourceError(self._name, found=found, expected=expected)
        end = levels[held - 1].end
        tables = {Kind.MANIFEST, Kind.DIRECTORY}
        self._lacks = [c for c in assembler.index.chunks if c.kind in tables and c.offset < end]
        self.levels = held

    def _add_directories(self) -> None:
        """A directory is read with that of the level before, so they are taken in their order."""
        assert self.assembler is not None
        while self._lacks:
            chunk = self._lacks[0]
            stored = self.data[chunk.offset : chunk.offset + chunk.stored]
            stored += self._late.get(chunk, b"")
            if len(stored) < chunk.stored:
                return
            self.assembler.add(self._lacks.pop(0), stored)
