"""Properties of an oscillation in a joint's record, measured without a model: growth, amplitude, harmonics, torque at its limit."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ..simulation.oscillation import FEWEST_SAMPLES, Vibration, parts_in
from ..system.linear.arrays import Floats
from .record import Record
from .speed_order import Turning

POSITIONS = ("motor_position", "link_position")
TORQUES = ("target_torque", "demand_torque", "actual_torque")
"""Torque channels in order from the controller to the joint."""
RINGING = 0.02  # damping ratio below which one that decays is a vibration: it takes more than 35 periods to a hundredth
UNCHANGED = 0.2  # relative change over the periods examined of an amplitude that is sustained
LOOKED_AT = 20.0  # periods from the end over which the amplitude is followed
AT_LIMIT = 2e-3  # of its range: a torque this near a limit is clipped
MOST_NOISE = 0.02  # of a limit: noise that is allowed for
LEAST_FLAT = 0.03  # share of rows at a limit beyond that of a sine
LEVELS = (0.999, 0.97, 0.93, 0.88, 0.8, 0.7)  # quantiles of a torque that may be its limit
STANDS = 0.04  # of the largest speed in the vibration: slower, the joint stands still
STANDING_PERIODS = 4.0  # over which that is counted
SPEED_OVER = (0.02, 0.04, 0.08)  # of a period
TURNED = 0.02  # of the frequency, that the phases of successive periods may correct it by
HARMONICS = 5


@dataclass(frozen=True)
class RecordedOscillation:
    """Vibration in a record.

    found       frequency [rad/s], growth [1/s], amplitude at the end [rad, of a torque N m]
    state       "growing", "sustained" or "decaying" over the last periods
    side        channel in which it was found
    rows        of the record
    parts       complex amplitude of every channel at that frequency, by name, at the end of the rows, in its unit
    step        of the encoder [rad], 0: finer than the motion
    odd, even   third and fifth, and second and fourth harmonic, over the first, in amplitude: of the torque, else position
    clipped     share of the rows with the torque at a limit; NaN where no torque is in the record
    limit       that torque [N m]; NaN where there is none
    standing    share of the rows in which the joint stands still
    irregular   without a single frequency: `vibration` has the same power, at its mean frequency
    began_small it grew from a twentieth of its size or less
    effort      amplitude of the torque over half of its range in the record; NaN where no torque is in it
    power       of the actual torque on the motion, over the largest that these amplitudes allow: 1 drives it, −1 brakes it, which
                is what a controller does to a motion that comes from elsewhere; NaN where one of them is not in the record
    turning     how its frequency goes with the speed of the joint; None where the set-point does not move steadily
    first       amplitude behind the first third of the rows, in its unit
    answers     the set-point swings, too, and is a law of the position
    """

    vibration: Vibration
    state: str
    side: str
    rows: slice
    parts: Mapping[str, complex]
    step: float = 0.0
    odd: float = math.nan
    even: float = math.nan
    clipped: float = math.nan
    limit: float = math.nan
    standing: float = math.nan
    irregular: bool = False
    began_small: bool = False
    effort: float = math.nan
    power: float = math.nan
    turning: Turning | None = None
    first: float = 0.0
    answers: bool = False

    @property
    def vibrates(self) -> bool:
        """True if the oscillation grows, is sustained, or decays slowly."""
        return self.state != "decaying" or self.vibration.damping_ratio < RINGING

    @property
    def steps(self) -> float:
        """Amplitude in encoder steps, that at first if the oscillation decays; inf if the encoder has no visible steps."""
        size = max(self.vibration.amplitude, self.first) if self.state == "decaying" else self.vibration.amplitude
        return size / self.step if self.step else math.inf


def measured(
    record: Record, side: str, rows: slice, found: Vibration, deviation: Floats, step: float, irregular: bool = False
) -> RecordedOscillation:
    """Properties of a vibration over its last periods."""
    tick, values = record.sample_time, deviation[rows]
    period = 2 * math.pi / found.frequency / tick
    if not irregular:
        found = _followed(values, tick, found)
    look = slice(-min(len(values), max(FEWEST_SAMPLES, math.ceil(LOOKED_AT * period))), None)
    parts = {name: complex(parts_in(column[rows][len(values) // 3 :, None], tick, found)[0]) for name, column in record.channels.items()}
    torque = next((name for name in TORQUES[::-1] if record.has(name)), None)
    clipped, limit, small, effort = math.nan, math.nan, False, math.nan
    if torque is not None:
        clipped, limit = _clipping(record, rows, look)
        small = _began_small(values)
        effort = 2 * abs(parts[torque]) / max(float(np.ptp(record.channels[torque])), 1e-300)
    odd, even = _harmonics(record.channels[torque][rows][look] if torque else values[look], tick, found.frequency)
    change = found.growth_rate * min(LOOKED_AT * period, len(values)) * tick
    state = "sustained" if irregular or abs(change) < UNCHANGED else "growing" if change > 0 else "decaying"
    return RecordedOscillation(
        found,
        state,
        side,
        rows,
        parts,
        step,
        odd,
        even,
        clipped,
        limit,
        _standing(record.channels[side][rows][-math.ceil(STANDING_PERIODS * period) :], step, period) if side in POSITIONS else math.nan,
        irregular,
        small,
        effort,
        power_of(parts.get("actual_torque", 0j), complex(found.growth_rate, found.frequency) * parts[side])
        if side in POSITIONS
        else math.nan,
        first=_size_at_first(values, tick, found),
    )


def _size_at_first(values: Floats, tick: float, found: Vibration) -> float:
    """Amplitude after the first third, when most have settled."""
    part = values[len(values) // 3 :]
    return abs(complex(parts_in(part[: max(FEWEST_SAMPLES, round(4 * math.pi / found.frequency / tick))][:, None], tick, found)[0]))


def power_of(torque: complex, velocity: complex) -> float:
    """Cosine of the angle between a torque and a velocity: their mean power over the largest that their amplitudes allow."""
    size = abs(torque) * abs(velocity)
    return (torque * velocity.conjugate()).real / size if size > 0 else math.nan


def _followed(values: Floats, tick: float, found: Vibration) -> Vibration:
    """Vibration with growth rate and amplitude, and a finer frequency, from amplitude and phase period by period.

    The pole of a limit cycle tells neither.
    """
    period = 2 * math.pi / found.frequency / tick
    values = values[len(values) // 3 :]
    width = max(4, round((2 if len(values) > 12 * period else 1) * period))  # of a few periods one each
    count = int(min(LOOKED_AT / 2, len(values) // width))
    if count < 3:
        return found
    time = np.arange(width) * tick
    basis = np.column_stack([np.cos(found.frequency * time), np.sin(found.frequency * time), np.ones(width), time])
    blocks = values[len(values) - count * width :].reshape(count, width).T
    cosine, sine = np.linalg.lstsq(basis, blocks, rcond=None)[0][:2]
    sizes, began = np.hypot(cosine, sine), np.arange(count) * width * tick
    if not np.all(sizes > 0):
        return found
    turned = np.unwrap(np.angle(cosine - 1j * sine) - found.frequency * began)
    off = float(np.polyfit(began, turned, 1)[0])
    frequency = found.frequency + off if abs(off) < TURNED * found.frequency else found.frequency
    middles = (np.arange(count) - count + 0.5) * width * tick  # from the end
    rate, last = np.polyfit(middles, np.log(sizes), 1)
    if count >= 6:  # what began in between has grown to its size, and grows no more
        late = np.polyfit(middles[count // 2 :], np.log(sizes[count // 2 :]), 1)
        rate, last = late if abs(late[0]) < 0.3 * abs(rate) else (rate, last)
    return Vibration(frequency, float(rate), float(np.exp(last)))


def _clipping(record: Record, rows: slice, look: slice) -> tuple[float, float]:
    """Share of rows at a limit, and the limit, of a torque that is flatter than a sine at its largest value; 0 if it is not.

    An actual torque overshoots its limit, so levels below the largest value are tried.
    """
    most, best = LEAST_FLAT, (0.0, math.nan)
    for name in TORQUES:
        if not record.has(name):
            continue
        part = record.channels[name][rows][look]
        sizes, noise = np.abs(part), _noise(part)
        for level in np.quantile(sizes, LEVELS).tolist():
            if level == 0:
                continue
            near = max(AT_LIMIT, min(3 * noise / level, MOST_NOISE))
            flat = np.abs(sizes - level) < near * level
            held = flat[1:] & flat[:-1] & (np.sign(part[1:]) == np.sign(part[:-1])) & (np.abs(np.diff(part)) < near * level)
            share = float(np.mean(held))
            excess = share - 2 / math.pi * math.acos(1 - 2 * near)
            if excess > most:
                most, best = excess, (share, level)
    return best


def _noise(values: Floats) -> float:
    """Standard deviation of white noise on a smooth signal, from third differences."""
    return 1.4826 * float(np.median(np.abs(np.diff(values, 3)))) / math.sqrt(20)


def _began_small(values: Floats) -> bool:
    """True if the oscillation grew from a twentieth of its size or less."""
    sizes = np.array([float(np.std(np.diff(part))) for part in np.array_split(values, 12)])
    last = int(np.argmax(sizes))
    return bool(last >= 2 and sizes[:last].min() < 0.05 * sizes[last] and np.all(np.diff(sizes[: last + 1]) > -0.3 * sizes[:last]))


def _harmonics(values: Floats, tick: float, omega: float) -> tuple[float, float]:
    """Amplitudes of the 3rd and 5th, and of the 2nd and 4th harmonic, over the first, by least squares; NaN beyond half the rate."""
    time = np.arange(len(values)) * tick
    orders = [k for k in range(1, HARMONICS + 1) if k * omega * tick < 0.9 * math.pi]
    taper = np.hanning(len(values) + 2)[1:-1]
    columns = [np.ones(len(time)), time, *(f(k * omega * time) for k in orders for f in (np.cos, np.sin))]
    weights = np.linalg.lstsq(np.column_stack(columns) * taper[:, None], values * taper, rcond=None)[0][2:]
    sizes = dict(zip(orders, np.hypot(weights[::2], weights[1::2]), strict=True))
    first = max(float(sizes.get(1, 0.0)), 1e-300)
    odd, even = (math.hypot(*(float(sizes.get(k, 0.0)) for k in some)) / first for some in ((3, 5), (2, 4)))
    return (odd if 3 in sizes else math.nan), (even if 2 in sizes else math.nan)


def _standing(values: Floats, step: float, period: float) -> float:
    """Share of the rows in which the position rests: by its speed over a fiftieth of a period, or as much more as the encoder needs."""
    for share in SPEED_OVER:
        span = max(1, round(share * period))
        speed = np.abs(values[span:] - values[:-span])
        most = float(np.quantile(speed, 0.98))
        if most > 4 * step:
            return float(np.mean(speed <= max(STANDS * most, 1.01 * step)))
    return math.nan
