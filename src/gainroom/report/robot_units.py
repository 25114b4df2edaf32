"""What the terminal and the page of a robot both say of units and of what is required."""

from typing import Any

from ..errors import first_of_many

_UNITS = {"load": ("kg·m²", "kg"), "kp": ("N·m/rad", "N/m"), "kd": ("N·m·s/rad", "N·s/m"), "ki": ("N·m/(rad·s)", "N/(m·s)")}
"""Of a hinge and of a joint that slides; a load is a motor's inertia too."""


def joint_units(body: Any) -> dict[str, str]:
    """The units of a RigidBody's joints by what they are of; under `sliding` a sentence that names those that slide, among hinges."""
    slides = body.prismatic.tolist()
    if not any(slides):
        return {name: hinge for name, (hinge, _) in _UNITS.items()} | {"sliding": ""}
    if all(slides):
        return {name: slide for name, (_, slide) in _UNITS.items()} | {"sliding": ""}
    found = [name for name, slide in zip(body.joint_names, slides, strict=True) if slide]
    units = {name: f"{hinge}; slides {slide}" for name, (hinge, slide) in _UNITS.items()}
    return units | {"sliding": f" Joints that slide: {first_of_many(found)}."}


def judged(spec: Any) -> str:
    """What a RobotSpec requires, and of which gains."""
    required = f"Required: {spec.requirements}"
    if spec.control.space == "task":
        return f"{required}; of all tasks closed together, and of gains to use."
    told = f"{required}; of the joints' gains closed together, and of gains to use."
    if not spec.robot.stack:
        return told
    return f"{told} The tasks' own gains, closed in the joints' place, are judged by stability alone: a limit above 1."
