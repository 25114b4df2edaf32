"""Actuators per joint: motor inertia, gearbox, friction and drives, from entries by joint-name pattern.

Entries are merged joint by joint, key by key: `default` first, then every pattern that matches, the later one winning. A motor is given
either by its inertia on the joint side or by rotor inertia and gear ratio: J_m = J_r N².
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ..errors import GainroomError, first_of_many, require_positive
from ..system.actuator_entry import ActuatorEntry
from ..system.drive import Drive
from ..system.linear.arrays import Booleans, Floats
from ..system.plausibility import NO_DATA, NO_INERTIA, NO_STIFFNESS
from .gearbox_types import DIRECT, middle
from .name_patterns import assign

NOT_NUMBERS = ("unknown", "uninformed", "gearbox")
LIKELY = 0.1
"""Assumed motor inertia on an elastic gearbox without data, as a share of the inertia that the motor moves.

Published joints lie between 0.05 (WALK-MAN's hip) and 1, where gear ratios match both inertias (Pasch and Seering 1984); readings
(studies/readings.py) look at 1, too.
"""


@dataclass(frozen=True)
class Actuators:
    """Motors and gearboxes of n joints, all on the joint side; each (n,).

    motor_inertia   reflected: rotor inertia × gear ratio² [kg m²]; 0 only on rigid joints
    stiffness       of the gearbox [N m/rad]; inf: rigid
    damping         of the gearbox [N m s/rad]
    motor_viscous, link_viscous   viscous friction to ground [N m s/rad]
    effort_limit    of the torque [N m]; inf: not known. No margin depends on it; it is passed on with the gains
    unknown   (n,) True for a rigid gearbox whose stiffness is not given; None: true of all rigid ones
    uninformed   (n,) True where no motor inertia is given: 0 is used, or LIKELY on an elastic gearbox; None: nowhere
    gearbox   (n,) gearbox type where no more is known: stiffness and damping are then one point of its range; "": other joints; (): none
    """

    motor_inertia: Floats
    stiffness: Floats
    damping: Floats
    motor_viscous: Floats
    link_viscous: Floats
    effort_limit: Floats = field(default_factory=lambda: np.asarray(math.inf))
    unknown: Booleans | None = None
    uninformed: Booleans | None = None
    gearbox: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if not np.ndim(self.effort_limit):
            object.__setattr__(self, "effort_limit", np.full(np.shape(self.stiffness), self.effort_limit))
        shapes = {name: np.shape(value) for name, value in vars(self).items() if name not in NOT_NUMBERS}
        if len(set(shapes.values())) != 1 or len(shapes["stiffness"]) != 1:
            raise GainroomError(f"actuators: shapes {shapes} must all be (n,)")
        for name in shapes:
            for value in getattr(self, name):
                bound = name in ("stiffness", "effort_limit")
                require_positive("actuators", name, value, zero=not bound, infinite=bound)
        if np.any((self.motor_inertia == 0) & np.isfinite(self.stiffness)):
            raise GainroomError("actuators: motor_inertia 0 kg·m² must be > 0 on an elastic joint")

    @property
    def quantities(self) -> dict[str, Floats]:
        """Quantities that margins depend on, by name, each (n,)."""
        return {name: value for name, value in vars(self).items() if name not in ("effort_limit", *NOT_NUMBERS)}

    @property
    def assumed_rigid(self) -> Booleans:
        """(n,) True for gearboxes taken as rigid because their stiffness is not given."""
        rigid = np.isinf(self.stiffness)
        return rigid if self.unknown is None else rigid & self.unknown

    @property
    def without_inertia(self) -> Booleans:
        """(n,) True for motors whose inertia is not given."""
        return self.uninformed if self.uninformed is not None else np.zeros(len(self.motor_inertia), dtype=bool)

    @property
    def of_a_type(self) -> Booleans:
        """(n,) True for gearboxes described by their type alone."""
        return np.array([bool(kind) for kind in self.gearbox] or [False] * len(self.stiffness))

    @property
    def guessed(self) -> Booleans:
        """(n,) True for motors whose inertia is the assumed share LIKELY."""
        return self.without_inertia & (self.motor_inertia > 0)

    @property
    def known(self) -> dict[str, Floats]:
        """Given motor_inertia, stiffness, damping, link_viscous and effort_limit, (n,) each.

        NaN for an assumed inertia, a gearbox that is rigid or known by type alone, no link friction and no torque limit.
        """
        inertia = np.where(self.guessed, math.nan, self.motor_inertia)
        given = np.isfinite(self.stiffness) & ~self.of_a_type
        found = {key: np.where(given, getattr(self, key), math.nan) for key in ("stiffness", "damping")}
        limit = np.where(np.isfinite(self.effort_limit), self.effort_limit, math.nan)
        return (
            {"motor_inertia": inertia}
            | found
            | {"link_viscous": np.where(self.link_viscous > 0, self.link_viscous, math.nan), "effort_limit": limit}
        )


def merge_entries(entries: Mapping[str, ActuatorEntry], joint_names: Sequence[str]) -> tuple[ActuatorEntry, ...]:
    """Entries merged per joint, one for each name, from all whose pattern matches it.

    Raises GainroomError if a pattern is malformed or matches nothing.
    """
    merged = []
    for matches in assign(entries, joint_names, "joints"):
        entry = ActuatorEntry()
        for stronger in matches:
            entry = stronger.over(entry)
        merged.append(entry)
    return tuple(merged)


def actuators_of(
    entries: Sequence[ActuatorEntry],
    joint_names: Sequence[str],
    armature: Floats,
    moved: Callable[[], Floats],
) -> tuple[Actuators, tuple[str, ...]]:
    """Actuators from merged entries, one per joint, and the assumptions made.

    armature   (n,) reflected rotor inertia of the model file [kg m²], 0 where none: used where an entry gives no inertia
    moved      (n,) inertia that each motor moves [kg m²]; the share LIKELY is used where an elastic joint has no other value

    Raises GainroomError where a joint's motor is half described.
    """
    inertia = np.zeros(len(joint_names))
    from_file, without, bare, undamped, guessed = [], [], [], [], {}
    for k, (name, entry) in enumerate(zip(joint_names, entries, strict=True)):
        owner = f"joint {name!r}"
        given = entry.reflected(owner)
        inertia[k] = armature[k] if given is None else given
        typed = entry.gearbox not in (None, DIRECT)
        soft = typed or (entry.stiffness is not None and math.isfinite(entry.stiffness))
        if given is None and armature[k] > 0:
            from_file.append(f"{name} {armature[k]:.4g}")
        elif given is None and soft:
            inertia[k] = LIKELY * moved()[k]
            guessed[name] = f"{name} {inertia[k]:.4g}"
        elif given is None:
            (without if entry.stiffness is None and entry.gearbox is None else bare).append(name)
        if soft and not typed and not entry.damping:
            undamped.append(name)
    warnings = []
    if from_file:
        warnings.append(f"motor inertia [kg m²] is the model file's armature where none is given: {first_of_many(from_file)}")
    if guessed:
        warnings.append(f"{NO_INERTIA} [kg m²]: {first_of_many([*guessed.values()])}; give motor_inertia")
    if without:
        warnings.append(f"{NO_DATA} are rigid with motor inertia 0: {first_of_many(without)}; give motor_inertia and stiffness")
    unsaid = [entry.stiffness is None and entry.gearbox is None for entry in entries]
    rigid = [name for name, one in zip(joint_names, unsaid, strict=True) if one and name not in without]
    if rigid:
        warnings.append(
            f"{NO_STIFFNESS}, so limits are optimistic: {first_of_many(rigid)}; give stiffness and damping, or stiffness: rigid"
        )
    if bare:
        warnings.append(f"motor inertia is 0 where none is given: {first_of_many(bare)}; give motor_inertia")
    if undamped:
        warnings.append(f"elastic joints have no damping, so resonances no width: {first_of_many(undamped)}; measure damping")
    columns = {name: np.array([getattr(entry, name) or 0.0 for entry in entries]) for name in ("damping", "motor_viscous", "link_viscous")}
    for name in ("stiffness", "effort_limit"):
        columns[name] = np.array([math.inf if (value := getattr(entry, name)) is None else value for entry in entries])
    types = tuple("" if entry.gearbox in (None, DIRECT) else str(entry.gearbox) for entry in entries)
    for k in [k for k, kind in enumerate(types) if kind]:
        columns["stiffness"][k], columns["damping"][k] = middle(types[k], inertia[k], published_peaks(entries)[k])
    uninformed = np.isin(joint_names, [*without, *bare, *guessed])
    found = Actuators(motor_inertia=inertia, **columns, unknown=np.array(unsaid), uninformed=uninformed, gearbox=types)
    return found, tuple(warnings)


def published_peaks(entries: Sequence[ActuatorEntry]) -> list[float]:
    """Published peak torque (n,) of each joint's actuator [N m]; 0 where none is, as a limit in a model may be anything."""
    return [entry.effort_limit or 0.0 if "effort_limit" in entry.published else 0.0 for entry in entries]


def drives_of(entries: Sequence[ActuatorEntry], common: Drive) -> tuple[Drive, ...]:
    """Drives per joint: `common`, with the values that the joint's entry overrides."""
    names = ("bandwidth", "damping_ratio", "delay")
    overrides = ({name: getattr(entry, name) for name in names if getattr(entry, name) is not None} for entry in entries)
    return tuple(replace(common, **changes) for changes in overrides)
