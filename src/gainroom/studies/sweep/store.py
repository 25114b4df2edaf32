"""Results of a sweep on disk: a Zarr group of labelled arrays, written task by task, so that a killed run can be continued.

    gain, lower_gain, frequency, limiting_joint, certified   (draw, contact, posture)
    angles                                                    (posture, joint)
    posture, contact, draw, joint                             labels

A task's arrays are files of their own, which Zarr writes under another name and then renames; a task is finished when all of them exist.
Their content depends on the sweep alone, not on who computed it, and when. All files have checksums (see checksums.py): damage is reported,
and a continued run repairs it, except in the group's zarr.json, which identifies the sweep.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import GainroomError
from .checksums import damaged
from .limits import Limits
from .plan import SweepPlan, SweepTask
from .store_layout import RESULTS, created, filled, kept, library, mended, require_same, telling

if TYPE_CHECKING:
    import xarray

FIELDS = dict(zip(RESULTS, Limits._fields, strict=True))


class Store:
    """Open store of one plan; `mended`: damaged files other than task results that were rewritten."""

    def __init__(self, path: Path, plan: SweepPlan, mended: tuple[str, ...] = ()):
        self.path, self.plan, self.mended = path, plan, mended
        with telling(path):
            group = library("zarr").open_group(kept(path), mode="r+", zarr_format=3)
            self._arrays = {name: group[name] for name in (*RESULTS, "angles")}

    @classmethod
    def of(cls, path: Path, plan: SweepPlan) -> "Store":
        """Store at `path` if it is this plan's, or a new one if nothing is there.

        Raises GainroomError if something else is there, which stays unchanged, and if none can be created.
        """
        if path.exists() or path.is_symlink():
            require_same(path, plan)
            return cls(path, plan, mended(path, plan))
        created(path, plan)
        return cls(path, plan)

    def has(self, task: SweepTask) -> bool:
        """True if a task is finished."""
        return all(filled(self.path / name / "c" / place) for name, place in self._places(task))

    def write(self, task: SweepTask, found: Limits) -> None:
        """Write a finished task. Raises GainroomError if it cannot be written, as on a full disk; existing files stay."""
        with telling(self.path):
            for name, field in FIELDS.items():
                self._arrays[name][task.draw, task.contact, task.first : task.stop] = getattr(found, field)
            if task.draw == task.contact == 0:
                self._arrays["angles"][task.first : task.stop] = self.plan.postures.at(task.first, task.stop)

    def read(self, task: SweepTask) -> Limits:
        """Stored limits of a task. Raises GainroomError, naming the file, if it is damaged."""
        with telling(self.path, "read"):
            parts = {field: self._arrays[name][task.draw, task.contact, task.first : task.stop] for name, field in FIELDS.items()}
        for name, field in FIELDS.items():
            if not np.all(_meant(name, parts[field], self.plan.robot.body.size)):
                raise damaged(self.path, f"{name}/c/{task.draw}/{task.contact}/{task.part}")
        return Limits(**parts)

    def damage(self, task: SweepTask) -> str:
        """Message about a finished task that is damaged; "" for an intact one."""
        try:
            self.read(task)
            if task.draw == task.contact == 0:
                with telling(self.path, "read"):
                    self._arrays["angles"][task.first : task.stop]
        except GainroomError as error:
            return str(error)
        return ""

    def finished(self) -> Iterator[tuple[SweepTask, Limits]]:
        """Finished tasks with their limits, in order, one in memory at a time."""
        for number in range(self.plan.tasks):
            task = self.plan.task(number)
            if self.has(task):
                yield task, self.read(task)

    def _places(self, task: SweepTask) -> list[tuple[str, str]]:
        places = [(name, f"{task.draw}/{task.contact}/{task.part}") for name in RESULTS]
        return [*places, ("angles", f"{task.part}/0")] if task.draw == task.contact == 0 else places


def open_sweep(path: Path | str) -> "xarray.Dataset":
    """Results of `gainroom sweep --output PATH` as labelled arrays (draw, contact, posture), loaded on access.

    Arrays and dimensions have a fixed order, whatever order the disk lists files in.

    Raises GainroomError if there are none or they are damaged, also on later access, and without the extra `sweep`.
    """
    path = Path(path)
    xarray = library("xarray")
    store = kept(path)
    with telling(path, "read"):
        found = xarray.open_zarr(store, consolidated=False, zarr_format=3)
        first = [name for name in (*RESULTS, "angles") if name in found]
        names = (*first, *sorted(set(found.data_vars) - set(first)))
        labels = {name: found.variables[name] for name in sorted(found.coords)}
        return xarray.Dataset({name: found.variables[name] for name in names}, labels, found.attrs)


def _meant(name: str, values: Any, joints: int) -> Any:
    """True for values of an array of RESULTS that are valid."""
    if name == "limiting_joint":
        return (values >= -1) & (values < joints)
    if name == "certified":
        return np.ones(len(values), dtype=bool)
    return np.isnan(values) | ((values >= 0) & ((values < np.inf) | (name == "gain")))
