"""What audit says first: the joint, how far to lower the gains, and what a safe verdict rests on; within 25 lines of 80 columns."""

import html
import json
import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
import yaml

from gainroom.cli import main

BOTH_MARGINS = ("--delay-margin-ms", "1", "--phase-margin-deg", "1", "--peak-sensitivity", "100")
"""So that gain and delay margin decide."""
LEG = Path(__file__).parents[1] / "examples" / "robot.xml"


@pytest.fixture(autouse=True)
def narrow(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("COLUMNS", "80")


def audited(capsys: pytest.CaptureFixture[str], *options: str) -> tuple[int, str]:
    status = main(["audit", str(LEG), *(options if "--delay-ms" in options else ("--delay-ms", "2", *options))])
    return status, capsys.readouterr().out


@pytest.mark.slow
@pytest.mark.parametrize(
    "options", [(), ("--stiffness", "8000", "--damping", "2", *BOTH_MARGINS), ("--rate-hz", "1000", "--margin-db", "12", *BOTH_MARGINS)]
)
def test_the_first_lines_name_joint_and_remedy(capsys: pytest.CaptureFixture[str], options: tuple[str, ...]):
    status, out = audited(capsys, *options)
    assert status == 1
    assert len(out.splitlines()) <= 25
    assert max(len(line) for line in out.splitlines() if not line.startswith("  gainroom ")) <= 80
    assert "ankle" in " ".join(out.splitlines()[:3])
    told = json.loads(audited(capsys, *options, "--json")[1])
    words = " ".join(out.split())
    use = told["to_use"]
    factors = sorted({joint["factor"] for joint in use["joints"]} - {1.0})
    if "--rate-hz" in options:
        assert f"Do this: Multiply the gains of ankle by {factors[0]:.4g} (kp " in words
        assert len(factors) == len(use["scaled"]) == 2
    else:  # what holds in continuous time alone is no gain to use yet
        assert "Do this: Give the loop's rate and audit again, such as:" in words
        assert f"\n  gainroom audit {LEG} --delay-ms 2" in out
        assert " --rate-hz 2000\n" in out
        assert f"Without a rate, × {factors[0]:.4g} on {'ankle' if len(use['scaled']) == 1 else 'all joints'} leaves" in words
        assert len(factors) == 1
    assert "×" not in words.partition("Do this: ")[0]  # no limit before the factor to use, which a reader would take for it
    shown = out[out.index("\n joint ") :].split("\n")
    for column in ("alone", "one loop"):
        assert (f"{column}: " in out) == (f" {column}" in shown[1])
    assert "kp [N·m/rad], kd [N·m·s/rad]" in words
    _, whole = audited(capsys, *options, "--verbose")
    assert "Assumed: " in whole
    assert "Assumed: " not in out


@pytest.mark.slow
@pytest.mark.parametrize("delay", ["2", "4"])
def test_scaled_gains_are_safe_and_hardly_more_is_not(tmp_path: Path, capsys: pytest.CaptureFixture[str], delay: str):
    """Of gains that are stable (2 ms) and that are not (4 ms), typed again with the factor that is said, and with 1 % more."""
    options = ("--delay-ms", delay, *BOTH_MARGINS)
    told = json.loads(audited(capsys, *options, "--json")[1])
    assert (told["safe"], told["requirements_met"], told["unmet"][0]) == (False, False, "gain_margin")
    assert told["stable"] == (delay == "2")
    for factor, safe in ((told["scale"], True), (1.01 * told["scale"], False)):
        gains = {joint["name"]: {"kp": factor * joint["kp"], "kd": factor * joint["kd"]} for joint in told["joints"]}
        path = tmp_path / "gains.yaml"
        for joint in told["joints"]:
            gains[joint["name"]]["motor_inertia"] = joint["motor_inertia"]
        path.write_text(yaml.safe_dump({"gains": gains}), "utf-8")
        again = json.loads(audited(capsys, *options, "--gains", str(path), "--json")[1])
        assert again["requirements_met"] is safe
        assert math.isclose(again["joints"][0]["kp"], factor * told["joints"][0]["kp"], rel_tol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("delay", ["2", "4"])
def test_gains_on_the_page_have_four_digits_and_are_safe(tmp_path: Path, capsys: pytest.CaptureFixture[str], delay: str):
    """Read off the page, and audited again."""
    page = tmp_path / "audit.html"
    told = json.loads(audited(capsys, "--delay-ms", delay, "--json", "--report", str(page))[1])
    lines = html.unescape(re.findall('<div class="copied"><pre>(.*?)</pre>', page.read_text("utf-8"), re.DOTALL)[-1])
    typed = yaml.safe_load(lines)
    values = [value for gains in typed.values() for value in gains.values()]
    assert all(value == float(f"{value:.4g}") for value in values)
    inertia = {joint["name"]: joint["motor_inertia"] for joint in told["joints"]}
    gains = {
        name: {**next(found for pattern, found in typed.items() if re.fullmatch(pattern, name)), "motor_inertia": value}
        for name, value in inertia.items()
    }
    path = tmp_path / "gains.yaml"
    path.write_text(yaml.safe_dump({"gains": gains}), "utf-8")
    assert json.loads(audited(capsys, "--delay-ms", delay, "--gains", str(path), "--json")[1])["requirements_met"] is True


@pytest.mark.slow
@pytest.mark.parametrize("delay", ["2", "4"])
def test_only_joints_that_need_it_are_lowered(tmp_path: Path, capsys: pytest.CaptureFixture[str], delay: str):
    """All others keep their gains; the set is safe, and with half a percent more on the lowered joints it is not."""
    told = json.loads(audited(capsys, "--delay-ms", delay, "--json")[1])
    use, present = told["to_use"], {joint["name"]: joint for joint in told["joints"]}
    assert 0 < len(use["scaled"]) < len(present)
    assert {name for name, joint in present.items() if not joint["safe"]} <= set(use["scaled"])
    for joint in use["joints"]:
        assert (joint["factor"] < 1) == (joint["name"] in use["scaled"])
        assert joint["kp"] == pytest.approx(joint["factor"] * present[joint["name"]]["kp"], rel=5e-4)  # typed with four digits
    for more, safe in ((1.0, True), (1.005, False)):  # the factor is rounded down to three digits: 0.3 % of the least here, 0.33
        gains = {
            joint["name"]: {
                "motor_inertia": present[joint["name"]]["motor_inertia"],
                **{key: joint[key] * (more if joint["name"] in use["scaled"] else 1.0) for key in ("kp", "kd")},
            }
            for joint in use["joints"]
        }
        path = tmp_path / "gains.yaml"
        path.write_text(yaml.safe_dump({"gains": gains}), "utf-8")
        assert json.loads(audited(capsys, "--delay-ms", delay, "--gains", str(path), "--json")[1])["requirements_met"] is safe


CARRIED = {  # name: kp, kd, motor inertia: the knee's are too high, and the ankle moves with it
    "hip_roll": (35.2, 1.07, 0.025),
    "hip_pitch": (34.5, 2.6, 0.025),
    "knee": (99.0, 7.96, 0.025),
    "ankle": (25.4, 2.24, 0.0072),
}


@pytest.mark.slow
def test_each_joint_is_lowered_as_little_as_it_needs(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    """A knee that is a little too stiff beside an ankle that is far too stiff: by one factor the knee lost 58 % for the ankle's sake.

    Truths, each an audit of gains as they are typed: the answer is safe; 1 % more on either joint is not; nor is any common factor that
    leaves the knee two thirds of what it keeps here, and the ankle gives away hardly more than by the largest common one.
    """
    path, options = tmp_path / "gains.yaml", ("--stiffness", "10000", "--damping", "10", "--rate-hz", "1000", *BOTH_MARGINS)
    present = {
        "hip_roll": (98.7, 6.28, 0.025),
        "hip_pitch": (98.7, 6.28, 0.025),
        "knee": (350.0, 16.0, 0.025),
        "ankle": (98.7, 6.28, 0.0072),
    }

    def audit_of(factors: Mapping[str, float]) -> dict[str, Any]:
        gains = {
            name: {"kp": factors.get(name, 1.0) * kp, "kd": factors.get(name, 1.0) * kd, "motor_inertia": inertia}
            for name, (kp, kd, inertia) in present.items()
        }
        path.write_text(yaml.safe_dump({"gains": gains}), "utf-8")
        return json.loads(audited(capsys, *options, "--gains", str(path), "--json")[1])

    use = audit_of({})["to_use"]
    own = {joint["name"]: joint["factor"] for joint in use["joints"]}
    assert use["factor"] is None  # none that a script could put on both
    assert use["scaled"] == ["knee", "ankle"]
    assert (own["hip_roll"], own["hip_pitch"]) == (1.0, 1.0)
    assert audit_of(own)["requirements_met"]
    for name in use["scaled"]:
        assert not audit_of(own | {name: 1.01 * own[name]})["requirements_met"]
    common = own["knee"] / 1.5
    assert not audit_of({"knee": common, "ankle": common})["requirements_met"]
    assert own["ankle"] > 0.9 * common
    path.write_text(
        yaml.safe_dump({"gains": {name: dict(zip(("kp", "kd", "motor_inertia"), one, strict=True)) for name, one in present.items()}})
    )
    words = " ".join(audited(capsys, *options, "--gains", str(path))[1].split())
    assert f"Multiply the gains of ankle by {own['ankle']:.4g} (kp " in words
    assert f" and knee by {own['knee']:.4g} (kp " in words


def test_a_joint_that_is_carried_along_keeps_its_gains(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    """No joint among those to lower could keep its gains with a tenth more (of the logarithm) on the others: each is audited so."""
    path, options = tmp_path / "gains.yaml", ("--stiffness", "3000", "--damping", "2", "--rate-hz", "1000", *BOTH_MARGINS)

    def audit_of(factors: Mapping[str, float]) -> dict[str, Any]:
        gains = {
            name: {"kp": factors.get(name, 1.0) * kp, "kd": factors.get(name, 1.0) * kd, "motor_inertia": inertia}
            for name, (kp, kd, inertia) in CARRIED.items()
        }
        path.write_text(yaml.safe_dump({"gains": gains}), "utf-8")
        return json.loads(audited(capsys, *options, "--gains", str(path), "--json")[1])

    first = audit_of({})
    factor, lowered = float(first["to_use"]["factor"]), list(first["to_use"]["scaled"])
    assert not first["requirements_met"]
    assert audit_of(dict.fromkeys(lowered, factor))["requirements_met"]
    assert not audit_of(dict.fromkeys(lowered, 1.01 * factor))["requirements_met"]
    for kept in lowered:
        assert not audit_of({name: factor**1.1 for name in lowered if name != kept})["requirements_met"]
    assert lowered == ["knee"]


def test_gains_that_hardly_damp_are_not_safe(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    """kd of a fiftieth: far from any gain limit, and ringing. On stiff gearboxes a loop's phase at ω is atan(ω kd/kp) − ωT above −180°."""
    kp, kd, path = 20.0, 0.05, tmp_path / "gains.yaml"
    path.write_text(f"gains: {{'.*': {{kp: {kp}, kd: {kd}, motor_inertia: 0.02}}}}\n", "utf-8")
    options = ("--delay-ms", "0.1", "--delay-margin-ms", "0.1", "--stiffness", "20000", "--damping", "20", "--gains", str(path))
    told = json.loads(audited(capsys, *options, "--json")[1])
    assert (told["verdict"], told["safe"], told["requirements_met"]) == ("unsafe", False, False)
    assert told["unmet"] == ["phase_margin", "peak_sensitivity"]
    assert told["peak_sensitivity"] > 5
    (phase,) = [one for one in told["findings"] if one["code"] == "phase_margin"]
    omega = phase["frequency_rad_s"]
    assert phase["phase_margin_deg"] == pytest.approx(math.degrees(math.atan(omega * kd / kp) - omega * 1e-4), rel=5e-3)
    status, out = audited(capsys, *options)
    words = " ".join(out.split())
    assert (status, words.startswith("Not safe: stable in continuous time, but 2 requirements fail: ")) == (1, True)
    assert f"Ms of one loop {told['peak_sensitivity']:.3g} (≤ 2) at " in words
    assert f"phase margin of all loops {told['phase_margin_deg']:.3g}° (≥ 30°) at " in words
    less = ("--phase-margin-deg", "0.5", "--peak-sensitivity", "100")
    assert json.loads(audited(capsys, *options, *less, "--json")[1])["requirements_met"] is True
    assert audited(capsys, *options, *less)[0] == 3  # the rate is still to be known


@pytest.mark.slow
def test_safe_rests_on_stiff_gearboxes(capsys: pytest.CaptureFixture[str]):
    """The headline says so, and says nothing of it where a stiffness is given."""
    rate = "the loop's rate is not given, and any rate costs margin (--rate-hz)"
    status, out = audited(capsys, "--delay-ms", "0.5")
    assert status == 3
    words = " ".join(out.split())
    assert words.startswith(f"Not decided: {rate}; the stiffness of the gearboxes is not given (--gearbox or --stiffness). ")
    assert "In continuous time and with rigid gearboxes every requirement is met; the tightest is " in words.partition("Do this")[0]
    assert "Do this: Audit again with your loop's rate and your gearboxes" in words
    assert "On softer gearboxes these gains may not be safe." in words
    assert "\n  gainroom audit " in out
    assert out.count(" --rate-hz 2000 --gearbox harmonic\n") == 1
    known = ("--delay-ms", "0.5", "--stiffness", "20000", "--damping", "20")
    status, out = audited(capsys, *known)
    words = " ".join(out.split())
    assert (status, words.startswith(f"Not decided: {rate}. In continuous time every requirement is met; ")) == (3, True)
    assert "gearbox" not in words.partition("Do this")[0]
    levels = [json.loads(audited(capsys, *known, "--rate-hz", rate, "--json")[1]) for rate in ("200", "4000")]  # 5 ms, 0.25 ms a tick
    assert [one["verdict"] for one in levels] == ["unsafe", "safe"]
    out = audited(capsys, *known, "--rate-hz", "4000")[1]
    assert out.startswith("Safe: every requirement is met; the tightest is ")
    assert "\nDo this: These gains may stay.\n" in out


@pytest.mark.slow
def test_motors_without_inertia_are_named_before_gains_are_lowered(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    """An inertia of 0 is not known to be one: it is asked for first, and what to multiply holds where it is really 0."""
    robot, gains = tmp_path / "arm.urdf", tmp_path / "gains.yaml"
    mass = '<mass value="1"/><origin xyz="0 0 -0.2"/>'
    inertia = f'<inertial>{mass}<inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>'
    joint = '<parent link="{}"/><child link="{}"/><axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="9" velocity="9"/>'
    parts = [f'<link name="{name}">{inertia}</link>' for name in ("base", "upper", "lower")]
    for name, ends in (("j1", ("base", "upper")), ("j2", ("upper", "lower"))):
        parts.append(f'<joint name="{name}" type="revolute">{joint.format(*ends)}</joint>')
    robot.write_text(f'<robot name="arm">{"".join(parts)}</robot>', "utf-8")
    call = ["audit", str(robot), "--delay-ms", "2", "--rate-hz", "1000", "--gains", str(gains)]
    for given, says in (
        ("", "Not safe: unstable "),  # with motors like their links they miss a requirement, too
        (", motor_inertia: 0.05", ""),
    ):
        gains.write_text(f'".*": {{kp: 900, kd: 30{given}}}\n', "utf-8")
        assert main(call) == 1
        words = " ".join(capsys.readouterr().out.split())
        assert words.startswith(says or "Not safe: stable, but ")
        assert ("Do this: Give the motors' inertias" in words) is bool(says)
        assert ("Do this: Multiply" in words) is not bool(says)
    assert main([*call, "--verbose"]) == 1
    assert "motor_inertia: 0.05" in capsys.readouterr().out.partition("Do this:")[2]


@pytest.mark.slow
def test_limits_far_above_the_gains_are_not_said_to_be_none(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    """Of gains that vibrate from some factor on a ten-thousandth does so from 10⁴ times that factor on; up to 1000 is looked at."""

    def said(share: float, *options: str) -> str:
        gains = {joint: {"kp": share * kp, "kd": share * kd} for joint, kp, kd in (("hip_pitch", 100.0, 5.0), ("knee", 100.0, 5.0))}
        (tmp_path / "gains.yaml").write_text(yaml.safe_dump(gains))
        return audited(capsys, "--gains", str(tmp_path / "gains.yaml"), "--motor-inertia", "0.1", "--rate-hz", "1000", *options)[1]

    assert json.loads(said(1.0, "--json"))["gain_limit"] > 1
    text = " ".join(said(1e-4).split())
    assert "No common factor up to 1000 on all gains makes it vibrate." in text
    assert ("∞" in text) == ("(∞: none up to 1000)" in text)
