"""Section `compare` of a joint.yaml: structures, objective, sensors and the drive's own loop of `gainroom compare`."""

import math
from typing import Annotated, Any, Literal

from pydantic import Field

from ..design.comparison.catalogue import structure_of
from ..design.comparison.objective import OBJECTIVES, Objective
from ..errors import GainroomError, digits
from ..io.validation import Positive, Refusals, Section, number, refusal, relation
from ..studies.comparison import BITS, ComparisonSettings, assumed_noise, assumed_step
from ..system.system import System
from .system_sections import GainPathSection

BANDED = "low_frequency_compliance"
"""Objective with an end in frequency."""

Step = Annotated[float, number(above=0, most=1, unit="rad")]


class ComparedSensorsSection(Section):
    """Section `compare.sensors`: what the sensors add to the torque command."""

    motor_resolution: Step | None = Field(None, description="one step of the motor's encoder, on the joint side [rad]")
    link_resolution: Step | None = Field(None, description="one step of the link's encoder [rad]")
    torque_noise: Positive | None = Field(None, description="the noise of the joint's torque sensor, rms [N·m]")

    @property
    def deviations(self) -> dict[str, float]:
        """Standard deviation per sample by sensor, of those that are given: of an encoder its step/√12 [rad], of the torque [N m]."""
        found = {"motor": self.motor_resolution, "link": self.link_resolution}
        noise = {sensor: step / math.sqrt(12) for sensor, step in found.items() if step is not None}
        return noise if self.torque_noise is None else noise | {"torque": self.torque_noise}


class CompareSection(Section):
    """Section `compare`."""

    objective: Literal[OBJECTIVES] = Field("dynamic_stiffness", description="what is made small")  # type: ignore[valid-type]
    below_hz: Positive | None = None
    structures: list[Any] = Field([], max_length=40)
    sensors: ComparedSensorsSection = Field(default_factory=dict, validate_default=True)  # type: ignore[assignment] - {} as a section
    drive_path: GainPathSection | None = None

    @relation
    def _end_of_the_band(self) -> Refusals:
        if self.objective == BANDED and self.below_hz is None:
            yield refusal(f"is missing: the highest frequency [Hz] of {BANDED}", key="below_hz")
        if self.objective != BANDED and self.below_hz is not None:
            yield refusal(f"is for the objective {BANDED} only", key="below_hz")

    @relation
    def _known_structures(self) -> Refusals:
        for index, entry in enumerate(self.structures):
            try:
                structure_of(entry)
            except GainroomError as error:
                yield refusal(str(error), key=f"structures[{index}]")

    def settings(self, system: System) -> ComparisonSettings:
        """Settings of a comparison on the joint of `system`, with an encoder that is assumed where none is given."""
        self.require_right()
        noise = assumed_noise(system) | self.sensors.deviations
        below = math.inf if self.below_hz is None else 2 * math.pi * self.below_hz
        path = None if self.drive_path is None else self.drive_path.path()
        return ComparisonSettings(tuple(self.structures), Objective(self.objective, below), noise, path)


def assumption(system: System, settings: ComparisonSettings) -> list[str]:
    """Sentence on the encoder that a comparison on `system` assumes; [] where it is given, or the noise has no ceiling of its size."""
    step = assumed_step(system)
    if not math.isclose(settings.sensor_noise.get(system.control.feedback.position, 0.0), step / math.sqrt(12)):
        return []
    size = f"{digits(step, 'rad', 3)}, {BITS} bits per turn of the motor"
    return [f"the encoder's step is {size}: give drive.encoder_resolution; it cancels out where structures use the encoder alone"]
