"""Plain YAML or JSON: joint or pattern → {kp, kd, ki, motor_inertia, …}, [kp, kd], or a servo's registers, at the top or under `gains`.

Later patterns win. Beside `gains` may stand where they run, at which rate, and the posture in which they were judged.
"""

from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, ValidationInfo

from ...io.validation import SEPARATELY, Refusals, Section, refusal, relation, validate
from ..gain_context import read_gain_context
from ..system_sections import DelayMs, SampleRate
from .gain_record import ANGLE, Gain, GainFile, GainSection, Origin, as_pair, postures_of
from .servo_registers import ServoSection

POSTURE = "posture"
DRIVE = ("drive_rate_hz", "drive_delay_ms")
PLACE = ("sample_rate_hz", "gains_run", *DRIVE, "joint_damping")


def _entry(value: object, info: ValidationInfo) -> object:
    """Section of one joint: a servo's registers where it names one, else gains."""
    kind = ServoSection if isinstance(value, dict) and "servo" in value else GainSection
    return kind.model_validate(as_pair(value), context=info.context)


class PlainFile(Section):
    """Plain file: joint or pattern → gains, and values for all of them."""

    gains: dict[str, Annotated[Any, BeforeValidator(_entry), SEPARATELY]] = Field(description="the gains by joint or pattern")
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
        if self.has_servos:
            yield from self._servos_place()
            return
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

    @property
    def has_servos(self) -> bool:
        """True if a joint's gains are the registers of a servo, which computes with them itself."""
        return any(isinstance(each, ServoSection) for each in (self.__dict__.get("gains") or {}).values())

    def _servos_place(self) -> Refusals:
        """Contradictions to gains that run in the servos; their rate and delay may be typed instead."""
        if self.gains_run not in (None, "drive"):
            yield refusal("must be drive: servos compute with their registers themselves", key="gains_run")
        elif self.is_given("sample_rate_hz"):
            yield refusal("has no meaning with servos; drive_rate_hz is the rate", key="sample_rate_hz")
        given = [key for key in DRIVE if self.is_given(key)]
        if len(given) == 1:
            yield refusal(f"is missing beside {given[0]}", key=next(key for key in DRIVE if key not in given))


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
    if any(isinstance(each, dict) and _is_servo(each) for each in values):
        return True
    return any(not isinstance(each.get(key, {}), dict | list) for each in sections for key in ("kp", "kd"))


def _is_gain(value: object) -> bool:
    """True if `value` looks like plain gains: a list of numbers, or a section with the key kp, kd or servo."""
    if isinstance(value, list):
        return bool(value) and all(isinstance(item, int | float) for item in value)
    return isinstance(value, dict) and ("kp" in value or "kd" in value or _is_servo(value))


def _is_servo(value: dict[str, Any]) -> bool:
    """True if a section looks like a servo's registers; a joint may be called servo."""
    return "servo" in value and not isinstance(value["servo"], dict)


def read_plain(data: dict[str, Any], source: str) -> GainFile:
    """Gains of a plain file. Raises GainroomError."""
    file = validate(PlainFile, data, source)
    postures, system = postures_of(read_gain_context(file.system, source, "system"))
    place: dict[str, Any] = {key: getattr(file, key) for key in PLACE} | ({"gains_run": "drive"} if file.has_servos else {})
    servos = [each for each in file.gains.values() if isinstance(each, ServoSection)]
    origin = Origin(**place, system=system, converted=tuple(dict.fromkeys(each.sentence() for each in servos)))
    gains = {name: each.gain() if isinstance(each, ServoSection) else Gain(**each.model_dump()) for name, each in file.gains.items()}
    return GainFile(source, "plain", gains, origin=origin, postures=postures or ({POSTURE: file.posture} if file.posture else {}))
