"""What a user of the package may add from outside, with nothing else touched."""

import json
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
import pytest

import gainroom as gr
from gainroom.cli import main
from gainroom.cli.joint import _facts, _terminal
from gainroom.report.columns import JOINT, Column
from gainroom.report.joint import joint_page
from gainroom.report.number_format import digits
from gainroom.system.controller import Controller
from robot_files import write_arm


def test_a_column_is_one_entry(tmp_path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch):
    """It stands in the terminal's table with its definition, in JSON, and on the page."""
    path = write_arm(tmp_path)
    monkeypatch.setattr("gainroom.studies.robot._recommended", lambda spec, tell: ())  # which takes longest, and has other columns
    rate = Column("kd/kp", "rate_s", lambda row: row.kd / row.kp, "s", "the time constant of the joint's zero")
    JOINT.append(rate)
    try:
        page = tmp_path / "page.html"
        main(["robot", str(path), "--report", str(page)])
        terminal = " ".join(capsys.readouterr().out.split())
        main(["robot", str(path), "--json"])
        (row, *_) = json.loads(capsys.readouterr().out)["states"][0]["joints"]
    finally:
        JOINT.remove(rate)
    assert "kd/kp: the time constant of the joint's zero" in terminal
    assert row["rate_s"] == pytest.approx(row["kd"] / row["kp"])
    shown = rate.text(type("Row", (), {"kd": row["kd"], "kp": row["kp"]}))
    assert shown in terminal
    html = page.read_text("utf-8")
    assert '<th scope="col">kd/kp</th>' in html
    assert f"<td>{shown}</td>" in html


@dataclass(frozen=True)
class Series(Controller):
    """u = kp (1 + lead s)(x_d − x): a PD in series form, kp [N m/rad], lead [s]."""

    kind: ClassVar[str] = "series PD"
    damping_name: ClassVar[str] = "lead"

    kp: Any
    lead: Any

    @classmethod
    def gain_names(cls) -> tuple[str, ...]:
        return ("kp", "lead")

    def terms(self):
        return {(0, 0): np.asarray(self.kp), (1, 0): np.asarray(self.kp * self.lead)}

    def scaled(self, factor: float) -> "Series":
        return replace(self, kp=self.kp * factor)

    def plane(self):
        return {(0, 0): 1.0}, {(1, 0): 1.0}

    def plane_gains(self):
        return self.kp, self.kp * self.lead

    def from_plane(self, kp: float, kd: float) -> "Series":
        return replace(self, kp=kp, lead=kd / kp)


def test_a_controller_is_one_class():
    """It is analysed, recommended for and shown as the PD that it amounts to."""
    joint, drive = gr.ElasticJoint(1.0, 16.0, 1e4, 1.0), gr.Drive(4000.0, 0.9, 2e-3)
    own, same = Series(1600.0, 0.04), gr.PD(1600.0, 64.0)
    found, known = (gr.margins(gr.build_loop(joint, drive, law)) for law in (own, same))
    assert found.gain_margin == pytest.approx(known.gain_margin, rel=1e-12)
    assert found.delay_margin == pytest.approx(known.delay_margin, rel=1e-12)
    study, pd = (gr.study_joint(gr.JointSpec(joint, drive, law, "motor")) for law in (own, same))
    assert study.recommended is not None
    assert isinstance(study.recommended.controller, Series)
    assert study.recommended.controller.plane_gains() == pytest.approx((pd.recommended.kp, pd.recommended.kd), rel=1e-9)
    assert _facts(study)["recommended"]["lead"] == pytest.approx(pd.recommended.kd / pd.recommended.kp, rel=1e-9)
    assert digits(study.recommended.kd) in _terminal(study, None)
    assert "Series" in joint_page(study, "again")


@dataclass(frozen=True)
class Loaded(gr.ElasticJoint):
    """A source of plants: one joint with each of several loads [kg m²], a state each."""

    loads: tuple[float, ...] = ()

    @property
    def states(self):
        return tuple((f"{load:g} kg m²", "held") for load in self.loads)

    def linearize(self, posture=None, contact=None, weight=False):
        load = next(load for load, (name, _) in zip(self.loads, self.states, strict=True) if name == posture)
        return gr.ElasticJoint(self.motor_inertia, load, self.stiffness, self.damping).plant()


def test_a_source_of_plants_is_one_class():
    """Every state that it names is analysed, and the requirements are judged over all of them."""
    loads, drive, law = (0.5, 4.0, 16.0), gr.Drive(4000.0, 0.9, 2e-3), gr.PD(1600.0, 64.0)
    source = Loaded(1.0, 16.0, 1e4, 1.0, loads=loads)
    found = gr.analyze(gr.System(source, (drive,), gr.Control("joint", law, "motor")))
    alone = [gr.margins(gr.build_loop(gr.ElasticJoint(1.0, load, 1e4, 1.0), drive, law)) for load in loads]
    assert [state.margins.gain_margin for state in found.every] == pytest.approx([one.gain_margin for one in alone], rel=1e-9)
    least = min(range(len(loads)), key=lambda k: alone[k].gain_margin)
    assert found.tightest.posture == f"{loads[least]:g} kg m²"
    assert found.worst["phase_margin"].margins.phase_margin == pytest.approx(min(one.phase_margin for one in alone), rel=1e-9)
    assert found.requirements_met is all(gr.Requirements.usual().met_by(one) for one in alone)


def test_a_controller_of_several_joints_is_the_same_class():
    plant = gr.Plant(np.array([[1.0, 0.3], [0.3, 2.0]]), np.full(2, 0.5), np.full(2, 1e4), np.full(2, 2.0))
    drive = gr.Drive(4000.0, 0.9, 2e-3)
    laws = Series(np.array([400.0, 300.0]), 0.05), gr.PD(np.array([400.0, 300.0]), np.array([20.0, 15.0]))
    limits = [gr.gain_limit(gr.build_loop(plant, drive, law)).gain for law in laws]
    assert limits[0] == pytest.approx(limits[1], rel=1e-9)
