"""What a user of the package may add from outside, with nothing else touched."""

import json
from configparser import ConfigParser
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest

import gainroom as gr
from gainroom.analysis.range_proof import prove
from gainroom.cli import main
from gainroom.cli.output import render
from gainroom.design.margin_slopes import GainCase, moved
from gainroom.files.export_forms import FORMS
from gainroom.files.export_forms.form import ExportForm
from gainroom.files.gain_formats.gain_record import Gain, GainFile
from gainroom.files.joint_yaml import parse_joint
from gainroom.files.robot_yaml import load_robot_system
from gainroom.report.columns import Column
from gainroom.report.joint import joint_page
from gainroom.report.joint_tables import JointPresentation
from gainroom.report.margin_columns import margin_rows
from gainroom.report.number_format import digits
from gainroom.report.robot_columns import JOINT
from gainroom.system.controller import Controller, GainKey
from gainroom.system.requirement import Requirement
from gainroom.system.requirements import REQUIREMENTS, SensitivityBound
from independent.joint import PDJoint
from independent.margins import frequency_grid, peak, response
from robot_files import ROBOT, write_arm


def test_a_column_is_one_entry(tmp_path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch):
    """It stands in the terminal's table with its definition, in JSON, and on the page."""
    path = write_arm(tmp_path)
    monkeypatch.setattr("gainroom.studies.robot._recommended", lambda system: [])  # which takes longest, and has other columns
    rate = Column("kd/kp", "rate_s", lambda row: row.kd / row.kp, "s", "the time constant of the joint's zero")
    JOINT.append(rate)
    try:
        page = tmp_path / "page.html"
        main(["robot", str(path), "--verbose", "--report", str(page)])
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


@pytest.mark.slow
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
    shown = JointPresentation(study)
    assert shown.facts()["recommended"]["lead"] == pytest.approx(pd.recommended.kd / pd.recommended.kp, rel=1e-9)
    assert digits(study.recommended.kd) in render(*next(shown.screens(verbose=True)))
    assert "Series" in joint_page(shown, "again")


@dataclass(frozen=True)
class Standard(Controller):
    """u = kp e + kp/ti ∫e + kd ė: a PID in standard form, with its integral time ti [s]."""

    kind: ClassVar[str] = "standard PID"
    GAINS: ClassVar[tuple[GainKey, ...]] = (*gr.PD.GAINS, GainKey("ti", "s", "the integral time", positive=True, scales=False))
    has_plane: ClassVar[bool] = False

    kp: Any
    kd: Any
    ti: Any

    def __post_init__(self) -> None:
        super().__post_init__()
        if not np.all(np.asarray(self.ti) > 0):
            raise gr.GainroomError("ti must be > 0")

    def terms(self):
        terms = {(0, 0): np.asarray(self.kp), (1, 0): np.asarray(self.kd), (0, 1): np.asarray(self.kp / self.ti)}
        return {powers: gain for powers, gain in terms.items() if np.any(gain)}


def test_a_time_constant_is_no_gain(tmp_path):
    """It stays where gains are scaled, and where other loops or gains are open: the limits are those of the PID that it amounts to."""
    kp, kd, ti = np.array([400.0, 300.0]), np.array([40.0, 30.0]), np.array([0.5, 0.8])
    own, same = Standard(kp, kd, ti), gr.PID(kp, kp / ti, kd)
    own.require_consistent()
    path, arm = gr.GainPath(1e-3, 5e-4), load_robot_system(write_arm(tmp_path))
    plant, drive = (
        gr.Plant(np.array([[1.0, 0.3], [0.3, 2.0]]), np.full(2, 0.5), np.full(2, 1e4), np.full(2, 2.0)),
        gr.Drive(4000.0, 0.9, 2e-3),
    )
    found = []
    for law in (own, same):
        apart = gr.margins(gr.build_loop(plant, drive, law, sample_time=1e-3, kd_path=path)).gain_margin
        (state,) = gr.analyze(arm.with_controller(law)).states
        found.append([apart, *state.limits_others_open])
    assert np.all(np.isfinite(found[0]))
    assert found[0] == pytest.approx(found[1], rel=1e-9)


class Twice(Series):
    """Acts on acceleration, which this package's controllers do not."""

    def terms(self):
        return {(0, 0): np.asarray(self.kp), (2, 0): np.asarray(self.kp * self.lead)}


def test_a_controller_of_other_powers_is_refused():
    """Analysis and simulation would each have taken it for something else."""
    one, drive = gr.ElasticJoint(1.0, 16.0, 1e4, 1.0), gr.Drive(4000.0, 0.9, 2e-3)
    two = gr.Plant(np.eye(2), np.full(2, 0.5), np.full(2, 1e4), np.full(2, 2.0))
    for joint, law in ((one, Twice(1600.0, 0.04)), (two, Twice(np.array([400.0, 300.0]), 0.05))):
        with pytest.raises(gr.GainroomError, match=r"powers \(2, 0\) of V and I must have powers of 0 or 1"):
            gr.margins(gr.build_loop(joint, drive, law))


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


COMPLEMENTARY = SensitivityBound(
    "peak_complementary",
    "peak complementary sensitivity",
    "peak_complementary",
    symbol="Mt",
    at_frequency="peak_complementary_frequency",
    slope=-1.0,
    offset=1.0,
)
SPARE = Requirement("spare_delay", "spare delay", "spare_delay_ms", "ms", 1e3, bounds="delay_margin", at_frequency="delay_crossover")
"""A requirement with an excluded set in closed form, and one that is known by its margin alone."""
KNEE = """\
joint: {motor_inertia: 1.0, link_inertia: 16.0, stiffness: 1e4, damping: 1.0}
drive: {bandwidth: 4000, delay_ms: 2}
control: {type: pd, feedback: motor, kp: 6000, kd: 250}
limits: {gain_margin_db: 6, peak_sensitivity: 2, peak_complementary: 1.3}
"""


def knee(kp: float, kd: float) -> PDJoint:
    return PDJoint(1.0, 16.0, 1e4, 1.0, kp, kd, delay=2e-3, bandwidth=4000.0)


def complementary(kp: float, kd: float) -> float:
    """Mt, from L straight out of the equations of motion."""
    return peak(knee(kp, kd), lambda value: np.abs(value / (1 + value)))


def delay_margin(kp: float, kd: float) -> float:
    """The least (arg(−L) mod 2π)/ω over all |L| = 1 [s], likewise."""
    joint = knee(kp, kd)
    omega = frequency_grid(joint)
    loop = response(joint, omega)
    k = np.flatnonzero(np.diff(np.sign(np.log(np.abs(loop)))))
    return float(np.min(np.angle(-loop[k]) % (2 * np.pi) / omega[k]))


def shown_by(command: str, path: Path, capsys: pytest.CaptureFixture[str]) -> tuple[dict[str, Any], str, str]:
    """What --json, the terminal and the page tell."""
    page = path.with_suffix(".html")
    main([command, str(path), "--json"])
    found = json.loads(capsys.readouterr().out)
    main([command, str(path), "--verbose", "--report", str(page)])
    return found, " ".join(capsys.readouterr().out.split()), page.read_text("utf-8")


@pytest.mark.slow
def test_a_requirement_is_one_object(tmp_path, capsys, monkeypatch):
    """A key of limits: it is judged, kept by the recommended gains, which would miss it without, and told in JSON, terminal and page."""
    one, needed, own = COMPLEMENTARY, 1.3, complementary
    path = tmp_path / "knee.yaml"
    path.write_text(KNEE, "utf-8")
    assert main(["joint", str(path)]) == 2  # nobody knows that key yet
    capsys.readouterr()
    monkeypatch.setitem(REQUIREMENTS, one.name, one)
    found, terminal, page = shown_by("joint", path, capsys)
    assert found["required"][one.key] == pytest.approx(one.in_unit(needed))
    assert found[one.key] == pytest.approx(own(6000.0, 250.0), rel=1e-6)
    gains = found["recommended"]["kp"], found["recommended"]["kd"]
    value = own(*gains)
    assert one.met(needed, value)
    assert one.shortfall(needed, value) > -0.02  # as stiff as it allows
    assert found["recommended"]["binding"] == one.name
    assert found["recommended"]["margins"][one.key] == pytest.approx(value, rel=1e-6)
    without = gr.recommend_pd(gr.ElasticJoint(1.0, 16.0, 1e4, 1.0), gr.Drive(4000.0, 0.9, 2e-3), gr.Requirements(2.0, None, 2.0))
    assert without is not None
    assert one.shortfall(needed, own(without.kp, without.kd)) > 0.05
    assert f"{one.sign} {digits(one.in_unit(needed), one.unit)} no" in terminal  # the file's own gains
    assert f"Recommended gains are limited by the {one.title}" in terminal
    assert f'<th scope="col">{one.title}' in page or one.label in page
    assert f"{one.sign} {digits(one.in_unit(needed), one.unit, 3)}" in page
    assert f"without the {one.title}" in page


@pytest.mark.slow
def test_a_requirement_without_an_excluded_set(monkeypatch: pytest.MonkeyPatch):
    """It is judged by its margin alone: the recommended gains keep it all the same, in a file's unit, and would not without it."""
    monkeypatch.setitem(REQUIREMENTS, SPARE.name, SPARE)
    parts = gr.ElasticJoint(1.0, 16.0, 1e4, 1.0), gr.Drive(4000.0, 0.9, 2e-3)
    text = KNEE.replace("gain_margin_db: 6, peak_sensitivity: 2, peak_complementary: 1.3", "peak_sensitivity: 2.5, spare_delay_ms: 5")
    required = parse_joint(text, "knee.yaml").requirements
    assert required.spare_delay == pytest.approx(5e-3)
    found, without = (gr.recommend_pd(*parts, asked) for asked in (required, required.only("peak_sensitivity")))
    assert found is not None
    assert without is not None
    assert delay_margin(without.kp, without.kd) < 0.7 * 5e-3
    assert 5e-3 * 0.999 < delay_margin(found.kp, found.kd) < 5e-3 * 1.02  # the grid's crossings are good to a few 1e-4
    assert found.binding == "spare_delay"
    found = gr.margins(gr.build_loop(*parts, without.controller))
    rows = margin_rows(found, found, required)
    assert ("≥ 5 ms", "no") in {row[3:] for row in rows if row[0] == "spare delay"}


def test_what_a_new_requirement_proves_over_ranges(monkeypatch: pytest.MonkeyPatch):
    """With an excluded set it is proved like any other, and no more than is true; without one nothing is claimed."""
    joint, drive = gr.ElasticJoint(1.0, 16.0, 1e4, 1.0), gr.Drive(4000.0, 0.9, 2e-3)
    ranges, controller = gr.Uncertainty(delay=(1.8e-3, 2.2e-3)), gr.PD(600.0, 180.0)
    for one in (COMPLEMENTARY, SPARE):
        monkeypatch.setitem(REQUIREMENTS, one.name, one)
    worst = peak(replace(knee(600.0, 180.0), delay=2.2e-3), lambda value: np.abs(value / (1 + value)))
    for share, holds in ((1.02, True), (0.99, False)):
        proof = prove(joint, drive, ranges, controller, gr.Requirements(peak_complementary=share * worst), most=50_000)
        assert proof.holds is holds
    proof = prove(joint, drive, ranges, controller, gr.Requirements(spare_delay=1e-6))
    assert not proof.holds
    assert not proof.broken


def ini_text(goal: Any, header: Any) -> str:
    comment = "".join(f"; {line}\n" for line in header)
    return comment + "".join(f"[{name}]\nstiff = {gain.kp!r}\ndamp = {gain.kd!r}\n" for name, gain in goal.gains.items())


def read_ini(text: str, path: Path) -> GainFile | None:
    if path.suffix != ".ini":
        return None
    parser = ConfigParser()
    parser.read_string(text)
    gains = {name: Gain(parser.getfloat(name, "stiff"), parser.getfloat(name, "damp")) for name in parser.sections()}
    return GainFile(str(path), "servo", gains)


SERVO = ExportForm("servo", "Servo INI", "stiff and damp", ".ini", ini_text, read=read_ini)


def test_an_export_form_is_one_entry(tmp_path, capsys, monkeypatch):
    """Help texts list it, `export` writes it, `audit` reads it, JSON has its text, and the app copies it."""
    pytest.importorskip("uvicorn", reason="the extra gainroom[app] is not installed")
    from gainroom.app.bench import Opened
    from gainroom.app.joint_bench import JointBench
    from gainroom.app.messages import View, read_message

    monkeypatch.chdir(tmp_path)
    write_arm(tmp_path)
    Path("gains.yaml").write_text("shoulder: {kp: 410.5, kd: 31.25}\nelbow: {kp: 300.0, kd: 20.0}\n", "utf-8")
    call = ["export", "gains.yaml", "--to", "servo"]
    ask = json.dumps({"ask": "copy", "key": 1, "form": "servo"})
    assert main(call) == 2  # nobody knows it yet
    capsys.readouterr()
    with pytest.raises(gr.GainroomError, match="must be one of yaml, ros2_control"):
        read_message(ask)
    monkeypatch.setitem(FORMS, SERVO.name, SERVO)

    main(["export", "--help"])
    assert "servo: stiff and damp." in " ".join(capsys.readouterr().out.split())
    main(["audit", "--help"])
    assert "moteus, MJCF, C header, Markdown, Servo INI;" in " ".join(capsys.readouterr().out.split())
    assert main([*call, "--output", "out.ini", "--write", "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert (said["form"], said["text"]) == ("servo", Path("out.ini").read_text("utf-8"))
    written = ConfigParser()
    written.read("out.ini")
    assert {name: dict(written[name]) for name in written.sections()} == {
        "shoulder": {"stiff": "410.5", "damp": "31.25"},
        "elbow": {"stiff": "300.0", "damp": "20.0"},
    }
    assert main(["export", "out.ini", "--to", "arrays"]) == 0
    assert "kps: [410.5, 300.0]" in capsys.readouterr().out
    Path("gains.yaml").write_text("elbow: {kp: 300.0, ki: 2.0}\n", "utf-8")
    assert main(call) == 2
    assert "holds no integral gain, which elbow have; yaml, ros2_control, c, markdown do" in capsys.readouterr().err

    bench = JointBench(Opened(KNEE.replace(", peak_complementary: 1.3", ""), "knee.yaml", tmp_path))
    assert bench.opening()["forms"]["servo"] == "Servo INI"
    assert "[joint]\nstiff = 6000.0\ndamp = 250.0\n" in bench.copied(View(), read_message(ask).form)


@pytest.mark.slow
def test_a_requirement_of_a_robot_is_the_same_object(tmp_path, capsys, monkeypatch):
    """All loops of an arm: the recommended gains keep Mt of each loop, the others closed, and would not without it."""
    monkeypatch.setitem(REQUIREMENTS, COMPLEMENTARY.name, COMPLEMENTARY)
    text = ROBOT.partition("tasks")[0].replace("kp: 400.0, kd: 30.0", "kp: 6000.0, kd: 90.0")
    gains = {}
    for limit in ("", ", peak_complementary: 1.3"):
        path = write_arm(tmp_path, f"{text}limits: {{gain_margin_db: 6, phase_margin_deg: 30, peak_sensitivity: 2{limit}}}\n")
        found, terminal, page = shown_by("robot", path, capsys)
        (sets, *_) = found["recommended"][0]["sets"]
        gains[limit] = sets
        (state,) = found["states"]
        own = highest_complementary(path, None, None)
        assert state["kept"]["peak_complementary"] == pytest.approx(own, rel=1e-3)
    assert found["unmet"].count("peak_complementary") == (own > 1.3)
    assert own > 1.3
    assert "peak complementary sensitivity" in terminal
    assert "peak complementary sensitivity Mt" in page
    assert "Mt (≤ 1.3)" in page
    (free, kept) = gains.values()
    assert "peak_complementary" in {one["margin"] for one in kept["held_back_by"]}
    assert highest_complementary(path, free["kp"], free["kd"]) > 1.4
    value = highest_complementary(path, kept["kp"], kept["kd"])
    assert value < 1.3 * (1 + 1e-5)
    assert value > 1.2
    assert kept["peak_complementary"] == pytest.approx(value, rel=1e-4)


def highest_complementary(path: Path, kp: Any, kd: Any) -> float:
    """The largest |1 − S_ii| of the arm with these gains, or the file's, on a dense grid."""
    system = load_robot_system(path)
    case = next(iter(system.cases()))
    controller = system.controller(case.model)
    if kp is not None:
        controller = replace(controller, kp=np.array(kp), kd=np.array(kd))
    loop = system.loop(case.model, controller)
    values = loop.response(np.geomspace(1e-2, np.pi * 2000, 200_000))
    own = np.diagonal(np.linalg.inv(np.eye(2) + values), axis1=1, axis2=2)
    return float(np.abs(1 - own).max())


def test_slopes_of_a_margin_that_has_no_curve(monkeypatch: pytest.MonkeyPatch):
    """By differences: they tell how the certified margin of two coupled loops changes with every gain."""
    monkeypatch.setitem(REQUIREMENTS, SPARE.name, SPARE)
    plant = gr.Plant(np.array([[1.0, 0.3], [0.3, 2.0]]), np.full(2, 0.5), np.full(2, 1e4), np.full(2, 2.0))
    drive, eye = gr.Drive(4000.0, 0.9, 2e-3), np.eye(2)

    def loop(gains):
        return gr.build_loop(plant, drive, gr.PD(gains[0], gains[1]))

    required = gr.Requirements(spare_delay=0.02)
    case = GainCase("bench", loop, eye, eye, np.zeros(2, dtype=bool), required)
    gains = np.array([[900.0, 700.0], [40.0, 30.0], [0.0, 0.0]])
    slopes = case.slopes(gains)
    assert slopes.name == ("spare_delay",)
    assert slopes.missed[0] == pytest.approx(np.log(0.02 / gr.joint_margins(loop(gains)).delay_margin), abs=1e-9)
    step = np.full((2, 2), -0.003)
    after = gr.joint_margins(loop(moved(gains, step, case.cascade))).delay_margin
    assert np.log(0.02 / after) - slopes.missed[0] == pytest.approx(float((slopes.slope[0] * step).sum()), rel=0.05)
    assert case.breaks(gains) == ""  # which is not to be seen without all margins
