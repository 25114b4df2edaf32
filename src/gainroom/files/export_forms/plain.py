"""Plain YAML, which holds everything that is known of gains."""

import math
from collections.abc import Sequence

import yaml

from .form import ExportedGains, ExportForm, commented, entries, number_text, quoted


def plain_text(goal: ExportedGains, header: Sequence[str]) -> str:
    """Plain YAML: joint → {kp, kd, …}, with location, rate and posture of the gains."""
    said = {key: getattr(goal.origin, key) for key in ("sample_rate_hz", "gains_run", "drive_rate_hz", "drive_delay_ms", "joint_damping")}
    lines = [f"{key}: {value if isinstance(value, str) else number_text(value)}\n" for key, value in said.items() if value is not None]
    lines += [f"posture: {{{entries(goal.posture)}}}\n"] * bool(goal.posture)
    if goal.origin.system:
        lines.append(
            f"system: {yaml.safe_dump(dict(goal.origin.system), default_flow_style=True, sort_keys=False, width=math.inf).strip()}\n"
        )
    lines.append("gains:\n")
    for name, gain in goal.gains.items():
        given = {key: value for key, value in vars(gain).items() if key in ("kp", "kd") or value}
        values = {key: quoted(value) if isinstance(value, str) else number_text(value) for key, value in given.items()}
        lines.append(f"  {quoted(name)}: {{{', '.join(f'{key}: {value}' for key, value in values.items())}}}\n")
    return f"{commented(header)}{''.join(lines)}"


PLAIN = ExportForm("yaml", "YAML", "plain, holds all", ".yaml", plain_text, integral=True)
