"""YAML of the arrays that deploy scripts have."""

from collections.abc import Sequence

from .form import ExportedGains, ExportForm, commented, number_text, quoted


def arrays_text(goal: ExportedGains, header: Sequence[str]) -> str:
    """YAML of the arrays kps and kds with joint_names."""
    columns = {
        "joint_names": map(quoted, goal.gains),
        "kps": (number_text(gain.kp) for gain in goal.gains.values()),
        "kds": (number_text(gain.kd) for gain in goal.gains.values()),
    }
    return commented(header) + "".join(f"{key}: [{', '.join(values)}]\n" for key, values in columns.items())


ARRAYS = ExportForm("arrays", "arrays", "kps and kds", ".yaml", arrays_text)
