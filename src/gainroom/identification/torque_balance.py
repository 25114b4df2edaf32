"""Torque that a fitted joint does not explain: the measured torque less the torque of the motor's motion by the model.

    τ = J_M q̈ + J_L q̈_L + friction and weight,    q_L = (B s + K)/(J_L s² + B s + K) q

With the motor's position given, the link is a forced oscillator, so that nothing here follows the log as a predictor does, which forgives
a wrong model what it does within a few ticks. Friction and weight are free, inertias and spring are those of the fit. By third octaves the
share of the torque's power that is left says how wrong a model is where it is wrong: a right one leaves friction's law and noise.
"""

from dataclasses import dataclass

import numpy as np

from ..system.assembly import current_loop
from ..system.drive import Drive
from ..system.elastic_joint import ElasticJoint
from ..system.linear.arrays import Booleans, Complexes, Floats
from .frequency_response import FrequencyResponse
from .prediction import Between, Noise, Signals

TAPER = 0.05  # of the record, at either end
OCTAVE = 2 ** (1 / 3)  # a band's highest over its lowest frequency
LINES = 8  # of the spectrum in a band, at least
LEAST_POWER = 0.01  # of the torque's in a band that counts: with less, friction and noise rule it
RINGING, BESIDES = 2, 3.0  # bands of a loop that rings may have all of it: then of so many times what is in the others
LAW, MOST_DRY = (
    0.1,
    0.3,
)  # of dry friction's power, no law of which is known to better than a third, and of how much of the torque's at most
MARGIN = 0.8, 1.1  # times the lowest and the highest excited frequency: what is looked at
HIGHEST = 0.45  # of the tick rate
SURE = 3.0  # standard errors of a band's noise power, which is that of as many exponential variables as it has lines


@dataclass(frozen=True)
class Balance:
    """Shares of the torque that the fitted joint's motion does not explain, by bands.

    edges   (b, 2) lowest and highest frequency [rad/s]
    left    (b,) share of the torque's power, without what the encoder's noise and an unknown law of friction make; may be above 1
    power   (b,) share of the whole torque's power that is in the band
    dry     (b,) power of the fitted Coulomb friction over the torque's
    """

    edges: Floats
    left: Floats
    power: Floats
    dry: Floats

    @property
    def worst(self) -> int:
        """Index of the band with the largest unexplained share, among those with power."""
        others = float(np.sort(self.power)[:-RINGING].sum())
        least = LEAST_POWER * (min(BESIDES * others, 1.0) if others > 0 else 1.0)
        return int(np.argmax(np.where(self.power >= least, self.left, -1.0)))

    @property
    def most(self) -> float:
        """Largest unexplained share of a band."""
        return float(self.left[self.worst])


class Spectra:
    """Signals of a log over the frequencies that the torque excites."""

    def __init__(self, signals: Signals, measured: FrequencyResponse) -> None:
        self.tick, self.count, self.position = signals.sample_time, len(signals.torque), signals.positions[:, 0]
        self.signals = signals
        # The padded record, in which filters act, and the record itself, whose lines are compared.
        self.omega = 2 * np.pi * np.fft.rfftfreq(2 * self.count, self.tick)
        turn = self.omega * self.tick
        restored = np.where(turn > 0, turn**2 / np.maximum(2 - 2 * np.cos(turn), 1e-12), 1.0)  # a second difference loses (ωT)²/12
        self.restored = np.where(turn < 2 * np.pi * HIGHEST, restored, 0.0)
        ends = max(int(TAPER * self.count), 4)
        ramp = 0.5 - 0.5 * np.cos(np.pi * np.arange(ends) / ends)
        self.window = np.ones(self.count)
        self.window[:ends], self.window[-ends:] = ramp, ramp[::-1]
        lines = 2 * np.pi * np.fft.rfftfreq(self.count, self.tick)
        excited = measured.omega[measured.excited]
        highest = min(MARGIN[1] * excited.max(), 2 * np.pi * HIGHEST / self.tick)
        self.used: Booleans = (lines > MARGIN[0] * excited.min()) & (lines < highest)
        self.lines = lines[self.used]
        self.bands = bands(self.lines)
        acceleration = np.diff(self.position, 2, prepend=self.position[0], append=self.position[-1]) / self.tick**2
        acceleration[[0, -1]] = 0.0
        self.acceleration: Complexes = np.fft.rfft(np.append(acceleration, np.zeros(self.count))) * self.restored

    def seen(self, values: Floats) -> Complexes:
        """Used lines (..., k) of values (..., m) in the window."""
        return np.fft.rfft((values - values.mean(axis=-1, keepdims=True)) * self.window)[..., self.used]

    def filtered(self, values: Floats, response: Complexes) -> Floats:
        """Values (m,) through a `response` at `omega`; beyond the record they go straight from its end to its begin."""
        padded = np.concatenate([values, np.linspace(values[-1], values[0], self.count)])
        return np.fft.irfft(np.fft.rfft(padded) * response, 2 * self.count)[: self.count]

    def accelerated(self, response: Complexes | float) -> Floats:
        """Acceleration (m,) of the motor through a `response`, from rest."""
        return np.fft.irfft(self.acceleration * response, 2 * self.count)[: self.count]


def bands(lines: Floats) -> Floats:
    """First line (b + 1,) of each third octave and the end, each of at least LINES, of rising frequencies (k,)."""
    edges = [0]
    while edges[-1] < len(lines):
        end = max(int(np.searchsorted(lines, OCTAVE * lines[edges[-1]])), edges[-1] + LINES)
        edges.append(len(lines) if len(lines) - end < LINES else end)
    return np.array(edges)


def through_drive(torque: Floats, drive: Drive, tick: float) -> Floats:
    """Torque (m,) of a drive for commands (m,), each held for a tick, at the ticks."""
    count = len(torque)
    omega = 2 * np.pi * np.fft.rfftfreq(2 * count, tick)
    response = np.exp(-1j * omega * (drive.delay + tick / 2)) * np.sinc(omega * tick / (2 * np.pi))
    response = response if drive.is_ideal else response * current_loop(drive).response(omega)
    padded = np.concatenate([torque, np.linspace(torque[-1], torque[0], count)])
    return np.fft.irfft(np.fft.rfft(padded) * response, 2 * count)[:count]


def acting_torque(signals: Signals, drive: Drive, between: Between) -> Floats:
    """Torque (m,) on the motor at the ticks."""
    if signals.sampled:
        return signals.torque + between.early * np.gradient(signals.torque)
    return through_drive(signals.torque, drive, signals.sample_time)


def torque_balance(spectra: Spectra, joint: ElasticJoint, drive: Drive, between: Between, noise: Noise, coulomb: Floats) -> Balance:
    """Balance between the torque and the motion of `joint`; `coulomb` (2,): fitted torques on motor and link."""
    omega, along = 1j * spectra.omega, spectra.signals.motion.along
    passed, columns = np.ones(len(omega), dtype=complex), []
    if np.isfinite(joint.stiffness):
        square, damping = joint.stiffness / joint.link_inertia, joint.damping / joint.link_inertia
        passed = (square + damping * omega) / (square + damping * omega + omega**2)
        # The link moves already when the record begins: its decaying free motion, in both phases.
        root = -damping / 2 + 1j * np.sqrt(max(square - damping**2 / 4, 0.0))
        free = np.exp(root * np.arange(spectra.count) * spectra.tick)
        columns = [free.real, free.imag]
    columns += [along[:, 0], along[:, 2], *(spectra.filtered(along[:, k], passed) for k in (1, 3, 4))]
    torque = spectra.seen(acting_torque(spectra.signals, drive, between))
    inertial = spectra.seen(spectra.accelerated(joint.motor_inertia + joint.link_inertia * passed))
    seen = spectra.seen(np.array(columns))
    rest = without(torque - inertial, seen)
    dry = coulomb[0] * seen[-5] + coulomb[1] * seen[-3]
    response = joint.plant().response(1j * spectra.lines, "motor")[:, 0, 0]
    encoder = float(noise.readings[0] ** 2 * np.sum(spectra.window**2)) / np.abs(response) ** 2
    return balance_of(spectra, rest, torque, encoder, dry)


def balance_of(spectra: Spectra, rest: Complexes, torque: Complexes, noise: Floats, dry: Complexes) -> Balance:
    """Balance by bands from the unexplained part `rest` (k,) of the torque (k,), with the power of noise (k,) and dry friction (k,)."""
    starts = spectra.bands[:-1]
    powers = np.add.reduceat(np.abs(torque) ** 2, starts)
    scatter = 1 + SURE / np.sqrt(np.diff(spectra.bands))
    left = np.add.reduceat(np.abs(rest) ** 2, starts) - scatter * np.add.reduceat(noise, starts)
    edges = np.column_stack([spectra.lines[starts], spectra.lines[spectra.bands[1:] - 1]])
    shares = [np.maximum(part, 0.0) / np.maximum(powers, 1e-300) for part in (left, np.add.reduceat(np.abs(dry) ** 2, starts))]
    left = np.maximum(shares[0] - LAW * np.minimum(shares[1], MOST_DRY), 0.0)
    return Balance(edges, left, powers / powers.sum(), shares[1])


def without(values: Complexes, columns: Complexes) -> Complexes:
    """Residual (k,) of `values` (k,) beside real factors of `columns` (c, k), by least squares."""
    matrix = np.hstack([columns.real, columns.imag]).T
    scale = np.maximum(np.linalg.norm(matrix, axis=0), 1e-300)
    factors = np.linalg.lstsq(matrix / scale, np.append(values.real, values.imag), rcond=1e-9)[0] / scale
    return values - factors @ columns
