"""The limit that is proved without loci: its parts against dense samples, its answers against the independent roots of the machines."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy import signal
from scipy.optimize import brentq

import gainroom as gr
from gainroom.analysis.margin_record import NUDGE
from gainroom.analysis.modal_loop import ModalLoop
from gainroom.analysis.proved_limit import _leads_from, proved_limit
from gainroom.system.plant import Plant
from independent.loci.limit import coupled_limit
from independent.loci.loci import Sweep
from independent.machine import unstable
from machines import limbs

POPULATION, SHARE = 2000, 8
STEP = 5e-4
DRIVE = gr.Drive(4000.0, 0.9, 2e-3)


def chain(rng: np.random.Generator, size: int = 4, **others) -> Plant:
    """Joints with different gearboxes, so that dampers couple the modes."""
    mixing = rng.normal(size=(size, size))
    return Plant(
        mixing @ mixing.T + 0.1 * np.eye(size), rng.uniform(0.2, 2, size), rng.uniform(3e3, 3e4, size), rng.uniform(1, 20, size), **others
    )


PLANTS = {
    "dampers couple": lambda rng: chain(rng),
    "dampers that let nothing swing": lambda rng: replace(chain(rng), damping=rng.uniform(500, 2000, 4)),
    "dampers in proportion": lambda rng: replace(chain(rng), stiffness=1e4, damping=2.0),
    "gravity": lambda rng: chain(rng, gravity_stiffness=np.diag(rng.uniform(-80, 80, 4))),
    "held by contacts": lambda rng: replace(chain(rng), link_inverse_inertia=np.outer(v := rng.normal(size=4), v)),
    "one rigid joint": lambda rng: replace(chain(rng), stiffness=np.array([1e4, math.inf, 2e4, 5e3])),
    "equal limbs": lambda rng: replace(chain(rng), **EQUAL),
}
EQUAL = {
    "link_inverse_inertia": np.kron(np.eye(2), [[2.0, 0.3], [0.3, 1.0]]),
    "motor_inertia": np.array([0.5, 0.7, 0.5, 0.7]),
    "stiffness": np.array([1e4, 2e4, 1e4, 2e4]),
    "damping": np.array([1.0, 4.0, 1.0, 4.0]),
}


@pytest.mark.parametrize("kind", PLANTS)
def test_the_sum_over_modes_is_the_response(kind):
    """Within 1e-8 of its largest entry: ten times what no sum is given beyond (system/plant.py), for ω beside a pole without damping."""
    for seed in range(5):
        plant = PLANTS[kind](np.random.default_rng(seed))
        assert plant.modes is not None
        s = np.concatenate([1j * np.geomspace(0.3, 3e4, 60), 20 + 1j * np.geomspace(1, 1e3, 20)])
        right = plant.response(s, "motor")
        off = np.abs(plant.modes.response(s) - right).max(axis=(1, 2)) / np.abs(right).max(axis=(1, 2))
        assert off.max() < 1e-8


def test_what_no_sum_is_known_for_has_none():
    plant = chain(np.random.default_rng(1))
    assert replace(plant, motor_viscous=0.1).modes is None
    assert replace(plant, link_viscous=0.1).modes is None


SETUPS = {
    "continuous": {},
    "ideal current loop": {"drive": gr.Drive(delay=2e-3)},
    "sampled": {"sample_time": STEP},
    "sampled, part of a tick": {"sample_time": STEP, "drive": gr.Drive(3000.0, 0.7, 2.3 * STEP)},
    "sampled, ideal current loop": {"sample_time": STEP, "drive": gr.Drive(delay=1.4 * STEP)},
}


def modal(setup: str, seed: int) -> tuple[gr.Loop, ModalLoop]:
    rng = np.random.default_rng(seed)
    controller = gr.PD(rng.uniform(500, 3000, 4), rng.uniform(20, 80, 4), velocity_filter=gr.LowPass(1500.0) if seed % 2 else None)
    loop = gr.build_loop(**{"joint": chain(rng), "drive": DRIVE, "controller": controller} | SETUPS[setup])
    found = ModalLoop.of(loop)
    assert found is not None
    return loop, found


@pytest.mark.parametrize("setup", SETUPS)
def test_the_core_s_loop_is_the_loop(setup):
    """L = P diag(c) from x P and d = x/c, to nine digits: sampled ones come from a matrix exponential there."""
    for seed in range(4):
        loop, found = modal(setup, seed)
        omega = np.geomspace(1.0, 3e4 if loop.sample_time is None else math.pi / STEP, 80)
        mobility, laws = found.response(omega)
        right = loop.response(omega)
        off = np.abs(mobility / laws[:, None, :] - right).max(axis=(1, 2)) / np.abs(right).max(axis=(1, 2))
        assert off.max() < 1e-8


@pytest.mark.parametrize("setup", SETUPS)
def test_interpolation_misses_no_more_than_its_bound(setup):
    """Cells of all widths: at 30 points in each, f₀, every f_k and d_i deviate from a straight line in x (or in ω) by no more."""
    seen = []
    for seed in range(6):
        loop, found = modal(setup, seed)
        rng = np.random.default_rng([3, seed])
        top = 2e4 if loop.sample_time is None else math.pi / STEP
        for _ in range(40):
            low = top * math.exp(-rng.uniform(0.0, 7.0))
            ends = np.array([low, min(low * (1 + math.exp(-rng.uniform(0.3, 8.0))), top)])
            if ends[1] <= ends[0]:
                continue
            omega = np.linspace(*ends, 32)
            functions, laws = found.core.responses(omega)
            x = omega**2 if loop.sample_time is None else (2 * np.sin(omega * STEP / 2) / STEP) ** 2
            by = x if loop.sample_time is None or ends[1] * STEP <= math.pi / 2 else omega
            share = ((by - by[0]) / (by[-1] - by[0]))[:, None]
            for values, bound in zip((functions, laws), found.core.bends(ends), strict=True):
                missed = np.abs(values - values[0] - share * (values[-1] - values[0])).max(axis=0)
                assert np.all(missed <= bound[0] + 1e-12 * np.abs(values).max(axis=0))  # round-off of values and of their differences
                seen.extend((missed / np.maximum(bound[0], 1e-300))[np.abs(values).max(axis=0) * 1e-9 < missed].tolist())
    assert max(seen) > 0.1  # a bound far above everything would prove nothing


@pytest.mark.parametrize("setup", SETUPS)
def test_only_joints_that_lead_and_small_loops_are_not_searched(setup):
    """Dense samples where nothing is searched: every law leads (arg in (0°, 180°)) and the motors take no power, or ρ(g L) < 1."""
    left_out = 0
    for seed in range(4):
        loop, found = modal(setup, seed)
        span = 1.0, 3e4 if loop.sample_time is None else math.pi / STEP
        for gain in (0.1, 1.0, 10.0):
            searched = found.core.searched(*span, gain, found.passive)
            assert np.all(np.diff(searched.ravel()) >= 0)
            omega = np.geomspace(*span, 2000)
            omega = omega[~np.any((omega[:, None] >= searched[:, 0]) & (omega[:, None] <= searched[:, 1]), axis=1)]
            leads = np.all(np.angle(1 / found.response(omega)[1]) > 0, axis=1) & found.passive
            left_out += leads.any() + (~leads).any()
            power = (1j * omega[:, None, None] * loop.parts.plant.response(1j * omega, "motor")).real
            assert np.linalg.eigvalsh(power).min(initial=0.0) > -1e-12 * np.abs(power).max(initial=1.0)
            small = np.abs(np.linalg.eigvals(gain * loop.response(omega))).max(axis=1) < 1
            assert np.all(leads | small)
    assert left_out > 2


def lowest_of_all(loop: gr.Loop) -> float:
    """From the loci."""
    return coupled_limit(Sweep(loop, 1e3, for_limit=True)).gain


@pytest.mark.parametrize("number", range(SHARE))
def test_limits_of_near_equal_limbs(number):
    assert_limit(number)


@pytest.mark.population
def test_limits_of_the_population():
    """9 of 10 stable loops are proved, at least; the rest is left to the loci. None is wrong."""
    known = [assert_limit(number) for number in range(POPULATION)]
    assert np.mean([one for one in known if one is not None]) > 0.9


def assert_limit(number: int) -> bool | None:
    """Against an independent count of roots on both sides; whether a limit was proved, None where it need not be, of unstable loops."""
    pair = limbs(4242, number)
    found = proved_limit(pair.loop)
    inside, outside = 1 - NUDGE, 1 + NUDGE
    if found is None:
        return None if unstable(pair.machine) else False
    assert found.stable is (unstable(pair.machine) == 0)
    assert found.lower_gain == 0
    if math.isinf(found.gain):
        assert unstable(pair.scaled(1e3).machine) == 0
        return True
    for share in (1e-3, 0.1, 0.5, 0.9, inside):
        assert unstable(pair.scaled(share * found.gain).machine) == 0
    assert unstable(pair.scaled(outside * found.gain).machine) > 0
    response = pair.loop.scaled(found.gain).response(np.array([found.frequency]))[0]
    assert np.linalg.norm(response @ found.mode + found.mode) < 1e-8 * np.linalg.norm(found.mode)
    return True


def test_it_is_the_limit_from_loci():
    """To 1e-7: where a lightly damped resonance meets the axis at an angle of 1e-5, round-off of 1e-14 moves its gain by 1e-8."""
    for number in range(12):
        loop = limbs(4243, number).loop
        found = proved_limit(loop)
        if found is not None:
            assert found.gain == pytest.approx(lowest_of_all(loop), rel=1e-7)


SKEW = np.diag([10.0, -20.0, 5.0, 1.0]) + np.eye(4, k=1)
CHANGES = {
    "link encoders": {"feedback": "link"},
    "unstable, lag": {"controller": gr.PD(2000.0, 1.0)},
    "two integrators": {"controller": gr.Compensator(signal.TransferFunction([20.0, 500.0, 100.0], [1.0, 0.0, 0.0]))},
    "different drives, sampled": {"drive": [DRIVE, DRIVE, DRIVE, gr.Drive(3000.0, 0.9, 2e-3)], "sample_time": STEP},
    "different drives, coupled gains": {
        "drive": [DRIVE, DRIVE, DRIVE, gr.Drive(3000.0, 0.9, 2e-3)],
        "controller": gr.PD(500.0 * np.eye(4) + 10.0, 20.0 * np.eye(4)),
    },
    "gravity that does work": {"joint": chain(np.random.default_rng(0), gravity_stiffness=SKEW)},
    "friction": {"joint": chain(np.random.default_rng(0), motor_viscous=0.1)},
}


@pytest.mark.parametrize(
    ("zeros", "poles"), [([1.0, -50.0], [1.0, -51.0]), ([1.0, 0.0, 900.0], [1.0, 0.0, 901.0])], ids=["unstable", "on the boundary"]
)
def test_controllers_that_are_not_stable_prove_nothing(zeros, poles):
    """A pole beside a zero, which no gain moves far: nearly the same response along the boundary, and an unstable loop."""
    lead = [20.0, 300.0], [1 / 2000.0, 1.0]
    law = gr.Compensator(signal.TransferFunction(*(np.polymul(part, more) for part, more in zip(lead, (zeros, poles), strict=True))))
    loop = gr.build_loop(chain(np.random.default_rng(0)), DRIVE, law)
    assert proved_limit(loop) is None
    assert proved_limit(gr.build_loop(chain(np.random.default_rng(0)), DRIVE, gr.Compensator(signal.TransferFunction(*lead)))) is not None


@pytest.mark.parametrize(("less", "factor"), [(1e-5, 4e-6), (1e-5, 1e-2), (1e-5, 1.0), (1e-3, 0.1), (1e-2, 0.1), (1e-2, 1.0)])
def test_lead_that_lag_nearly_cancels_proves_nothing_from_rest(less: float, factor: float):
    """Less lead than lag as ω → 0, by `less` of 2 s, and more further up: low gains are unstable, up to where both are equal at a crossing.

    There P is M₀/ω² up to what springs give, (ω/ω₁)² < 1e-5 of it: γ = ω²/(μ |c|), μ its lowest eigenvalue.
    """
    pole = 1 / (2 - 2e-3 - 1.8 / 4000 - 5e-4 + less)
    law = gr.Compensator(signal.ZerosPolesGain([-1, -1], [-pole, -2000], factor * pole * 2000))
    plant = chain(np.random.default_rng(0))
    loop = gr.build_loop(plant, DRIVE, law)
    assert _leads_from(ModalLoop.of(loop)) is None

    def law_at(omega: float) -> complex:
        s = 1j * omega
        return factor * (s + 1) ** 2 / (s / pole + 1) / (s / 2000 + 1) / (1 + 1.8 * s / 4000 + (s / 4000) ** 2) * np.exp(-s * 2e-3)

    omega = brentq(lambda omega: np.angle(law_at(omega)), 1e-4, 1.0)
    lowest = omega**2 / (np.linalg.eigvalsh(plant.modes.rigid)[0] * abs(law_at(omega)))
    found = proved_limit(loop)
    if lowest > 1:
        assert found is None
    elif lowest < 1e-4:  # no factor is searched that low, as GainLimit says
        assert found is None or found.lower_gain == 0
    elif found is None:
        assert less < 1e-3  # all but marginal for decades of ω
    else:
        assert found.lower_gain == pytest.approx(lowest, rel=1e-5)
        assert found.lower_frequency == pytest.approx(omega, rel=1e-5)


def test_a_loop_that_does_not_fall_ends_without_proof():
    law = gr.Compensator(signal.ZerosPolesGain([-10, -100.0], [], 0.1))
    assert proved_limit(gr.build_loop(chain(np.random.default_rng(0)), gr.Drive(delay=1e-3), law)) is None


def test_a_current_loop_with_a_pole_of_the_plant_proves_nothing():
    plant = replace(chain(np.random.default_rng(0)), stiffness=1e4, damping=100.0)
    pole = max(plant.modes.poles, key=abs)
    drive = gr.Drive(abs(pole), -pole.real / abs(pole), 2e-3)
    assert proved_limit(gr.build_loop(plant, drive, gr.PD(20.0, 5.0), sample_time=STEP)) is None


def test_what_no_proof_is_known_for_is_left_to_the_loci():
    setup = {"joint": chain(np.random.default_rng(0)), "drive": DRIVE, "controller": gr.PD(500.0, 20.0)}
    assert proved_limit(gr.build_loop(**setup)) is not None
    for change in CHANGES.values():
        assert proved_limit(gr.build_loop(**(setup | change))) is None


def test_units_do_not_matter():
    """Torques, and with them inertias, stiffness and gains, in millionths and in millions."""
    rng = np.random.default_rng(5)
    plant, kp, kd = chain(rng), rng.uniform(500, 3000, 4), rng.uniform(20, 80, 4)
    found = []
    for unit in (1e-6, 1.0, 1e6):
        scaled = Plant(plant.link_inverse_inertia / unit, unit * plant.motor_inertia, unit * plant.stiffness, unit * plant.damping)
        found.append(proved_limit(gr.build_loop(scaled, DRIVE, gr.PD(unit * kp, unit * kd))))
    assert all(one is not None for one in found)
    assert [one.gain for one in found] == pytest.approx([found[1].gain] * 3, rel=1e-9)


@pytest.mark.slow
def test_random_plants():
    """Chains of all sizes, some joints rigid, some held by contacts: what is proved is what loci show."""
    proved = 0
    for seed in range(30):
        rng = np.random.default_rng([9, seed])
        plant = chain(rng, int(rng.integers(2, 9)))
        size, root = plant.size, rng.normal(size=(plant.size, int(rng.integers(1, plant.size + 1))))
        stiffness = np.where(rng.random(size) < 0.2, math.inf, plant.stiffness)
        plant = replace(plant, stiffness=stiffness, link_inverse_inertia=root @ root.T)
        loop = gr.build_loop(plant, DRIVE, gr.PD(20.0, rng.uniform(0.5, 5.0, size)), sample_time=STEP if seed % 3 == 0 else None)
        found = proved_limit(loop)
        if found is not None and math.isfinite(found.gain):
            proved += 1
            assert found.gain == pytest.approx(lowest_of_all(loop), rel=1e-7)
    assert proved > 15
