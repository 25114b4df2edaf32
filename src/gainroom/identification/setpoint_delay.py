"""Identification of command delay and loop delay from set-point and position alone.

A firmware turns a set-point that is T_c old into torque, and the torque reaches the motor T_l after the position that it was made from:

    J θ̈ = kp (x_d(t − T_c − T_l) − θ(t − T_l)) − kd θ̇(t − T_l) [+ kd ẋ_d(t − T_c − T_l)] − b θ̇ − friction + constant

Only T_l costs stability. Both delay the answer alike; what tells them apart is how T_l bends the response near the loop's bandwidth.
Viscous friction b is in the law, as kd may act on ẋ_d − θ̇ and b never does: left out, it looks like a tick of either delay. The position is
simulated from the set-point (an output-error fit): noise and friction then do not matter for bias, whatever their colour, as the set-point
does not know of them (Ljung, System Identification, sec. 13.4).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..errors import GainroomError
from ..system.linear.arrays import Complexes, Floats
from .estimate import FREEDOM, Estimate, interval, quantile
from .likelihood import Maximum, maximize
from .record import Record, resolution

LEAST_STEPS = 30  # of the encoder that the position must move
LEAST_CHANGES = 8
# Starts of the search. The likelihood has lesser maxima where the natural frequency is off by its width: steps of 2.4 with one ratio of
# damping ended there (2 and 7 ticks: −1.4 and 10.6; 4 and 3: 33 and 36), and the other law was taken for the log's.
NATURALS = 4.0 * 1.5 ** np.arange(11)  # rad/s
RATIOS = (0.2, 0.6)
DELAYS = (1.0, 8.0)  # ticks of each delay, a search from either: from the longer one it may miss a maximum with a delay below 0
ITERATIONS = 100  # both delays, viscous friction and kd make a valley; 40 ended on the way
SHARES = (0.3, 0.7)  # of the sum of both delays that are the loop's at other starts of the search
UNKNOWN_TICKS = 1.0  # half-width of an interval: more, and the delays are confounded
LAW_ERROR = 0.04  # ticks of either delay
UNKNOWN_TOTAL = 2.0  # ticks
LEAST_EXPLAINED = 0.8
UNLIKELY = 12.0  # of minus twice the log likelihood: a law so much worse than the other is not the log's
LEAST_POWER = 1e-3  # of the reference's, above the frequency at which it counts as ending
VISCOUS = 0.3  # of √(kp J): deviation of viscous friction, of which kd is 2ζ
NO_VISCOUS = 1e-5  # its deviation where there is none
SLOW = 0.3  # of the natural frequency
SMOOTH = 0.05  # of the root mean square velocity, over which friction's direction changes
EITHER_LAW = "the log does not tell whether kd acts on the velocity or on that of the error: the intervals hold for both"


@dataclass(frozen=True)
class SetpointDelay:
    """Delays and position loop identified from set-point and position.

    command, loop   T_c and T_l [s], each at least 0
    total           T_c + T_l [s], from set-point to torque
    confounded      True where the excitation does not tell them apart; then only `total` is measured, and the others are bounded by it
    natural_frequency, damping_ratio   √(kp/J) [rad/s] and of the loop without delay
    rate_of_error   kd acts on ẋ_d − θ̇ (True) or on −θ̇
    explained       share of the position's power, its mean apart
    sample_time     [s]
    loop_sample_time   [s] of the loop on kp and kd, whose hold and velocity difference are not in `loop`; None: they are
    warnings        what the reader should know
    """

    command: Estimate
    loop: Estimate
    total: Estimate
    confounded: bool
    natural_frequency: Estimate
    damping_ratio: float
    rate_of_error: bool
    explained: float
    sample_time: float
    loop_sample_time: float | None = None
    warnings: tuple[str, ...] = ()


def identify_setpoint_delay(record: Record, loop_sample_time: float | None = None) -> SetpointDelay:
    """Delays from `reference` and motor_position (or link_position).

    loop_sample_time   [s] of the loop on kp and kd: its torque is held that long and its velocity is a difference over it; None: it runs
                       much faster than the log, as in a drive, and hold and difference count as part of the loop delay

    Raises GainroomError where channels are missing, where set-point or position hardly move, where the set-point is so slow that neither
    delay shows, and where no such loop explains the position.
    """
    record = record.longest_run()
    side = "motor_position" if record.has("motor_position") or not record.has("link_position") else "link_position"
    reference, position = record.need("delay", "reference", side)
    changes = int(np.count_nonzero(np.diff(reference)))
    if changes < LEAST_CHANGES:
        raise GainroomError(f"delay: reference changes {changes} times, at least {LEAST_CHANGES} are needed: record steps or a multisine")
    step = resolution(position)
    if np.ptp(position) == 0 or np.ptp(position) < LEAST_STEPS * step:
        raise GainroomError(
            f"delay: {side} moves by {np.ptp(position):.3g} rad, {LEAST_STEPS} steps of its encoder ({step:.3g} rad) are needed: "
            "record larger set-points"
        )
    sampled = loop_sample_time is not None
    fits = [_Simulation(record, reference, position, follows, loop_sample_time, sampled) for follows in (False, True)]
    best, other = sorted(fits, key=lambda fit: fit.found.cost)
    others, warnings = [], []
    if not sampled:  # what hold and velocity difference may add is like viscous friction: the intervals hold with it, too
        others.append(_Simulation(record, reference, position, best.follows, None, True))
    if best.likely(other):
        others.append(other)
        warnings.append(EITHER_LAW)
    return best.result(others, warnings)


class _Simulation:
    """Simulation of the position from the set-point in the frequency domain: delays are exact, and trial parameters may be unstable."""

    def __init__(self, record: Record, reference: Floats, position: Floats, follows: bool, loop_tick: float | None, viscous: bool) -> None:
        from scipy.fft import next_fast_len

        self.tick, self.follows, self.count = record.sample_time, follows, len(position)
        self.loop_tick, held = loop_tick, loop_tick or 0.0
        self.viscous = VISCOUS if viscous else NO_VISCOUS
        self.mean, self.scale = float(position[0]), float(np.std(position))
        pad = min(self.count, int(4.0 / self.tick))
        self.size: Any = next_fast_len(self.count + pad, real=True)
        self.omega = 2 * np.pi * np.fft.rfftfreq(self.size, self.tick)
        self.position = position - self.mean
        velocity = np.gradient(position, self.tick)
        smooth = 1 / (1 + (self.omega * self.tick * 8) ** 4)
        velocity = np.fft.irfft(self._spectrum(velocity) * smooth, self.size)[: self.count]
        along = np.clip(velocity / (SMOOTH * float(np.std(velocity)) + 1e-12), -1, 1)
        # A fast loop holds set-points from tick to tick, a sampled one torques: the hold delays by half a tick and attenuates by sin x / x.
        self.hold, self.rate = _hold(self.omega, held), 1j * self.omega * _hold(self.omega, held)
        self.raw = reference - self.mean
        self.reference = self._spectrum(self.raw) * (_hold(self.omega, self.tick) if held < 0.5 * self.tick else 1.0)
        self.along = self._spectrum(along)
        self.constant = self._spectrum(np.ones(self.count))
        self.used = np.ones(self.count)
        self.used[: min(int(1.0 / self.tick), self.count // 4)] = 0.0
        self.found = self._search()

    def _spectrum(self, values: Floats) -> Complexes:
        ramp = np.linspace(values[-1], values[0], self.size - self.count)
        return np.fft.rfft(np.concatenate([values, ramp]))

    def _simulated(self, point: Floats) -> Floats:
        """Position (m,) at: log kp/J, log kd/J over √(kp/J), delays [ticks], friction/(kp scale), constant, log noise, b/√(kp J)."""
        stiffness, loop, command = math.exp(2 * point[0]), point[2] * self.tick, point[3] * self.tick
        rate = 2 * math.exp(point[1]) * math.exp(point[0])
        s = 1j * self.omega
        late = np.exp(-s * loop) * self.hold
        given = (stiffness + (rate * self.rate if self.follows else 0.0)) * late
        viscous = point[7] * math.exp(point[0]) * s
        inverse = 1 / (s * s + viscous + (stiffness + rate * self.rate) * late)
        back = stiffness * self.scale * inverse
        total = inverse * given * np.exp(-s * command) * self.reference - back * (point[4] * self.along - point[5] * self.constant)
        return np.fft.irfft(total, self.size)[: self.count]

    def _errors(self, point: Floats) -> tuple[Floats, Floats]:
        with np.errstate(all="ignore"):
            error = (self.position - self._simulated(point)) / self.scale
        return error, np.full(self.count, math.exp(2 * min(max(point[6], -20.0), 5.0)))

    def _search(self) -> Maximum:
        """Likeliest point from several starts, as the two delays compensate each other."""
        found = []
        for delay in DELAYS:
            starts = [np.array([math.log(each), math.log(ratio), delay, delay, 0, 0, -1, 0]) for each in NATURALS for ratio in RATIOS]
            powers = [float(np.mean(self._errors(start)[0][self.used > 0] ** 2)) for start in starts]
            found.append(self._maximum(starts[int(np.argmin(powers))], None))
        first = min(found, key=lambda fit: fit.cost)
        total = float(max(first.parameters[2] + first.parameters[3], 0.0))
        for share in SHARES:
            start = first.parameters.copy()
            start[2:4] = share * total, (1 - share) * total
            found.append(self._maximum(start, None))
        best = min(found, key=lambda fit: fit.cost)
        inside = [fit for fit in found if np.all(fit.parameters[2:4] > -quantile(FREEDOM) * _errors(fit)[:2])]
        # A lesser maximum is no answer where the likely one has a delay below 0: that says that the loop or the stamps are others.
        self.at_bound = not any(self._likely(best, fit) for fit in inside)
        if self.at_bound:  # no delay is negative: the best with one of them at 0, which is then not known
            inside = [self._maximum(_with(best.parameters, held), held) for held in (2, 3)]
        return min(inside, key=lambda fit: fit.cost)

    def _maximum(self, start: Floats, held: int | None) -> Maximum:
        """Maximum near `start`, with the parameter `held` at 0."""
        mean = np.array([start[0], math.log(0.6), 2.0, 2.0, 0.0, 0.0, -3.0, 0.0])
        deviation = np.array([2.0, 1.0, 20.0, 20.0, 0.5, 1.0, np.inf, self.viscous])
        if held is not None:
            mean[held], deviation[held] = 0.0, 1e-3
        return maximize(self._errors, start, self.used, np.stack([mean, deviation**-2.0]), ITERATIONS)

    def likely(self, other: "_Simulation") -> bool:
        """True if another law is not much less likely, with noise as coloured as it is."""
        return self._likely(self.found, other.found)

    def _likely(self, best: Maximum, other: Maximum) -> bool:
        coloured = max(float(best.variance[2, 2] / np.linalg.pinv(best.information, hermitian=True)[2, 2]), 1.0)
        return float((other.cost - best.cost) * self.used.sum()) < UNLIKELY * coloured

    def delays(self) -> tuple[Estimate, Estimate, Estimate]:
        """Estimates of T_l, T_c and their sum [ticks]."""
        loop, command = self.found.parameters[2:4]
        errors = _errors(self.found)
        return _bounded(loop, errors[0], math.inf), _bounded(command, errors[1], math.inf), _bounded(loop + command, errors[2], math.inf)

    def result(self, others: Sequence["_Simulation"], warnings: Sequence[str]) -> SetpointDelay:
        """Result with intervals over the laws `others`, too, that the log allows; confounded delays are bounded by their sum."""
        point, variance = self.found.parameters, self.found.variance
        rows = self.used > 0
        explained = 1 - float(np.mean(self.found.errors[rows] ** 2)) / float(np.var(self.position[rows]) / self.scale**2)
        if explained < LEAST_EXPLAINED:
            raise GainroomError(
                f"delay: a loop with two delays explains {100 * max(explained, 0):.0f} % of the position; look at the columns"
            )
        power = np.abs(np.fft.rfft(self.raw - self.raw.mean())) ** 2
        share = np.cumsum(power[::-1])[::-1] / power.sum()
        fastest = 2 * math.pi * float(np.fft.rfftfreq(self.count, self.tick)[int(np.argmin(share > LEAST_POWER))])
        if fastest < SLOW * math.exp(point[0]):
            raise GainroomError(
                f"delay: the reference's power ends at {fastest / 2 / math.pi:.2g} Hz and the loop's natural frequency is about "
                f"{math.exp(point[0]) / 2 / math.pi:.2g} Hz: so slow a motion shows no delay; record steps or a multisine up to there"
            )
        own = self.delays()[2]
        if not own.high > 0:
            raise GainroomError(
                f"delay: the position is {-(point[2] + point[3]):.2g} ± {quantile(FREEDOM) * own.standard_error:.2g} ticks ahead of what "
                "set-points without delay would make of it: elasticity, friction or a torque limit hides the delay; record the torque"
            )
        # The sum, too: the wrong law puts it elsewhere, by 0.1 to 1.2 ticks on simulated logs, with an interval of mostly ± 0.04.
        loop, command, total = (_over(each) for each in zip(self.delays(), *(other.delays() for other in others), strict=True))
        if total.half_width > UNKNOWN_TOTAL:
            raise GainroomError(
                f"delay: set-point and position tell the sum of the delays to ± {total.half_width:.2g} ticks only: record steps or a "
                "multisine up to the loop's natural frequency and beyond, or the torque"
            )
        loop, command = (replace(each, value=min(each.value, total.value)) for each in (loop, command))
        confounded = self.at_bound or max(loop.half_width, command.half_width) > UNKNOWN_TICKS
        if confounded:
            loop, command = _bounded(point[2], math.inf, total.high), _bounded(point[3], math.inf, total.high)
            warnings = (
                f"command delay and loop delay confounded: the log tells their sum, {total.value:.2f} ticks ({total.low:.2f} to "
                f"{total.high:.2f}); to tell them apart excite up to the loop's bandwidth and beyond, or record the torque",
                *warnings,
            )
        tick = self.tick
        return SetpointDelay(
            command.scaled(tick), loop.scaled(tick), total.scaled(tick), confounded,
            interval(math.exp(point[0]), math.exp(point[0]) * float(variance[0, 0] ** 0.5), FREEDOM), math.exp(point[1]), self.follows,
            explained, tick, self.loop_tick, tuple(warnings),
        )  # fmt: skip


def _errors(fit: Maximum) -> Floats:
    """Standard errors (3,) of T_l, T_c and their sum [ticks]."""
    # Friction and torque limits are not in the model to the last: they trade one delay for the other before they change the sum.
    variance = fit.variance[2:4, 2:4] + LAW_ERROR**2 * np.array([[1.0, -0.9], [-0.9, 1.0]])
    return np.sqrt([variance[0, 0], variance[1, 1], variance.sum()])


def _over(each: Sequence[Estimate]) -> Estimate:
    """First estimate, with an interval over all."""
    return replace(each[0], low=min(one.low for one in each), high=max(one.high for one in each))


def _with(point: Floats, held: int) -> Floats:
    moved = point.copy()
    moved[held] = 0.0
    return moved


def _hold(omega: Floats, time: float) -> Complexes:
    """Response (1 − e^{−jωT})/(jωT) of a hold, or a difference, over `time` T [s]."""
    return np.exp(-0.5j * omega * time) * np.sinc(omega * time / (2 * np.pi))


def _bounded(value: float, error: float, high: float) -> Estimate:
    found = interval(float(value), float(error), FREEDOM)
    value, low, upper = np.clip([found.value, found.low, found.high], 0.0, high).tolist()
    return Estimate(value, low, upper, float(error))
