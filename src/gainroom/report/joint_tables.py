"""The tables of a joint's page, and its inputs as text."""

import math

from ..analysis.margins import Margins
from ..studies.joint import JointStudy
from ..system.requirements import to_db
from ..system.system import System
from .bode import Case
from .columns import compared_rows, yes
from .joint_text import rise_text, uncertainty_cost_text
from .number_format import digits, frequency, own_gains, plane_names, quantity
from .page import Html, facts, table
from .page_parts import filters

MARKS = {"yes": "met", "no": "unmet", "unstable": "unmet", "not certified": "unmet"}


def margin_table(study: JointStudy) -> Html:
    """The margins of the file's gains beside the recommended ones and the 10 Hz rule's."""
    names, found, gains = ["this file"], [study.margins], [_own_gains(study)]
    recommended = study.recommended
    if recommended is not None:
        shown = [("recommended", recommended.nominal)]
        if study.system.uncertainty.names:
            shown = [("recommended (worst case)", recommended.worst), ("recommended (nominal)", recommended.nominal)]
        for name, margins in shown:
            names.append(name)
            found.append(margins)
            gains.append((recommended.kp, recommended.kd))
    names.append("10 Hz rule" if study.system.control.controller.kind == "PD" else "10 Hz rule (plain PD)")
    found.append(study.rule.margins)
    gains.append((study.rule.kp, study.rule.kd))
    kp_name, kd_name = plane_names(study.system.control.controller)
    rows = [
        (f"{kp_name} [N·m/rad]", *(digits(kp) for kp, _ in gains)),
        (f"{kd_name} [N·m·s/rad]", *(digits(kd) for _, kd in gains)),
        ("stable", *("yes" if one.stable else "unstable" for one in found)),
        *compared_rows(found),
    ]
    caption = (
        "The 10 Hz rule is kp = J ω², kd = 2 ζ J ω with ω = 2π·10 rad/s, ζ = 2 and J the motor inertia. "
        "Margins of an unstable loop are meaningless."
    )
    if recommended is not None and study.system.uncertainty.names:
        caption += " Worst case: the least of each margin over the cases examined, which may differ from margin to margin."
    return table(["", *names], rows, caption, MARKS, sorts=False)


def uncertainty_table(study: JointStudy) -> Html:
    """Recommended gains with what is known, with each uncertain quantity known exactly, and with all of them."""
    found, recommended, nothing = study.uncertainty_cost, study.recommended, (math.nan, math.nan)
    assert found is not None
    kp_name, kd_name = plane_names(found.exact.controller)
    gains = nothing if recommended is None else (recommended.kp, recommended.kd)
    rows = [("as uncertain as it is", *gains, "", "" if recommended is None else yes(recommended.proved))]
    rows += [(f"{one.name.replace('_', ' ')} known exactly", one.kp, one.kd, rise_text(study, one), yes(one.proved)) for one in found.known]
    rows.append(("everything known exactly", found.exact.kp, found.exact.kd, "", yes(found.exact.proved)))
    shown = [(name, digits(kp), digits(kd), rise, proved) for name, kp, kd, rise, proved in rows]
    return table(
        ("Recommended gains", f"{kp_name} [N·m/rad]", f"{kd_name} [N·m·s/rad]", f"change of {kp_name}", "proved"),
        shown,
        uncertainty_cost_text(study, ranked=True),
        sorts=False,
    )


def _own_gains(study: JointStudy) -> tuple[float, float]:
    if study.max_kd is None:
        return math.nan, math.nan
    kp, kd = study.system.control.controller.plane_gains()
    return float(kp), float(kd)


def crossing_table(found: Margins) -> Html:
    """Every crossing of the file's loop, by frequency."""
    rows = [
        (c.omega, ("phase", digits(c.omega), digits(c.omega / (2 * math.pi)), digits(to_db(c.gain), "dB"), "–", "–"))
        for c in found.phase_crossings
    ]
    for c in found.gain_crossings:
        cells = (
            digits(c.omega),
            digits(c.omega / (2 * math.pi)),
            "–",
            digits(math.degrees(c.phase_margin), "°"),
            digits(1e3 * c.delay_margin, "ms"),
        )
        rows.append((c.omega, ("gain", *cells)))
    headers = ["crossing", "ω [rad/s]", "f [Hz]", "gain to −1", "phase to −1", "extra delay to −1"]
    caption = "Phase crossings: L is real and negative. Gain crossings: |L| = 1. The last columns: the change that moves L to −1 there."
    return table(headers, [row for _, row in sorted(rows)], caption)


def case_table(shown: list[Case]) -> Html:
    """The four cases of the Bode picture in numbers."""
    rows = [
        (
            case.name,
            digits(to_db(case.margins.gain_margin), "dB") if case.margins.stable else "unstable",
            frequency(case.margins.phase_crossover),
            digits(math.degrees(case.margins.phase_margin), "°"),
            digits(1e3 * case.margins.delay_margin, "ms"),
        )
        for case in shown
    ]
    return table(["case", "gain margin", "vibration at", "phase margin", "delay margin"], rows, "", MARKS)


def inputs(study: JointStudy) -> Html:
    """The joint, the drive, the controller and what is required, as used on the page."""
    system = study.system
    joint, drive = system.source, system.drives[0]
    pairs = [
        ("motor inertia, joint side", digits(joint.motor_inertia, "kg·m²")),
        ("link inertia", digits(joint.link_inertia, "kg·m²")),
        ("gearbox stiffness", "rigid" if math.isinf(joint.stiffness) else digits(joint.stiffness, "N·m/rad")),
        ("gearbox damping", digits(joint.damping, "N·m·s/rad")),
        ("viscous friction, motor and link", f"{digits(joint.motor_viscous)} and {digits(joint.link_viscous, 'N·m·s/rad')}"),
        (
            "anti-resonance, resonance",
            f"{frequency(joint.antiresonance)}, {frequency(joint.resonance)}" if math.isfinite(joint.stiffness) else "none",
        ),
        (
            "current loop",
            "ideal" if drive.is_ideal else f"bandwidth ω_c {digits(drive.bandwidth, 'rad/s')}, ζ {digits(drive.damping_ratio)}",
        ),
        ("delay, target to demand torque", _delay(system)),
        ("controller", _controller(system)),
        ("encoder", f"{system.control.feedback} side of the gearbox"),
        ("time", _time(system)),
        ("required", str(system.requirements)),
        ("uncertainty", _uncertainty(system)),
    ]
    return facts(pairs)


def _delay(system: System) -> str:
    text = digits(1e3 * system.delay, "ms")
    return text if system.control.sample_time is None else f"{text} = {digits(system.delay / system.control.sample_time)} ticks"


def _controller(system: System) -> str:
    controller = system.control.controller
    gains = ", ".join(f"{name} {digits(value, unit)}" for name, value, unit in own_gains(controller))
    return f"{type(controller).__name__}: {gains}; {filters(controller)}"


def _time(system: System) -> str:
    sample_time = system.control.sample_time
    if sample_time is None:
        return "continuous: no sampling, no hold, the velocity is known exactly; the delay is exact"
    return (
        f"sampled at {digits(1 / sample_time, 'Hz')}: torque held between ticks, velocity by difference, plant and delay discretised "
        "exactly; responses at the sample instants"
    )


def _uncertainty(system: System) -> str:
    text = ", ".join(quantity(name, *getattr(system.uncertainty, name)) for name in system.uncertainty.names)
    return text or "none given: every value is taken as exact"
