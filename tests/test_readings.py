"""What nobody gave is read in every way: unsafe in all is unsafe, safe in all is safe; each reading right by a loop that is built by hand.

A pendulum on a motor, sampled: ẋ = Ax + bu between ticks, exactly, with a delay of any part of a tick and a velocity by difference. Its
gain margin is a scan of the closed loop's eigenvalues, phase margin and Ms are of a dense grid; no margin of an example lies within 2 % of
what is required, which is more than either grid leaves out.
"""

import itertools
import json
import math
import re
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from scipy.linalg import expm

pytest.importorskip("pinocchio")

from gainroom.cli import main
from gainroom.robot.gearbox_types import TYPES
from gainroom.studies.readings import STIFFEST, USUAL_RATES
from gainroom.studies.verdict import STATUS
from robot_truths import hinge, link

LOAD = 1.0
"""[kg m²] about the hinge."""
FACTOR, PHASE, PEAK = 10 ** (6 / 20), 30.0, 2.0
NEAR = 1.02


class Hand:
    """The loop of one motor with a link of LOAD on its gearbox (`stiffness` inf: rigid), by hand."""

    def __init__(self, motor: float, stiffness: float, damping: float, delay: float, rate: float) -> None:
        tick = 1 / rate
        if math.isinf(stiffness):
            a, b = np.array([[0.0, 1.0], [0.0, 0.0]]), np.array([[0.0], [1 / (motor + LOAD)]])
        else:
            spring, damper = stiffness, damping
            a = np.array([[0, 1, 0, 0], [-spring, -damper, spring, damper], [0, 0, 0, 1], [spring, damper, -spring, -damper]], dtype=float)
            a[1], a[3], b = a[1] / motor, a[3] / LOAD, np.array([[0.0], [1 / motor], [0.0], [0.0]])
        whole, part = divmod(delay / tick, 1.0)
        self.tick, self.whole = tick, int(whole)
        (self.phi, _), (_, self.late) = self.over(a, b, tick), self.over(a, b, (1 - part) * tick)
        self.early = self.over(a, b, (1 - part) * tick)[0] @ self.over(a, b, part * tick)[1]

    @staticmethod
    def over(a: np.ndarray, b: np.ndarray, time: float) -> tuple[np.ndarray, np.ndarray]:
        n = len(a)
        both = expm(time * np.block([[a, b], [np.zeros((1, n + 1))]]))
        return both[:n, :n], both[:n, n:]

    def stable(self, kp: float, kd: float) -> bool:
        """Of the state, the last position and the commands on their way."""
        n, held = len(self.phi), self.whole + 1
        size = n + 1 + held
        step = np.zeros((size, size))
        step[:n, :n], step[n, 0] = self.phi, 1.0
        command = np.zeros(size)
        command[0], command[n] = -(kp + kd / self.tick), kd / self.tick
        queue = [command, *np.eye(size)[n + 1 :]]  # u_k, u_{k−1}, …
        step[:n] += self.late @ queue[self.whole][None] + self.early @ queue[self.whole + 1][None]
        for k in range(held):
            step[n + 1 + k] = queue[k]
        return bool(np.abs(np.linalg.eigvals(step)).max() < 1)

    def level(self, kp: float, kd: float) -> str:
        """Safe or unsafe; "near" where a requirement is within NEAR of what is asked for."""
        omega = np.geomspace(1e-2, math.pi / self.tick, 60_001)
        z, n = np.exp(1j * omega * self.tick), len(self.phi)
        moved = np.linalg.solve(z[:, None, None] * np.eye(n) - self.phi, self.late + self.early / z[:, None, None])[:, 0, 0]
        loop = (kp + kd * (1 - 1 / z) / self.tick) * moved * z**-self.whole
        peak = np.abs(1 / (1 + loop)).max()
        crossing = np.flatnonzero(np.diff(np.sign(np.abs(loop) - 1)))
        phase = np.degrees(np.abs(np.angle(-loop[crossing]))).min(initial=180.0)

        def holds(spare: float) -> bool:
            factors = np.geomspace(1 / (FACTOR * spare), FACTOR * spare, 161)
            kept = all(self.stable(factor * kp, factor * kd) for factor in factors)
            return kept and phase >= PHASE * spare and peak <= PEAK / spare

        return "safe" if holds(NEAR) else "near" if holds(1 / NEAR) else "unsafe"


@cache
def at_rates(name: str) -> dict[float, str]:
    """A rigid joint with the gains of RATES, at every usual rate."""
    kp, kd, delay = RATES[name]
    return {rate: Hand(0.5, math.inf, 0.0, 1e-3 * delay, rate).level(kp, kd) for rate in USUAL_RATES}


def gearbox(motor: float, resonance: float, ratio: float) -> tuple[float, float]:
    return motor * resonance**2, 2 * ratio * motor * resonance


def answer(capsys: pytest.CaptureFixture[str], *words: str | Path) -> dict[str, Any]:
    status = main([*map(str, words), "--json"])
    facts = json.loads(capsys.readouterr().out)
    assert status == STATUS[facts["verdict"]]
    return facts


def pendulum(folder: Path) -> None:
    body = link("upper", 1.0, (0.0, 0.0, -0.9), (0.19, 0.19, 0.01))
    (folder / "arm.urdf").write_text(f'<robot name="arm"><link name="root"/>{body}{hinge("hip", "root", "upper")}</robot>', "utf-8")


def robot(folder: Path, joint: dict[str, Any], kp: float, kd: float, delay_ms: float, rate: float | None) -> Path:
    pendulum(folder)
    described = {
        "model": {"file": "arm.urdf", "base": "fixed"},
        "joints": {"default": joint},
        "drive": {"bandwidth": math.inf, "delay_ms": delay_ms},
        "control": {"type": "pd", "feedback": "motor", "kp": kp, "kd": kd} | ({} if rate is None else {"sample_rate_hz": rate}),
    }
    file = folder / "robot.yaml"
    file.write_text(yaml.safe_dump(described), "utf-8")
    return file


def of_code(facts: dict[str, Any], code: str) -> dict[str, Any]:
    return next(one for one in facts["findings"] if one["code"] == code)


RIGID = {"motor_inertia": 0.5, "stiffness": "rigid"}
RATES = {"slow": (100.0, 20.0, 3.0), "not at 200 Hz": (3e3, 250.0, 1.5), "stiff": (400.0, 900.0, 3.0), "hardly damped": (900.0, 4.0, 2.0)}
RATES["safe in continuous time"] = (1e5, 9e4, 0.01)
"""kp, kd, delay [ms] of gains that are safe at all rates, at fast ones alone, and at none."""


@pytest.mark.slow
@pytest.mark.parametrize("name", RATES)
def test_without_a_rate_gains_are_unsafe_where_they_are_at_all_usual_rates_and_never_safe(name: str, tmp_path: Path, capsys):
    kp, kd, delay = RATES[name]
    truths = at_rates(name)
    assert "near" not in truths.values()
    facts = answer(capsys, "robot", robot(tmp_path, RIGID, kp, kd, delay, None))
    assert facts["verdict"] == ("unsafe" if set(truths.values()) == {"unsafe"} else "undecided")
    told = of_code(facts, "rate_unknown")
    for one in told.get("readings", ()):
        assert one["verdict"] == truths[float(re.findall(r"[\d.]+", one["reading"])[0])]
    for rate in (2000.0, 200.0):  # the key decides
        assert answer(capsys, "robot", robot(tmp_path, RIGID, kp, kd, delay, rate))["verdict"] == truths[rate]


@pytest.mark.slow
def test_the_rates_show_both_and_all_that_is_unsafe():
    """Or the test above shows nothing."""
    found = {name: set(at_rates(name).values()) for name in RATES}
    assert found["slow"] == {"safe"}
    assert found["not at 200 Hz"] == {"safe", "unsafe"}
    assert found["stiff"] == found["hardly damped"] == found["safe in continuous time"] == {"unsafe"}


GEARBOXES = {
    "heavy motor": (20.0, 100.0, 60.0, "safe"),
    "soft gains": (0.2, 60.0, 8.0, "undecided"),
    "safe on soft ones": (0.48, 4600.0, 58.0, "undecided"),
    "stiff gains": (0.3, 4000.0, 600.0, "unsafe"),
}
"""Motor inertia, kp, kd at 1 kHz and 2 ms, and what they are over all stiffnesses."""


@pytest.mark.slow
@pytest.mark.parametrize("name", GEARBOXES)
def test_gearboxes_that_nobody_described_are_read_from_rigid_to_the_softest_type(name: str, tmp_path: Path, capsys):
    motor, kp, kd, level = GEARBOXES[name]
    soft = min(TYPES.values(), key=lambda one: one.resonance)
    every = [Hand(motor, math.inf, 0.0, 2e-3, 1e3).level(kp, kd)]
    for resonance in np.geomspace(soft.resonance[0], STIFFEST, 12):
        every += [Hand(motor, *gearbox(motor, resonance, ratio), 2e-3, 1e3).level(kp, kd) for ratio in soft.damping_ratio]
    assert ("undecided" if len(set(every)) > 1 else every[0]) == level
    facts = answer(capsys, "robot", robot(tmp_path, {"motor_inertia": motor}, kp, kd, 2.0, 1e3))
    assert facts["verdict"] == level
    told = of_code(facts, "gearbox_unknown")
    assert ("readings" in told) == (level == "undecided")
    for one in told.get("readings", ()):
        first, second = map(float, re.findall(r"[\d.]+", one["reading"]))
        own = gearbox(motor, 2 * math.pi * first, second / 100) if "Hz" in one["reading"] else (first, second)
        assert one["verdict"] == Hand(motor, *own, 2e-3, 1e3).level(kp, kd)
    assert ("range_sampled" in {one["code"] for one in facts["findings"]}) == (level == "safe")
    spring, damper = gearbox(motor, 200.0, 0.03)
    for given, truth in ((("rigid", 0.0), every[0]), ((spring, damper), Hand(motor, spring, damper, 2e-3, 1e3).level(kp, kd))):
        joint = {"motor_inertia": motor, "stiffness": given[0], "damping": given[1]}
        assert answer(capsys, "robot", robot(tmp_path, joint, kp, kd, 2.0, 1e3))["verdict"] == truth


MOTORS = {
    "safe with any": (60.0, 14.0, "safe"),
    "unsafe with any": (60.0, 900.0, "unsafe"),
    "safe without": (100.0, 7.0, "undecided"),
    "safe with much": (2000.0, 238.0, "undecided"),
}
"""kp, kd at 1 kHz and 2 ms, and what they are over all inertias of the motor."""


@pytest.mark.slow
@pytest.mark.parametrize("name", MOTORS)
def test_motors_that_nobody_described_are_read_from_none_to_what_they_move(name: str, tmp_path: Path, capsys):
    kp, kd, level = MOTORS[name]
    every = {share: Hand(share * LOAD, math.inf, 0.0, 2e-3, 1e3).level(kp, kd) for share in (0.0, 0.1, 1.0)}
    assert "near" not in every.values()
    assert ("undecided" if len(set(every.values())) > 1 else every[0.0]) == level
    facts = answer(capsys, "robot", robot(tmp_path, {"stiffness": "rigid"}, kp, kd, 2.0, 1e3))
    assert facts["verdict"] == level
    for one in of_code(facts, "motor_inertia_unknown").get("readings", ()):
        assert one["verdict"] == every[float(re.findall(r"[\d.]+", one["reading"])[0])]
    given = robot(tmp_path, {"stiffness": "rigid", "motor_inertia": LOAD}, kp, kd, 2.0, 1e3)
    assert answer(capsys, "robot", given)["verdict"] == every[1.0]


ON_SPRINGS = {
    "safe with any": (60.0, 14.0, "safe"),
    "unsafe with any": (3e3, 300.0, "unsafe"),
    "safe with little": (100.0, 7.0, "undecided"),
    "safe with much": (300.0, 40.0, "undecided"),
}
"""kp, kd at 1 kHz and 2 ms, and what they are over a motor of a tenth of what it moves and one of all of it, on SPRING."""
SPRING = (2e4, 20.0)


@pytest.mark.slow
@pytest.mark.parametrize("name", ON_SPRINGS)
def test_motors_on_springs_that_nobody_described_are_read_from_a_tenth_of_what_they_move(name: str, tmp_path: Path, capsys):
    kp, kd, level = ON_SPRINGS[name]
    every = {share: Hand(share * LOAD, *SPRING, 2e-3, 1e3).level(kp, kd) for share in (0.1, 1.0)}
    assert "near" not in every.values()
    assert ("undecided" if len(set(every.values())) > 1 else every[0.1]) == level
    spring = {"stiffness": SPRING[0], "damping": SPRING[1]}
    facts = answer(capsys, "robot", robot(tmp_path, spring, kp, kd, 2.0, 1e3))
    assert facts["verdict"] == level
    told = of_code(facts, "motor_inertia_unknown")
    assert ("readings" in told) == (level == "undecided")
    for one in told.get("readings", ()):
        assert one["verdict"] == every[float(re.findall(r"[\d.]+", one["reading"])[0])]
    assert [each["motor_inertia"] for each in facts["actuators"]] == [None]  # a guess is no value
    for share, truth in every.items():  # the key decides
        given = robot(tmp_path, {**spring, "motor_inertia": share * LOAD}, kp, kd, 2.0, 1e3)
        assert answer(capsys, "robot", given)["verdict"] == truth


OF_A_TYPE = {"safe with any": (30.0, 6.0, "safe"), "unsafe with any": (2e3, 238.0, "unsafe"), "safe with much": (60.0, 14.0, "undecided")}
"""kp, kd at 1 kHz and 2 ms on harmonic gearboxes."""


@pytest.mark.slow
@pytest.mark.parametrize("name", OF_A_TYPE)
def test_motors_on_a_type_of_gearbox_are_read_with_all_of_its_range(name: str, tmp_path: Path, capsys):
    kp, kd, level = OF_A_TYPE[name]
    kind, every = TYPES["harmonic"], {}
    for share in (0.1, 1.0):
        ends = itertools.product(np.geomspace(*kind.resonance, 9), kind.damping_ratio)
        levels = {Hand(share * LOAD, *gearbox(share * LOAD, *end), 2e-3, 1e3).level(kp, kd) for end in ends}
        every[share] = "unsafe" if "unsafe" in levels else levels.pop()
    assert ("undecided" if len(set(every.values())) > 1 else every[0.1]) == level
    pendulum(tmp_path)
    (tmp_path / "gains.yaml").write_text(f"gains: {{hip: {{kp: {kp}, kd: {kd}}}}}\n", "utf-8")
    call = ["audit", tmp_path / "arm.urdf", "--gains", tmp_path / "gains.yaml", "--delay-ms", "2", "--rate-hz", "1000"]
    facts = answer(capsys, *call, "--gearbox", "harmonic")
    assert facts["verdict"] == level
    for one in of_code(facts, "motor_inertia_unknown").get("readings", ()):
        assert one["verdict"] == every[float(re.findall(r"[\d.]+", one["reading"])[0])]
    for share, truth in every.items():
        assert answer(capsys, *call, "--gearbox", "harmonic", "--motor-inertia", str(share * LOAD))["verdict"] == truth


ORDINARY = {
    "direct": (("--gearbox", "direct"), 60.0, 14.0),
    "rigid": (("--stiffness", "inf"), 60.0, 14.0),
    "measured": (("--stiffness", "20000", "--damping", "20", "--motor-inertia", "0.5"), 60.0, 14.0),
    "of a type": (("--gearbox", "harmonic", "--motor-inertia", "20"), 100.0, 60.0),
    "too much": (("--gearbox", "direct"), 60.0, 900.0),
    "too much on a spring": (("--stiffness", "20000", "--damping", "20", "--motor-inertia", "0.5"), 4000.0, 600.0),
    "too much for a type": (("--gearbox", "planetary", "--motor-inertia", "0.5"), 4000.0, 600.0),
    "on a spring alone": (("--stiffness", "20000", "--damping", "20"), 60.0, 14.0),
    "of a type alone": (("--gearbox", "harmonic"), 30.0, 6.0),
    "too much on a spring alone": (("--stiffness", "20000", "--damping", "20"), 3000.0, 300.0),
    "too much for a type alone": (("--gearbox", "harmonic"), 2000.0, 238.0),
}
"""What is typed of gearboxes beside the delay and the rate, kp and kd; nothing else is known of the URDF."""


@pytest.mark.slow
@pytest.mark.parametrize("name", ORDINARY)
def test_an_ordinary_urdf_is_decided_by_delay_rate_and_gearbox(name: str, tmp_path: Path, capsys):
    typed, kp, kd = ORDINARY[name]
    pendulum(tmp_path)
    (tmp_path / "gains.yaml").write_text(f"gains: {{hip: {{kp: {kp}, kd: {kd}}}}}\n", "utf-8")
    call = ["audit", tmp_path / "arm.urdf", "--gains", tmp_path / "gains.yaml", "--delay-ms", "2"]
    assert answer(capsys, *call)["verdict"] in ("undecided", "unsafe")
    facts = answer(capsys, *call, "--rate-hz", "1000", *typed)
    assert facts["verdict"] == ("unsafe" if "too much" in name else "safe"), facts["sentence"]


@pytest.mark.slow
def test_a_joint_without_a_rate_likewise(tmp_path: Path, capsys):
    for name, (kp, kd, delay) in RATES.items():
        described = {
            "joint": {"motor_inertia": 0.5, "link_inertia": LOAD, "stiffness": "rigid"},
            "drive": {"bandwidth": math.inf, "delay_ms": delay},
            "control": {"type": "pd", "feedback": "motor", "kp": kp, "kd": kd},
        }
        (tmp_path / "joint.yaml").write_text(yaml.safe_dump(described), "utf-8")
        facts = answer(capsys, "joint", tmp_path / "joint.yaml")
        truths = set(at_rates(name).values())
        assert facts["verdict"] == ("unsafe" if truths == {"unsafe"} else "undecided"), name
        assert ("unsafe_at_usual_rates" in {one["code"] for one in facts["findings"]}) == (name == "safe in continuous time")


@pytest.mark.slow
def test_of_several_unknowns_all_that_decide_are_asked_for(tmp_path: Path, capsys):
    """Unsafe at all rates without the motor's inertia, and safe at 2 kHz with it."""
    kp, kd = 400.0, 270.0
    truths = {(share, rate): Hand(share * LOAD, math.inf, 0.0, 3e-3, rate).level(kp, kd) for share in (0.0, 1.0) for rate in USUAL_RATES}
    assert {truths[0.0, rate] for rate in USUAL_RATES} == {"unsafe"}
    assert truths[1.0, 2000.0] == "safe"
    facts = answer(capsys, "robot", robot(tmp_path, {"stiffness": "rigid"}, kp, kd, 3.0, None))
    assert facts["verdict"] == "undecided"
    assert {one["code"] for one in facts["findings"] if one["level"] == "undecided"} >= {"rate_unknown", "motor_inertia_unknown"}
    known = robot(tmp_path, {"stiffness": "rigid", "motor_inertia": LOAD}, kp, kd, 3.0, 2000.0)
    assert answer(capsys, "robot", known)["verdict"] == "safe"
    described = robot(tmp_path, {}, kp, kd, 3.0, 2000.0)  # its gearbox neither
    facts = answer(capsys, "robot", described)
    assert facts["verdict"] == "undecided"
    assert of_code(facts, "motor_inertia_unknown")["level"] == "undecided"
