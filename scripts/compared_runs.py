"""Brings the table of docs/compare.md up to date in which compared controllers are pushed in simulation; some minutes.

python scripts/compared_runs.py
"""

import math
import re
from pathlib import Path

from gainroom.studies.compared_runs import CASES, PUSH, pushed
from gainroom.studies.comparison import Comparison, ComparisonSettings, compare
from gainroom.system.controller import PD
from gainroom.system.drive import Drive
from gainroom.system.elastic_joint import ElasticJoint
from gainroom.system.system import System

PAGE = Path(__file__).resolve().parents[1] / "docs" / "compare.md"
TABLE = re.compile(r"(<!-- pushed in simulation -->\n).*?(<!-- end -->)", re.DOTALL)
COUNT = 7.67e-6  # rad
JOINTS: dict[str, tuple[ElasticJoint, float, float, float]] = {
    "Fig. 9": (ElasticJoint(1.0, 16.0, 1e4, 1.0), 2e-3, COUNT, 5.0),
    "testbed": (ElasticJoint(0.2, 0.8, 1e4, 1.0), 2.174e-3, COUNT, 1.0),
    "knee": (ElasticJoint(1.9546e-4 * 144**2, 16.0, 1e4, 20.0), 2e-3, COUNT * 100 / 144, 5.0),
}
"""Joint, delay [s], step of the encoder [rad] and Coulomb friction [N m] of each example, at 2 kHz."""


def compared(name: str) -> Comparison:
    """All structures compared on one of JOINTS."""
    joint, delay, count, _ = JOINTS[name]
    system = System.of_joint(joint, Drive(4000.0, 0.9, delay, resolution=count), PD(1.0, 1.0), sample_time=5e-4)
    return compare(system, settings=ComparisonSettings(sensor_noise={"torque": 0.05}))


def main() -> None:
    """Write the table."""
    head = ["joint", "structure", "holds the box", *CASES]
    rows = [head, ["---"] * len(head)]
    for name, (*_, friction) in JOINTS.items():
        for row in compared(name).rows:
            if row.controller is None:
                continue
            cells = [_cell(one.peak, one.vibrates) for one in pushed(row.controller, friction)]
            rows.append([name, row.structure, "yes" if row.holds else "no", *cells])
    table = "".join(f"| {' | '.join(row)} |\n" for row in rows)
    text = PAGE.read_text("utf-8")
    said = f"Largest motion of the link [mrad] under {PUSH:g} N·m that come at once and stay.\n\n"
    PAGE.write_text(TABLE.sub(lambda found: f"{found[1]}\n{said}{table}\n{found[2]}", text), "utf-8")


def _cell(peak: float, vibrates: bool) -> str:
    moved = "diverges" if not math.isfinite(peak) else f"{1e3 * peak:.3g}"
    return f"**{moved}, vibrates**" if vibrates else moved


if __name__ == "__main__":
    main()
