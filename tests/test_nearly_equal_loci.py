"""Loci of equal limbs that nearly meet between two samples take each other's way, and cross once more, with less phase than is seen."""

from dataclasses import replace

import numpy as np
import pytest

import gainroom as gr
from gainroom.analysis.loop_samples import WHOLE, joint_loops, margins_of_samples, take_samples
from gainroom.files.robot_yaml import parse_robot

G1 = """
model: {file: "example-robot-data:g1_29dof_rev_1_0.urdf", base: floating}
joints:
  default: {stiffness: 3000.0, damping: 1.0}
  .*_(elbow|shoulder_pitch|shoulder_roll|shoulder_yaw|wrist_roll)_joint: {motor_inertia: 0.00361}
  .*_(hip_pitch|hip_yaw)_joint|waist_yaw_joint: {motor_inertia: 0.010178}
  .*_(hip_roll|knee)_joint: {motor_inertia: 0.025102}
  .*_(wrist_pitch|wrist_yaw)_joint: {motor_inertia: 0.00425}
  .*_(ankle_pitch|ankle_roll)_joint|waist_(pitch|roll)_joint: {motor_inertia: 0.007219}
drive: {bandwidth: 4000.0, damping_ratio: 0.9, delay_ms: 2.0}
control: {type: pd, space: joint, feedback: motor, kp: 20.0, kd: 1.0}
contacts: {left: [left_ankle_roll_link]}
postures: {stand: {.*_ankle_pitch_joint: -0.3, .*_hip_pitch_joint: -0.3, .*_knee_joint: 0.6}}
"""
ARM = ((18.0, 0.6539), (26.17, 0.7174), (58.99, 0.5537), (50.9, 0.7007), (56.57, 0.467), (66.68, 0.7574), (18.77, 0.4733))
LEFT = ((21.55, 1.804), (14.64, 4.73), (2.166, 1.709), (6.736, 4.761), (245.3, 0.6191), (108.5, 0.8672))
RIGHT = ((264.1, 1.571), (72.17, 4.658), (186.6, 1.295), (350.0, 2.609), (85.7, 0.9349), (67.24, 0.7266))
WAIST = ((266.3, 1.347), (13.37, 1.102), (16.52, 1.572))
OTHER = ((18.05, 0.6543), (26.17, 0.7174), (58.99, 0.5537), (50.86, 0.7002), (56.57, 0.467), (66.68, 0.7574), (18.77, 0.4733))


@pytest.fixture(scope="module")
def loop():
    """A humanoid on its left foot, whose arms differ by a thousandth in their gains."""
    pytest.importorskip("pinocchio")
    system = parse_robot(G1, "g1.yaml")
    kp, kd = np.array(LEFT + RIGHT + WAIST + ARM + OTHER).T
    return replace(system, control=replace(system.control, controller=gr.PD(kp, kd))).loop(system.source.linearize("stand", "left"))


def test_the_phase_margin_is_where_any_locus_first_crosses(loop):
    """Against eigenvalues so close together that none moves by more than 2e-4: those within that of the unit circle have no less phase."""
    margins = gr.margins(loop)
    assert margins.certified
    values = np.linalg.eigvals(loop.response(np.linspace(17.50, 17.56, 1201)))
    near = values[np.abs(np.abs(values) - 1) < 2e-4]
    least = np.abs(np.angle(-near)).min()
    assert abs(margins.phase_margin - least) < 4e-4  # twice as far as they move
    assert least < 0.51  # a locus that is followed by coarse samples crosses at 0.524, as many others do


def test_looks_of_the_search_see_it_too(loop):
    controller = loop.parts.controller
    gains = np.array([controller.kp, controller.kd, np.zeros(loop.size)])
    seen = margins_of_samples(take_samples(joint_loops(loop), gains, WHOLE), loop.size)
    assert seen.phase_margin < 0.51
    # Loci nearer than 3e-4 are not told apart there.
    assert abs(seen.phase_margin - gr.margins(loop).phase_margin) < 1e-4
