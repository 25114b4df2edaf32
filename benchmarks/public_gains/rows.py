"""Rows of rows.yaml: a robot with gains that are public, the readings of them, and the call of `gainroom audit` that each amounts to."""

import shlex
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

from gainroom.errors import GainroomError
from gainroom.files.audit_options import AuditOptions
from gainroom.robot.formats.model_names import locate

FILE = Path(__file__).with_name("rows.yaml")
FROM_CLONE = "benchmarks/public_gains/rows.yaml"
CHECKOUTS = "$CHECKOUTS"
"""Folder of the checkouts in commands: that of --checkouts."""
DELAY = 3.0
"""Delay of the readings [ms]; DELAYS are those of the host's factors."""
DELAYS = (1.0, 3.0, 5.0)
ASSUMED_RATE = 500.0
"""Rate of a loop on a host of which no source says one [Hz]."""
ASSUMED_DRIVE = {"rate": 4000.0, "delay": 0.3}
"""Rate [Hz] and delay [ms] of a loop in a drive of which no source says them."""
NOTHING = 1e-6
"""Motor inertia that stands for none [kg m²]: a thousandth of the smallest link's in any row, and more."""
HOST, DRIVE, BARE, GEARS = "host", "drive", "bare", "gears"
VIBRATION_ALONE = "--require phase_margin_deg=none --require peak_sensitivity=none"
"""Options with which a search over gearboxes looks for the worst gain margin, as the numbers do."""
PLACES = {
    "drive": "These gains run in the drives.",
    "host": "These gains run on the host.",
    "simulation": "These are gains of a simulation; that they run on the robot is not known.",
}


@dataclass(frozen=True)
class Row:
    """Public gains of one robot. Attributes are the keys of rows.yaml, where they are explained."""

    name: str
    robot: str
    set: str
    model: str
    source: dict[str, Any]
    run: str
    inertia: str
    audit: dict[str, Any]
    repository: str | None = None
    rate: float = ASSUMED_RATE
    rate_said: str | None = None
    drive: dict[str, Any] = field(default_factory=lambda: ASSUMED_DRIVE)
    actuators: dict[str, str] = field(default_factory=dict)
    armature: str | None = None
    gearbox: str | dict[str, str] | None = None
    base: str | None = None
    note: str | None = None

    @property
    def readings(self) -> tuple[str, ...]:
        """Readings of the row: in a drive only where the robot's drives can run kp and kd, elastic where the type of gearbox is known."""
        return (HOST, *([DRIVE] if self.drive else []), BARE, *([GEARS] if self.gearbox else []))

    def in_drive(self, reading: str) -> bool:
        """True if kp and kd run in the drive in a reading; elastic gearboxes are read where the gains run."""
        return reading == DRIVE or (reading == GEARS and self.run == DRIVE)

    @property
    def in_checkout(self) -> str:
        """Path of the model from the folder that holds the checkouts."""
        assert self.repository is not None
        return f"{self.repository.partition('/')[2]}/{self.model}"

    def model_in(self, checkouts: Path | None) -> str | None:
        """Name of the model as `audit` takes it; None where neither a package nor a checkout has it."""
        if self.repository is not None:
            path = None if checkouts is None else checkouts / self.in_checkout
            return str(path) if path is not None and path.is_file() else None
        try:
            locate(self.model)
        except GainroomError:
            return None
        return self.model

    @property
    def bare(self) -> str:
        """Title of the third reading."""
        return "host, the model's own armature" if self.armature == "model" else "host, links alone"

    def title(self, reading: str) -> str:
        """Title of a reading."""
        types = sorted(set(self.gearbox.values())) if isinstance(self.gearbox, dict) else [self.gearbox]
        elastic = f"{'drive' if self.in_drive(GEARS) else 'host'}, worst {' and '.join(map(str, types))} gearboxes"
        return {HOST: "host", DRIVE: "drive", BARE: self.bare, GEARS: elastic}[reading]

    def actuators_in(self, reading: str) -> dict[str, str]:
        """Actuators that are typed in a reading."""
        return {} if reading == BARE else self.actuators

    def options(self, reading: str, delay: float = DELAY) -> AuditOptions:
        """Options of a reading, with `delay` [ms] in the loop or, in a drive, of set-points."""
        drive = self.in_drive(reading)
        own = {"rate_hz": None, "drive_rate_hz": self.drive["rate"], "drive_delay_ms": self.drive["delay"]} if drive else {}
        bare = reading == BARE and self.armature != "model"
        gears = self.gearbox if reading == GEARS and self.gearbox else "direct"
        return AuditOptions(
            delay,
            **{"rate_hz": float(self.rate), "gains_run": DRIVE if drive else HOST, **own},
            base=self.base,
            gearboxes=(gears,) if isinstance(gears, str) else tuple(f"{pattern}={kind}" for pattern, kind in gears.items()),
            actuators=tuple(f"{pattern}={name}" for pattern, name in self.actuators_in(reading).items()),
            of_joints=(("motor_inertia", ".*", NOTHING),) if bare else (),
        )

    def command(self, reading: str) -> str:
        """Command that shows the row in a reading, in a clone of the repository; of a checkout with its folder in $CHECKOUTS."""
        asked = self.options(reading)
        model = shlex.quote(self.model) if self.repository is None else f'"{CHECKOUTS}/{self.in_checkout}"'
        words = ["gainroom audit", model, "--gains", f"{FROM_CLONE}:rows.{self.name}.audit", *_words(asked)]
        if reading == GEARS:
            words.append(VIBRATION_ALONE)
        return " ".join(words)

    @property
    def gains(self) -> Path:
        """Name of the gains as `audit` takes it."""
        return Path(f"{FILE}:rows.{self.name}.audit")


def _words(asked: AuditOptions) -> Iterator[str]:
    """Words of a command for the options that rows use."""
    values = {
        "--delay-ms": asked.delay_ms,
        "--gains-run": asked.gains_run,
        "--rate-hz": asked.rate_hz,
        "--drive-rate-hz": asked.drive_rate_hz,
        "--drive-delay-ms": asked.drive_delay_ms,
        "--base": asked.base,
    }
    for option, value in values.items():
        if value is not None:
            yield f"{option} {value if isinstance(value, str) else f'{value:g}'}"
    lists = {
        "--gearbox": asked.gearboxes,
        "--actuator": asked.actuators,
        "--motor-inertia": tuple(f"{pattern}={value:g}" for _, pattern, value in asked.of_joints),
    }
    for option, texts in lists.items():
        for text in texts:
            yield f"{option} {shlex.quote(text)}"


def rows() -> list[Row]:
    """Every row of rows.yaml."""
    return [Row(name, **keys) for name, keys in yaml.safe_load(FILE.read_text("utf-8"))["rows"].items()]
