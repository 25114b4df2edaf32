"""Export of the controller of a joint.yaml as difference equations: sections of order 2 and less, for each sensor that it measures.

A law of which kd runs in the drive is written in two parts, each at its own rate.

Sections keep the digits that one polynomial of a high order loses; a pole at z = 1, an integrator, has a section in which it is exact.
"""

import datetime
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import GainroomError, printable
from ..system.feedback import Sensor
from ..system.linear.arrays import Complexes, Floats
from ..system.linear.transfer_function import Factored
from .export_forms.c_header import STEP
from .export_forms.form import number_text
from .gain_export import Export
from .joint_yaml import load_joint

SEEN: dict[Sensor, str] = {
    "motor": "wanted minus measured position of the motor [rad]",
    "link": "wanted minus measured position of the link [rad]",
    "torque": "minus the measured torque of the spring [N m]",
}


@dataclass(frozen=True)
class ExportedLaw:
    """Controller of a joint as it runs, or the part of it that runs in the drive.

    sections      of each sensor, rows b0, b1, b2, a1, a2 (k, 5), through which its signal goes one after another
    sample_time   [s]
    prefix        of its names in C: gainroom_, or gainroom_drive_
    """

    sections: dict[Sensor, Floats]
    sample_time: float
    prefix: str = "gainroom_"

    @property
    def in_drive(self) -> bool:
        """True if it is the part that runs in the drive."""
        return self.prefix != ExportedLaw.prefix

    def seen(self, sensor: Sensor) -> str:
        """Signal that the part gets of a sensor, in words; no reference goes to the drive."""
        return SEEN[sensor].replace("wanted minus measured", "minus the measured") if self.in_drive else SEEN[sensor]


def export_law(path: Path, form: str, onto: Path | None, version: str, today: datetime.date) -> Export:
    """Export of the controller of the joint.yaml at `path` in one of LAW_FORMS.

    Raises GainroomError for an existing file, and for a controller in continuous time.
    """
    if onto is not None:
        raise GainroomError(f"--onto {onto}: the controller of one joint is written as a whole; give --output")
    system = load_joint(path, two_paths=True)
    control = system.control
    step, controller = control.sample_time, control.controller
    if step is None:
        raise GainroomError(f"{path}: control.sample_rate_hz is missing: a controller is exported as difference equations at its rate")
    feedback, in_drive, laws = control.feedback, control.kd_path, list[ExportedLaw]()
    if in_drive is not None:
        own = controller.kd_alone().transfer(in_drive.sample_time)
        laws, controller = [_law({feedback.position: own}, in_drive.sample_time, "gainroom_drive_")], controller.without_kd()
    if feedback.mixed:
        laws.insert(0, _law({sensor: controller.law(sensor, feedback, step) for sensor in feedback.sensors}, step))
    else:
        laws.insert(0, _law({feedback.position: controller.transfer(step)}, step))
    controller = control.controller
    values = [f"{key.name} {float(getattr(controller, key.name))!r} {key.unit}".rstrip() for key in controller.gain_keys()]
    parameters = f"{controller.kind}: {', '.join(values)}"
    header = [printable(f"gainroom export {version}, {today:%Y-%m-%d}: the controller of {path}"), parameters]
    notes = () if controller.rate_of_error else ("velocity is here that of the error, wanted minus measured, not of the position alone",)
    if in_drive is not None:
        notes = (*notes, "kd's part runs in the drive: its torque is added there, and no reference goes to it")
    return Export(LAW_FORMS[form](laws, header), "", {}, (), notes)


def _law(laws: dict[Sensor, Factored], step: float, prefix: str = "gainroom_") -> ExportedLaw:
    return ExportedLaw({sensor: sections_of(law) for sensor, law in laws.items() if law.gain}, step, prefix)


def sections_of(law: Factored) -> Floats:
    """Sections (k, 5) with rows b0, b1, b2, a1, a2 in z of a sampled transfer function. Raises GainroomError for more zeros than poles."""
    step = law.sample_time
    assert step is not None
    if law.relative_degree < 0:
        raise GainroomError("a law with more zeros than poles in z would need readings of the future")
    zeros, poles = 1 + step * law.zeros, np.append(1 + step * law.poles, np.zeros(round(law.delay / step)))
    gain = law.gain * step ** (len(law.poles) - len(law.zeros))
    numerators, denominators = _factors(zeros), _factors(poles)
    rows = []
    for below in sorted(denominators, key=lambda one: (-len(one), abs(one[-1]))):
        # The longest numerator that fits, and of those the nearest, keeps the sections' gains of a size.
        fitting = [k for k, one in enumerate(numerators) if len(one) <= len(below)]
        best = min(fitting, key=lambda k: (-len(numerators[k]), abs(numerators[k][-1] - below[-1])), default=-1)
        above = numerators.pop(best) if fitting else np.ones(1)
        rows.append([*np.zeros(len(below) - len(above)), *above, *np.zeros(3 - len(below)), *below[1:], *np.zeros(3 - len(below))])
    if numerators:
        raise GainroomError("a law could not be split into real sections")
    found = np.array(rows).reshape(-1, 5)
    if not len(found):
        return np.array([[gain, 0.0, 0.0, 0.0, 0.0]])
    found[0, :3] *= gain
    return found


def _factors(roots: Complexes) -> list[Floats]:
    """Real polynomials of order 2, and one of order 1 where the number is odd, that have these roots; a root 1 goes with the smallest."""
    pairs = [np.array([1.0, -2 * root.real, abs(root) ** 2]) for root in roots.tolist() if root.imag > 0]
    reals = sorted((root.real for root in roots.tolist() if root.imag == 0), key=abs)
    single = [np.array([1.0, -reals.pop()]) for _ in range(len(reals) % 2)]
    while reals:
        large, small = reals.pop(), reals.pop(0)  # beside 0 a root 1 is exact
        pairs.append(np.array([1.0, -(large + small), large * small]))
    return pairs + single


def _c_header(laws: Sequence[ExportedLaw], header: Sequence[str]) -> str:
    """Header in C99, which C++ takes, too."""
    said = "".join(f" * {line}\n" for line in header).replace("*/", "* /")
    parts = "".join(_c_part(law, STEP if k == 0 else "") for k, law in enumerate(laws))
    return f"/*\n{said} */\n#ifndef GAINROOM_LAW_H\n#define GAINROOM_LAW_H\n\n{parts}#endif\n"


def _c_part(law: ExportedLaw, before: str) -> str:
    """Coefficients, state and step of one part of the law; `before`: what stands before its state."""
    prefix = law.prefix
    arrays = "".join(
        f"static const double {prefix}{sensor}[{len(rows)}][5] = {{\n"
        + "".join(f"    {{{', '.join(map(number_text, row))}}},\n" for row in rows.tolist())
        + "};\n"
        for sensor, rows in law.sections.items()
    )
    members = "".join(f"    double {sensor}[{len(rows)}][2];\n" for sensor, rows in law.sections.items())
    arguments = ", ".join(f"double {sensor}" for sensor in law.sections)
    step = "    for (int k = 0; k < {1}; k++)\n        {0} = gainroom_filter({2}{0}[k], state->{0}[k], {0});\n"
    body = "".join(step.format(sensor, len(rows), prefix) for sensor, rows in law.sections.items())
    meant = "".join(f" * {sensor}: {law.seen(sensor)}\n" for sensor in law.sections)
    where = ", in the drive" if law.in_drive else ""
    return (
        f"static const double {prefix}sample_time = {number_text(law.sample_time)}; /* [s] */\n{arrays}{before}\n"
        f"/* What the controller remembers: all zero at the start, with the wanted position at the measured one. */\n"
        f"typedef struct {{\n{members}}} {prefix}state;\n\n"
        f"/*\n * Torque command [N m] on the joint side{where}; once in each sample time, in double precision.\n{meant} */\n"
        f"static inline double {prefix}law({prefix}state *state, {arguments})\n{{\n{body}"
        f"    return {' + '.join(law.sections)};\n}}\n\n"
    )


def _markdown(laws: Sequence[ExportedLaw], header: Sequence[str]) -> str:
    """Tables of coefficients for a design document or a review."""
    text = "# Controller\n\n```text\n" + "".join(f"{line}\n" for line in header) + "```\n"
    head = ["section", "b0", "b1", "b2", "a1", "a2"]
    for law in laws:
        when = f"{'In the drive, every' if law.in_drive else 'Every'} {number_text(law.sample_time)} s"
        text += (
            f"\n{when} the torque command [N m] is the sum of what each signal becomes behind its sections, one after another: "
            "y[k] = b0 x[k] + b1 x[k−1] + b2 x[k−2] − a1 y[k−1] − a2 y[k−2].\n"
        )
        for sensor, rows in law.sections.items():
            table: list[list[str]] = [head, ["---"] * 6, *([str(k), *map(number_text, row)] for k, row in enumerate(rows.tolist(), 1))]
            title = f"{sensor}, in the drive" if law.in_drive else sensor
            text += f"\n## {title}: {law.seen(sensor)}\n\n" + "".join(f"| {' | '.join(row)} |\n" for row in table)
    return text


LAW_FORMS: dict[str, Any] = {"c": _c_header, "markdown": _markdown}
"""Forms of the controller of one joint, by name, as --to has them."""
