"""How large the pages of a Parquet column are when they are unpacked, before anything is: pyarrow believes what they announce.

A page's header is a struct in Thrift's compact protocol (parquet.thrift, PageHeader); its fields 2 and 3 are the two sizes.
"""

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO

from ....errors import GainroomError

UNCOMPRESSED, COMPRESSED = 2, 3
MOST_HEADER = 1 << 16
"""Bytes: two numbers, an encoding, and statistics with the column's least and largest value."""
DEEPEST = 16


def page_sizes(path: Path, chunk: Any) -> Iterator[int]:
    """Uncompressed size of every page of a column chunk, as announced [bytes]. Raises GainroomError."""
    first = chunk.data_page_offset
    if chunk.has_dictionary_page and chunk.dictionary_page_offset is not None and 0 < chunk.dictionary_page_offset < first:
        first = chunk.dictionary_page_offset
    place, end = first, first + chunk.total_compressed_size
    if not 4 <= place <= end <= path.stat().st_size:
        raise GainroomError(f"{path}: column {chunk.path_in_schema} lies outside the file")
    with open(path, "rb") as file:
        while place < end:
            file.seek(place)
            header = _Compact(file)
            sizes = header.struct()
            if sizes.get(COMPRESSED, -1) < 0 or sizes.get(UNCOMPRESSED, -1) < 0:
                raise GainroomError(f"{path}: a page of column {chunk.path_in_schema} has no size")
            yield sizes[UNCOMPRESSED]
            place += header.count + sizes[COMPRESSED]


class _Compact:
    """Reader of Thrift's compact protocol, as far as needed to skip over it."""

    def __init__(self, file: BinaryIO) -> None:
        self._data, self.count = file.read(MOST_HEADER), 0

    def _bytes(self, count: int) -> bytes:
        piece = self._data[self.count : self.count + count]
        if len(piece) < count:
            raise ValueError("a page's header does not end")
        self.count += count
        return piece

    def _varint(self) -> int:
        value = 0
        for shift in range(0, 70, 7):
            byte = self._bytes(1)[0]
            value |= (byte & 0x7F) << shift
            if byte < 0x80:
                return value
        raise ValueError("a page's header holds a number of more than 64 bits")

    def _integer(self) -> int:
        value = self._varint()
        return (value >> 1) ^ -(value & 1)

    def struct(self, depth: int = 0) -> dict[int, int]:
        """Integers of a struct, by field number; all other fields are skipped."""
        if depth > DEEPEST:
            raise ValueError("a page's header is nested too deep")
        numbers: dict[int, int] = {}
        field = 0
        while head := self._bytes(1)[0]:
            step, kind = head >> 4, head & 0x0F
            field = field + step if step else self._integer()
            value = self._value(kind, depth)
            if value is not None:
                numbers[field] = value
        return numbers

    def _value(self, kind: int, depth: int) -> int | None:
        if kind in (4, 5, 6):
            return self._integer()
        if kind in (3, 7):
            self._bytes(1 if kind == 3 else struct.calcsize("d"))
        elif kind == 8:
            self._bytes(self._varint())
        elif kind in (9, 10):
            head = self._bytes(1)[0]
            count = head >> 4 if head >> 4 < 15 else self._varint()
            for _ in range(min(count, MOST_HEADER)):
                self._value(head & 0x0F if head & 0x0F > 2 else 3, depth + 1)
        elif kind == 12:
            self.struct(depth + 1)
        elif kind not in (1, 2):
            raise ValueError("a page's header is not Thrift")
        return None
