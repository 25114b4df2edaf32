"""Structures of one joint's controller that the page offers: the file's, and others that start where it stands."""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from ..errors import GainroomError
from ..files.edited_text import with_section
from ..files.joint_yaml import parse_joint
from ..io.yaml_text import parse_yaml
from ..report.comparison_text import name_of
from ..report.number_format import typed
from ..studies.comparison import usual_path
from ..system.controller import type_of
from ..system.system import System
from .path_parts import APPROXIMATE
from .tunables import Tunable, tunables

TITLES = {key: name_of(key) for key in ("pd", "pid", "pd+biquad", "split", "torque_feedback", "dob")}
"""Names of the structures for people, as `gainroom compare` has them."""
BETWEEN = ("pd", "pid", "torque_feedback", "dob")
"""Types of controllers whose kp and kd are those of a PD, so that one can take the other's place."""
DAMPING = 0.7
"""Damping ratio of a new biquad's zeros and poles."""
SLOW = 0.002
"""Bandwidth of a new disturbance observer per kp/kd: slow enough to change margins by less than they show."""
BELOW_RATE = 0.2
"""Highest frequency of a new biquad per sample rate: there is room above it for its slider."""


@dataclass(frozen=True)
class Structure:
    """Structure: a joint.yaml with its own controller, or with another in its place."""

    text: str
    source: str

    @cached_property
    def system(self) -> System:
        """System of the file."""
        return parse_joint(self.text, self.source, two_paths=True)

    @cached_property
    def data(self) -> dict[str, Any]:
        """Content of the file."""
        return parse_yaml(self.text, self.source)

    @cached_property
    def tunables(self) -> list[Tunable]:
        """Numbers of its controller that the page moves."""
        return tunables(self.system, self.data["control"])

    def described(self) -> dict[str, Any]:
        """Description for the page."""
        controller = self.system.control.controller
        return {
            "gains": [one.described() for one in self.tunables],
            "axes": controller.plane_names,
            "bode_of": "" if self.system.control.kd_path is None else APPROXIMATE,
            "map_of": "" if controller.has_plane else f"a plain PD: {controller.kind} has no such plane, and is moved by its sliders",
        }

    def with_structure(self, key: str) -> "Structure":
        """The file with another structure, of the same kp and kd and otherwise without effect. Raises GainroomError where it has none."""
        if type_of(self.system.control.controller) not in BETWEEN:
            raise GainroomError(f"structure {key}: takes the place of {', '.join(BETWEEN)} alone, of which kp and kd are those of a PD")
        found = Structure(with_section(self.text, self.source, "control", self._section(key)), f"{self.source} with structure {key}")
        _ = found.system
        return found

    def _section(self, key: str) -> dict[str, Any]:
        """Section `control` of another structure."""
        control, given, joint = self.system.control, self.data["control"], self.system.source
        kp, kd = control.controller.kp, control.controller.kd
        rate = given.get("sample_rate_hz")
        section = {"type": "pd" if key == "split" else key.removesuffix("+biquad"), "kp": kp, "kd": kd}
        section |= {name: given[name] for name in ("velocity_filter", "notches") if given.get(name)}
        sides: Any = control.feedback.without_torque
        section["feedback"] = sides.written
        if rate is not None:
            section["sample_rate_hz"] = rate
        if key == "pid":
            section["ki"] = 0.0
        elif key == "split":
            section["kd_path"] = self._drive_path()
        elif key == "pd+biquad":
            usual = joint.resonance if math.isfinite(joint.resonance) else kp / kd if kd else 1.0
            at = float(typed(min(usual, math.inf if rate is None else 2 * math.pi * BELOW_RATE * rate), 3))
            section["biquads"] = [{"zero_frequency": at, "zero_damping": DAMPING, "pole_frequency": at, "pole_damping": DAMPING}]
        elif key == "torque_feedback":
            section |= {"ktau": 0.0, "kstau": 0.0, "feedback": {"kp": sides.position, "kd": sides.velocity, "ktau": "torque"}}
        elif key == "dob":
            section.pop("velocity_filter", None)  # its velocity is a plain difference
            section |= {
                "nominal_inertia": float(typed(joint.motor_inertia, 4)),
                "bandwidth": float(typed(SLOW * kp / kd if kd else 1.0, 3)),
            }
        return section

    def _drive_path(self) -> dict[str, Any]:
        """Section `kd_path` of the drive's own loop: that of section `compare`, else the usual one."""
        if given := (self.data.get("compare") or {}).get("drive_path"):
            return dict(given)
        if self.system.control.sample_time is None:
            raise GainroomError("structure split: control.sample_rate_hz is missing: the rate of kp, which stays on the host")
        path = usual_path(self.system)
        return {"delay_ms": float(typed(1e3 * path.delay, 7)), "sample_rate_hz": float(typed(1 / path.sample_time, 7))}


class Structures:
    """Structures of one file, by name; "" is the file's own."""

    def __init__(self, text: str, source: str) -> None:
        self.own = Structure(text, source)
        self._others: dict[str, Structure] = {}

    def of(self, key: str | None) -> Structure:
        """Structure by its name. Raises GainroomError for what the file cannot have."""
        if not key:
            return self.own
        if key not in TITLES:
            raise GainroomError(f"structure {key[:40]!r} must be one of {', '.join(TITLES)}")
        if key not in self._others:
            self._others[key] = self.own.with_structure(key)
        return self._others[key]

    def described(self) -> dict[str, dict[str, Any]]:
        """Description of each for the page; of one that the file cannot have, why."""
        found = {"": {"title": "as in the file", **self.own.described()}}
        for key, title in TITLES.items():
            try:
                found[key] = {"title": title, **self.of(key).described()}
            except GainroomError as error:
                found[key] = {"title": title, "refused": str(error)}
        return found
