"""Export of the controller of a joint.yaml as difference equations: sections of order 2 and less, for each sensor that it measures.

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
    """Controller of a joint as it runs.

    sections      of each sensor, rows b0, b1, b2, a1, a2 (k, 5), through which its signal goes one after another
    sample_time   [s]
    parameters    of the controller, as text
    """

    sections: dict[Sensor, Floats]
    sample_time: float
    parameters: str


def export_law(path: Path, form: str, onto: Path | None, version: str, today: datetime.date) -> Export:
    """Export of the controller of the joint.yaml at `path` in one of LAW_FORMS.

    Raises GainroomError for an existing file, and for a controller in continuous time.
    """
    if onto is not None:
        raise GainroomError(f"--onto {onto}: the controller of one joint is written as a whole; give --output")
    system = load_joint(path)
    control = system.control
    step, controller = control.sample_time, control.controller
    if step is None:
        raise GainroomError(f"{path}: control.sample_rate_hz is missing: a controller is exported as difference equations at its rate")
    feedback = control.feedback
    laws: dict[Sensor, Factored] = {feedback.position: controller.transfer(step)}
    if feedback.mixed:
        laws = {sensor: controller.law(sensor, feedback, step) for sensor in feedback.sensors}
    sections: dict[Sensor, Floats] = {sensor: sections_of(law) for sensor, law in laws.items() if law.gain}
    values = [f"{key.name} {float(getattr(controller, key.name))!r} {key.unit}".rstrip() for key in controller.gain_keys()]
    parameters = f"{controller.kind}: {', '.join(values)}"
    header = [printable(f"gainroom export {version}, {today:%Y-%m-%d}: the controller of {path}"), parameters]
    notes = () if controller.rate_of_error else ("velocity is here that of the error, wanted minus measured, not of the position alone",)
    return Export(LAW_FORMS[form](ExportedLaw(sections, step, parameters), header), "", {}, (), notes)


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


def _c_header(law: ExportedLaw, header: Sequence[str]) -> str:
    """Header in C99, which C++ takes, too."""
    said = "".join(f" * {line}\n" for line in header).replace("*/", "* /")
    arrays = "".join(
        f"static const double gainroom_{sensor}[{len(rows)}][5] = {{\n"
        + "".join(f"    {{{', '.join(map(number_text, row))}}},\n" for row in rows.tolist())
        + "};\n"
        for sensor, rows in law.sections.items()
    )
    members = "".join(f"    double {sensor}[{len(rows)}][2];\n" for sensor, rows in law.sections.items())
    arguments = ", ".join(f"double {sensor}" for sensor in law.sections)
    step = "    for (int k = 0; k < {1}; k++)\n        {0} = gainroom_filter(gainroom_{0}[k], state->{0}[k], {0});\n"
    body = "".join(step.format(sensor, len(rows)) for sensor, rows in law.sections.items())
    meant = "".join(f" * {sensor}: {SEEN[sensor]}\n" for sensor in law.sections)
    return (
        f"/*\n{said} */\n#ifndef GAINROOM_LAW_H\n#define GAINROOM_LAW_H\n\n"
        f"static const double gainroom_sample_time = {number_text(law.sample_time)}; /* [s] */\n{arrays}{STEP}\n"
        f"/* What the controller remembers: all zero at the start, with the wanted position at the measured one. */\n"
        f"typedef struct {{\n{members}}} gainroom_state;\n\n"
        f"/*\n * Torque command [N m] on the joint side; once in each sample time, in double precision.\n{meant} */\n"
        f"static inline double gainroom_law(gainroom_state *state, {arguments})\n{{\n{body}"
        f"    return {' + '.join(law.sections)};\n}}\n\n#endif\n"
    )


def _markdown(law: ExportedLaw, header: Sequence[str]) -> str:
    """Tables of coefficients for a design document or a review."""
    text = "# Controller\n\n```text\n" + "".join(f"{line}\n" for line in header) + "```\n\n"
    text += (
        f"Every {number_text(law.sample_time)} s the torque command [N m] is the sum of what each signal becomes behind its sections, one "
        "after another: y[k] = b0 x[k] + b1 x[k−1] + b2 x[k−2] − a1 y[k−1] − a2 y[k−2].\n"
    )
    head = ["section", "b0", "b1", "b2", "a1", "a2"]
    for sensor, rows in law.sections.items():
        table: list[list[str]] = [head, ["---"] * len(head), *([str(k), *map(number_text, row)] for k, row in enumerate(rows.tolist(), 1))]
        text += f"\n## {sensor}: {SEEN[sensor]}\n\n" + "".join(f"| {' | '.join(row)} |\n" for row in table)
    return text


LAW_FORMS: dict[str, Any] = {"c": _c_header, "markdown": _markdown}
"""Forms of the controller of one joint, by name, as --to has them."""
