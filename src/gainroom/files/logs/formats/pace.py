"""PyTorch's .pt files with arrays of numbers, such as PACE's {time, dof_pos, des_dof_pos}: without torch, and without unpickling.

A .pt file is a zip archive: a pickle, which says what there is, and one entry per array with its bytes. A pickle is a program, and
Python's unpickler runs it. The reader below runs none of it: it knows the instructions that build dictionaries, lists, names and numbers,
and the two calls that torch writes for a tensor; anything else is refused by its name.
"""

import contextlib
import math
import pickletools
import zipfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ....errors import GainroomError, one_line
from ..table import MOST_COLUMNS, LogFormat, Table, bounded, checked_file
from .arrays import ArrayTable, NamedArray
from .zip_entries import ZipEntries

STORAGES = {
    f"torch {kind}Storage": dtype
    for kind, dtype in {
        "Double": "f8",
        "Float": "f4",
        "Half": "f2",
        "Long": "i8",
        "Int": "i4",
        "Short": "i2",
        "Char": "i1",
        "Byte": "u1",
        "Bool": "u1",
    }.items()
}
TENSOR = "torch._utils _rebuild_tensor_v2"
MAPPING = "collections OrderedDict"
"""The hooks of a tensor, always empty."""
MOST_PICKLE = 1 << 24
"""Bytes of the pickle: some hundred per array."""
DEEPEST = 4
"""Dictionaries within dictionaries."""


class Torch(LogFormat):
    """Reader of logs in .pt files of torch.save."""

    name = ".pt (PACE)"
    title = "a .pt file with arrays"
    endings = (".pt", ".pth")

    @contextlib.contextmanager
    def table(self, path: Path, time: str | None) -> Iterator[Table]:
        size = checked_file(path)
        if not zipfile.is_zipfile(path):
            raise GainroomError(f"{path}: is not a .pt file since torch 1.6 (a zip archive); save it anew with torch.save")
        with zipfile.ZipFile(path) as archive:
            arrays, labels = _arrays(path, ZipEntries(path, archive, size))
        yield ArrayTable(path, arrays, time, labels)


@dataclass(frozen=True)
class _Global:
    """Name that the pickle would import; nothing is imported."""

    name: str


@dataclass(frozen=True)
class _Storage:
    entry: str
    dtype: str


@dataclass(frozen=True)
class _Tensor:
    storage: _Storage
    offset: int
    shape: tuple[int, ...]
    strides: tuple[int, ...]


def _arrays(path: Path, archive: ZipEntries) -> tuple[dict[str, NamedArray], tuple[str, ...]]:
    """Arrays by their path in the file's dictionary, and a list of texts in it: the names of the joints."""
    pickles = [name for name in archive.names if name == "data.pkl" or name.endswith("/data.pkl")]
    if len(pickles) != 1:
        raise GainroomError(f"{path}: has {len(pickles)} entries data.pkl, and a .pt file has one")
    root = pickles[0].removesuffix("data.pkl")
    order = ">" if archive.entry(f"{root}byteorder", 16).strip() == b"big" else "<"
    found: dict[str, NamedArray] = {}
    labels: tuple[str, ...] = ()

    def take(name: str, value: object, depth: int) -> None:
        nonlocal labels
        bounded(path, "number of arrays", len(found), MOST_COLUMNS)
        if isinstance(value, dict) and depth < DEEPEST:
            for key, item in value.items():
                take(f"{name}/{key}" if name else str(key), item, depth + 1)
        elif isinstance(value, _Tensor):
            data = np.frombuffer(archive.entry(f"{root}data/{value.storage.entry}"), order + value.storage.dtype)
            found[name] = NamedArray.of(_strided(path, name, value, data))
        elif isinstance(value, list) and value and all(isinstance(item, str) for item in value):
            labels = tuple(value)

    take("", _built(path, archive.entry(pickles[0], MOST_PICKLE)), 0)
    return found, labels


def _strided(path: Path, name: str, tensor: _Tensor, data: Any) -> Any:
    """Numbers of a tensor as an array. Raises GainroomError if the file does not hold all of them."""
    shape, strides = tensor.shape, tensor.strides
    if len(shape) != len(strides) or any(each < 0 for each in (tensor.offset, *shape, *strides)):
        raise GainroomError(f"{path}: {one_line(name, 60)}: shape {shape} with strides {strides} is none")
    count = math.prod(shape)
    last = tensor.offset + sum((length - 1) * step for length, step in zip(shape, strides, strict=True)) if count else 0
    if count > len(data) or (count and last >= len(data)):  # a stride of 0 would repeat one number for ever
        raise GainroomError(f"{path}: {one_line(name, 60)}: {count} numbers of shape {shape} must be in its {len(data)} numbers")
    places = [step * data.itemsize for step in strides]
    return np.lib.stride_tricks.as_strided(data[tensor.offset :], shape, places, writeable=False)


def _built(path: Path, data: bytes) -> object:
    """Object that a pickle describes: dictionaries, lists, tuples, texts, numbers, tensors. Raises GainroomError for anything else."""
    machine = _Machine(path)
    for code, argument, _ in pickletools.genops(data):
        if code.name == "STOP":
            return machine.pop()
        machine.run(code.name, argument)
    raise GainroomError(f"{path}: its pickle does not end")


class _Machine:
    """Interpreter of the pickle instructions in torch's files: a stack and a memory."""

    MARK = object()
    VALUES = frozenset(
        [
            "BININT",
            "BININT1",
            "BININT2",
            "LONG1",
            "BINFLOAT",
            "BINUNICODE",
            "SHORT_BINUNICODE",
            "BINUNICODE8",
            "UNICODE",
            "INT",
            "LONG",
            "FLOAT",
        ]
    )
    CONSTANTS = {"NONE": None, "NEWTRUE": True, "NEWFALSE": False}  # noqa: RUF012 - never changed

    def __init__(self, path: Path) -> None:
        self._path = path
        self._stack: list[Any] = []
        self._memory: dict[int, Any] = {}

    def pop(self) -> Any:
        return self._stack.pop()

    def _marked(self) -> list[Any]:
        items: list[Any] = []
        while (item := self._stack.pop()) is not self.MARK:
            items.append(item)
        return items[::-1]

    def run(self, name: str, argument: Any) -> None:
        stack = self._stack
        if name in ("PROTO", "FRAME"):
            return
        if name in self.VALUES:
            stack.append(argument)
        elif name in self.CONSTANTS:
            stack.append(self.CONSTANTS[name])
        elif name == "MARK":
            stack.append(self.MARK)
        elif name in ("EMPTY_DICT", "EMPTY_LIST", "EMPTY_TUPLE"):
            stack.append({"EMPTY_DICT": dict, "EMPTY_LIST": list, "EMPTY_TUPLE": tuple}[name]())
        elif name in ("BINPUT", "LONG_BINPUT", "PUT", "MEMOIZE"):
            self._memory[len(self._memory) if name == "MEMOIZE" else argument] = stack[-1]
        elif name in ("BINGET", "LONG_BINGET", "GET"):
            stack.append(self._memory[argument])
        elif name in ("TUPLE1", "TUPLE2", "TUPLE3"):
            count = int(name[-1])
            stack[-count:] = [tuple(stack[-count:])]
        else:
            self._compound(name, argument)

    def _compound(self, name: str, argument: Any) -> None:
        stack = self._stack
        if name in ("TUPLE", "LIST", "DICT"):
            items = self._marked()
            stack.append(tuple(items) if name == "TUPLE" else items if name == "LIST" else self._pairs(items))
        elif name in ("SETITEM", "SETITEMS"):
            items = self._marked() if name == "SETITEMS" else [stack.pop(-2), stack.pop()]
            self._holder(dict).update(self._pairs(items))
        elif name in ("APPEND", "APPENDS"):
            items = self._marked() if name == "APPENDS" else [stack.pop()]
            self._holder(list).extend(items)
        elif name == "GLOBAL":
            if argument not in (TENSOR, MAPPING, *STORAGES):
                raise GainroomError(
                    f"{self._path}: its pickle names {one_line(argument, 60)!r}; only arrays of numbers are read from .pt files"
                )
            stack.append(_Global(argument))
        elif name == "BINPERSID":
            stack.append(self._storage(stack.pop()))
        elif name == "REDUCE":
            arguments, function = stack.pop(), stack.pop()
            stack.append(self._tensor(function, arguments))
        else:
            raise GainroomError(f"{self._path}: its pickle holds the instruction {name}, which arrays of numbers do not need")

    def _pairs(self, items: list[Any]) -> dict[str | int, Any]:
        """Dictionary of alternating keys and values; keys must be texts or numbers, as nested tuples could take for ever to be hashed."""
        if not all(type(key) in (str, int) for key in items[::2]):
            raise GainroomError(f"{self._path}: its pickle has a key that is neither a text nor a whole number")
        return dict(zip(items[::2], items[1::2], strict=True))

    def _holder(self, kind: type) -> Any:
        if type(self._stack[-1]) is not kind:
            raise GainroomError(f"{self._path}: its pickle adds to something that is no {kind.__name__}")
        return self._stack[-1]

    def _storage(self, described: Any) -> _Storage:
        word, kind, entry = described[:3]
        if word != "storage" or not isinstance(kind, _Global) or kind.name not in STORAGES or not isinstance(entry, str):
            raise GainroomError(f"{self._path}: its pickle refers to something that is no array of numbers")
        return _Storage(entry, STORAGES[kind.name])

    def _tensor(self, function: Any, arguments: Any) -> object:
        name = function.name if isinstance(function, _Global) else f"a {type(function).__name__}"
        if name == MAPPING and arguments == ():
            return {}
        if name != TENSOR or not isinstance(arguments, tuple) or len(arguments) < 4:
            raise GainroomError(f"{self._path}: its pickle calls {name}; nothing is called to read a log")
        storage, offset, shape, strides = arguments[:4]
        whole = all(type(each) is int for part in (shape, strides) if isinstance(part, tuple) for each in (offset, *part))
        if not isinstance(storage, _Storage) or not isinstance(shape, tuple) or not isinstance(strides, tuple) or not whole:
            raise GainroomError(f"{self._path}: its pickle describes an array that is none")
        return _Tensor(storage, offset, shape, strides)
