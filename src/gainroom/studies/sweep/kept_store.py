"""Zarr store on disk that returns only content confirmed by checksums, and writes through no link."""

from collections.abc import AsyncGenerator, Collection, Iterable, Mapping
from pathlib import Path
from typing import Any

from zarr.core.buffer import default_buffer_prototype
from zarr.storage import LocalStore, WrapperStore

from .checksums import confirmed, damaged, refuse_links


class KeptStore(WrapperStore[LocalStore]):
    """Zarr store in a folder with verified content.

    known     SHA-256 of each array's zarr.json by its place, and of the group's as it was when that was checked
    growing   arrays whose chunks are added one by one: no chunk of any other array may be missing
    """

    def __init__(self, store: LocalStore, path: Path, known: Mapping[str, str], growing: Collection[str]):
        super().__init__(store)
        self._path, self._known, self._growing = path, known, growing

    def _with_store(self, store: LocalStore) -> "KeptStore":
        return type(self)(store, self._path, self._known, self._growing)

    async def get(self, key: str, prototype: Any = None, byte_range: Any = None) -> Any:
        """Verified content of a file. Raises GainroomError, naming the file, if it is damaged or lost."""
        found = await super().get(key, prototype or default_buffer_prototype(), byte_range)
        if byte_range is None and found is not None and not confirmed(key, found.to_bytes(), self._known):
            raise damaged(self._path, key)
        name, _, chunk = key.partition("/c/")
        if found is None and (key in self._known or (chunk and name not in self._growing)):
            raise damaged(self._path, key)
        return found

    async def _get_many(self, requests: Iterable[Any]) -> AsyncGenerator[Any, None]:
        for key, prototype, byte_range in requests:
            yield key, await self.get(key, prototype, byte_range)

    async def set(self, key: str, value: Any) -> None:
        """Write a file. Raises GainroomError if a link is in the way."""
        refuse_links(self._path, key)
        await super().set(key, value)
