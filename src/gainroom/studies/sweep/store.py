"""Results of a sweep on disk: a Zarr group of labelled arrays, written task by task, each as a whole, so that a killed run goes on.

    gain, lower_gain, frequency, limiting_joint, certified   (draw, contact, posture)
    angles                                                    (posture, joint)
    posture, contact, draw, joint                             labels

A task's arrays are files of their own, which Zarr writes under another name and then renames; a task is finished when all of them are
there. What is in them depends on the sweep alone, not on who computed it, and when.
"""

import contextlib
import json
import os
import secrets
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import GainroomError, one_line
from ...io.run_files import at_last
from ...system.linear.arrays import Floats
from .limits import Limits
from .plan import SweepPlan, Task

if TYPE_CHECKING:
    import xarray

FORMAT = "gainroom sweep 2"
NAME = FORMAT.rstrip("0123456789")
RESULTS = {
    "gain": ("float64", "1", "largest factor on all gains up to which the loop is proved stable"),
    "lower_gain": ("float64", "1", "the loop is stable from this factor on; 0: from the lowest"),
    "frequency": ("float64", "rad/s", "at which the loop vibrates at that factor"),
    "limiting_joint": ("int16", "1", "number of the joint that moves most in that vibration; -1: none"),
    "certified": ("bool", "1", "whether the gain is proved, or unstable roots were counted on both sides of it"),
}
"""By name: type, unit, meaning."""
FIELDS = dict(zip(RESULTS, Limits._fields, strict=True))
DIFFERENT = {
    "version": "was computed by gainroom {stored}; this is {now}",
    "robot": "is of another robot, control or drive",
    "postures": "is of other postures",
    "contacts": "is of other contact states",
    "draws": "is of other draws of the uncertainty",
}


def library(name: str) -> Any:
    """zarr or xarray. Raises GainroomError where it is not installed."""
    import importlib

    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise GainroomError(f"results of sweeps need {name}: pip install 'gainroom[sweep]'") from error


class Store:
    """An open store of one plan."""

    def __init__(self, path: Path, plan: SweepPlan):
        self.path, self.plan = path, plan
        zarr = library("zarr")
        with _telling(path):
            self._group = zarr.open_group(path, mode="r+")
            self._arrays = {name: self._group[name] for name in (*RESULTS, "angles")}

    @classmethod
    def of(cls, path: Path, plan: SweepPlan) -> "Store":
        """The store at `path` where it is this plan's, else a new one where nothing is.

        Raises GainroomError where something else is there, which stays as it is, and where none can be made.
        """
        if path.exists() or path.is_symlink():
            require_same(path, plan)
        else:
            _created(path, plan)
        return cls(path, plan)

    def has(self, task: Task) -> bool:
        """Whether a task is finished."""
        return all(_filled(self.path / name / "c" / place) for name, place in self._places(task))

    def write(self, task: Task, found: Limits) -> None:
        """A finished task. Raises GainroomError where it cannot be written, as on a full disk; what was there before stays."""
        with _telling(self.path):
            for name, field in FIELDS.items():
                self._arrays[name][task.draw, task.contact, task.first : task.stop] = getattr(found, field)
            if task.draw == task.contact == 0:
                self._arrays["angles"][task.first : task.stop] = self.plan.postures.at(task.first, task.stop)

    def read(self, task: Task) -> Limits:
        """What was written. Raises GainroomError where it is damaged."""
        with _telling(self.path):
            parts = {field: self._arrays[name][task.draw, task.contact, task.first : task.stop] for name, field in FIELDS.items()}
        return Limits(**parts)

    def finished(self) -> Iterator[tuple[Task, Limits]]:
        """All finished tasks in order, one in memory at a time."""
        for number in range(self.plan.tasks):
            task = self.plan.task(number)
            if self.has(task):
                yield task, self.read(task)

    def _places(self, task: Task) -> list[tuple[str, str]]:
        places = [(name, f"{task.draw}/{task.contact}/{task.part}") for name in RESULTS]
        return [*places, ("angles", f"{task.part}/0")] if task.draw == task.contact == 0 else places


def open_sweep(path: Path | str) -> "xarray.Dataset":
    """The results of `gainroom sweep --output PATH` as labelled arrays (draw, contact, posture), loaded when they are asked for.

    Arrays and dimensions come in the order above, whatever order the disk lists files in.

    Raises GainroomError where there are none, and without the extra `sweep`.
    """
    path = Path(path)
    attributes(path)
    xarray = library("xarray")
    with _telling(path):
        found = xarray.open_zarr(path, consolidated=False)
        first = [name for name in (*RESULTS, "angles") if name in found]
        names = (*first, *sorted(set(found.data_vars) - set(first)))
        labels = {name: found.variables[name] for name in sorted(found.coords)}
        return xarray.Dataset({name: found.variables[name] for name in names}, labels, found.attrs)


def attributes(path: Path) -> dict[str, Any]:
    """What a store says of itself. Raises GainroomError where it is none."""
    found = {}
    with contextlib.suppress(OSError, ValueError, KeyError, TypeError):
        found = dict(json.loads((path / "zarr.json").read_text("utf-8"))["attributes"])
    kept = str(found.get("format"))
    if kept == FORMAT:
        return found
    what = "the store of a sweep by another version of gainroom" if kept.startswith(NAME) else "not the store of a sweep"
    raise GainroomError(f"{path}: is {what}, and stays as it is")


def require_same(path: Path, plan: SweepPlan) -> None:
    """Raise GainroomError where the store at `path` is of another sweep."""
    stored = attributes(path)["identity"]
    for name, text in DIFFERENT.items():
        if stored.get(name) != plan.identity[name]:
            said = text.format(stored=stored.get(name), now=plan.identity[name])
            raise GainroomError(f"{path}: {said}; nothing was changed there: name another store")


def _created(path: Path, plan: SweepPlan) -> None:
    """Under another name first, so that there is a whole store or none."""
    zarr = library("zarr")
    if not path.parent.is_dir():
        raise GainroomError(f"{path}: cannot be written: there is no directory {path.parent}")
    temporary = path.with_name(f".gainroom-{secrets.token_hex(6)}.tmp{path.suffix}")
    with at_last(lambda: shutil.rmtree(temporary, ignore_errors=True)), _telling(path):
        group = zarr.create_group(temporary, zarr_format=3)
        postures, chunk = plan.postures.count, plan.chunk
        for name, (kind, unit, meaning) in RESULTS.items():
            # What is nowhere written as such is missing, so that every chunk is a file.
            missing = {"float64": np.nan, "int16": -2, "bool": False}[kind]
            group.create_array(
                name,
                shape=(len(plan.places), len(plan.contacts), postures),
                chunks=(1, 1, chunk),
                dtype=kind,
                fill_value=missing,
                dimension_names=("draw", "contact", "posture"),
                attributes={"units": unit, "long_name": meaning},
                config={"write_empty_chunks": True},
            )
        angles = {"units": "m for prismatic joints, rad for others", "long_name": "joint positions"}
        size = plan.robot.body.size
        group.create_array(
            "angles", shape=(postures, size), chunks=(chunk, size), dtype="float64", fill_value=np.nan,
            dimension_names=("posture", "joint"), attributes=angles,
        )  # fmt: skip
        for name, labels in (("contact", plan.contacts), ("joint", plan.robot.joint_names)):
            array = group.create_array(name, shape=(len(labels),), chunks=(len(labels),), dtype="str", dimension_names=(name,))
            array[:] = np.array(labels, dtype=object)
        for name, values, unit in _draw_columns(plan):
            shape = values.shape
            dimensions = ("draw", "joint")[: len(shape)]
            array = group.create_array(
                f"draw_{name}", shape=shape, chunks=shape, dtype="float64", dimension_names=dimensions, attributes={"units": unit}
            )
            array[...] = values
        group.attrs.update(_about(plan))
        os.rename(temporary, path)


def _draw_columns(plan: SweepPlan) -> Iterator[tuple[str, Floats, str]]:
    """Of each uncertain quantity its value in every draw (draws, n), nominal first."""
    units = {"delay": "s", "stiffness": "N m/rad", "link_inertia": "kg m2", "motor_inertia": "kg m2", "damping": "N m s/rad"}
    systems = [plan.system.at(place) for place in plan.places]
    size = plan.robot.body.size
    for name in plan.system.uncertainty.names if len(plan.places) > 1 else ():
        if name == "delay":
            yield name, np.array([[drive.delay for drive in one.drives] for one in systems]), units[name]
        else:
            yield name, np.array([np.broadcast_to(one.source.quantities[name], size) for one in systems]), units[name]


def _about(plan: SweepPlan) -> dict[str, Any]:
    """Provenance, and what is needed to go on."""
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


def _filled(path: Path) -> bool:
    try:
        return path.stat().st_size > 0
    except OSError:
        return False


@contextlib.contextmanager
def _telling(path: Path) -> Iterator[None]:
    """Turns what Zarr and the disk raise into a GainroomError."""
    try:
        zarr = library("zarr")
        with zarr.config.set({"array.write_empty_chunks": True}):
            yield
    except OSError as error:
        raise GainroomError(f"{path}: cannot be written: {(error.strerror or one_line(error)).lower()}") from error
    except (KeyError, ValueError, RuntimeError) as error:
        if isinstance(error, GainroomError):
            raise
        raise GainroomError(f"{path}: is damaged: {one_line(error)}") from error
