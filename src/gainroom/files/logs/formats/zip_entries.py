"""Entries of a zip archive, within bounds."""

import zipfile
from pathlib import Path

from ....errors import one_line
from ..table import MOST_RATIO, MOST_WHOLE, bounded

MOST_ENTRIES = 10_000


class ZipEntries:
    """Entries of a zip archive; each is unpacked once at most."""

    def __init__(self, path: Path, archive: zipfile.ZipFile, size: int) -> None:
        self._path, self._archive, self._size = path, archive, size
        self._entries = {entry.filename: entry for entry in archive.infolist()}
        bounded(path, "number of entries", len(self._entries), MOST_ENTRIES)
        self._unpacked: dict[str, bytes] = {}

    @property
    def names(self) -> list[str]:
        """Names of all entries, in the archive's order."""
        return [*self._entries]

    def entry(self, name: str, most: int = MOST_WHOLE) -> bytes:
        """Content of an entry, of at most `most` bytes; b"" if there is none. The size is checked before and while it is unpacked."""
        if name not in self._entries:
            return b""
        if name not in self._unpacked:
            announced = self._entries[name].file_size
            bounded(self._path, f"entry {one_line(name, 60)}:", announced, min(most, self._size * MOST_RATIO), " bytes")
            bounded(self._path, "entries together:", announced + sum(map(len, self._unpacked.values())), MOST_WHOLE, " bytes")
            with self._archive.open(self._entries[name]) as stream:
                self._unpacked[name] = stream.read(announced)
        return self._unpacked[name]
