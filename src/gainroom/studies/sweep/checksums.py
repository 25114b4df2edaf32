"""Checksums of a sweep's store, and no way through links.

Chunks end with their CRC-32C, which is Zarr's codec of that name. The SHA-256 of each array's zarr.json stands in that of the group,
which has its own, of what is in it but that. One flipped bit is always found; who wants to deceive can compute checksums, too.
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
"""The attribute of a group with the digest of its own zarr.json."""
WIDTH = 4
"""Bytes of a CRC-32C."""


def sha256(content: bytes) -> str:
    """In hexadecimal digits."""
    return hashlib.sha256(content).hexdigest()


def confirmed(place: str, content: bytes, known: Mapping[str, str]) -> bool:
    """Whether a file's content is what was once written in this place of the store."""
    if place.rpartition("/")[2] == METADATA:
        return sha256(content) == known.get(place)
    import google_crc32c  # comes with the extra `sweep`

    return len(content) > WIDTH and google_crc32c.value(content[:-WIDTH]).to_bytes(WIDTH, "little") == content[-WIDTH:]


def damaged(path: Path, place: str) -> GainroomError:
    """Says which file of a store is."""
    return GainroomError(f"{path}: is damaged: {place} is not what was written there")


def refuse_links(path: Path, place: str) -> None:
    """Raise GainroomError where a file of a store, or a folder in it on the way there, is a link: what it leads to is not ours."""
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
    """Of what a group's zarr.json says, but for this digest."""
    attributes = {key: value for key, value in group["attributes"].items() if key != CHECKSUM}
    return sha256(json.dumps({**group, "attributes": attributes}, sort_keys=True).encode())
