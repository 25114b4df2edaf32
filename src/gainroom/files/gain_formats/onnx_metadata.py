"""The gains that a policy was trained with, from its ONNX file's metadata: joint_names, joint_stiffness, joint_damping, default_joint_pos.

mjlab and exporters for Isaac Lab write them as comma-separated text. Only this text is read, by the few rules of protobuf's encoding that
it takes: what is not metadata is passed over where it lies, so a file of any size costs little, the network is never loaded, and the
package onnx is not needed. (onnx.proto: ModelProto has StringStringEntryProto metadata_props = 14 with key = 1 and value = 2.)
"""

import io
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from ...errors import GainroomError
from ...io.bounded_text import regular_file
from ...io.yaml_text import shown
from .gain_arrays import ArrayNames, OrderedGains, read_arrays

METADATA, KEY, VALUE = 14, 1, 2
VARINT, FIXED64, BYTES, FIXED32 = 0, 1, 2, 5
MOST_FIELDS = 10_000
MOST_BYTES = 1 << 20
"""Of all metadata together."""
DECIMALS = 3
"""That exporters write."""
COARSE = 50 * 10.0**-DECIMALS
"""Below this rounding takes more than a percent."""


def read_onnx(path: Path) -> OrderedGains:
    """The gains in a policy's metadata. Raises GainroomError, one line that names the file."""
    metadata = _metadata(path)
    source = str(path)
    missing = [key for key in ("joint_names", "joint_stiffness", "joint_damping") if key not in metadata]
    if missing:
        known = f"; it has {', '.join(map(shown, list(metadata)[:8]))}" if metadata else "; it has none"
        raise GainroomError(f"{source}: {missing[0]} is missing in the metadata{known}; give --gains FILE of another form")
    names = tuple((name.strip(),) for name in _items(metadata["joint_names"]))
    data = {key: [_number(f"{source}: {key}", text) for text in _items(metadata[key])] for key in ("joint_stiffness", "joint_damping")}
    found = read_arrays(data, ArrayNames(names, (), "joint_names"), source)
    coarse = [name for (name,), gain in zip(names, found.ordered, strict=True) if min(gain.kp, gain.kd) < COARSE]
    notes = (f"{source}: gains are written with {DECIMALS} decimals, which is coarse for {', '.join(coarse[:4])}",) if coarse else ()
    return OrderedGains(source, "ONNX metadata", {}, notes=notes, ordered=found.ordered, order=found.order, what=found.what)


def _items(text: str) -> list[str]:
    return text.strip().removeprefix("[").removesuffix("]").split(",")


def _number(owner: str, text: str) -> float:
    try:
        return float(text) + 0.0  # -0.000 is 0
    except ValueError as error:
        raise GainroomError(f"{owner}: {shown(text)} must be a number") from error


def _metadata(path: Path) -> dict[str, str]:
    """The texts of a model's metadata by key."""
    found: dict[str, str] = {}
    total = 0
    with regular_file(path) as (stream, size):
        for length in _entries(stream, size, path):
            total += length
            if total > MOST_BYTES:
                raise GainroomError(f"{path}: holds more than {MOST_BYTES} bytes of metadata; this is no policy")
            key, value = _pair(stream.read(length), path)
            if key in found:
                raise GainroomError(f"{path}: {shown(key)} stands in the metadata twice")
            found[key] = value
    return found


def _entries(stream: BinaryIO, size: int, path: Path) -> Iterator[int]:
    """Where the stream stands at an entry of metadata, its length; the rest is passed over."""
    for _ in range(MOST_FIELDS):
        if stream.tell() >= size:
            return
        number, kind = divmod(_varint(stream, path), 8)
        if number == 0 or kind not in (VARINT, FIXED64, BYTES, FIXED32):
            raise _malformed(path)
        length = {FIXED64: 8, FIXED32: 4}.get(kind, 0)
        if kind in (VARINT, BYTES):
            value = _varint(stream, path)
            length = value if kind == BYTES else 0
        end = stream.tell() + length
        if end > size:
            raise _malformed(path)
        if number == METADATA and kind == BYTES:
            yield length
        stream.seek(end)
    raise GainroomError(f"{path}: has more than {MOST_FIELDS} fields; this is no policy")


def _pair(entry: bytes, path: Path) -> tuple[str, str]:
    """Key and value of one entry."""
    stream = io.BytesIO(entry)
    texts = {KEY: "", VALUE: ""}
    while stream.tell() < len(entry):
        number, kind = divmod(_varint(stream, path), 8)
        if kind != BYTES:
            raise _malformed(path)
        length = _varint(stream, path)
        raw = stream.read(length) if length <= len(entry) else b""
        if len(raw) != length:
            raise _malformed(path)
        if number in texts:
            try:
                texts[number] = raw.decode("utf-8")
            except UnicodeDecodeError as error:
                raise GainroomError(f"{path}: a text in the metadata is not UTF-8") from error
    return texts[KEY], texts[VALUE]


def _varint(stream: BinaryIO, path: Path) -> int:
    """A number of up to 64 bits, seven per byte, the lowest first."""
    value = 0
    for shift in range(0, 70, 7):
        byte = stream.read(1)
        if not byte:
            break
        value |= (byte[0] & 0x7F) << shift
        if byte[0] < 0x80:
            return value
    raise _malformed(path)


def _malformed(path: Path) -> GainroomError:
    return GainroomError(f"{path}: is no ONNX model, or not a whole one")
