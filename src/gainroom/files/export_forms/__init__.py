"""Forms in which gains are written. A new one is a file here with an ExportForm, and its place in FORMS."""

from collections.abc import Mapping
from typing import Any

from ...errors import GainroomError, first_of_many, printable
from ...system.filters import FILTERS
from ..gain_formats.gain_record import Gain, Origin
from .actuator_configs import ISAAC_LAB, MJLAB
from .arrays import ARRAYS
from .c_header import C_HEADER
from .form import ExportedGains, ExportForm
from .legged_gym import LEGGED_GYM
from .markdown import MARKDOWN
from .mjcf import MJCF
from .plain import PLAIN
from .ros2_control import ROS2_CONTROL
from .sampled_law import MARK

FORMS = {form.name: form for form in (PLAIN, ROS2_CONTROL, MJCF, MJLAB, ISAAC_LAB, LEGGED_GYM, ARRAYS, C_HEADER, MARKDOWN)}
"""By name, as --to has them."""
OF_WHOLE_FILES = {"mjlab-actuator": "mjlab actuators with delay and elasticity"}
"""Forms, with a description, that need more than gains: files/actuator_export.py writes them of a joint.yaml or a robot.yaml."""


def refuse_integral(gains: Mapping[str, Gain], form: ExportForm, owner: str) -> None:
    """Raise GainroomError, which begins with `owner`, if the form holds no integral gain and some joint has one."""
    with_ki = [name for name, gain in gains.items() if gain.ki]
    if with_ki and not form.integral:
        able = ", ".join(each.name for each in FORMS.values() if each.integral)
        raise GainroomError(f"{owner}: holds no integral gain, which {first_of_many(with_ki)} have; {able} do")


def pasted_gains(gains: Mapping[str, Gain], form: str, margins: str, rate: float | None, control: Mapping[str, Any]) -> str:
    """Text of gains to be pasted, in one of FORMS.

    margins   what they keep, as a comment
    rate      of the controller [Hz]; None: continuous
    control   the section of the file, whose filters go along where the form holds some

    Raises GainroomError where the form cannot hold the gains.
    """
    kind = FORMS[form]
    refuse_integral(gains, kind, form)
    text = kind.text_to_paste
    if text is None:
        raise GainroomError(f"{form}: is only written into an existing file, with gainroom export")
    filters = {name: control[name] for name in FILTERS if control.get(name)}
    run = "split" if control.get("kd_path") else None
    goal = ExportedGains(gains, Origin(sample_rate_hz=rate, gains_run=run, system={"control": filters} if filters else {}))
    header = [printable(f"gains from gainroom app: {margins}")[:300]]
    found = text(goal, header)
    return found if not filters or MARK in found else text(goal, [*header, "  without the loop's filters, which this form does not hold"])
