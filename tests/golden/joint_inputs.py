"""Inputs about one joint: good joint.yamls of every kind of controller and section, and hostile ones."""

from typing import Any

import yaml

JOINT = {"motor_inertia": 1.0, "link_inertia": 16.0, "stiffness": 1e4, "damping": 1.0}
DRIVE = {"bandwidth": 4000.0, "damping_ratio": 0.9, "delay_ms": 2.0}
CONTROL = {"type": "pd", "kp": 4000.0, "kd": 200.0, "feedback": "motor", "sample_rate_hz": 2000}
LIMITS = {"gain_margin_db": 6.0, "phase_margin_deg": 30.0, "peak_sensitivity": 2.0}
TESTBED = {"motor_inertia": 0.2, "link_inertia": 0.8, "stiffness": 1e4, "damping": 1.0}


def joint_file(joint: dict | None = None, drive: dict | None = None, control: dict | None = None, **sections: Any) -> str:
    """A joint.yaml with these changes of the usual one; a value None takes the key away."""
    whole = {"joint": JOINT | (joint or {}), "drive": DRIVE | (drive or {}), "control": CONTROL | (control or {}), "limits": LIMITS}
    for section in whole.values():
        for key in [key for key, value in section.items() if value is None]:
            del section[key]
    return yaml.safe_dump(whole | sections, sort_keys=False)


GOOD = {
    "safe.yaml": joint_file(),
    "unstable.yaml": joint_file(TESTBED, {"delay_ms": 2.174}, {"kp": 1600.0, "kd": 80.0}),
    "unstable_in_range.yaml": joint_file(control={"kp": 1e4, "kd": 300.0}, uncertainty={"delay_ms": [2.0, 5.0], "stiffness": "20%"}),
    "missed_in_range.yaml": joint_file(uncertainty={"delay_ms": [2.0, 3.5], "link_inertia": [4.0, 32.0]}),
    "no_rate.yaml": joint_file(control={"sample_rate_hz": None}),
    "no_rate_unstable.yaml": joint_file(control={"sample_rate_hz": None, "kd": 900.0}),
    "rigid.yaml": joint_file({"stiffness": "rigid", "damping": None}),
    "locked_output.yaml": joint_file({"link_inertia": float("inf")}),
    "pid.yaml": joint_file(control={"type": "pid", "ki": 9000.0}),
    "ppi.yaml": joint_file(control={"type": "ppi", "kp": 20.0, "kd": None, "kv": 200.0, "ki": 500.0}),
    "link_side.yaml": joint_file(control={"feedback": "link", "kp": 500.0, "kd": 40.0}),
    "filters.yaml": joint_file(
        control={"velocity_filter": {"bandwidth_hz": 200.0, "order": 2}, "notches": [{"frequency_hz": 120.0, "width": 0.4}]}
    ),
    "two_paths.yaml": joint_file(
        control={"sample_rate_hz": 500, "kd_path": {"delay_ms": 0.2, "sample_rate_hz": 5000}}, limits={"gain_margin_db": 6.0}
    ),
    "delay_margin.yaml": joint_file(limits={"gain_margin_db": 6.0, "delay_margin_ms": 1.5}),
    "beyond_reach.yaml": joint_file(drive={"delay_ms": 40.0}, limits={"peak_sensitivity": 1.05, "phase_margin_deg": 80.0}),
    "doubtful_units.yaml": joint_file({"motor_inertia": 1e3, "link_inertia": 2e4}, control={"kp": 1e5, "kd": 2e4}),
    "moved.yaml": joint_file(
        TESTBED,
        {"delay_ms": 2.0},
        {"kp": 1600.0, "kd": 50.0},
        scenario={
            "duration": 0.6,
            "reference": {"type": "quintic", "by": 0.1, "duration": 0.2},
            "disturbance": {"torque": 5.0, "start": 0.4},
            "friction": {"motor": {"coulomb": 1.0, "static": 1.5}},
            "torque_limit": 100.0,
            "motor_resolution": 1e-5,
        },
    ),
    "linear_run.yaml": joint_file(TESTBED, {"delay_ms": 2.0}, {"kp": 1600.0, "kd": 50.0}, scenario={"duration": 0.6}),
}
"""By file name."""

HOSTILE = {
    "bad_key.yaml": joint_file({"stifness": 1e4}),
    "bad_section.yaml": joint_file(gains={"kp": 1.0}),
    "bad_value.yaml": joint_file(drive={"delay_ms": "2 ms"}),
    "negative.yaml": joint_file({"link_inertia": -1.0}),
    "not_finite.yaml": joint_file({"motor_inertia": float("nan")}, control={"kp": float("inf")}),
    "bad_type.yaml": joint_file(control={"type": "lqr"}),
    "missing_gain.yaml": joint_file(control={"kd": None}),
    "both_delays.yaml": joint_file(drive={"delay_ticks": 4}),
    "range_without.yaml": joint_file(uncertainty={"stiffness": [2e4, 3e4]}),
    "no_rate_for_ticks.yaml": joint_file(drive={"delay_ms": None, "delay_ticks": 4}, control={"sample_rate_hz": None}),
    "damaged.yaml": joint_file().replace("control:\n", "control: {type: pd,\n"),
    "a_list.yaml": "- 1\n- 2\n",
    "empty.yaml": "",
    "binary.yaml": bytes(range(256)),
    "escapes.yaml": '"\\e[31mjoint</script>": 1\n',
}
"""By file name; every command refuses them."""
