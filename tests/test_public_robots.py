"""Public robots with gains in seven forms: audited as the robot described by hand is, exported, audited again with the same verdict."""

import json
import math
from dataclasses import dataclass
from pathlib import Path

import pytest
import yaml

import gainroom as gr
from gainroom.cli import main
from gainroom.robot import load_model
from test_gain_formats import onnx

DELAY_MS = 3.0


@dataclass(frozen=True)
class Case:
    """A robot, its gains as a file of that form has them, and the same by joint pattern: kp, kd, motor inertia."""

    model: str
    file: str
    text: str | bytes
    gains: dict[str, tuple[float, float, float]]
    exported: str
    base: str = "floating"


OMEGA = 2 * math.pi * 10
G1 = {".*_(hip_pitch|hip_yaw)_joint": 0.010177520, ".*_(hip_roll|knee)_joint": 0.025101925, ".*_ankle_.*_joint": 0.00721945}
G1_TEXT = f"""
import math
NATURAL_FREQ = 10 * 2.0 * math.pi
HIP, KNEE, ANKLE = {", ".join(map(str, G1.values()))}
{
    "".join(
        f'''
{name}_CFG = BuiltinPositionActuatorCfg(
  target_names_expr=({pattern!r},), stiffness={name} * NATURAL_FREQ**2, damping=2.0 * 2.0 * {name} * NATURAL_FREQ, armature={name})'''
        for name, pattern in zip(("HIP", "KNEE", "ANKLE"), G1, strict=True)
    )
}
"""
GO2_TEXT = """
UNITREE_GO2_CFG = ArticulationCfg(
    actuators={"base_legs": DCMotorCfg(joint_names_expr=[".*_hip_joint", ".*_thigh_joint", ".*_calf_joint"],
        effort_limit=23.5, saturation_effort=23.5, velocity_limit=30.0, stiffness=25.0, damping=0.5, friction=0.0, armature=0.02)})
"""
TALOS = {
    f"leg_left_{number}_joint": gains for number, gains in zip("123456", [(5000, 60)] * 3 + [(5500, 70)] + [(4000, 40)] * 2, strict=True)
}
TALOS_TEXT = yaml.safe_dump(
    {
        "controller_manager": {"ros__parameters": {"update_rate": 1000}},
        "legs": {
            "ros__parameters": {
                "joints": [*TALOS],
                "command_interfaces": ["effort"],
                "gains": {name: {"p": float(kp), "i": 0.0, "d": float(kd)} for name, (kp, kd) in TALOS.items()},
            }
        },
    }
)
SOLO = ["FL_HAA", "FL_HFE", "FL_KFE", "FR_HAA", "FR_HFE", "FR_KFE"]
SOLO_TEXT = f"""
const char* joint_names[] = {{{", ".join(f'"{name}"' for name in SOLO)}}};
const float Kp[6] = {{3.0f, 3.0f, 2.5f, 3.0f, 3.0f, 2.5f}};  // N m / rad
const float Kd[6] = {{0.2, 0.2, 0.15, 0.2, 0.2, 0.15}};
"""
PANDA = dict(zip([f"panda_joint{k}" for k in range(1, 8)], [0.6057, 0.6057, 0.4625, 0.4625, 0.2055, 0.2055, 0.2055], strict=True))
PANDA_TEXT = yaml.safe_dump({"gains": {name: {"kp": 600.0, "kd": 50.0, "motor_inertia": inertia} for name, inertia in PANDA.items()}})
ANYMAL = [f"{leg}_{joint}" for leg in ("LF", "RF", "LH", "RH") for joint in ("HAA", "HFE", "KFE")]
ANYMAL_TEXT = onnx(
    {
        "joint_names": ",".join(ANYMAL),
        "joint_stiffness": ",".join(["85.0"] * 12),
        "joint_damping": ",".join(["0.6"] * 12),
        "default_joint_pos": ",".join(["0.1"] * 12),
    }
)
Z1 = [f"joint{k}" for k in range(1, 7)]
Z1_TEXT = yaml.safe_dump({"moteus": {name: {"kp": 120.0, "kd": 9.0} for name in Z1}})
TURN = 2 * math.pi

CASES = {
    "G1 from mjlab": Case(
        "g1_29dof_rev_1_0.urdf", "g1_constants.py", G1_TEXT, {p: (j * OMEGA**2, 4 * j * OMEGA, j) for p, j in G1.items()}, "mjlab"
    ),
    "Go2 from Isaac Lab": Case("go2.urdf", "unitree.py", GO2_TEXT, {".*_(hip|thigh|calf)_joint": (25.0, 0.5, 0.02)}, "isaaclab"),
    "TALOS from ros2_control": Case(
        "talos_reduced.urdf", "controllers.yaml", TALOS_TEXT, {name: (*gains, 2.0) for name, gains in TALOS.items()}, "ros2_control"
    ),
    "Solo from a C header": Case("solo12.urdf", "gains.h", SOLO_TEXT, {"F._H.*": (3.0, 0.2, 0.02), "F._KFE": (2.5, 0.15, 0.02)}, "arrays"),
    "Panda from YAML": Case("panda.urdf", "gains.yaml", PANDA_TEXT, {name: (600.0, 50.0, j) for name, j in PANDA.items()}, "yaml", "fixed"),
    "ANYmal from a policy": Case(
        "anymal_c_simple_description/urdf/anymal.urdf", "policy.onnx", ANYMAL_TEXT, dict.fromkeys(ANYMAL, (85.0, 0.6, 0.02)), "arrays"
    ),
    "Z1 from moteus": Case("z1.urdf", "moteus.yaml", Z1_TEXT, dict.fromkeys(Z1, (120.0 / TURN, 9.0 / TURN, 0.02)), "ros2_control", "fixed"),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_audited_as_described_by_hand_and_exported_with_the_same_verdict(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], name: str
):
    case = CASES[name]
    monkeypatch.chdir(tmp_path)
    model = f"example-robot-data:{case.model}"
    Path(case.file).write_bytes(case.text.encode() if isinstance(case.text, str) else case.text)
    common = ["--delay-ms", str(DELAY_MS), "--base", case.base, "--motor-inertia", "0.02", "--stiffness", "8000", "--damping", "2"]
    if "TALOS" in name:
        common[common.index("0.02")] = "2.0"
    if name in ("G1 from mjlab", "Panda from YAML"):  # which have that of every joint themselves, so that another one is an error
        del common[(place := common.index("--motor-inertia")) : place + 2]

    def audited(*gains: str) -> dict:
        main(["audit", model, *common, *gains, "--json"])
        return json.loads(capsys.readouterr().out)

    found = audited("--gains", case.file)

    body = load_model(model, base=case.base)
    rows = {joint["name"]: joint for joint in found["joints"]}
    text = {
        "model": {"file": model, "base": case.base, "gravity_stiffness": False},
        "joints": {
            "default": {"stiffness": 8000, "damping": 2},
            **{pattern: {"motor_inertia": inertia} for pattern, (_, _, inertia) in case.gains.items()},
            "locked": [joint for joint in body.joint_names if joint not in rows],
        },
        "drive": {"bandwidth": math.inf, "delay_ms": DELAY_MS},
        "control": {
            "type": "pd",
            "feedback": "motor",
            "kp": {p: kp for p, (kp, _, _) in case.gains.items()},
            "kd": {p: kd for p, (_, kd, _) in case.gains.items()},
        }
        | ({"sample_rate_hz": 1000} if "TALOS" in name else {}),
    }
    Path("hand.yaml").write_text(yaml.safe_dump(text), "utf-8")
    hand = gr.load_robot("hand.yaml").system
    assert list(rows) == list(hand.source.joint_names)
    truth = gr.gain_limit(hand.loop(hand.source.linearize()))
    assert found["gain_limit"] == pytest.approx(truth.gain, rel=1e-6)  # gains of files have seven digits
    assert found["stable"] == truth.stable

    out = f"exported{ {'mjlab': '.py', 'isaaclab': '.py'}.get(case.exported, '.yaml') }"
    assert main(["export", case.file, "--to", case.exported, "--model", model, "--output", out, "--write"]) == 0
    capsys.readouterr()
    again = audited("--gains", out)
    assert again["safe"] == found["safe"]
    assert again["gain_limit"] == pytest.approx(found["gain_limit"], rel=1e-6)
    assert [joint["safe"] for joint in again["joints"]] == [joint["safe"] for joint in found["joints"]]
