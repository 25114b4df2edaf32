"""What the uncertainty costs: a joint of which more is known is never recommended less, and what is said of it holds."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import gainroom as gr
from gainroom.cli import main
from gainroom.design.joint_gains import recommend_pd
from gainroom.design.uncertainty_cost import UncertaintyCost
from gainroom.errors import digits
from gainroom.files.joint_yaml import parse_joint
from gainroom.studies.joint import JointStudy, study_joint

TESTBED = """\
joint: {rotor_inertia: 0.2e-4, gear_ratio: 100, link_inertia: 0.8, stiffness: 1.0e4, damping: 5.0}
drive: {bandwidth: 4000.0, damping_ratio: 0.9, delay_ms: 2.5}
control: {type: pd, kp: 800.0, kd: 40.0, feedback: motor, sample_rate_hz: 2000}
uncertainty: {delay_ms: [2.2, 2.8], motor_inertia: 10%}
"""
# Five quantities, of which one ranges over a factor of 40; a resonance that is hardly damped.
WIDE = """\
joint: {rotor_inertia: 0.2e-4, gear_ratio: 100, link_inertia: 0.8, stiffness: 1.0e4, damping: 1.0}
drive: {bandwidth: 4000.0, damping_ratio: 0.9, delay_ms: 2.5}
control: {type: pd, kp: 800.0, kd: 40.0, feedback: motor, sample_rate_hz: 2000}
uncertainty: {delay_ms: [2.0, 3.0], stiffness: 10%, link_inertia: [0.4, 16.0], motor_inertia: 10%, damping: 30%}
"""
ROUNDED = 1.01  # three digits, and the reserve of a search over several cases


@pytest.fixture(scope="module")
def study() -> JointStudy:
    return study_joint(parse_joint(TESTBED, "testbed"))


def cost(study: JointStudy) -> UncertaintyCost:
    assert study.uncertainty_cost is not None
    return study.uncertainty_cost


def test_less_uncertainty_has_gains_where_more_has():
    """WIDE without its stiffness' range: a search on a grid that was too coarse found none, and kp 7 with it."""
    system = parse_joint(WIDE, "wide")
    rest, tick = system.uncertainty.without("stiffness"), system.control.sample_time
    found = recommend_pd(system.source, system.drives[0], uncertainty=rest, sample_time=tick, objective="largest_kp")  # type: ignore[arg-type]
    assert found is not None
    assert found.proved
    assert found.kp >= 7.0


@pytest.mark.slow
def test_the_exact_joint_is_the_most_and_the_uncertain_one_the_least(study):
    found = cost(study)
    assert study.recommended is not None
    values = [found.exact.value * ROUNDED, *(one.value for one in found.known), study.recommended.value]
    assert values == sorted(values, reverse=True)
    assert {one.name for one in found.known} == {"delay", "motor_inertia"}
    assert found.cost == pytest.approx(1 - study.recommended.value / found.exact.value)
    assert 0 < found.cost < 1


@pytest.mark.slow
def test_half_of_the_range_that_costs_most_lies_between(study):
    """From half way to the nominal value on either side; its gains meet the requirements there, and lie between those for all and none."""
    found, system = cost(study), study.system
    half, first = found.half, found.known[0]
    assert half.name == first.name == "delay"
    assert (half.low, half.high) == pytest.approx((2.35e-3, 2.65e-3))
    assert study.recommended is not None
    assert study.recommended.value <= half.value <= ROUNDED * first.value
    low, high = system.uncertainty.motor_inertia
    for delay in (half.low, half.high):
        for inertia in (low, high):
            case = system.with_values(delay=delay, motor_inertia=float(inertia))
            assert system.requirements.met_by(gr.margins(case.loop(controller=gr.PD(half.kp, half.kd))))


@pytest.mark.slow
def test_gains_of_what_is_known_exactly_hold_there_and_hardly_more_would(study):
    """By margins at many joints of the remaining range; and of gains about them none that meet them all have a link 2 % stiffer."""
    system = study.system
    for one in cost(study).known:
        rest = system.uncertainty.without(one.name)
        (name,) = rest.names
        low, high = getattr(rest, name)
        cases = [system.with_values(**{name: float(value)}) for value in np.linspace(low, high, 5)]

        def met(kp: float, kd: float, cases=cases) -> bool:
            found = [gr.margins(case.loop(controller=gr.PD(kp, kd))) for case in cases]
            return all(each.stable and system.requirements.met_by(each) for each in found)

        assert one.proved
        assert met(one.kp, one.kd)

        def least(kp: float, kd: float, cases=cases) -> float:
            return min(gr.dynamic_stiffness(case.loop(controller=gr.PD(kp, kd))).least for case in cases)

        assert least(one.kp, one.kd) == pytest.approx(one.value, rel=5e-3)  # to which peaks between samples are known
        around = [(kp, kd) for kp in np.linspace(0.8, 1.3, 6) * one.kp for kd in np.linspace(0.8, 1.3, 6) * one.kd]
        assert not any(met(*gains) and least(*gains) > ROUNDED**2 * one.value for gains in around)


@pytest.mark.slow
def test_one_quantity_that_is_known_is_all(study):
    single = replace(study.system, uncertainty=study.system.uncertainty.without("motor_inertia"))
    found = cost(study_joint(single))
    assert [(one.name, one.value) for one in found.known] == [("delay", found.exact.value)]


def test_without_uncertainty_nothing_is_said(study):
    exact = study_joint(replace(study.system, uncertainty=type(study.system.uncertainty)()))
    assert exact.cost is None
    assert exact.uncertainty_cost is None


@pytest.mark.slow
def test_json_terminal_and_page_agree(tmp_path: Path, capsys: pytest.CaptureFixture[str], study):
    file, page = tmp_path / "joint.yaml", tmp_path / "joint.html"
    file.write_text(TESTBED, "utf-8")
    main(["joint", str(file), "--json"])
    facts = json.loads(capsys.readouterr().out)
    told, found = facts["uncertainty_cost"], cost(study)
    assert told["exact"] == {"kp": found.exact.kp, "kd": found.exact.kd, "value": found.exact.value}
    assert facts["recommended"]["costs"]["uncertainty"] == found.exact.value
    assert [one["name"] for one in told["known_exactly"]] == [one.name for one in found.known]
    main(["joint", str(file), "--verbose", "--report", str(page)])
    shown = " ".join(capsys.readouterr().out.split())
    first = found.known[0].name.replace("_", " ")
    assert told["half_range"] == {key: getattr(found.half, key) for key in ("name", "low", "high", "kp", "kd", "value", "proved")}
    for words in (
        f"The uncertainty costs {100 * found.cost:.0f} % of the dynamic stiffness of the link",
        f"Measure the {first} (2.2 to 2.8 ms) better first: the dynamic stiffness of the link would be "
        f"{digits(found.half.value, 'N·m/rad')} (",
        ") if it were surely 2.35 to 2.65 ms, half of that range, and ",
        "with the motor inertia (0.18 to 0.22 kg·m²) known exactly: ",
    ):
        assert words in shown
        assert words in page.read_text("utf-8")
    main(["joint", str(file)])
    assert "The uncertainty costs" not in capsys.readouterr().out
