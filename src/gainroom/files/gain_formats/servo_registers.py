"""Gains of hobby servos as their registers have them, in N m/rad by the published law of their firmware.

Such a servo turns the error of its position into a duty cycle, and the duty cycle of its supply drives the motor:
torque = (kt/R) (volts · duty · P · error − kt · speed). Only what is published of a servo is converted; anything else is refused by name.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

from pydantic import Field

from ...errors import UnjudgedError, digits, first_of_many
from ...io.validation import Name, NotNegative, Positive, Refusals, Section, refusal, relation
from ..actuator_facts import actuators, unknown_actuator
from ..system_sections import Stiffness
from .gain_record import Gain

FEETECH_D = "the servo was measured with D = I = 0"
X_SERIES = "the time base of D/16 and I/65536 is not in the manual"
MX_PID = "; D and I: emanual.robotis.com, PID Gain: Kp = P/8, Ki = I·1000/2048, Kd = D·4/1000"
PER_D, PER_I = 8 * 4 / 1000, 8 * 1000 / 2048
"""Sizes of a step of D [s] and of I [1/s] beside a step of P, of servos with protocol 1 (MX) and of XL-320.

ROBOTIS-GIT/emanual: _includes/en/dxl/control_table_mx_pid.md.
"""


@dataclass(frozen=True)
class ServoLaw:
    """Law of a servo's firmware, and the motor behind it.

    duty              duty cycle per rad and step of P
    torque_constant   at the output [N m/A], of one fit with the winding's resistance [Ω]
    volts             supply (low, high) of the version that was measured [V]
    most              largest value of a register
    source            of all these
    per_d, per_i      steps of D [s] and I [1/s] beside those of P; None: not published, for the reason `unpublished`
    spread            ratio of the largest to the least kt/R of several published fits
    version           actuator that this version alone is; "": no figures are published of it alone
    """

    duty: float
    torque_constant: float
    resistance: float
    volts: tuple[float, float]
    most: int
    source: str
    per_d: float | None = None
    per_i: float | None = None
    unpublished: str = ""
    spread: float = 1.0
    version: str = ""

    def stiffness(self, volts: float) -> float:
        """Torque per rad and step of P [N m/rad] at a supply of `volts`."""
        return self.duty * volts * self.torque_constant / self.resistance

    @property
    def back_emf(self) -> float:
        """Damping of the motor by its own voltage [N m s/rad], which is there at any gain."""
        return self.torque_constant**2 / self.resistance

    def sentence(self, servo: str, volts: float) -> str:
        """Sentence on the conversion, with its source."""
        step = digits(self.stiffness(volts), "N·m/rad", 3)
        law = f"a step of P is duty·volts·kt/R = {self.duty:.4g}·{volts:g} V·{self.torque_constant:.4g}/{self.resistance:.4g} = {step}"
        emf = f"back-EMF damps the motor by kt²/R = {digits(self.back_emf, 'N·m·s/rad', 3)}, which is no part of kd"
        apart = f"; fits to it differ by {100 * (self.spread - 1):.0f} %" if self.spread > 1 else ""
        return f"{servo}: {law}; {emf} ({self.source}{apart})"


def _bam(name: str, more: str) -> str:
    return f"github.com/Rhoban/bam: bam/{name}/actuator.py, bam/params{more}"


# github.com/Rhoban/bam, 1b5a1ce: error_gain of bam/feetech/actuator.py, kt and R of bam/params/feetech_sts3215_7_4V/m1.json; D written as 0
# in bam/feetech/record.py.
_STS3215_7V4 = ServoLaw(
    0.166, 1.21164135295077, 2.6761663274455603, (4, 9), 254, _bam("feetech", "/feetech_sts3215_7_4V/m1.json"), unpublished=FEETECH_D,
    version="feetech-sts3215-7v4",
)  # fmt: skip
# github.com/kscalelabs/sysid, f4739df: error_gain measured at the leads in feetech/sts3215-12v/README.md, kt and R of
# feetech/sts3215-12v/params/id004-params/m1.json, the fit that the README names; error_gain_ratio·kt/R of id004 to id008
# from 0.367 to 0.465.
_STS3215_12V = ServoLaw(
    0.164890901, 3.6070648958284464, 9.817457446450632, (9, 15), 254,
    "github.com/kscalelabs/sysid: feetech/sts3215-12v", unpublished=FEETECH_D, spread=1.27,
)  # fmt: skip
# The same: feetech/sts3250/README.md and params/id004-params/m1.json; kt/R of id004 to id008 from 0.605 to 0.726.
_STS3250 = ServoLaw(
    0.16382926, 2.655159021949133, 4.390307981792371, (9, 15), 254,
    "github.com/kscalelabs/sysid: feetech/sts3250", unpublished=FEETECH_D, spread=1.20,
)  # fmt: skip
# github.com/Rhoban/bam: bam/dynamixel/actuator.py, XL330Actuator: 4096/(2π) steps per rad, a divisor of 256, found on the servo where the
# manual says 128, and 885 for the whole duty cycle; bam/params/xl330/m1.json.
_XL330 = ServoLaw(
    651.8986469044033 / (256 * 885), 0.3866957639281311, 4.017129222290597, (3, 8), 16383, _bam("dynamixel", "/xl330/m1.json"),
    unpublished=X_SERIES,
)  # fmt: skip
# The same, MXActuator and XL320Actuator, with bam/params/mx64, mx106 and xl320/m1.json; firmware of protocol 1.
_MX_64 = ServoLaw(
    0.158, 1.6224667906987444, 3.949433673232461, (9, 16), 254, _bam("dynamixel", "/mx64/m1.json") + MX_PID, PER_D, PER_I
)  # fmt: skip
_MX_106 = ServoLaw(
    0.158, 2.1913757006745245, 2.9649903987776804, (9, 16), 254, _bam("dynamixel", "/mx106/m1.json") + MX_PID, PER_D, PER_I
)  # fmt: skip
_XL_320 = ServoLaw(
    0.05048199, 0.9869471336819953, 35.609097347319235, (5, 9), 254, _bam("dynamixel", "/xl320/m1.json") + MX_PID, PER_D, PER_I
)  # fmt: skip
LAWS: dict[str, Sequence[ServoLaw]] = {
    "feetech-sts3215": (_STS3215_7V4, _STS3215_12V),
    "feetech-sts3215-7v4": (_STS3215_7V4,),
    "feetech-sts3250": (_STS3250,),
    "dynamixel-xl330": (_XL330,),
    "dynamixel-xl330-m288": (_XL330,),
    "dynamixel-mx-64": (_MX_64,),
    "dynamixel-mx-106": (_MX_106,),
    "dynamixel-xl320": (_XL_320,),
}
"""Laws by the name of an actuator, one for each version of it, by its supply."""
FREE = {"d": "kd", "i": "ki"}
"""Registers, and the gains that stand for them where they are not published."""


class ServoSection(Section):
    """Entry of a plain file for a servo whose gains are registers."""

    MEANT: ClassVar[Mapping[str, str]] = {"kp": "p (of a servo; kp without servo)", "voltage": "volts", "v": "volts"}

    servo: Name = Field(description="a name of `gainroom actuators`")
    p: NotNegative = Field(description="the register of the gain on position")
    i: NotNegative = Field(0.0, description="the register of the integral gain")
    d: NotNegative = Field(0.0, description="the register of the derivative gain")
    volts: Positive = Field(description="the supply [V]")
    kd: NotNegative = Field(0.0, description="[N m s/rad] in place of d")
    ki: NotNegative = Field(0.0, description="[N m/(rad s)] in place of i")
    motor_inertia: Positive | None = Field(None, description="on the joint side [kg m²]")
    effort_limit: Positive | None = Field(None, description="[N m]")
    stiffness: Stiffness | None = Field(None, description="of the gearbox [N m/rad]")
    damping: NotNegative | None = Field(None, description="of the gearbox [N m s/rad]")
    link_viscous: NotNegative | None = Field(None, description="of the link [N m s/rad]")

    @property
    def law(self) -> ServoLaw:
        """Law of the servo at its supply. Raises UnjudgedError where there is none."""
        fitting = [law for law in LAWS.get(self.servo, ()) if law.volts[0] <= self.volts <= law.volts[1]]
        if not fitting:
            raise UnjudgedError("servo")
        return fitting[0]

    @relation
    def _known_servo(self) -> Refusals:
        if self.servo not in actuators():
            yield refusal(unknown_actuator(self.servo), key="servo")
        elif self.servo not in LAWS:
            known = first_of_many([*LAWS], len(LAWS))
            yield refusal(
                f"what the registers of {self.servo} are in N·m/rad is not published: give kp and kd in their place (known: {known})",
                key="servo",
            )

    @relation
    def _supplied(self) -> Refusals:
        spans = [f"{law.volts[0]:g} to {law.volts[1]:g} V" for law in LAWS.get(self.servo, ())]
        if spans and not any(law.volts[0] <= self.volts <= law.volts[1] for law in LAWS[self.servo]):
            yield refusal(f"{self.volts:g} V must be {' or '.join(spans)}, at which {self.servo} was measured", key="volts")

    @relation
    def _registers(self) -> Refusals:
        law = self.law
        for key, per_step in (("p", 1.0), ("d", law.per_d), ("i", law.per_i)):
            value, gain = getattr(self, key), FREE.get(key, "")
            if value > law.most:
                yield refusal(f"{value:g} must be at most {law.most}, the largest value of the register", key=key)
            elif value and per_step is None:
                yield refusal(
                    f"{value:g}: what this register does in {self.servo} is not published ({law.unpublished}): leave it out, and give "
                    f"{gain} in its place where it is known",
                    key=key,
                )
            elif value and gain and getattr(self, gain):
                yield refusal(f"stands beside {key}: give one of the two", key=gain)

    def gain(self) -> Gain:
        """Gains in SI, and the motor's damping by its back-EMF."""
        law = self.law
        step = law.stiffness(self.volts)
        return Gain(
            step * self.p,
            self.kd or step * (law.per_d or 0.0) * self.d,
            self.ki or step * (law.per_i or 0.0) * self.i,
            **{key: getattr(self, key) for key in ("motor_inertia", "effort_limit", "stiffness", "damping", "link_viscous")},
            motor_viscous=law.back_emf,
            actuator=law.version or self.servo,
        )

    def sentence(self) -> str:
        """Sentence on the conversion, with its source."""
        return self.law.sentence(self.servo, self.volts)
