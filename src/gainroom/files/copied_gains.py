"""Gains as text to be pasted into another file: the page's `Copy`."""

from collections.abc import Mapping
from xml.sax.saxutils import quoteattr

from ..errors import GainroomError, printable
from .gain_formats.export_text import number_text, plain_text, ros2_control_text
from .gain_formats.gain_record import Gain

HEADER = ("gains from gainroom app: {}",)


def copied_gains(gains: Mapping[str, Gain], form: str, margins: str, rate: float | None) -> str:
    """The gains of named joints as `yaml` (which `gainroom audit --gains` reads), `ros2_control` or `mjcf` (an `<actuator>` section).

    margins   what they keep, as a comment
    rate      of the controller [Hz]; None: continuous

    Raises GainroomError where the form cannot hold the gains.
    """
    header = [printable(line.format(margins))[:300] for line in HEADER]
    if form == "yaml":
        return plain_text(gains, header, rate)
    if form == "ros2_control":
        return ros2_control_text(gains, header, rate)
    if any(gain.ki for gain in gains.values()):
        raise GainroomError("mjcf: a position actuator holds no integral gain; ros2_control and yaml do")
    lines = [
        f"  <position joint={quoteattr(name)} kp={quoteattr(number_text(gain.kp))} kv={quoteattr(number_text(gain.kd))}/>\n"
        for name, gain in gains.items()
    ]
    return f"<!-- {' '.join(header).replace('--', '- -')} -->\n<actuator>\n{''.join(lines)}</actuator>\n"
