"""Layout of a sweep's store: arrays, labels, attributes and checksums, and the check that it is intact."""

import contextlib
import json
import math
import os
import secrets
import shutil
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import GainroomError, one_line
from ...io.run_files import at_last
from ...system.linear.arrays import Floats
from ...system.uncertainty import OF_GEARBOXES
from .checksums import CHECKSUM, METADATA, confirmed, damaged, digests, own_digest, refuse_links, sha256
from .plan import SweepPlan

FORMAT = "gainroom sweep 3"
UNCHECKED = ("gainroom sweep 1", "gainroom sweep 2")
"""Older formats without checksums."""
DIGESTS = "metadata"
"""Attribute with the digests of the arrays' zarr.json."""
NAME = FORMAT.rstrip("0123456789")
RESULTS = {
    "gain": ("float64", "1", "largest factor on all gains up to which the loop is proved stable"),
    "lower_gain": ("float64", "1", "the loop is stable from this factor on; 0: from the lowest"),
    "frequency": ("float64", "rad/s", "at which the loop vibrates at that factor"),
    "limiting_joint": ("int16", "1", "number of the joint that moves most in that vibration; -1: none"),
    "certified": ("bool", "1", "whether the gain is proved, or unstable roots were counted on both sides of it"),
}
"""Result arrays by name: type, unit, meaning."""
GROWING = (*RESULTS, "angles")
"""Arrays written task by task."""
DIFFERENT = {
    "version": "was computed by gainroom {stored}; this is {now}",
    "robot": "is of another robot, control or drive",
    "postures": "is of other postures",
    "contacts": "is of other contact states",
    "draws": "is of other draws of the uncertainty",
}


def library(name: str) -> Any:
    """Module zarr or xarray. Raises GainroomError if it is not installed."""
    import importlib

    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise GainroomError(f"results of sweeps need {name}: pip install 'gainroom[sweep]'") from error


def attributes(path: Path) -> dict[str, Any]:
    """Attributes of the store at `path`. Raises GainroomError if it is no store, or damaged there."""
    content = _content(path / METADATA)
    try:
        group = json.loads(content.decode())
        found = dict(group["attributes"])
    except (ValueError, KeyError, TypeError, RecursionError):
        group, found = {}, {}
    written_format = str(found.get("format"))
    whole = CHECKSUM in found and own_digest(group) == found[CHECKSUM]
    if (CHECKSUM in found and not whole) or (not found and NAME.encode() in content):
        raise GainroomError(f"{damaged(path, METADATA)}, so whose it is cannot be told; it stays as it is: name another store")
    if whole and written_format == FORMAT:
        if not _complete(found):
            raise damaged(path, METADATA)
        return found
    if written_format in UNCHECKED:
        what = "the store of a sweep by an older gainroom, without checksums: damage in it would not be seen"
        raise GainroomError(f"{path}: is {what}; it stays as it is: sweep again into another store")
    what = "the store of a sweep by another version of gainroom" if written_format.startswith(NAME) else "not the store of a sweep"
    raise GainroomError(f"{path}: is {what}, and stays as it is")


def _complete(found: dict[str, Any]) -> bool:
    """True if attributes have everything needed to read and continue the sweep."""
    names = (
        isinstance(found.get(key), dict) and all(isinstance(each, str) for each in found[key].values()) for key in ("identity", DIGESTS)
    )
    counts = (isinstance(found.get(key), int) and found[key] > 0 for key in ("count", "chunk"))
    return all(names) and all(counts)


def kept(path: Path) -> Any:
    """KeptStore at `path`: a Zarr store that verifies the SHA-256 of each file when it is read.

    Raises GainroomError if the attributes are refused, see `attributes`.
    """
    zarr, known = library("zarr"), attributes(path)[DIGESTS]
    from .kept_store import KeptStore

    return KeptStore(zarr.storage.LocalStore(path), path, {**known, METADATA: sha256(_content(path / METADATA))}, GROWING)


def require_finished(path: Path) -> None:
    """Raise GainroomError if parts of the results at `path` are missing."""
    found = attributes(path)
    with telling(path, "read"):
        shapes = {name: json.loads((path / name / METADATA).read_bytes())["shape"] for name in GROWING}
    for name, shape in shapes.items():
        parts = math.ceil(found["count"] / found["chunk"])
        before = ["/".join(map(str, place)) + "/" for place in np.ndindex(*shape[:2])] if name in RESULTS else [""]
        after = "" if name in RESULTS else "/0"
        for place in (f"{name}/c/{first}{part}{after}" for first in before for part in range(parts)):
            if not filled(path / place):
                raise GainroomError(f"{path}: is not finished, {place} is missing: the `gainroom sweep` that made it goes on")


def require_same(path: Path, plan: SweepPlan) -> None:
    """Raise GainroomError if the store at `path` belongs to another sweep."""
    stored = attributes(path)["identity"]
    for name, text in DIFFERENT.items():
        if stored.get(name) != plan.identity[name]:
            message = text.format(stored=stored.get(name), now=plan.identity[name])
            raise GainroomError(f"{path}: {message}; nothing was changed there: name another store")


def created(path: Path, plan: SweepPlan) -> None:
    """Create a store, under another name first, so that there is a complete store or none."""
    if not path.parent.is_dir():
        raise GainroomError(f"{path}: cannot be written: there is no directory {path.parent}")
    with _empty(path, plan) as made, telling(path):
        os.rename(made, path)


def mended(path: Path, plan: SweepPlan) -> tuple[str, ...]:
    """Rewrite damaged files of the plan's store at `path` that are not task results; returns their places.

    Raises GainroomError if one cannot be reproduced.
    """
    known, broken = attributes(path)[DIGESTS], []
    if all(confirmed(place, _content(path / place), known) for place in [*known, *_labels(path, known)]):
        return ()
    with _empty(path, plan) as made, telling(path):
        for place in (each.relative_to(made).as_posix() for each in sorted(made.rglob("*")) if each.is_file()):
            if place == METADATA or confirmed(place, _content(path / place), known):
                continue
            refuse_links(path, place)
            if not confirmed(place, _content(made / place), known):
                raise damaged(path, place)
            os.makedirs((path / place).parent, exist_ok=True)
            os.replace(made / place, path / place)
            broken.append(place)
    return tuple(broken)


def _labels(path: Path, known: Iterable[str]) -> Iterator[str]:
    """Places of the single chunk of each array that is no task result, if its zarr.json can be read."""
    for name in {place.partition("/")[0] for place in known} - {*GROWING}:
        with contextlib.suppress(ValueError, KeyError, TypeError):
            yield "/".join((name, "c", *("0" for _ in json.loads(_content(path / name / METADATA))["shape"])))


@contextlib.contextmanager
def _empty(path: Path, plan: SweepPlan) -> Iterator[Path]:
    """Context with a new store without results beside `path`, under another name."""
    zarr = library("zarr")
    codecs = (zarr.codecs.ZstdCodec(level=0), zarr.codecs.Crc32cCodec())
    temporary = path.with_name(f".gainroom-{secrets.token_hex(6)}.tmp{path.suffix}")
    with at_last(lambda: shutil.rmtree(temporary, ignore_errors=True)), telling(path):
        group = zarr.create_group(temporary, zarr_format=3)
        postures, chunk = plan.postures.count, plan.chunk
        for name, (kind, unit, meaning) in RESULTS.items():
            # A chunk of fill values is written too: a missing file then always means missing results.
            missing = {"float64": np.nan, "int16": -2, "bool": False}[kind]
            group.create_array(
                name,
                shape=(len(plan.places), len(plan.contacts), postures),
                chunks=(1, 1, chunk),
                dtype=kind,
                fill_value=missing,
                dimension_names=("draw", "contact", "posture"),
                attributes={"units": unit, "long_name": meaning},
                compressors=codecs,
                config={"write_empty_chunks": True},
            )
        angles = {"units": "m for prismatic joints, rad for others", "long_name": "joint positions"}
        size = plan.robot.body.size
        group.create_array(
            "angles", shape=(postures, size), chunks=(chunk, size), dtype="float64", fill_value=np.nan,
            dimension_names=("posture", "joint"), attributes=angles, compressors=codecs,
        )  # fmt: skip
        for name, labels in (("contact", plan.contacts), ("joint", plan.robot.joint_names)):
            size = len(labels)
            array = group.create_array(name, shape=(size,), chunks=(size,), dtype="str", dimension_names=(name,), compressors=codecs)
            array[:] = np.array(labels, dtype=object)
        for name, values, unit in _draw_columns(plan):
            shape = values.shape
            dimensions = ("draw", "joint")[: len(shape)]
            array = group.create_array(
                f"draw_{name}", shape=shape, chunks=shape, dtype="float64", dimension_names=dimensions, attributes={"units": unit},
                compressors=codecs,
            )  # fmt: skip
            array[...] = values
        group.attrs.update(_about(plan) | {DIGESTS: digests(temporary)})
        group.attrs[CHECKSUM] = own_digest(json.loads((temporary / METADATA).read_bytes()))
        yield temporary


GEARBOX = ("stiffness", "damping")


def _draw_columns(plan: SweepPlan) -> Iterator[tuple[str, Floats, str]]:
    """Name, values in every draw (draws, n), nominal first, and unit of each uncertain quantity."""
    units = {"delay": "s", "stiffness": "N m/rad", "link_inertia": "kg m2", "motor_inertia": "kg m2", "damping": "N m s/rad"}
    systems = [plan.system.at(place) for place in plan.places]
    size = plan.robot.body.size
    varied = {name: None for each in plan.system.uncertainty.names for name in (GEARBOX if each in OF_GEARBOXES else (each,))}
    for name in varied if len(plan.places) > 1 else ():
        if name == "delay":
            yield name, np.array([[drive.delay for drive in one.drives] for one in systems]), units[name]
        else:
            yield name, np.array([np.broadcast_to(one.source.quantities[name], size) for one in systems]), units[name]


def _about(plan: SweepPlan) -> dict[str, Any]:
    """Attributes of a store: provenance, and everything needed to continue."""
    from ... import __version__

    return {
        "format": FORMAT,
        "gainroom": __version__,
        "robot": plan.robot.name,
        "identity": plan.identity,
        "postures": plan.postures.kind,
        "count": plan.postures.count,
        "chunk": plan.chunk,
        "seed": plan.seed,
        "low": plan.postures.low.tolist(),
        "high": plan.postures.high.tolist(),
        "sample_time_s": plan.system.control.sample_time,
    }


def _content(path: Path) -> bytes:
    """Content of a file; b"" if it cannot be read."""
    try:
        return path.read_bytes()
    except OSError:
        return b""


def filled(path: Path) -> bool:
    """True if a file exists and is not empty."""
    try:
        return path.stat().st_size > 0
    except OSError:
        return False


@contextlib.contextmanager
def telling(path: Path, what: str = "written") -> Iterator[None]:
    """Context that turns errors of Zarr and the disk into a GainroomError."""
    try:
        zarr = library("zarr")
        with zarr.config.set({"array.write_empty_chunks": True}):
            yield
    except OSError as error:
        raise GainroomError(f"{path}: cannot be {what}: {(error.strerror or one_line(error)).lower()}") from error
    except (KeyError, ValueError, RuntimeError) as error:
        if isinstance(error, GainroomError):
            raise
        raise GainroomError(f"{path}: is damaged: {one_line(error)}") from error
