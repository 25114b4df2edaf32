"""Gains that a firmware really applies: kp and kd from set-point, position, velocity and torque.

    torque(t) = kp (x_d − x)(t − lag) + kd (ẋ_d − ẋ)(t − lag) + constant,      or with −ẋ alone

is linear in the gains; behind a current loop the lag is that of a delay and C(s) together, both of which are fitted. All signals pass the
same zero-phase band, which leaves the equation true and keeps out the frequencies at which a
position is mostly its encoder's steps: noise in a regressor would make the gains look smaller than they are (errors in variables).
Rows in which the torque was limited are no rows of that law: they are left out of both sides before the band, row by row.
"""

import math
from dataclasses import dataclass

import numpy as np

from ..errors import GainroomError
from ..system.linear.arrays import Booleans, Complexes, Floats
from .clipping import Limited, limited_rows, limited_text
from .estimate import FREEDOM, Estimate, covariance, interval, quantile
from .excited_part import most_excited
from .record import Record, resolution, slow_rows

DAMPING_RATIO = 0.8  # of a current loop
AHEAD = 0.1  # ticks of a torque ahead of its positions: more, and positions between the rows made it
LONGEST_LAG = 0.02  # [s] of a torque behind the positions that it was made from
LAW, LAW_BEHIND = 1e-6, 7e-4  # of the gains: what rounding leaves, and what a current loop of assumed damping leaves
FASTEST_BEHIND = 0.4  # radians per tick: faster, what a current loop does between ticks is not in the log
CLEAR = 30.0  # power over the encoder's noise that a frequency needs
TAPER = 0.02  # of the record, at either end
MOST_EXPLAINED, LEAST_EXPLAINED = 0.98, 0.5  # of the torque's power in the band: beyond, the law is found; below, there is none
MOST_RELATIVE = 0.1  # half-width of kp's interval that still names a factor
SAME_FACTOR = 0.04  # of a factor: two gains this near are the same
LEAST_STEPS = 20
MOST_LIMITED = 0.9  # share of rows with a limited torque: more, and too few rows are left
LIMITED_ROWS = 30_000  # of a long record with a limited torque, the most excited: every lag that is tried takes its spectra
SETTLES = 3e-3  # [s] behind limited rows in which a current loop still settles


@dataclass(frozen=True)
class UnitError:
    """Gain that is a known factor away from the gain asked for.

    gain, factor, name   "kp" or "kd"; applied/asked; what commonly makes that factor
    """

    gain: str
    factor: float
    name: str


@dataclass(frozen=True)
class GainsFit:
    """Control law identified from the firmware's torque.

    kp, kd          [N m/rad], [N m s/rad] on the joint side
    lag             of the torque behind the positions [s]
    rate_of_error   True: kd acts on ẋ_d − ẋ; False: on −ẋ; None: the set-point moves too little to tell
    velocity        what kd acts on: "motor_velocity" of the record, "difference" of positions from tick to tick, or "derivative"
    offset          constant torque [N m]
    torque          the channel
    explained       share of the torque's power in the band
    band            [rad/s] up to which signals were used
    unit_errors     gains that are a known factor from those asked for
    limited         rows in which the torque was limited, which were left out
    warnings        what the reader should know
    """

    kp: Estimate
    kd: Estimate
    lag: float
    rate_of_error: bool | None
    velocity: str
    offset: float
    torque: str
    explained: float
    band: float
    limited: Limited
    unit_errors: tuple[UnitError, ...] = ()
    warnings: tuple[str, ...] = ()


def identify_gains(record: Record, kp: float | None = None, kd: float | None = None, gear_ratio: float | None = None) -> GainsFit:
    """Fit of kp and kd from reference, motor (or link) position, and target, demand or actual torque; velocities if they are logged.

    kp, kd        what was asked for, joint side; None: not compared
    gear_ratio    lets errors of gear and gear² be named

    Raises GainroomError where channels are missing, where set-point and position hardly differ, and where the torque does not follow such a
    law; the message says what to record.
    """
    record = record.longest_run()
    side = "motor_position" if record.has("motor_position") or not record.has("link_position") else "link_position"
    reference, position = record.need("gains", "reference", side)
    name = record.first_of("gains", "target_torque", "demand_torque", "actual_torque")
    torque = record.channels[name]
    if np.ptp(torque) == 0:
        raise GainroomError(f"gains: {name} does not change: record while the joint moves")
    step = resolution(position)
    if min(np.ptp(reference - position), np.ptp(position)) <= LEAST_STEPS * step:
        raise GainroomError(
            f"gains: set-point and position differ by {np.ptp(reference - position):.3g} rad, {LEAST_STEPS} steps of the encoder "
            f"({step:.3g} rad) are needed: record larger and faster motion"
        )
    limited = limited_rows(record, name)
    if limited.share > MOST_LIMITED:
        raise GainroomError(
            f"gains: {name} is limited in {100 * limited.share:.0f} % of the rows, which tell no gains: record smaller or slower motion"
        )
    if limited.kinds and len(record.time) > LIMITED_ROWS:
        record = most_excited(record, LIMITED_ROWS)
        limited = limited_rows(record, name)
    spectra = _Spectra(record, side, name, limited)
    fits = [
        _fitted(spectra, velocity, follows, name == "actual_torque")
        for velocity in spectra.velocities
        for follows in ((False, True) if spectra.reference_moves else (False,))
    ]
    best = min(fits, key=lambda fit: fit.cost)
    explained = 1 - best.cost
    if explained < LEAST_EXPLAINED:
        raise GainroomError(
            f"gains: kp and kd explain {100 * max(explained, 0):.0f} % of {name}, less than half: look at signs, units and columns, "
            "or record without feed-forward torque"
        )
    return _result(spectra, best, name, (kp, kd, gear_ratio))


class _Spectra:
    """Signals in the frequency domain, with the inverse transform."""

    def __init__(self, record: Record, side: str, name: str, limited: Limited) -> None:
        reference, position, torque = record.channels["reference"], record.channels[side], record.channels[name]
        self.tick, self.count, self.limited = record.sample_time, len(position), limited
        ends = max(int(TAPER * self.count), 4)
        ramp = 0.5 - 0.5 * np.cos(np.pi * np.arange(ends) / ends)
        self.window = np.ones(self.count)
        self.window[:ends], self.window[-ends:] = ramp, ramp[::-1]
        self.window[_with_settling(limited.rows, 0 if name != "actual_torque" else math.ceil(SETTLES / self.tick))] = 0.0
        # Operations that must see the whole signal (differences) come before the window, band and lag after it.
        pad = np.diff(position, prepend=2 * position[0] - position[1]) / self.tick
        middle = np.gradient(position, self.tick)
        ahead = np.diff(reference, prepend=2 * reference[0] - reference[1]) / self.tick
        self.reference_moves = bool(np.any(ahead != 0))
        self.error, self.torque = reference - position, torque
        self.velocities = {"difference": (pad, ahead), "derivative": (middle, np.gradient(reference, self.tick))}
        if record.has("motor_velocity"):
            given = record.channels.get("reference_velocity", self.velocities["derivative"][1])
            self.velocities = {"motor_velocity": (record.channels["motor_velocity"], given)} | self.velocities
        self.omega = 2 * np.pi * np.fft.rfftfreq(self.count, self.tick)
        self.band = self._clear_band(position)
        if name == "actual_torque":
            self.band = min(self.band, FASTEST_BEHIND / self.tick)

    def _clear_band(self, position: Floats) -> float:
        """Frequency [rad/s] below which the position's power, differenced, is well above that at the highest frequencies."""
        from scipy.signal import welch

        length = min(self.count, max(256, int(2.0 / self.tick)))
        frequency, power = welch(np.diff(position), fs=1 / self.tick, nperseg=min(length, self.count - 1))
        shape = 2 - 2 * np.cos(2 * np.pi * frequency * self.tick)
        high = frequency > 0.35 / self.tick
        floor = float(np.median(power[high] / shape[high])) * np.maximum(shape, 1e-12)
        clear = (power > CLEAR * floor) & (frequency > 0)
        top = frequency[clear].max() if clear.any() else 0.1 / self.tick
        return 2 * math.pi * float(np.clip(top, 10 * frequency[1], 0.4 / self.tick))

    def passed(self, values: Floats, lag: float = 0.0, slow: float = 0.0) -> Floats:
        """Signal (m,) through window and band, `lag` [s] later and through a current loop of bandwidth 1/`slow` [s]."""
        return np.fft.irfft(self.spectrum(values, lag, slow) / (1 + (self.omega / self.band) ** 8), self.count)

    def spectrum(self, values: Floats, lag: float = 0.0, slow: float = 0.0) -> Complexes:
        """Spectrum (k,) of `values` (m,), delayed, through the window, without their mean in it."""
        if not self.limited.kinds:  # a window without gaps is as good before as behind what is late
            return np.fft.rfft((values - values.mean()) * self.window) * late(self.omega, lag, slow)
        if lag or slow:
            padded = np.concatenate([values, np.linspace(values[-1], values[0], self.count)])
            omega = 2 * np.pi * np.fft.rfftfreq(len(padded), self.tick)
            values = np.fft.irfft(np.fft.rfft(padded) * late(omega, lag, slow), len(padded))[: self.count]
        return np.fft.rfft((values - np.average(values, weights=self.window)) * self.window)


def _with_settling(rows: Booleans, behind: int) -> Booleans:
    """Rows (m,) and the `behind` rows after each."""
    return np.convolve(rows, np.ones(behind + 1))[: len(rows)] > 0.5


def late(omega: Floats, lag: float, slow: float) -> Complexes:
    """Factor e^{−jω lag} C(jω), with C of eq. (3) of Jung et al. 2017, its bandwidth 1/`slow`, and a typical damping."""
    return np.exp(-1j * omega * lag) / (1 + 2j * DAMPING_RATIO * omega * slow - (omega * slow) ** 2)


@dataclass(frozen=True)
class _Fit:
    velocity: str
    follows: bool
    lag: float
    slow: float
    gains: Floats
    cost: float


def _law(spectra: _Spectra, velocity: str, follows: bool) -> tuple[Floats, Floats]:
    """Signals (m,) on which kp and kd act."""
    measured, wanted = spectra.velocities[velocity]
    return spectra.error, (wanted - measured if follows else -measured)


def _columns(spectra: _Spectra, velocity: str, follows: bool, lag: float, slow: float) -> Floats:
    return np.column_stack([spectra.passed(values, lag, slow) for values in _law(spectra, velocity, follows)])


def _fitted(spectra: _Spectra, velocity: str, follows: bool, behind: bool) -> _Fit:
    """Fit at the lag of least error; `behind` a current loop."""
    from scipy.optimize import minimize

    torque, columns = spectra.passed(spectra.torque), _columns(spectra, velocity, follows, 0.0, 0.0)
    used = spectra.omega < 2.5 * spectra.band
    omega, weight = spectra.omega[used], np.where(spectra.omega[used] > 0, 2.0, 1.0)
    wanted, given = np.fft.rfft(torque)[used], np.fft.rfft(columns, axis=0)[used]
    power = float(weight @ np.abs(wanted) ** 2)
    band, law, gaps = 1 / (1 + (omega / spectra.band) ** 8), _law(spectra, velocity, follows), bool(spectra.limited.kinds)

    def moments(given: Complexes) -> tuple[Floats, Complexes]:
        """Sums (3, k) of the columns' products, and (k, 2) of those with the torque, by frequency."""
        products = np.stack([np.abs(given[:, 0]) ** 2, np.real(given[:, 0].conj() * given[:, 1]), np.abs(given[:, 1]) ** 2])
        return weight * products, weight[:, None] * given.conj() * wanted[:, None]

    whole = moments(given)

    def solved(lag: float, slow: float) -> tuple[Floats, float]:
        products, cross, response = *whole, late(omega, lag, slow)
        if gaps:
            there = [spectra.spectrum(values, lag, slow)[used] * band for values in law]
            products, cross, response = *moments(np.column_stack(there)), np.ones(len(omega), dtype=complex)
        first, both, second = products @ np.abs(response) ** 2
        right = np.real(response.conj() @ cross)
        gains = np.linalg.lstsq(np.array([[first, both], [both, second]]), right, rcond=None)[0]
        return gains, 1 - float(right @ gains) / power

    tick = spectra.tick
    grid = np.arange(-1.0, LONGEST_LAG / tick + 0.5, 0.5) * tick
    start = float(grid[int(np.argmin([solved(float(lag), 0.0)[1] for lag in grid]))])
    simplex = np.array([[start, 0.2 * tick], [start + 0.4 * tick, 0.2 * tick], [start - 0.3 * tick, 0.6 * tick]])
    if not behind:
        simplex = np.array([[start], [start + 0.3 * tick]])

    def cost(point: Floats) -> float:
        return solved(point[0], abs(point[1]) if behind else 0.0)[1]

    options = {"initial_simplex": simplex / tick, "xatol": 1e-7, "fatol": 1e-15, "maxiter": 300}
    found = minimize(lambda point: cost(point * tick), simplex[0] / tick, method="Nelder-Mead", options=options)
    lag, slow = found.x[0] * tick, abs(found.x[1]) * tick if behind else 0.0
    gains, least = solved(lag, slow)
    return _Fit(velocity, follows, float(lag), float(slow), gains, least)


def _result(spectra: _Spectra, best: _Fit, name: str, asked: tuple[float | None, float | None, float | None]) -> GainsFit:
    columns = _columns(spectra, best.velocity, best.follows, best.lag, best.slow)
    step = 0.05 * spectra.tick
    later = [(best.lag + step, best.slow)] + ([(best.lag, best.slow + step)] if best.slow > 0 else [])
    slopes = [(_columns(spectra, best.velocity, best.follows, *moved) - columns) @ best.gains / step for moved in later]
    jacobian = np.column_stack([columns, *slopes])
    residual = spectra.passed(spectra.torque) - columns @ best.gains
    inverse = np.linalg.pinv(jacobian.T @ jacobian)
    variance = covariance(residual[:, None] * (jacobian @ inverse))
    # Variance of the rounding of the torque, step²/12, which remains even where the signal repeats.
    rounding = resolution(spectra.torque) ** 2 / 12
    variance = variance + rounding * inverse
    floor = (LAW_BEHIND if best.slow > 0 else LAW) * np.array([*np.abs(best.gains), *np.zeros(len(slopes))])
    errors = np.sqrt(np.diag(variance) + floor**2)
    kp, kd = (interval(float(value), float(error), FREEDOM) for value, error in zip(best.gains, errors, strict=False))
    warnings, lag, tick = [], best.lag + 2 * DAMPING_RATIO * best.slow, 1e3 * spectra.tick
    if lag < -AHEAD * spectra.tick:
        between = f"{name} is {-1e3 * lag:.3g} ms ahead of the positions it was made from: the controller runs faster"
        warnings += slow_rows(spectra.tick, f"{between}, and its kd is not the one found here, whatever the interval", certain=True)
    else:
        between = (
            f"velocity is a difference over {tick:.3g} ms: of a controller that runs faster kd and lag are others, whatever the interval"
        )
        warnings += slow_rows(spectra.tick, between) if best.velocity != "motor_velocity" else []
    explained = 1 - best.cost
    if explained < MOST_EXPLAINED:
        warnings.append(f"kp and kd explain {100 * explained:.1f} % of {name}: the rest is feed-forward, a filter, a limit or noise")
    for label, gain in (("kp", kp), ("kd", kd)):
        if gain.low <= 0 <= gain.high:
            warnings.append(
                f"the record does not tell {label} from 0: record motion with more {'deflection' if label == 'kp' else 'velocity'}"
            )
    warnings += limited_text(spectra.limited, "tell no gains and are left out")
    offset = float(np.average(spectra.torque - best.gains[0] * spectra.error, weights=spectra.window > 0))
    follows = best.follows if spectra.reference_moves else None
    return GainsFit(
        kp, kd, lag, follows, best.velocity, offset, name, explained, spectra.band, spectra.limited,
        _unit_errors(kp, kd, *asked), tuple(warnings),
    )  # fmt: skip


def factors(gear_ratio: float | None) -> dict[str, float]:
    """Common unit mistakes: the factor applied/asked by its name."""
    known = {
        "2π: revolutions taken for radians": 2 * math.pi,
        "1/2π: radians taken for revolutions": 1 / (2 * math.pi),
        "180/π: degrees taken for radians": 180 / math.pi,
        "π/180: radians taken for degrees": math.pi / 180,
    }
    if gear_ratio is not None and gear_ratio != 1:
        known |= {
            "gear: position or torque on the rotor's side": gear_ratio,
            "1/gear: position or torque on the rotor's side": 1 / gear_ratio,
            "gear²: gains act on the rotor's side": gear_ratio**2,
            "1/gear²: gains of the rotor's side on the joint's": gear_ratio**-2,
            "2π · gear: revolutions of the rotor": 2 * math.pi * gear_ratio,
            "gear/2π: radians taken for revolutions of the rotor": gear_ratio / (2 * math.pi),
            "1/(2π · gear): radians taken for revolutions, on the rotor's side": 1 / (2 * math.pi * gear_ratio),
        }
    return known


def _unit_errors(
    kp: Estimate, kd: Estimate, asked_kp: float | None, asked_kd: float | None, gear_ratio: float | None
) -> tuple[UnitError, ...]:
    """Unit errors whose factor fits, and is not 1."""
    found = []
    for label, gain, asked in (("kp", kp, asked_kp), ("kd", kd, asked_kd)):
        if not asked or gain.value <= 0 or gain.half_width > MOST_RELATIVE * gain.value:
            continue
        ratio = gain.value / asked
        sure = math.log1p(SAME_FACTOR) + quantile(FREEDOM) * gain.standard_error / gain.value
        if abs(math.log(ratio)) <= sure:
            continue
        name, factor = min(factors(gear_ratio).items(), key=lambda item: abs(math.log(ratio / item[1])))
        if abs(math.log(ratio / factor)) <= sure:
            found.append(UnitError(label, factor, name))
    return tuple(found)


def predicted_torque(fit: GainsFit, record: Record) -> tuple[Record, Floats, Floats]:
    """Rows used, logged torque (m,) and torque of the fitted law (m,) [N m], both without frequencies above `fit.band`."""
    record = record.longest_run()
    tick, channels = record.sample_time, record.channels
    position = channels.get("motor_position", channels.get("link_position"))
    reference = channels["reference"]
    assert position is not None
    if fit.velocity == "motor_velocity":
        velocity = channels["motor_velocity"]
        ahead = channels.get("reference_velocity", np.gradient(reference, tick))
    elif fit.velocity == "difference":
        velocity, ahead = (np.diff(values, prepend=values[0]) / tick for values in (position, reference))
    else:
        velocity, ahead = np.gradient(position, tick), np.gradient(reference, tick)
    rate = (ahead if fit.rate_of_error else 0.0) - velocity
    law = fit.kp.value * (reference - position) + fit.kd.value * rate
    law = np.interp(record.time - fit.lag, record.time, law)
    law += float(np.mean(channels[fit.torque] - law))  # weight and other torques that the gains do not make
    logged, law = (_smoothed(values, fit.band, tick) for values in (channels[fit.torque], law))
    return record, logged, law


def _smoothed(values: Floats, band: float, tick: float) -> Floats:
    """Values (m,) smoothed by a fourth-order low-pass of cut-off `band` [rad/s] without phase shift; mirrored at the ends."""
    padded = np.concatenate([values, values[::-1]])
    omega = 2 * np.pi * np.fft.rfftfreq(len(padded), tick)
    return np.fft.irfft(np.fft.rfft(padded) / (1 + (omega / band) ** 4), len(padded))[: len(values)]
