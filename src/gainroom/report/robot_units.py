"""Units of a robot's joints, and requirements, as text."""

from typing import TYPE_CHECKING, Any

from ..errors import first_of_many

if TYPE_CHECKING:
    from ..system.controller import GainKey

_UNITS = {"load": ("kg·m²", "kg"), "kp": ("N·m/rad", "N/m"), "kd": ("N·m·s/rad", "N·s/m"), "ki": ("N·m/(rad·s)", "N/(m·s)")}
"""Units of a revolute and of a prismatic joint; "load" applies to a motor's inertia, too."""


def unit_of_gain(key: "GainKey", body: Any) -> str:
    """Unit of a gain of a RigidBody's joints."""
    return joint_units(body)[key.name] if key.unit == _UNITS.get(key.name, ("",))[0] else key.unit


def joint_units(body: Any) -> dict[str, str]:
    """Units of a RigidBody's joints by quantity; `prismatic`: a sentence that names prismatic joints among revolute ones."""
    prismatic = [name for name, is_prismatic in zip(body.joint_names, body.prismatic.tolist(), strict=True) if is_prismatic]
    if len(prismatic) in (0, body.size):
        return {name: both[bool(prismatic)] for name, both in _UNITS.items()} | {"prismatic": ""}
    units = {name: f"{revolute}; prismatic {other}" for name, (revolute, other) in _UNITS.items()}
    return units | {"prismatic": f" Prismatic joints: {first_of_many(prismatic)}."}


def requirements_text(system: Any) -> str:
    """Requirements of a System, with the gains that they apply to, as text."""
    required = f"Required: {system.requirements}"
    if system.control.space == "task":
        return f"{required}; of all tasks closed together, and of recommended gains."
    text = f"{required}; of the joints' gains closed together, and of recommended gains."
    if not system.source.stack:
        return text
    return f"{text} The tasks' own gains, closed in the joints' place, are required to be stable only."
