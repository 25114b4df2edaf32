"""Recommended gains of a robot whose sway a balance controller damps: sway leaves margins and cost, and keeps a damping ratio."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("pinocchio")

from gainroom.analysis.followed_root import root_near
from gainroom.cli.example import example_texts
from gainroom.design.gain_cases import case_of
from gainroom.design.gain_search import RAISE
from gainroom.design.margin_slopes import moved
from gainroom.design.swaying import FLOOR
from gainroom.files.robot_yaml import load_robot_system
from gainroom.studies.analysis import analyze
from gainroom.studies.robot import study_robot
from gainroom.system.controller import PD
from gainroom.system.system import System
from test_sway import DELAY, KD, KP, LOAD, TICK, standing


def biped(folder: Path, balance: str) -> System:
    file = folder / "biped.yaml"
    file.write_text(example_texts()["biped"], "utf-8")
    return replace(load_robot_system(file), balance=balance)


def gains_of(kp: float | np.ndarray, kd: float | np.ndarray) -> np.ndarray:
    return np.array([np.atleast_1d(kp), np.atleast_1d(kd), np.zeros(np.size(kp))], dtype=float)


def test_the_damping_ratio_of_a_torso_on_its_ankle_by_hand(tmp_path: Path):
    """J s² + (kd s + kp) e^{−sτ}: ζ = (kd/J − ω²τ)/(2ω) to first order, and its slopes those of that formula."""
    system = load_robot_system(standing(tmp_path, balance="controller"))
    (state,) = analyze(system).states
    case = case_of(state.case, "joint")
    assert case.sway is not None
    found = case.sway.at(gains_of(KP, KD))

    def ratio(kp: float, kd: float) -> float:
        omega = math.sqrt(kp / LOAD)
        return (kd / LOAD - omega**2 * (DELAY + TICK / 2)) / (2 * omega)

    assert found.damping[0] == pytest.approx(ratio(KP, KD), rel=2e-4)  # the foot's 1e-3 kg beside the torso's
    small = 1e-5
    for k, there in enumerate(((KP * math.exp(small), KD), (KP, KD * math.exp(small)))):
        assert found.slope[0, k, 0] == pytest.approx((ratio(*there) - ratio(KP, KD)) / small, rel=1e-3)  # steps of 1e-5, and the foot


def test_the_damping_ratio_is_that_of_the_loops_root(tmp_path: Path):
    """Of a biped's supporting legs at gains that sway slowly, against Newton's method on the loop with its exact delay."""
    system = biped(tmp_path, "controller").scaled(0.02)
    seen = 0
    for state in analyze(system).states:
        case, gains = case_of(state.case, "joint"), gains_of(state.controller.kp, state.controller.kd)
        if case.sway is None:
            continue
        found = case.sway.at(gains)
        for frequency, ratio in zip(found.frequency.tolist(), found.damping.tolist(), strict=True):
            root = root_near(state.loop, complex(-ratio, 1.0) * frequency)
            assert root is not None
            # second order in ζ, and in the motion that coupled damping gives the other modes
            assert -root.real / abs(root) == pytest.approx(ratio, rel=0.05, abs=0.002)
            seen += 1
    assert seen >= 6


@pytest.mark.slow
def test_slopes_of_damping_and_of_compliance_are_differences(tmp_path: Path):
    """Of the stance legs: those by damping to 1e-4; those by stiffness miss what changes the mode's shape."""
    (state,) = [one for one in analyze(biped(tmp_path, "controller")).states if one.contact == "double"][:1]
    case, gains = case_of(state.case, "joint"), gains_of(state.controller.kp, state.controller.kd) * 0.1
    assert case.sway is not None
    assert case.balanced
    here, peaks = case.sway.at(gains), case.peaks(gains)
    assert np.all(peaks.omega[peaks.omega > 0] > here.bands.max())
    small = 1e-5
    for k in (0, 1):
        for j in range(gains.shape[1]):
            step = np.zeros((2, gains.shape[1]))
            step[k, j] = small
            there = moved(gains, step, case.cascade)
            change = (case.sway.at(there).damping - here.damping) / small
            assert here.slope[:, k, j] == pytest.approx(change, rel=1e-3 if k else 0.5, abs=1e-5 if k else 0.02)
            other = case.peaks(there)
            rest = peaks.omega == 0
            assert np.array_equal(other.direction[other.omega == 0], peaks.direction[rest])
            moves = (other.height[other.omega == 0] - peaks.height[rest]) / small
            assert peaks.slope[rest, k, j] == pytest.approx(moves, abs=1e-4)  # a step of 1e-5 in ln of a gain


@pytest.mark.slow
@pytest.mark.parametrize("balance", ["controller", "joints"])
def test_gains_of_a_biped_whose_sway_something_else_damps(balance: str, tmp_path: Path):
    """Every requirement outside sway's bands by a grid of the exact loop, stability by the certified margins, sway by its root."""
    system = biped(tmp_path, balance)
    study = study_robot(system)
    assert study.to_use is not None
    found = study.to_use[1]
    control = replace(system.control, controller=PD(found.kp, found.kd))
    asked = system.requirements.needed
    for state in analyze(replace(system, control=control)).states:
        assert state.limit.stable
        if balance == "joints" or state.sway is None:
            assert system.requirements.met_by(state.margins) or found.without_weight
            continue
        assert state.sway.damping_ratio > 0.9 * FLOOR  # the search's ratio is of first order
        omega = np.geomspace(0.05, math.pi / system.control.sample_time, 20_001)
        response = state.loop.response(omega)
        own = np.abs(np.diagonal(np.linalg.inv(np.eye(response.shape[1]) + response), axis1=1, axis2=2))
        tops = (own[1:-1] > own[:-2]) & (own[1:-1] > own[2:])
        bands = state.sway.bands
        away = ~np.any((omega[:, None] > bands[:, 0]) & (omega[:, None] < bands[:, 1]), axis=1)
        assert own[1:-1][tops & away[1:-1, None]].max(initial=0.0) < asked["peak_sensitivity"] * 1.001
        loci = np.linalg.eigvals(response[away])
        near = np.abs(np.log(np.abs(loci))) < 2e-3
        assert np.abs(np.angle(-loci))[near].min(initial=math.pi) > asked["phase_margin"] - 0.01  # a grid's step of the unit circle


def test_what_sway_keeps_from_a_joint_is_named(tmp_path: Path):
    """A torso on its ankle: in flight the motor's inertia bounds kd, and 30° on sway then kp; a balance controller frees it."""
    found, states = {}, {"ground": ["foot"], "free": []}
    for balance in ("joints", "controller"):
        study = study_robot(load_robot_system(standing(tmp_path, balance=balance, objective="largest_kp", contacts=states)))
        assert study.to_use is not None
        found[balance] = study.to_use[1]
    assert found["joints"].of_sway == (True,)
    assert found["controller"].of_sway == (False,)
    assert found["controller"].kp[0] > RAISE * found["joints"].kp[0]
    (stands,) = [one for one in found["controller"].links if one.contact == "ground"]
    assert stands.damping["sway"][0] > 0.9 * FLOOR
