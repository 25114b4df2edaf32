"""Checksums of a sweep's store, and refusal of links.

Chunks end with their CRC-32C, which is Zarr's codec of that name. The SHA-256 of each array's zarr.json is stored in that of the group,
which stores its own over the rest of its content. One flipped bit is always found; a forger could compute checksums, too.
"""

import hashlib
import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ...errors import GainroomError

METADATA = "zarr.json"
CHECKSUM = "checksum"
"""Attribute of a group with the digest of its own zarr.json."""
WIDTH = 4
"""Number of bytes of a CRC-32C."""


def sha256(content: bytes) -> str:
    """SHA-256 of `content` in hexadecimal digits."""
    return hashlib.sha256(content).hexdigest()


def confirmed(place: str, content: bytes, known: Mapping[str, str]) -> bool:
    """True if a file's content matches the checksum of its place in the store."""
    if place.rpartition("/")[2] == METADATA:
        return sha256(content) == known.get(place)
    import google_crc32c  # comes with the extra `sweep`

    return len(content) > WIDTH and google_crc32c.value(content[:-WIDTH]).to_bytes(WIDTH, "little") == content[-WIDTH:]


def damaged(path: Path, place: str) -> GainroomError:
    """Error that names the damaged file of a store."""
    return GainroomError(f"{path}: is damaged: {place} is not what was written there")


def refuse_links(path: Path, place: str) -> None:
    """Raise GainroomError if a file of a store, or a folder in it on the way there, is a link, which would lead outside the store."""
    way = path
    for part in place.split("/"):
        way = way / part
        if os.path.islink(way):
            raise GainroomError(f"{path}: {way.relative_to(path)} is a link, which is not followed; nothing was written there")


def digests(path: Path) -> dict[str, str]:
    """SHA-256 of every array's zarr.json by its place."""
    found = sorted(path.glob(f"*/{METADATA}"))
    return {str(each.relative_to(path).as_posix()): sha256(each.read_bytes()) for each in found}


def own_digest(group: Mapping[str, Any]) -> str:
    """Digest of a group's zarr.json without the digest itself."""
    attributes = {key: value for key, value in group["attributes"].items() if key != CHECKSUM}
    return sha256(json.dumps({**group, "attributes": attributes}, sort_keys=True).encode())
