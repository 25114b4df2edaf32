"""Header for C and C++: gains as arrays, and, where a rate is known, the torque of a joint with all filters at that rate."""

import json
import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from ...errors import GainroomError
from ...io.validation import checked
from ..gain_formats.gain_arrays import ArrayNames, read_arrays
from ..gain_formats.gain_record import NOT_NEGATIVE, GainFile
from .form import ExportedGains, ExportForm, number_text
from .sampled_law import SampledLaw, filter_notes, rate_of, sampled_law

COLUMNS = {"kps": "kp", "kds": "kd", "kis": "ki"}
ARRAY = re.compile(r"^static const (?:double|char \*const) (joint_names|kps|kds|kis)\[\d*\] = \{(.*)\};$", re.MULTILINE)
STEP = """
/* One step of y = b0 x + b1 x' + b2 x'' - a1 y' - a2 y''; c: b0, b1, b2, a1, a2; m: memory, zero at the start. */
static inline double gainroom_filter(const double c[5], double m[2], double x)
{
    const double y = c[0] * x + m[0];
    m[0] = c[1] * x - c[3] * y + m[1];
    m[1] = c[2] * x - c[4] * y;
    return y;
}
"""


def c_header_text(goal: ExportedGains, header: Sequence[str]) -> str:
    """Text of a header in C99 that C++ takes, too."""
    count, law, rate = len(goal.gains), sampled_law(goal), rate_of(goal.origin)
    said = "".join(f" * {line}\n" for line in [*header, *([] if law is None else [f"  {law.line}"])])
    names = ", ".join(json.dumps(name, ensure_ascii=False) for name in goal.gains)
    arrays = "".join(
        f"static const double {column}[{count}] = {{{', '.join(number_text(getattr(gain, key)) for gain in goal.gains.values())}}};\n"
        for column, key in COLUMNS.items()
    )
    return (
        f"/*\n{said.replace('*/', '* /')} */\n#ifndef GAINROOM_GAINS_H\n#define GAINROOM_GAINS_H\n\n"
        f"static const char *const joint_names[{count}] = {{{names}}};\n{arrays}"
        f"{'' if rate is None else _torque(law, rate)}\n#endif\n"
    )


def _torque(law: SampledLaw | None, rate: float) -> str:
    """Function that computes the torque of a joint, with its filters and its state."""
    low_pass, shaping = (None, ()) if law is None else (law.velocity, law.shaping)
    arrays, memory, smooth, shape = "", "", "", ""
    if low_pass is not None:
        arrays += f"static const double gainroom_velocity_filter[5] = {{{', '.join(low_pass.coefficients)}}};\n"
        memory += " velocity[2];"
        smooth = "    rate = gainroom_filter(gainroom_velocity_filter, state->velocity, rate);\n"
    if shaping:
        rows = "".join(f"    {{{', '.join(one.coefficients)}}}, /* {one.name} */\n" for one in shaping)
        arrays += f"static const double gainroom_shaping[{len(shaping)}][5] = {{\n{rows}}};\n"
        memory += f" shaping[{len(shaping)}][2];"
        shape = (
            f"    for (int k = 0; k < {len(shaping)}; k++)\n"
            "        torque = gainroom_filter(gainroom_shaping[k], state->shaping[k], torque);\n"
        )
    members = "".join(f"    double {each.strip()};\n" for each in memory.split(";") if each.strip())
    return f"""
static const double gainroom_sample_time = {number_text(1 / rate)}; /* [s] */
{arrays}{STEP if law else ""}
/* What one joint remembers: all zero at the start. */
typedef struct {{
    int started;
    double error, integral;
{members}}} gainroom_state;

/* Torque of a joint from the error, wanted minus measured position; once in each sample time. */
static inline double gainroom_torque(gainroom_state *state, int joint, double error)
{{
    double torque, rate = state->started ? (error - state->error) / gainroom_sample_time : 0.0;
    state->started = 1;
    state->error = error;
    state->integral += gainroom_sample_time * error;
{smooth}    torque = kps[joint] * error + kds[joint] * rate + kis[joint] * state->integral;
{shape}    return torque;
}}
"""


def _read(text: str, path: Path) -> GainFile | None:
    """Gains of such a header: names may have spaces, and there are integral gains, which other arrays in C have not."""
    if "GAINROOM_GAINS_H" not in text:
        return None
    found: dict[str, Any] = {}
    for name, content in ARRAY.findall(text):
        try:
            found[name] = json.loads(f"[{content}]")
        except ValueError:
            raise GainroomError(f"{path}: {name}: must be numbers, or names in quotes, between braces") from None
    if missing := [name for name in ("joint_names", *COLUMNS) if name not in found]:
        raise GainroomError(f"{path}: {missing[0]} is missing, one entry for each joint")
    if len({len(found[name]) for name in ("joint_names", *COLUMNS)}) > 1:
        raise GainroomError(f"{path}: joint_names, kps, kds and kis must have one entry for each joint")
    integral = [checked(f"{path}: kis", each, NOT_NEGATIVE) for each in found.pop("kis")]
    gains = read_arrays(found, ArrayNames.of(found, {}), str(path))
    return replace(gains, ordered=tuple(replace(gain, ki=ki) for gain, ki in zip(gains.ordered, integral, strict=True)))


C_HEADER = ExportForm("c", "C header", "a header for C and C++", ".h", c_header_text, read=_read, notes=filter_notes, integral=True)
