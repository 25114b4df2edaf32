"""Measured frequency response of a joint, with coherence; and the joint that roughly fits it, from which a search may start.

Positions are differenced twice before their spectra are taken: the joint's double integrator would leak over all frequencies.

In a feedback loop the quotient of both spectra is the joint's response only where the torque is given from outside; where noise goes round
the loop it is the controller's inverse. `given_torque` is what feedback did not make, and as an instrument takes that error out
(Ljung, System Identification, 1999, section 13.4).

Averages over segments resolve a dozenth of a log, which is too coarse where a slow resonance has rung for a few seconds. The local
polynomial method resolves what the whole log does: over some lines beside each other both the response and what the record's ends add
are smooth (Pintelon and Schoukens, System Identification, 2012, chapter 7).
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from ..system.drive import Drive
from ..system.elastic_joint import ElasticJoint
from ..system.linear.arrays import Booleans, Complexes, Floats

FEEDBACK = 4  # latest steps that a controller's law may rest on; more would foretell the torque itself from what it moved before
SEGMENTS = 12  # at least, over which spectra are averaged
BESIDE, DEGREE = 4, 2  # lines to either side of one, over which response and the ends' part are polynomials of a degree
FINE_AVERAGES, ALIKE = 4, 3  # as of segments, of a fit over these lines; and how many lines beside each other tell as much as one
LONGEST_SEGMENT = 8.0  # [s]
STRONG = 0.005  # power of the torque that a frequency needs
CLEAR = 10.0  # power over the encoder's noise that a frequency needs
LEAST_POWER = 0.01  # of the strongest: turning friction round makes harmonics that are weaker
LEAST_LINE = 3  # of the spectra: lower ones hold the trend
OPPOSITE = 0.4  # of the cost: a joint pushed the other way that costs less is what was recorded
EXCITED = 0.6  # coherence of SEGMENTS that a frequency needs to count: of n unrelated ones, c is exceeded with probability (1 − c)ⁿ⁻¹


@dataclass(frozen=True)
class FrequencyResponse:
    """Frequency response from torque to the acceleration of one side.

    omega       (k,) [rad/s]
    response    (k,) [rad/s² / (N m)] of the twice differenced position
    coherence   (k,) 0 to 1, of the motion with torque and instrument, the lesser; with a torque alone also near 1 where feedback makes it
    clearance   (k,) power of the motion over that of the encoder's noise
    strength    (k,) power of torque and instrument over that of their strongest tenths, the lesser; where it is low feedback answers noise
    lowest      [rad/s] below which nothing counts
    averages    independent spectra behind each frequency
    alike       frequencies beside each other that tell as much as one
    """

    omega: Floats
    response: Complexes
    coherence: Floats
    clearance: Floats
    strength: Floats
    lowest: float
    averages: int = SEGMENTS
    alike: int = 1

    @property
    def excited(self) -> Booleans:
        """Lines (k,) where the torque is strong and explains the motion, and the motion is not the encoder's noise."""
        least = 1 - (1 - EXCITED) ** ((SEGMENTS - 1) / (self.averages - 1))  # as unlikely by chance as EXCITED is of SEGMENTS
        return (self.coherence >= least) & (self.clearance >= CLEAR) & (self.strength >= STRONG) & (self.omega > self.lowest)

    @property
    def frequencies(self) -> int:
        """Number of excited frequencies."""
        return int(np.count_nonzero(self.excited)) // self.alike

    @property
    def lines(self) -> int:
        """Number of excited frequencies whose power is at least a share LEAST_POWER of the strongest."""
        power = self.strength[self.excited]
        return int(np.count_nonzero(power >= LEAST_POWER * power.max(initial=0.0))) // self.alike


def given_torque(torque: Floats, position: Floats) -> Floats:
    """Part of the torque (m,) [N m] that no law of the last positions (m,) [rad] explains: from set-points, or added to the controller's.

    The law is that of least squares between both differenced twice: slow motion, which follows its set-point, would hide it.
    """
    lags = sliding_window_view(np.diff(position, prepend=position[0]), FEEDBACK)
    columns = np.column_stack([position[FEEDBACK - 1 :], lags])
    law, *_ = np.linalg.lstsq(np.diff(columns, 2, axis=0), np.diff(torque[FEEDBACK - 1 :], 2), rcond=None)
    given = torque[FEEDBACK - 1 :] - columns @ law
    return np.concatenate([np.full(FEEDBACK - 1, given[0]), given])


def frequency_response(torque: Floats, position: Floats, sample_time: float, instrument: Floats | None = None) -> FrequencyResponse:
    """Frequency response by Welch's method (scipy.signal) from torque (m,) [N m] to position (m,) [rad].

    Both are correlated with `instrument` (m,), if given.
    """
    from scipy.signal import csd, welch

    acceleration = np.diff(position, 2) / sample_time**2
    length = int(min((len(torque) - 2) / (SEGMENTS / 2 + 0.5), LONGEST_SEGMENT / sample_time))
    options = {"fs": 1 / sample_time, "nperseg": max(length, 16), "detrend": "constant"}
    drivers = [signal[1:-1] for signal in (torque, instrument) if signal is not None]
    frequency, output_power = welch(acceleration, **options)
    powers = [welch(driver, **options)[1] for driver in drivers]
    crosses = [csd(driver, acceleration, **options)[1] for driver in drivers]
    through = csd(drivers[-1], drivers[0], **options)[1]
    with np.errstate(all="ignore"):
        response = crosses[-1] / through
        shared = [np.abs(cross) ** 2 / (power * output_power) for cross, power in zip(crosses, powers, strict=True)]
    return _judged(
        sample_time, frequency, response, np.array(shared), output_power, np.array(powers), LEAST_LINE * frequency[1], (SEGMENTS, 1)
    )


def fine_response(torque: Floats, position: Floats, sample_time: float, instrument: Floats | None = None) -> FrequencyResponse:
    """Frequency response by the local polynomial method, at all lines of the log; arguments as frequency_response."""
    signals = [np.diff(position, 2) / sample_time**2, torque[1:-1], *([] if instrument is None else [instrument[1:-1]])]
    count, width = len(signals[0]), 2 * BESIDE + 1
    spectra = np.array([np.fft.rfft(signal - signal.mean()) for signal in signals])
    near = sliding_window_view(spectra, width, axis=1).swapaxes(0, 1)  # (k, signals, width)
    frequency = np.fft.rfftfreq(count, sample_time)[BESIDE : BESIDE + len(near)]
    powers = sliding_window_view(np.abs(np.fft.rfft(np.array(signals) * np.hanning(count))) ** 2, width, axis=1).mean(axis=-1)
    smooth = (np.arange(-BESIDE, BESIDE + 1)[:, None] / BESIDE) ** np.arange(DEGREE + 1.0)
    ends = np.linalg.qr(smooth)[0]
    inner = np.eye(width) - ends @ ends.T  # takes out what the ends add
    driven, nothing = inner @ (near[:, -1, :, None] * smooth), 1e-300
    basis, triangle = np.linalg.qr(driven)
    wanted = inner @ near[:, :-1].swapaxes(1, 2)
    seen = basis.conj().swapaxes(1, 2) @ wanted
    shared = np.sum(np.abs(seen) ** 2, axis=1) / np.maximum(np.sum(np.abs(wanted) ** 2, axis=1), nothing)
    factors = np.linalg.solve(triangle + nothing * np.eye(DEGREE + 1), seen)[:, 0]
    response = factors[:, 0] / (factors[:, 1] if instrument is not None else 1.0)
    return _judged(
        sample_time,
        frequency,
        response,
        shared.T[:1] if instrument is None else shared.T,
        powers[0],
        powers[1:],
        0.0,
        (FINE_AVERAGES, ALIKE),
    )


def _judged(
    sample_time: float,
    frequency: Floats,
    response: Complexes,
    shared: Floats,
    output_power: Floats,
    powers: Floats,
    lowest: float,
    averaging: tuple[int, int],
) -> FrequencyResponse:
    """Response with clearance and strength, from coherences (d, k) and powers (d, k) by driver; `lowest` [Hz] that counts."""
    # White noise of the encoder, differenced twice; its size from the highest frequencies, where a joint hardly moves.
    shape = (2 - 2 * np.cos(2 * np.pi * frequency * sample_time)) ** 2
    high = (frequency > 0.3 / sample_time) & (frequency < 0.45 / sample_time)
    floor = max(float(np.median(output_power[high] / shape[high])), 1e-300) * np.maximum(shape, 1e-12)
    clearance = output_power / floor
    clear = (clearance >= CLEAR) & (frequency > lowest)
    strongest = [float(np.quantile(power[clear], 0.9)) if clear.any() else 0.0 for power in powers]
    strength = np.min([power / max(most, 1e-300) for power, most in zip(powers, strongest, strict=True)], axis=0)
    coherence = np.min(shared, axis=0)
    good = np.isfinite(response) & np.isfinite(coherence) & (frequency > 0) & (frequency < 0.45 / sample_time)
    return FrequencyResponse(
        2 * np.pi * frequency[good], response[good], coherence[good], clearance[good], strength[good], 2 * np.pi * lowest, *averaging
    )


def differenced_response(joint: ElasticJoint, omega: Floats, sample_time: float) -> Complexes:
    """Response (k,) from torque to acceleration of the motor at `omega` (k,) [rad/s], as a twice differenced position shows it."""
    differenced = (2 - 2 * np.cos(omega * sample_time)) / sample_time**2
    return -differenced * joint.plant().response(1j * omega, "motor")[:, 0, 0]


def fitted_response(omega: Floats, joint: ElasticJoint, drive: Drive, sample_time: float, commanded: bool) -> Complexes:
    """Response of the fitted joint, if `commanded` from the target torque, with hold, current loop and delay; else from the torque."""
    from ..system.assembly import current_loop

    plant = differenced_response(joint, omega, sample_time)
    if not commanded:
        return plant
    return plant * current_loop(drive).response(omega) * np.exp(-1j * omega * (drive.delay + sample_time / 2))


@dataclass(frozen=True)
class Rough:
    """Joint and delay [s] that roughly fit a measured response.

    opposite   True where a joint that is pushed the other way goes through it far better: a sign is wrong
    """

    joint: ElasticJoint
    delay: float
    opposite: bool = False


def rough_joint(measured: FrequencyResponse, sample_time: float, delays: Floats, elastic: bool) -> Rough:
    """Joint of least error over the excited frequencies: a coarse grid over resonance, ratio, damping and `delays` (d,) [s], refined.

    The delay is that from torque to motion with the current loop's and half a tick of hold.
    """
    from scipy.optimize import minimize

    used = measured.excited
    omega, logs, sure = measured.omega[used], np.log(measured.response[used]), np.clip(measured.coherence[used], 0.0, 0.99)
    strength = measured.strength[used]
    weight = (sure / (1 - sure)) ** 0.5 * strength / (strength + 10 * STRONG) / omega  # per octave, not per hertz
    weight /= weight.sum()
    late = np.exp(-1j * np.outer(delays, omega))

    def cost(shape: Complexes, turned: float = 0.0) -> tuple[Floats, Floats]:
        """Cost and logarithm of the scale of responses (..., k), whose phase is `turned` [rad]."""
        rest = logs - np.log(shape) + 1j * turned
        rest = rest.real + 1j * ((rest.imag + np.pi) % (2 * np.pi) - np.pi)
        # The median: where friction or noise rules, a frequency may lie anywhere.
        order = np.argsort(rest.real, axis=-1)
        place = np.argmax(np.cumsum(weight[order], axis=-1) >= 0.5, axis=-1)
        scale = np.take_along_axis(rest.real, np.take_along_axis(order, place[..., None], axis=-1), axis=-1)
        return np.minimum(np.abs(rest - scale) ** 2, 0.5) @ weight, scale[..., 0]

    def shape(resonance: float, ratio: float, damping: float) -> Complexes:
        """Response of a joint with J_M = 1."""
        if not elastic:
            return differenced_response(ElasticJoint(0.5, 0.5), omega, sample_time)
        stiffness = resonance**2 / (1 + 1 / ratio)
        return differenced_response(ElasticJoint(1.0, ratio, stiffness, 2 * damping * stiffness / resonance), omega, sample_time)

    grid = [
        (resonance, ratio, damping)
        for resonance in np.geomspace(omega[0] * 1.2, omega[-1] * 1.5, 50)
        for ratio in (0.15, 0.3, 0.6, 1.2, 2.5, 5.0, 10.0, 20.0)
        for damping in (0.01, 0.06)
    ]
    grid = grid if elastic else [(0.0, 0.0, 0.0)]
    best, opposite = (math.inf, grid[0], 0, 0.0), math.inf
    for case in grid:
        shapes = shape(*case) * late
        costs, scales = cost(shapes)
        if elastic:
            opposite = min(opposite, float(cost(shapes, np.pi)[0].min()))
        place = int(np.argmin(costs))
        if costs[place] < best[0]:
            best = (float(costs[place]), case, place, float(scales[place]))
    coarse, case, place, scale = best
    if not elastic:
        total = math.exp(-scale)
        return Rough(ElasticJoint(0.5 * total, 0.5 * total), float(delays[place]))
    start = np.append(np.log(case), delays[place] / sample_time)

    def objective(point: Floats) -> float:
        delay = point[3] * sample_time if len(delays) > 1 else delays[0]
        if np.any(np.abs(point[:3]) > 20):
            return math.inf
        return float(cost(shape(*np.exp(point[:3])) * np.exp(-1j * omega * delay))[0])

    simplex = start + np.vstack([np.zeros(4), np.diag([0.02, 0.2, 0.3, 0.3])])
    found = minimize(objective, start, method="Nelder-Mead", options={"maxiter": 400, "initial_simplex": simplex})
    resonance, ratio, damping = np.exp(found.x[:3])
    delay = float(max(found.x[3] * sample_time, 0.0)) if len(delays) > 1 else float(delays[0])
    inertia = math.exp(-float(cost(shape(resonance, ratio, damping) * np.exp(-1j * omega * delay))[1]))
    stiffness = inertia * resonance**2 / (1 + 1 / ratio)
    joint = ElasticJoint(inertia, inertia * ratio, stiffness, 2 * damping * stiffness / resonance)
    return Rough(joint, delay, opposite < OPPOSITE * coarse)
