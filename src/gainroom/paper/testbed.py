"""Sec. IV-B: the limit of the one-joint testbed, in the paper's continuous model and as its 2 kHz hardware runs it."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache

from scipy.optimize import root_scalar

from ..analysis.gain_region import PDRegion, pd_region
from ..analysis.margin_record import PhaseCrossing
from ..analysis.margins import margins
from ..analysis.stability import is_stable
from ..system.controller import PD
from ..system.loop import build_loop
from ..system.margin_units import to_db
from .joints import CROSSOVER, LARGEST_KV, SAMPLE_TIME, STABLE_KV, TESTBED, TESTBED_DRIVE, TESTBED_KP, VIBRATING_KV
from .picture import Curve, Mark, Panel, Picture
from .row import Row, compare, same, within
from .virtual_testbed import BUS_DELAY

PRINTED_MARGIN = 76.8e-3  # [dB]
GRID_LIMITS = {4.0: 86.25, 5.0: 65.25}  # ticks: first unstable Kv on a grid of 0.25, computed elsewhere before
TICKS = BUS_DELAY / SAMPLE_TIME
DELAY_TEXT = f"{1e3 * TESTBED_DRIVE.delay:.4g} ms"


def rows() -> Iterator[Row]:
    """Rows of the continuous, then of the sampled model."""
    yield from _continuous_rows()
    yield from _sampled_rows()


def pictures() -> Iterator[Picture]:
    """Stability boundaries: the continuous model, and 4, 4.35 and 5 ticks at 2 kHz."""
    models = {f"2 kHz, {ticks:.3g} ticks": _region(ticks) for ticks in (TICKS, 4.0, 5.0)} | {f"continuous, {DELAY_TEXT}": _region()}
    low, high = _explaining_ticks()
    caption = (
        f"Inside its line each model is stable, outside the joint vibrates. With {TICKS:.3g} ticks in the drive the sampled limit "
        f"lies where the continuous model with {DELAY_TEXT} has it; 4 ticks would make kd 80 stable, 5 would make 70 unstable. "
        f"Only {low:.2f} to {high:.2f} ticks explain what the paper saw."
    )
    curves = tuple(Curve(name, *region.boundary[0].T, filled=place == 0) for place, (name, region) in enumerate(models.items()))
    marks = (Mark(TESTBED_KP, STABLE_KV, f"{STABLE_KV:g}: stable", 0), Mark(TESTBED_KP, VIBRATING_KV, f"{VIBRATING_KV:g}: vibrates", 4))
    title = "Testbed. How large kp and kd can be: the paper's two trials straddle the limit"
    yield Picture(title, caption, "kp [N·m/rad]", (0.0, 9500.0), (Panel("kd [N·m·s/rad]", (0.0, 100.0), curves, marks),))


def _continuous_rows() -> Iterator[Row]:
    inferred = f"T = {DELAY_TEXT}, current loop and B inferred."
    note = "Inferred: the delay that puts the crossover at the printed 494 rad/s. The paper: 4 to 6 ticks, about 2 to 3 ms."
    yield within("testbed.delay_ms", 2.0, 3.0, 1e3 * TESTBED_DRIVE.delay, "ms", note)
    at_77 = _crossing()
    note = f"Kp 1600, Kv 77. {inferred}"
    yield compare("testbed.phase_crossover_rad_s", CROSSOVER, at_77.omega, "rad/s", 0.5, note, "494")
    rounding = to_db((LARGEST_KV + 0.5) / LARGEST_KV)
    with_spare = LARGEST_KV * 10 ** (PRINTED_MARGIN / 20)
    matching = LARGEST_KV * at_77.gain / 10 ** (PRINTED_MARGIN / 20)
    note = f"Kp 1600, Kv 77. Tolerance: that Kv is rounded, worth {rounding:.3f} dB; Kv {matching:.2f} has the printed margin. {inferred}"
    yield compare("testbed.gain_margin_db", PRINTED_MARGIN, to_db(at_77.gain), "dB", rounding, note, "76.8e-3")
    note = "Largest Kv at Kp 1600. The paper: Kv 77 with its 0.0768 dB to spare. Tolerance: 0.5 for that Kv, 0.2 for the inferred T."
    yield compare("testbed.kv_limit", with_spare, _region().max_kd(TESTBED_KP), "N·m·s/rad", 0.5 + 0.2, note)
    for kv, stable in ((STABLE_KV, True), (VIBRATING_KV, False)):
        loop = build_loop(TESTBED, TESTBED_DRIVE, PD(TESTBED_KP, kv))
        note = f"Fig. 11: Kp:Kv 1600:{kv:g} {'was stable' if stable else 'vibrated'}. {inferred}"
        yield same(f"testbed.kv_{kv:g}.stable", stable, is_stable(loop), note)


def _sampled_rows() -> Iterator[Row]:
    limit = _region(TICKS).max_kd(TESTBED_KP)
    note = (
        f"2 kHz, hold, backward difference, {TICKS:.3f} ticks in the drive (inferred: T less one tick). The paper: above {STABLE_KV:g}, "
        f"below {VIBRATING_KV:g}."
    )
    yield within("testbed.sampled.kv_limit", STABLE_KV, VIBRATING_KV, limit, "N·m·s/rad", note)
    low, high = _explaining_ticks()
    for name, ticks, end in (
        ("least", low, f"any less and Kv {VIBRATING_KV:g} is stable"),
        ("most", high, f"any more and Kv {STABLE_KV:g} is not"),
    ):
        note = f"2 kHz: {end}. Between the two both trials come out as Fig. 11 has them. The paper: 4 to 6 ticks."
        yield within(f"testbed.sampled.{name}_delay_ticks", 4.0, 6.0, ticks, "ticks", note)
    for ticks, grid_value in GRID_LIMITS.items():
        limit = _region(ticks).max_kd(TESTBED_KP)
        verdicts = ", ".join(f"{kv:g} would {'be stable' if limit > kv else 'vibrate'}" for kv in (VIBRATING_KV, STABLE_KV))
        note = f"Not in the paper: {grid_value:g} was the first unstable value on a grid of 0.25. With {ticks:g} whole ticks Kv {verdicts}."
        yield compare(f"testbed.sampled_{ticks:g}_ticks.kv_limit", grid_value, limit, "N·m·s/rad", 0.25, note)


def _crossing() -> PhaseCrossing:
    """The lowest phase crossing at Kp 1600, Kv 77."""
    return margins(build_loop(TESTBED, TESTBED_DRIVE, PD(TESTBED_KP, LARGEST_KV))).phase_crossings[0]


def _region(ticks: float | None = None) -> PDRegion:
    """Stable gains: in continuous time, or sampled with `ticks` of delay in the drive."""
    if ticks is None:
        return pd_region(TESTBED, TESTBED_DRIVE)
    return pd_region(TESTBED, replace(TESTBED_DRIVE, delay=ticks * SAMPLE_TIME), sample_time=SAMPLE_TIME)


@cache
def _explaining_ticks() -> tuple[float, float]:
    """The delays in ticks at which the sampled limit on Kv equals 80 and 70: between them both trials come out as seen."""
    low, high = (_zero(lambda ticks, kv=kv: _region(ticks).max_kd(TESTBED_KP) - kv, 4.0, 5.0) for kv in (VIBRATING_KV, STABLE_KV))
    return low, high


def _zero(function: Callable[[float], float], low: float, high: float) -> float:
    return float(root_scalar(function, bracket=(low, high), xtol=1e-9 * high).root)
