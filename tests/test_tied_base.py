"""A floating base of an MJCF that constraints hold to the world, against MuJoCo's own constraints and against a fixed base."""

import json

import numpy as np
import pytest
from numpy.testing import assert_allclose

import gainroom as gr
from gainroom.cli import main
from gainroom.robot import load_model
from gainroom.robot.linearize import gravity_stiffness, linearize
from mujoco_loops import in_mujoco, posed, projected, solid
from refusals import assert_refused
from robot_bodies import write
from robot_truths import actuators

SOLVED = 1e-8
"""Of W: matrices of condition up to 1e6, inverted twice."""

ARM = f"""<mujoco><compiler angle="radian"/><worldbody>
<body name="gate" pos="1.2 0.3 0.8"><joint name="gate" axis="0 0 1"/>{solid(3.0, 0.3, "0.1 0.2 0")}</body>
<body name="base" pos="0.2 -0.1 1" euler="0.3 -0.5 0.2"><freejoint/>{solid(0.5, 0.1, "0.02 0.01 0")}<site name="back" pos="0 0.1 0.1"/>
  <body name="upper" pos="0.1 0 0"><joint name="j" axis="0 1 0" armature="0.05"/>{solid(2.0, 0.1, "0.3 0 0")}
    <body name="lower" pos="0.6 0 0.1"><joint name="k" axis="0 1 0.2" armature="0.05"/>{solid(1.5, 0.1, "0.3 0 0")}</body></body>
  <body name="tail" pos="-0.2 0 0"><joint name="tail" axis="0 0 1"/>{solid(0.4, 0.1, "-0.1 0 0")}</body></body>
</worldbody><equality>{{}}</equality><actuator><motor joint="j"/><motor joint="k"/></actuator></mujoco>"""
TIES = {
    "weld": '<weld body1="base"/>',
    "weld, world first": '<weld body1="world" body2="base"/>',
    "weld elsewhere": '<weld body1="world" body2="base" relpose="0.3 0.1 0.9 0.9 0.3 -0.2 0.1"/>',
    "pin": '<connect body1="base" anchor="0 0 0"/>',
    "pin of the hand": '<connect body1="lower" anchor="0.6 0 0"/>',
    "weld of the hand": '<weld body1="lower"/>',
    "two pins": '<connect body1="base" anchor="0 0.2 0"/><connect body1="tail" anchor="-0.3 0 0"/>',
    "a site": '<weld site1="back" site2="hook"/>',
    "the gate": '<connect body1="lower" body2="gate" anchor="0.6 0 0"/>',
}


def tied(name: str) -> str:
    hook = '<worldbody><site name="hook" pos="0.1 0.2 1.3" euler="0.2 0.1 1"/>'
    return ARM.format(TIES[name]).replace("<worldbody>", hook)


@pytest.mark.slow
@pytest.mark.parametrize("name", TIES)
def test_it_moves_as_in_mujoco(tmp_path, name):
    text = tied(name)
    body = load_model(write(tmp_path, text), passive=["tail", "gate"])
    for angles in ({}, {"j": 0.3, "k": -0.4}, {"j": -0.5, "k": 0.2}):
        q = body.configuration(angles)
        assert_allclose(body.angles(q), [angles.get("j", 0.0), angles.get("k", 0.0)], atol=1e-12)  # the base follows, not the motors
        found = linearize(body, actuators(2), q).link_inverse_inertia
        assert_allclose(found, projected(*in_mujoco(text, body, q)), rtol=SOLVED, atol=SOLVED * np.abs(found).max())


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in TIES if name not in ("weld elsewhere", "a site")])
def test_it_stands_as_in_the_file_where_nothing_is_said_of_its_posture(tmp_path, name):
    body = load_model(write(tmp_path, tied(name)), passive=["tail", "gate"])
    model, data = posed(tied(name), body, body.configuration({}))
    assert_allclose(data.qpos, model.qpos0, atol=1e-9)


def test_welded_it_is_a_fixed_base(tmp_path):
    """Inertia, weight and places are those of the file with the base bolted down where it stands."""
    path = write(tmp_path, tied("weld"))
    welded, fixed = (load_model(path, base=base, locked=["tail", "gate"]) for base in (None, "fixed"))
    assert (welded.base, fixed.base) == ("floating", "fixed")
    angles = {"j": 0.3, "k": -0.4}
    one, other = (linearize(body, actuators(2), body.configuration(angles), gravity=True) for body in (welded, fixed))
    assert_allclose(one.link_inverse_inertia, other.link_inverse_inertia, rtol=SOLVED)
    assert_allclose(one.gravity_stiffness, other.gravity_stiffness, rtol=1e-6, atol=1e-6)
    assert np.abs(other.gravity_stiffness).max() > 1
    for found, truth in zip(welded.frame_placement(one.q, "lower"), fixed.frame_placement(other.q, "lower"), strict=True):
        assert_allclose(found, truth, atol=1e-9)


def test_pinned_it_has_no_gravity_stiffness(tmp_path):
    body = load_model(write(tmp_path, tied("pin")), locked=["tail", "gate"])
    assert_refused(lambda: gravity_stiffness(body, body.configuration({})), ["contacts and closed loops", "3 directions"])


def test_audit_holds_it(tmp_path, capsys):
    """The gain limit is that of the held robot, a third of what it would be in flight; no state is called flight."""
    text = tied("weld").replace(
        '<motor joint="j"/><motor joint="k"/>', '<position joint="j" kp="300" kv="8"/><position joint="k" kp="40" kv="2"/>'
    )
    path = write(tmp_path, text)
    main(["audit", str(path), "--delay-ms", "2", "--stiffness", "5000", "--damping", "1", "--json"])
    found = json.loads(capsys.readouterr().out)
    assert [state["contact"] for state in found["states"]] == ["free"]
    said = found["assumptions"] + found["warnings"]
    assert any("closed loops are kept closed: the loop of 'weld#0' through the world" in text for text in said)
    assert not any("flight" in text for text in said)
    body = load_model(path, base="fixed", locked=["tail", "gate"])
    inverse = linearize(body, actuators(2), body.neutral()).link_inverse_inertia
    loop = gr.build_loop(
        gr.Plant(inverse, np.full(2, 0.05), np.full(2, 5000.0), np.ones(2)),
        gr.Drive(np.inf, 1.0, 2e-3),
        gr.PD(np.array([300.0, 40.0]), np.array([8.0, 2.0])),
    )
    assert found["gain_limit"] == pytest.approx(gr.gain_limit(loop).gain, rel=1e-6)


def test_out_of_reach_it_is_refused(tmp_path):
    text = ARM.format('<weld body1="base"/><connect body1="lower" body2="world" anchor="0.6 0 0"/>')
    body = load_model(write(tmp_path, text), passive=["gate", "tail"])
    in_mujoco(text, body, body.configuration({}))
    assert_refused(lambda: body.configuration({"j": 0.9, "k": 0.0}), ["through the world", "cannot be closed"])


def test_what_is_held_but_left_out_is_said(tmp_path):
    text = ARM.format('<weld body1="base" body2="cart"/>').replace(
        "</worldbody>", f'<body name="cart"><freejoint/>{solid(1, 0.1)}</body></worldbody>'
    )
    notes = load_model(write(tmp_path, text)).notes
    assert any("'weld#0' is ignored" in note for note in notes)


def test_a_base_that_nothing_holds_stands_at_the_identity(tmp_path):
    body = load_model(write(tmp_path, ARM.format("")))
    assert_allclose(body.frame_placement(body.neutral(), "base")[1], 0.0)
