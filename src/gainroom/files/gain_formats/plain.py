"""Plain YAML or JSON: joint name or pattern → {kp, kd, ki, motor_inertia, …} or [kp, kd], at the top or under `gains`.

Later patterns win. Beside `gains` may stand where they run, at which rate, and the posture in which they were judged.
"""

from typing import Annotated, Any, Literal

from pydantic import Field

from ...io.validation import Refusals, Section, refusal, relation, validate
from ..gain_context import read_gain_context
from ..system_sections import DelayMs, SampleRate
from .gain_record import ANGLE, AnyGain, Gain, GainFile, Origin, postures_of

POSTURE = "posture"
DRIVE = ("drive_rate_hz", "drive_delay_ms")
PLACE = ("sample_rate_hz", "gains_run", *DRIVE, "joint_damping")


class PlainFile(Section):
    """Plain file: joint or pattern → gains, and values for all of them."""

    gains: dict[str, AnyGain] = Field(description="the gains by joint or pattern")
    sample_rate_hz: SampleRate | None = Field(None, description="of the controller [Hz]")
    gains_run: Literal["host", "drive", "split"] | None = Field(None, description="where they run, as --gains-run has it")
    drive_rate_hz: SampleRate | None = Field(None, description="of gains that run on the drive [Hz]")
    drive_delay_ms: DelayMs | None = Field(None, description="of their own loop, measurement to torque [ms]")
    system: dict[str, Any] | None = Field(None, description="what else decides, as sections of a robot.yaml")
    joint_damping: Literal["controller", "friction"] | None = Field(
        None, description="what the model's own joint damping was taken for, which these kd or link_viscous hold already"
    )
    posture: dict[str, Annotated[float, ANGLE]] | None = Field(None, description="angles by joint or pattern [rad; m if prismatic]")

    @classmethod
    def prepared(cls, data: dict[str, Any]) -> dict[str, Any]:
        return data if "gains" in data else {"gains": data}

    @relation
    def _whole_place(self) -> Refusals:
        on_drive = self.gains_run in ("drive", "split")
        for key in DRIVE:
            if self.is_given(key) != on_drive:
                needed = (
                    f"is missing, which gains_run: {self.gains_run} needs"
                    if on_drive
                    else "has no meaning without gains_run: drive or split"
                )
                yield refusal(needed, key=key)
        if self.gains_run == "drive" and self.is_given("sample_rate_hz"):
            yield refusal("has no meaning with gains_run: drive; drive_rate_hz is the rate", key="sample_rate_hz")


def is_plain(data: dict[str, Any]) -> bool:
    """True if a file's data look like plain gains."""
    section = data.get("gains", data)
    return isinstance(section, dict) and any(_is_gain(value) for value in section.values())


def is_plain_gain(data: dict[str, Any]) -> bool:
    """True if a mapping is plain gains at any place of a file. A pair of numbers counts only under the key `gains`."""
    section = data.get("gains", data)
    values = list(section.values()) if isinstance(section, dict) else []
    if section is not data and values and all(isinstance(each, list) and _is_gain(each) for each in values):
        return True
    sections = [each for each in values if isinstance(each, dict) and "p" not in each]
    return any(not isinstance(each.get(key, {}), dict | list) for each in sections for key in ("kp", "kd"))


def _is_gain(value: object) -> bool:
    """True if `value` looks like plain gains: a list of numbers, or a section with the key kp or kd."""
    if isinstance(value, list):
        return bool(value) and all(isinstance(item, int | float) for item in value)
    return isinstance(value, dict) and ("kp" in value or "kd" in value)


def read_plain(data: dict[str, Any], source: str) -> GainFile:
    """Gains of a plain file. Raises GainroomError."""
    file = validate(PlainFile, data, source)
    postures, system = postures_of(read_gain_context(file.system, source, "system"))
    origin = Origin(**{key: getattr(file, key) for key in PLACE}, system=system)
    gains = {name: Gain(**each.model_dump()) for name, each in file.gains.items()}
    return GainFile(source, "plain", gains, origin=origin, postures=postures or ({POSTURE: file.posture} if file.posture else {}))
