"""Gains of hobby servos given as registers: what they are in N m/rad by what others published of the same servos, and what is refused."""

import json
from pathlib import Path

import pytest

import gainroom as gr
from gainroom.cli import main
from gainroom.files.actuator_facts import actuators
from gainroom.files.gain_files import gains_of, parse_gains
from gainroom.files.gain_formats.servo_registers import LAWS
from refusals import assert_refused

ARM = """<mujoco><worldbody><body><joint name="pan" axis="0 0 1"/><geom size=".02" pos=".1 0 0" mass=".3"/>
<body pos=".2 0 0"><joint name="lift" axis="0 1 0"/><geom size=".02" pos=".1 0 0" mass=".2"/></body></body></worldbody></mujoco>"""


@pytest.mark.parametrize(
    ("servo", "volts", "kp", "damping", "viscous"),
    [
        # What its authors put into simulators for P = 32: kp, and the damping with back-EMF in it; friction_viscous of the same fit apart.
        # apirrone/Open_Duck_Playground, sts3215 at 7.4 V: kp 17.8 and damping 0.6, rounded.
        ("feetech-sts3215", 7.4, pytest.approx(17.8, abs=0.05), pytest.approx(0.6, abs=0.05), 0.0591),
        # kscalelabs/sysid, feetech/sts3215-12v/README.md and feetech/sts3250/README.md, "Exported Parameters", M1;
        # kp to the digits of the duty cycle that they round.
        ("feetech-sts3215", 12.1, pytest.approx(23.45765502, rel=1e-5), pytest.approx(1.384307522, rel=1e-8), 0.05902373678644679),
        ("feetech-sts3250", 12.1, pytest.approx(38.36403950, rel=1e-5), pytest.approx(1.660372517, rel=1e-8), 0.054592361937820244),
    ],
)
def test_gains_are_those_that_were_published_for_simulators(servo: str, volts: float, kp: object, damping: object, viscous: float):
    found = gains_of(parse_gains(f"hip: {{servo: {servo}, p: 32, volts: {volts}}}", "x.yaml"), ["hip"])
    assert found.kp[0] == kp
    assert found.kd[0] == 0
    assert found.actuators[0]["motor_viscous"] + viscous == damping


def test_registers_of_protocol_1_by_hand():
    """MX-64: 0.158 duty a rad and step of P; Kp = P/8, Kd = 4 D/1000, Ki = 1000 I/2048 in the manual, one scale for all three."""
    found = gains_of(parse_gains("hip: {servo: dynamixel-mx-64, p: 32, i: 2, d: 10, volts: 12}", "x.yaml"), ["hip"])
    torque = 12 * 1.6224667906987444 / 3.949433673232461  # N m at full duty: 4.930
    scale = 0.158 * 8  # duty a rad and unit of Kp
    assert found.kp[0] == pytest.approx(torque * scale * 32 / 8, rel=1e-12)  # 24.92 N m/rad
    assert found.kd[0] == pytest.approx(torque * scale * 4 * 10 / 1000, rel=1e-12)
    assert found.ki[0] == pytest.approx(torque * scale * 1000 * 2 / 2048, rel=1e-12)
    assert found.kp[0] == pytest.approx(24.92, abs=0.01)


def test_registers_of_an_xl330_by_hand():
    """256 · 885 encoder steps are the whole duty cycle at P = 1: at P = 400, 5 V, of 651.9 steps a rad."""
    found = gains_of(parse_gains("hip: {servo: dynamixel-xl330, p: 400, volts: 5, kd: 0.02}", "x.yaml"), ["hip"])
    assert found.kp[0] == pytest.approx(5 * 0.386696 / 4.017129 * 400 * 651.8986 / (256 * 885), rel=1e-6)  # 0.554 N m/rad
    assert found.kd[0] == 0.02
    assert found.named == ("dynamixel-xl330",)


def test_the_laws_have_the_constants_of_the_actuators_and_peak_torques_that_are_near():
    for servo, laws in LAWS.items():
        own = actuators()[servo].figures["torque_constant"]
        for law in laws:
            assert any(one.low <= law.torque_constant * (1 + 1e-12) and law.torque_constant * (1 - 1e-12) <= one.high for one in own)
            peak = actuators()[servo].used("peak_torque")
            stall = law.torque_constant / law.resistance * sum(law.volts) / 2
            assert peak is None or 0.3 < stall / peak.value < 3  # friction and heat are in one of them


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("servo: feetech-sts3215, p: 16, d: 32, volts: 7.4", ["hip.d: 32", "feetech-sts3215 is not published", "D = I = 0", "give kd"]),
        ("servo: feetech-sts3215, p: 16, i: 1, volts: 7.4", ["hip.i: 1", "is not published", "give ki"]),
        ("servo: dynamixel-xl330, p: 400, d: 600, volts: 5", ["hip.d: 600", "time base", "give kd"]),
        ("servo: dynamixel-xm430, p: 800, volts: 12", ["dynamixel-xm430 are in N·m/rad is not published", "give kp and kd"]),
        ("servo: robstride-04, p: 800, volts: 12", ["robstride-04 are in N·m/rad is not published"]),
        ("servo: feetech-sts3216, p: 16, volts: 7.4", ["feetech-sts3216", "is no actuator", "feetech-sts3215"]),
        ("servo: feetech-sts3215-7v4, p: 16, volts: 12", ["hip.volts: 12 V must be 4 to 9 V", "was measured"]),
        ("servo: feetech-sts3215, p: 16, volts: 24", ["4 to 9 V or 9 to 15 V"]),
        ("servo: feetech-sts3215, p: 16", ["hip.volts is missing", "supply [V]"]),
        ("servo: feetech-sts3215, volts: 7.4", ["hip.p is missing"]),
        ("servo: feetech-sts3215, p: 300, volts: 7.4", ["hip.p: 300 must be at most 254"]),
        ("servo: feetech-sts3215, p: -1, volts: 7.4", ["hip.p: -1 must be >= 0"]),
        ("servo: feetech-sts3215, p: .nan, volts: 7.4", ["hip.p"]),
        ("servo: feetech-sts3215, kp: 16, volts: 7.4", ["hip.kp", "did you mean p"]),
        ("servo: [1], p: 16, volts: 7.4", ["hip.servo: [1] must be a name"]),
        ("servo: dynamixel-mx-64, p: 32, d: 1, kd: 0.1, volts: 12", ["hip.kd: stands beside d"]),
        ("kp: 16, actuator: gizmo", ["hip.actuator", "gizmo"]),
    ],
)
def test_what_is_not_published_is_refused_by_name(text: str, words: list[str]):
    assert_refused(lambda: parse_gains(f"hip: {{{text}}}", "arm.yaml"), ["arm.yaml", *words])


SERVO = "{servo: feetech-sts3215-7v4, p: 16, volts: 7.4}"


@pytest.mark.parametrize(
    ("beside", "words"),
    [
        ("gains_run: host", ["gains_run: must be drive"]),
        ("gains_run: split", ["gains_run: must be drive"]),
        ("drive_rate_hz: 500", ["drive_delay_ms is missing beside drive_rate_hz"]),
        ("sample_rate_hz: 500", ["sample_rate_hz has no meaning with servos"]),
    ],
)
def test_servos_compute_themselves(beside: str, words: list[str]):
    assert_refused(lambda: parse_gains(f"{beside}\ngains: {{hip: {SERVO}}}", "arm.yaml"), words)


def arm(folder: Path, text: str) -> tuple[str, str]:
    (folder / "arm.xml").write_text(ARM)
    (folder / "arm.yaml").write_text(text)
    return str(folder / "arm.xml"), str(folder / "arm.yaml")


@pytest.mark.slow
def test_an_audit_says_the_conversion_and_judges_the_same_gains_in_newton_metres(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    model, servos = arm(tmp_path, f"drive_rate_hz: 500\ndrive_delay_ms: 4\ngains: {{pan: {SERVO}, lift: {SERVO}}}\n")
    assert main(["audit", model, "--delay-ms", "20", "--gains", servos, "--json"]) != 2
    found = json.loads(capsys.readouterr().out)
    said = next(text for text in found["assumptions"] if "a step of P" in text)
    for word in ("0.166·7.4 V·1.212/2.676 = 0.556 N·m/rad", "kt²/R = 0.549 N·m·s/rad", "no part of kd", "github.com/Rhoban/bam", "m1.json"):
        assert word in said
    assert sum("a step of P" in text for text in found["assumptions"]) == 1
    assert any("kp and kd run on the drives at 500 Hz, 4 ms" in text for text in found["assumptions"])
    kp, viscous = 7.4 * 0.166 * 16 * 1.21164135295077 / 2.6761663274455603, 1.21164135295077**2 / 2.6761663274455603
    joint = f"{{kp: {kp!r}, motor_viscous: {viscous!r}, actuator: feetech-sts3215-7v4}}"
    run = "gains_run: drive\ndrive_rate_hz: 500\ndrive_delay_ms: 4\n"
    arm(tmp_path, f"{run}gains: {{pan: {joint}, lift: {joint}}}\n")
    assert main(["audit", model, "--delay-ms", "20", "--gains", servos, "--json"]) != 2
    plain = json.loads(capsys.readouterr().out)
    for one, other in zip(found["joints"], plain["joints"], strict=True):
        assert one["kp"] == pytest.approx(other["kp"], rel=1e-12)
        assert one["gain_limit"] == pytest.approx(other["gain_limit"], rel=1e-9)


def test_the_supply_tells_which_version_the_motor_is_too(tmp_path: Path):
    """The STS3215 at 7.4 V has published figures of its own, 0.0284 kg·m²; all versions together have 0.026 to 0.147."""
    model, servos = arm(tmp_path, "drive_rate_hz: 500\ndrive_delay_ms: 4\ngains: {'.*': {servo: feetech-sts3215, p: 16, volts: 7.4}}\n")
    found = gr.audit(model, servos, delay=0.02)
    assert {joint["actuator"] for joint in found.to_dict()["joints"]} == {"feetech-sts3215-7v4"}


def test_a_motor_that_its_back_emf_damps_needs_no_kd(tmp_path: Path):
    model, servos = arm(tmp_path, "drive_rate_hz: 500\ndrive_delay_ms: 30\ngains: {'.*': {servo: feetech-sts3215, p: 254, volts: 7.4}}\n")
    found = gr.audit(model, servos, delay=0.02).to_dict()
    assert found["verdict"] == "unsafe"
    assert not any("no gain damps" in text for text in found["warnings"])


def test_servos_need_the_rate_of_their_loop_which_may_be_typed(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    model, servos = arm(tmp_path, f"pan: {SERVO}\nlift: {SERVO}\n")
    assert main(["audit", model, "--delay-ms", "20", "--gains", servos]) == 2
    assert "drive_rate_hz and drive_delay_ms" in capsys.readouterr().err
    call = [
        "audit",
        model,
        "--delay-ms",
        "20",
        "--gains",
        servos,
        "--gains-run",
        "drive",
        "--drive-rate-hz",
        "500",
        "--drive-delay-ms",
        "4",
    ]
    assert main([*call, "--json"]) != 2
    assert any("a step of P" in text for text in json.loads(capsys.readouterr().out)["assumptions"])


def test_programs_give_registers_too(tmp_path: Path):
    model, _ = arm(tmp_path, "")
    one = {"servo": "feetech-sts3215-7v4", "p": 16, "volts": 7.4}
    result = gr.audit(model, {"pan": one, "lift": one}, delay=0.02, gains_run="drive", drive_rate=500, drive_delay=0.004)
    assert result.joints[0].kp == pytest.approx(8.8986, abs=1e-3)


def test_an_export_keeps_the_damping_and_the_servo(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    _, servos = arm(tmp_path, f"drive_rate_hz: 500\ndrive_delay_ms: 4\ngains: {{pan: {SERVO}}}\n")
    assert main(["export", servos, "--to", "yaml"]) == 0
    text = capsys.readouterr().out
    back = gains_of(parse_gains(text, "out.yaml"), ["pan"])
    assert back.named == ("feetech-sts3215-7v4",)
    assert back.actuators[0]["motor_viscous"] == pytest.approx(1.21164135295077**2 / 2.6761663274455603, rel=1e-12)
    assert back.origin.drive_rate_hz == 500
    assert main(["export", servos, "--to", "arrays"]) == 0
    said = capsys.readouterr()
    assert "--actuator feetech-sts3215-7v4" in said.out
    assert "the motors' friction and back-EMF have no place" in said.err
