"""Forms in which gains are written. A new one is a file here with an ExportForm, and its place in FORMS."""

from collections.abc import Mapping

from ...errors import GainroomError, first_of_many, printable
from ..gain_formats.gain_record import Gain, Origin
from .actuator_configs import ISAAC_LAB, MJLAB
from .arrays import ARRAYS
from .form import ExportedGains, ExportForm
from .legged_gym import LEGGED_GYM
from .mjcf import MJCF
from .plain import PLAIN
from .ros2_control import ROS2_CONTROL

FORMS = {form.name: form for form in (PLAIN, ROS2_CONTROL, MJCF, MJLAB, ISAAC_LAB, LEGGED_GYM, ARRAYS)}
"""By name, as --to has them."""


def refuse_integral(gains: Mapping[str, Gain], form: ExportForm, owner: str) -> None:
    """Raise GainroomError, which begins with `owner`, if the form holds no integral gain and some joint has one."""
    with_ki = [name for name, gain in gains.items() if gain.ki]
    if with_ki and not form.integral:
        able = ", ".join(each.name for each in FORMS.values() if each.integral)
        raise GainroomError(f"{owner}: holds no integral gain, which {first_of_many(with_ki)} have; {able} do")


def pasted_gains(gains: Mapping[str, Gain], form: str, margins: str, rate: float | None) -> str:
    """Text of gains to be pasted, in one of FORMS.

    margins   what they keep, as a comment
    rate      of the controller [Hz]; None: continuous

    Raises GainroomError where the form cannot hold the gains.
    """
    kind = FORMS[form]
    refuse_integral(gains, kind, form)
    text = kind.text_to_paste
    if text is None:
        raise GainroomError(f"{form}: is only written into an existing file, with gainroom export")
    return text(ExportedGains(gains, Origin(sample_rate_hz=rate)), [printable(f"gains from gainroom app: {margins}")[:300]])
