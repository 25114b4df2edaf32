"""Recommended gains of a joint: no gains that meet the requirements have a dynamically stiffer link, on grids worked out here.

A third of the joints is plain, a third has to keep the noise of its torque down, and a third has delays that vary. Over ranges, corners
and points inside keep what is asked for.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
import pytest

import gainroom as gr

BANDWIDTH, CURRENT_DAMPING = 4000.0, 0.9
GM, PM, MS = 2.0, math.pi / 6, 2.0  # 6 dB, 30°, 2
ALIASES = np.arange(-8, 9)  # the torque's path falls with the fifth power of the frequency: those left out are below 1e-5
ROUND_OFF = 1e-6  # relative: of margins in dB and degrees
SOFTER = 1e-2  # share of the stiffness told that a joint within ranges may lack: a softer case joins the search from 3e-3 on
SUMMED = 2e-3  # relative: of an integral over these frequencies, and of a peak between two of them


@dataclass(frozen=True)
class Asked:
    """What gains keep in addition to the usual margins; the defaults ask for nothing.

    resolution   of the encoder [rad]
    noise        largest rms torque command that the encoder's steps make [N m]
    jitter       width of the range in which delays vary [s]
    """

    resolution: float = 0.0
    noise: float = math.inf
    jitter: float = 0.0

    @property
    def requirements(self):
        noise = None if math.isinf(self.noise) else self.noise
        return gr.Requirements(GM, PM, MS, torque_noise=noise, jitter_margin=self.jitter or None)

    def drive(self, delay):
        return gr.Drive(BANDWIDTH, CURRENT_DAMPING, delay, self.resolution)

    def met(self, joint, delay, step, kp, kd, share=1.0):
        """True (g,) where gains keep `share` of noise and jitter by the formulas here."""
        found = np.ones(len(kp), dtype=bool)
        if self.noise < math.inf:
            found &= noise(joint, delay, step, kp, kd, self.resolution) <= share * self.noise
        if self.jitter:
            found &= share * jitter(joint, delay, step, kp, kd) >= self.jitter
        return found


def frequencies(joint, delay, step):
    """Up to half the sample rate, or far above the current loop; close together about the resonances of held and free motor."""
    k = joint["stiffness"]
    modes = [math.sqrt(k / joint["link_inertia"]), math.sqrt(k * (1 / joint["link_inertia"] + 1 / joint["motor_inertia"]))]
    last = 10 * BANDWIDTH if step is None else math.pi / step
    fine = np.concatenate([np.linspace(-0.08, 0.08, 80), -np.geomspace(1e-7, 0.01, 40), np.geomspace(1e-7, 0.01, 40)])
    omega = np.concatenate(
        [np.geomspace(1e-3 * modes[0], last, 700), np.linspace(0, last, 800)[1:], *(mode * (1 + fine) for mode in modes)]
    )
    return np.unique(omega[omega <= last])


def torque_to_motor(joint, s):
    """Motor position per torque command, without delay and hold."""
    spring = joint["stiffness"] + s * joint["damping"]
    motor, link = joint["motor_inertia"] * s * s + spring, joint["link_inertia"] * s * s + spring
    return link / (motor * link - spring**2) * BANDWIDTH**2 / (s * s + 2 * CURRENT_DAMPING * BANDWIDTH * s + BANDWIDTH**2)


def sampled_path(joint, delay, step, omega):
    """Sampled motor position per held torque command (k,), all aliases together; each without delay and hold; their s."""
    s = 1j * (omega[:, None] + 2 * math.pi / step * ALIASES)
    alone = torque_to_motor(joint, s)
    return (alone * np.exp(-s * delay) * -np.expm1(-s * step) / (s * step)).sum(axis=1), alone, s


def in_parts(of_gains, kp, kd):
    """`of_gains` (kp (m, 1), kd (m, 1)) → (m,), for few gains at a time: a row of frequencies each."""
    return np.concatenate([np.zeros(0), *(of_gains(kp[k : k + 200, None], kd[k : k + 200, None]) for k in range(0, len(kp), 200))])


def noise(joint, delay, step, kp, kd, resolution):
    """The rms torque command (g,) of white noise of resolution²/12 per sample: power of D/(1 + P D), summed over frequencies."""
    omega = frequencies(joint, delay, step)
    path, difference = sampled_path(joint, delay, step, omega)[0], -np.expm1(-1j * omega * step) / step

    def power(kp, kd):
        control = kp + kd * difference
        return np.trapezoid(np.abs(control / (1 + path * control)) ** 2, omega * step, axis=1) / math.pi

    return resolution / math.sqrt(12) * np.sqrt(in_parts(power, kp, kd))


def jitter(joint, delay, step, kp, kd):
    """Width (g,) [s] in which delays may vary, by small gain: 1/max |ω T|, or what the sampled loop has in its place."""
    omega = frequencies(joint, delay, step)
    if step is None:
        s = 1j * omega
        path = torque_to_motor(joint, s) * np.exp(-s * delay)

        def height(kp, kd):
            value = path * (kp + kd * s)
            return (omega * np.abs(value / (1 + value))).max(axis=1)

        return 1 / in_parts(height, kp, kd)
    path, alone, s = sampled_path(joint, delay, step, omega)
    every = np.sqrt(np.abs(alone).sum(axis=1) ** 2 + step**2 / 32 * (np.abs(s * alone) ** 2).sum(axis=1))
    change = -np.expm1(-1j * omega * step)

    def steps(kp, kd):
        control = kp + kd * change / step
        return (np.abs(change * control / (1 + path * control)) * every).max(axis=1)

    ticks = 1 / in_parts(steps, kp, kd)
    whole = np.floor(ticks)
    return step * np.where(ticks < 1, ticks, whole + (ticks**2 - whole**2) / (2 * whole + 1))


def torque_per_position(s, delay, step):
    """What kp and kd of a PD put on the motor per position, each (k,)."""
    late = BANDWIDTH**2 / (s * s + 2 * CURRENT_DAMPING * BANDWIDTH * s + BANDWIDTH**2) * np.exp(-s * delay)
    if step is None:
        return late, late * s
    late = late * (1 - np.exp(-s * step)) / (s * step)
    return late, late * (1 - np.exp(-s * step)) / step


def random_joint(rng):
    """Joint with resonance 3 to 100 Hz, inertia ratio 0.1 to 30, damping 0 to 5 %, delay 0.5 to 10 ms, continuous or sampled."""
    link, ratio = 1.0, 10 ** rng.uniform(-1, math.log10(30))
    motor, mode = link / ratio, 2 * math.pi * 10 ** rng.uniform(math.log10(3), 2)
    stiffness = mode**2 / (1 / link + 1 / motor)
    damping = 2 * rng.choice([0.0, rng.uniform(0, 0.05)]) * stiffness / mode
    delay, step = 10 ** rng.uniform(math.log10(5e-4), -2), rng.choice([None, 5e-4, 1e-3, 2e-3])
    return {"motor_inertia": motor, "link_inertia": link, "stiffness": stiffness, "damping": damping}, delay, step


def on_grid(joint, delay, step, kp, kd):
    """Dynamic stiffness and least distance of L from −1 at gains (g,), from frequencies alone."""
    k, b = joint["stiffness"], joint["damping"]
    held, free = math.sqrt(k / joint["link_inertia"]), math.sqrt(k * (1 / joint["link_inertia"] + 1 / joint["motor_inertia"]))
    fine = np.concatenate([np.linspace(-0.08, 0.08, 80), -np.geomspace(1e-7, 0.01, 40), np.geomspace(1e-7, 0.01, 40)])
    omega = np.concatenate([np.geomspace(1e-3 * held, max(30 * free, 30 / delay), 700), held * (1 + fine), free * (1 + fine)])
    omega = np.sort(omega if step is None else omega[omega < math.pi / step])
    s = 1j * omega
    a, c = torque_per_position(s, delay, step)
    fed = kp[:, None] * a + kd[:, None] * c
    spring = k + s * b
    motor, link = joint["motor_inertia"] * s * s + spring, joint["link_inertia"] * s * s + spring
    held_load = 1.0 if step is None else np.abs((1 - np.exp(-s * step)) / (s * step))
    compliance = np.abs((motor + fed) / ((motor + fed) * link - spring**2)) * held_load
    distance = np.abs(1 + fed * link / (motor * link - spring**2))
    return 1 / compliance.max(axis=1), distance.min(axis=1)


def loop_of(joint, delay, step, kp, kd, asked):
    return gr.build_loop(gr.ElasticJoint(**joint), asked.drive(delay), gr.PD(kp, kd), sample_time=step)


def check(joint, delay, step, asked=Asked()):
    """Raise where gains on a grid are better than those recommended; the share by which the best of them is, and None without gains."""
    found = gr.recommend_pd(gr.ElasticJoint(**joint), asked.drive(delay), asked.requirements, sample_time=step)
    if found is None:
        nothing_meets(joint, delay, step, asked)
        return None
    assert found.certificate.startswith("exact")
    best = loop_of(joint, delay, step, found.kp, found.kd, asked)
    own = gr.dynamic_stiffness(best).least
    assert asked.requirements.met_by(gr.margins(best))
    assert asked.met(joint, delay, step, np.array([found.kp]), np.array([found.kd]), 1 + SUMMED).all()
    assert own == pytest.approx(found.stiffness, rel=5e-3)  # what the search may miss of a peak between its frequencies, 3e-3, and more
    wide = found.kp * np.geomspace(0.02, 20, 70), found.kd * np.geomspace(0.05, 8, 70)
    stiffest, kp, kd = best_on_grid(joint, delay, step, asked, *wide, 0.9 * own)
    around = [(found.kp, found.kd, 1.17), (found.kp, found.kd, 1.03)]  # a step of the grid to each side, and finer: corners are narrow
    for kp_about, kd_about, ratio in [*around, *([(kp, kd, 1.17)] if stiffest else [])]:
        near = np.geomspace(1 / ratio, ratio, 40)
        stiffest = max(stiffest, best_on_grid(joint, delay, step, asked, kp_about * near, kd_about * near, own)[0])
    assert stiffest <= 1.01 * own, (stiffest / own, joint, delay, step, asked, found.kp, found.kd, kp, kd)
    return stiffest / own - 1


def best_on_grid(joint, delay, step, asked, kps, kds, least):
    """Largest dynamic stiffness on a grid, above `least`, of gains that keep what is asked for, and the gains; 0 where none do."""
    kp, kd = (part.ravel() for part in np.meshgrid(kps, kds))
    stiffness, distance = on_grid(joint, delay, step, kp, kd)  # of a peak narrower than its frequencies too large
    near = np.flatnonzero((stiffness > least) & (distance > 0.999 / MS))
    region = gr.pd_region(gr.ElasticJoint(**joint), asked.drive(delay), GM, PM, MS, sample_time=step)
    near = near[region.contains(kp[near], kd[near])]
    near = near[asked.met(joint, delay, step, kp[near], kd[near])]
    best = 0.0, float(np.median(kps)), float(np.median(kds))
    for k in near[np.argsort(-stiffness[near])].tolist():
        if stiffness[k] <= best[0]:
            break
        one = loop_of(joint, delay, step, kp[k], kd[k], asked)
        if gr.Requirements.usual().met_by(gr.margins(one)):
            best = max(best, (gr.dynamic_stiffness(one).least, float(kp[k]), float(kd[k])))
    return best


def nothing_meets(joint, delay, step, asked, cases=()):
    """No gains down to 1e-4 of J/T² meet the requirements in all cases: an undamped gearbox that the delay turns. Less is as good as none.

    cases   joints with their delays; none: the one alone
    """
    cases, scale = cases or [(joint, delay)], joint["motor_inertia"] / delay
    kp, kd = (part.ravel() for part in np.meshgrid(scale / delay * np.geomspace(1e-4, 10, 61), scale * np.geomspace(1e-4, 10, 61)))
    for case, late in cases:
        near = on_grid(case, late, step, kp, kd)[1] > 1 / MS
        near[near] = asked.met(case, late, step, kp[near], kd[near])
        kp, kd = kp[near], kd[near]
    for one in zip(kp.tolist(), kd.tolist(), strict=True):
        found = (gr.margins(loop_of(case, late, step, *one, asked)) for case, late in cases)
        assert not all(gr.Requirements.usual().met_by(margins) for margins in found), (joint, delay, step, asked, one)


def seeds(count, quick=2):
    return pytest.mark.parametrize("seed", [*range(quick), *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(quick, count))])


@pytest.mark.slow
@seeds(300)
def test_no_gains_on_a_grid_have_a_stiffer_link(seed):
    check(*random_joint(np.random.default_rng(seed)))


def with_noise(seed):
    """A sampled joint, and a limit of 0.1 to 1.3 times the noise of what is recommended without one."""
    rng = np.random.default_rng([seed, 1])
    joint, delay, _ = random_joint(rng)
    step, share = rng.choice([5e-4, 1e-3, 2e-3]), 10 ** rng.uniform(-1, 0.1)
    asked = Asked(resolution=2 * math.pi / 2 ** rng.integers(12, 20))
    free = gr.recommend_pd(gr.ElasticJoint(**joint), asked.drive(delay), sample_time=step)
    made = math.inf if free is None else noise(joint, delay, step, np.array([free.kp]), np.array([free.kd]), asked.resolution)[0]
    return joint, delay, step, replace(asked, noise=share * made if free else asked.resolution * joint["motor_inertia"] / delay**2)


def with_jitter(seed):
    """A joint, and delays that vary by 0.8 to 5 times the jitter margin of what is recommended without."""
    rng = np.random.default_rng([seed, 2])
    joint, delay, step = random_joint(rng)
    share, free = 10 ** rng.uniform(-0.1, 0.7), gr.recommend_pd(gr.ElasticJoint(**joint), Asked().drive(delay), sample_time=step)
    width = delay if free is None else jitter(joint, delay, step, np.array([free.kp]), np.array([free.kd]))[0]
    return joint, delay, step, Asked(jitter=share * width)


@pytest.mark.slow
@seeds(100)
def test_nor_with_little_noise(seed):
    check(*with_noise(seed))


@pytest.mark.slow
@seeds(100)
def test_nor_with_delays_that_vary(seed):
    check(*with_jitter(seed))


def with_ranges(seed):
    """A joint whose stiffness, load and delay range about what is known; a third with noise, a third with jitter, by what suits it."""
    rng = np.random.default_rng([seed, 3])
    joint, delay, step, asked = [lambda seed: (*random_joint(rng), Asked()), with_noise, with_jitter][seed % 3](1000 + seed)
    less, more = rng.uniform(0.7, 1.0), rng.uniform(1.0, 1.5)
    ranges = {"stiffness": (0.8, 1.2), "link_inertia": (0.5, 1.5), "delay": (less, more)}
    known = joint | {"delay": delay}
    return joint, delay, step, asked, {name: (low * known[name], high * known[name]) for name, (low, high) in ranges.items()}, rng


def within(joint, delay, ranges, rng):
    """Joints with their delays at every corner of the ranges, and at 200 points inside."""
    shares = np.vstack([np.indices((2,) * len(ranges)).reshape(len(ranges), -1).T, rng.random((200, len(ranges)))])
    low, high = (np.array([interval[end] for interval in ranges.values()]) for end in (0, 1))
    for values in (low + shares * (high - low)).tolist():
        case = dict(zip(ranges, values, strict=True))
        yield joint | {name: case[name] for name in ("stiffness", "link_inertia")}, case["delay"]


def check_ranges(joint, delay, step, asked, ranges, rng):
    """Raise where recommended gains break a requirement within the ranges; what they have to spare at least, or None without gains."""
    parts = gr.ElasticJoint(**joint), asked.drive(delay), asked.requirements, gr.Uncertainty(**ranges)
    found, cases = gr.recommend_pd(*parts, sample_time=step), list(within(joint, delay, ranges, rng))
    if found is None:
        nothing_meets(joint, delay, step, asked, cases[:30])
        return None
    gains, spare = (np.array([found.kp]), np.array([found.kd])), math.inf
    for case, late in cases:
        spare = min(spare, -asked.requirements.shortfall(gr.margins(loop_of(case, late, step, found.kp, found.kd, asked))))
        assert asked.met(case, late, step, *gains, 1 + SUMMED).all(), (joint, delay, step, asked, ranges, found.kp, found.kd, case, late)
    assert spare >= -ROUND_OFF, (spare, joint, delay, step, asked, ranges, found.kp, found.kd, found.certificate)
    softest = min(gr.dynamic_stiffness(loop_of(*case, step, found.kp, found.kd, asked)).least for case in cases[:30])
    assert softest >= (1 - SOFTER) * found.stiffness, (joint, delay, step, asked, ranges, found.kp, found.kd)
    return spare


@pytest.mark.slow
@seeds(40, quick=1)
def test_recommended_gains_keep_what_is_asked_for_within_ranges(seed):
    check_ranges(*with_ranges(seed))


def test_a_region_beside_an_undamped_resonance():
    """Between two samples the shadow of the disk breaks off and begins again, where the resonance turns L past it."""
    parts = gr.ElasticJoint(2.3915386, 1.0, 191629.66, 0.0), gr.Drive(BANDWIDTH, CURRENT_DAMPING, 1.42622e-3)
    region = gr.pd_region(*parts, peak_sensitivity=2.0)
    omega = np.concatenate([np.linspace(300.0, 700.0, 15_000), np.geomspace(1.0, 3000.0, 5000)])
    for kp in (3000.0, 3700.0, 4130.0):
        for kd in np.linspace(150.0, 270.0, 25):
            height = float((1 / np.abs(1 + gr.build_loop(*parts, gr.PD(kp, kd)).response(omega))).max())
            if abs(height - 2) > 2e-4:  # what lies between the frequencies
                assert region.contains(kp, kd) == (height < 2), (kp, kd, height)


@pytest.mark.slow
@pytest.mark.parametrize("feedback", ["motor", {"kp": "link", "kd": "motor"}], ids=["motor", "both"])
@pytest.mark.parametrize("ticks", [0, 1, 3])
def test_whole_ticks_of_delay_behind_an_ideal_current_loop(feedback, ticks):
    """L vanishes at half the rate there, and the gains that put it into a disk are without end: the region is that of margins."""
    joint, drive = gr.ElasticJoint(0.448, 0.35, 900.0), gr.Drive(delay=1e-3 * ticks)
    asked = gr.Requirements.usual()
    region = gr.pd_region(joint, drive, GM, PM, MS, feedback=feedback, sample_time=1e-3)
    rng, inside = np.random.default_rng(ticks), 0
    for kp, kd in zip(900 * 10 ** rng.uniform(-1.5, 0.7, 60), 50 * 10 ** rng.uniform(-1.5, 1.0, 60), strict=True):
        found = gr.margins(gr.build_loop(joint, drive, gr.PD(kp, kd), feedback=feedback, sample_time=1e-3))
        met = asked.met_by(found)
        short = asked.shortfall(found)
        if abs(short) > 1e-3:  # not on the edge
            assert bool(region.contains(np.array([kp]), np.array([kd]))[0]) == met, (kp, kd)
        inside += met
    assert inside > 3
