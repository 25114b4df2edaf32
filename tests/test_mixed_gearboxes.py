"""Gearboxes drawn joint by joint in their ranges: where gains are said to hold over a range, margins by another way hold at all of them."""

from pathlib import Path

import numpy as np
import pytest

import gainroom as gr
from gainroom.files.audit_options import AuditOptions, audited
from gainroom.robot.gearbox_types import TYPES
from gainroom.studies.audit import audit
from robot_files import write_arm

DRAWS = 200
REQUIRED = gr.Requirements(gain_margin=2.0, phase_margin=0.5, peak_sensitivity=2.0)
ROBOTS = {
    "biped, stiff": ("gainroom:biped.urdf", '".*": {kp: 200, kd: 22, motor_inertia: 0.5}', 0.5, "harmonic"),
    "biped, belts": ("gainroom:biped.urdf", '".*": {kp: 500, kd: 40, motor_inertia: 0.5}', 1.0, "belt"),
    "arm": ("robot.urdf", '".*": {kp: 400, kd: 30, motor_inertia: 0.5}', 1.0, "harmonic"),
    "arm, fast": ("robot.urdf", '".*": {kp: 100, kd: 12, motor_inertia: 0.1}', 0.5, "planetary"),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", ROBOTS)
def test_no_draw_fails_where_gains_are_said_to_hold(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """By `margins` on the loop of each draw, whose loci are followed; the verdict is from the core's samples, at other places."""
    model, gains, delay, kind = ROBOTS[name]
    monkeypatch.chdir(tmp_path)
    write_arm(tmp_path)
    Path("gains.yaml").write_text(gains, "utf-8")
    asked = audited(model, Path("gains.yaml"), AuditOptions(delay, rate_hz=2000.0, gearboxes=(kind,)))
    found = audit(asked.system, REQUIRED)
    if not found.safe:
        assert found.to_use is not None
        found = found.to_use.audited
    assert found.verdict.level == "safe"
    system, rng = found.system, np.random.default_rng([len(name), 7])
    inertia, size = system.source.quantities["motor_inertia"], len(system.source.joint_names)
    resonance, ratio = TYPES[kind].resonance, TYPES[kind].damping_ratio
    for _ in range(DRAWS):
        omega, damped = (np.exp(rng.uniform(*np.log(ends), size)) for ends in (resonance, ratio))
        geared = system.with_values(stiffness=inertia * omega**2, damping=2 * damped * inertia * omega)
        for posture, contact in system.source.states:
            margins = gr.margins(geared.loop(geared.source.linearize(posture, contact)))
            assert margins.stable
            assert REQUIRED.met_by(margins), (omega, damped, contact)
