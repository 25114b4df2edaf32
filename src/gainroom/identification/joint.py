"""Identification of a joint from torque and position by maximum likelihood: inertias, stiffness, damping, friction and delay.

The search starts from the measured frequency response and ends at the joint, the noise and the friction under which the log is likeliest.
Predictions are made row by row (prediction.py), so that a feedback loop that was closed while the log was recorded does no harm: what the
controller did is in the torque, and the error of a prediction is independent of it (likelihood.py).
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ..errors import GainroomError
from ..system.drive import Drive
from ..system.elastic_joint import ElasticJoint
from ..system.linear.arrays import Complexes, Floats
from .clipping import Limited, limited_rows, limited_text
from .contradictions import encoders_apart
from .delay import TorqueDelay, identify_delay
from .estimate import BLOCKS, FREEDOM, Estimate, log_interval, quantile
from .excited_part import most_excited
from .frequency_response import FrequencyResponse, Rough, fine_response, fitted_response, frequency_response, given_torque, rough_joint
from .friction_estimates import damping_beside_friction, friction_not_below_zero, viscous_beside_friction
from .joint_model import JointModel, Prior
from .likelihood import Maximum, maximize
from .motion import NO_WEIGHT, STRIBECK_VELOCITIES, motion_of
from .prediction import UNKNOWN, Between, Signals, prediction_errors
from .record import Record, resolution
from .residuals import Residuals, residual_tests
from .rivals import Rival, rivals_of, rivals_text
from .torque_balance import Spectra, acting_torque, through_drive, torque_balance

FITTED_ROWS = 60_000  # of a long log, the most excited: what is left is then friction's law, not noise
ROUGH_ROWS = 10_000  # of a long log, on which the search begins and models are compared
LEAST_OVER_FRICTION = 3.0  # torque; at 1.5 the inertias of a virtual joint were a tenth off, at 5 none beyond its interval
LEAST_STEPS = 30  # of the encoder that the motor must move
LEAST_LINES = 12  # of the spectrum, at which the torque must explain the motion
MOST_RELATIVE = 0.2  # standard error of log K, above which the log does not tell the stiffness
MOST_INERTIA = 0.1  # standard error of the logarithm of inertia
DELAY_FLOOR = 0.02  # ticks: what torque logged once a tick knows of the delay at best
# Every law of friction is inexact, and its error repeats with the motion, so that no average over time removes it. The share of
# the residual that the torque explains shows how much is left. Sized on virtual joints with Stribeck friction on both sides (tests).
MODEL_ERROR, MODEL_ERROR_EXPLAINED = 0.0007, 0.007  # of inertias and stiffness
USUAL_LAG = 1.5  # ticks of a hold and a current loop
MOST_DIFFERENT = 0.003  # of the torque's power, in which the command is not the torque: inertias would be some 5 % off
MOST_GAIN = 0.03  # from 1, of a drive: more moves inertias by as much
CUT_DELAY = 0.2  # ticks: what the corners of a command that is cut know of the delay; 0.15 off in simulated logs
SETTLES, MOST_TAPS = 0.02, 40  # [s] and rows in which a command arrives
UNUSED = 0.1  # of its motion: an encoder's noise from which on it tells nothing
INERTIAL = "motor_inertia", "link_inertia", "inertia", "stiffness"
HELD = 1e12  # information: as good as known
MEMORY, FEWEST_BLOCKS = 3.0, 10  # periods that a residual remembers, and blocks of them
MOST_AHEAD = 1.0  # ticks: a delay that is this far below 0 is none
SEARCHED = 8.0  # ticks of delay, where no torque log tells it


@dataclass(frozen=True)
class JointFit:
    """Joint identified from a log.

    model        "rigid", "two-mass" or "two-mass with friction"
    parameters   by name, as far as the model has them: motor_inertia, link_inertia, of a rigid joint inertia [kg m²], stiffness [N m/rad],
                 damping, viscous [N m s/rad], coulomb, link_coulomb, weight_sine, weight_cosine [N m], delay [s], resonance,
                 antiresonance [rad/s]
    names, covariance   (p,), (p, p) of the parameters that were fitted, SI
    joint, drive   the best values; `parameters` have the delay that the torques tell, and the damping with what friction may hide
    torque       the channel that drove the fit
    measured     frequency response from that torque to the acceleration of the measured side, by what feedback did not make of the torque
    residuals    of the fit, and what they say of the model
    delay        what the torques say of the delay; None where they say nothing
    sample_time  [s]
    used         first and last moment of the part of the log that was fitted [s]
    rivals       models that explain the log much better, the best first; looked for where the fit is not adequate
    warnings     what the reader should know
    """

    model: str
    parameters: Mapping[str, Estimate]
    names: tuple[str, ...]
    covariance: Floats
    joint: ElasticJoint
    drive: Drive
    torque: str
    measured: FrequencyResponse
    residuals: Residuals
    delay: TorqueDelay | None
    sample_time: float
    used: tuple[float, float]
    rivals: tuple[Rival, ...] = ()
    warnings: tuple[str, ...] = ()

    @property
    def adequate(self) -> bool:
        """True if little of the torque is unexplained, and nothing important in the residuals can be explained (residuals.py)."""
        return self.residuals.adequate

    def response(self, omega: Floats) -> Complexes:
        """Response of the fit like `measured`: torque → acceleration at `omega` (k,) [rad/s], with hold, current loop and delay."""
        return fitted_response(omega, self.joint, self.drive, self.sample_time, self.torque == "target_torque")


def identify_joint(record: Record, drive: Drive | None = None) -> JointFit:
    """Identified joint from the motor's position, and the link's if both are logged.

    The link's alone tells J_M + J_L and the resonance, whose J_M J_L/K nothing there takes apart.

    The link's alone tells J_M + J_L and the resonance, whose J_M J_L/K nothing there takes apart.

    drive   what is known of delay and current loop; None: both come from the torques, as far as they are logged

    Raises GainroomError where channels are missing, where nothing moves, and where the torque does not excite the joint enough; the message
    says what to record.
    """
    record = most_excited(record.longest_run(), FITTED_ROWS)
    if not record.has("motor_position") and record.has("link_position"):
        raise GainroomError(
            "joint: needs motor_position: link_position alone tells the sum of both inertias and the resonance, not how J_M, J_L and K "
            "make them"
        )
    record.need("joint", "motor_position")
    record.first_of("joint", "actual_torque", "target_torque")
    warnings: list[str] = []
    source = _source(record, drive, warnings)
    _require_motion(record, source.torque)
    measured, seen = _responses(record, source)
    return _selected(record, source, measured, seen, warnings)


@dataclass(frozen=True)
class _Source:
    """Torque that drives the fit.

    name, torque   the channel
    sampled        it is the torque itself, not its command
    drive          between command and torque
    prior          mean and deviation of the delay [ticks]; None: fixed
    delays         (d,) [s] from torque to motion that the rough search tries
    torques        what they say of the delay
    known          drive between command and torque, where the torque itself drives the fit and its command is logged, too
    """

    name: str
    torque: Floats
    sampled: bool
    drive: Drive
    prior: tuple[float, float] | None
    delays: Floats
    torques: TorqueDelay | None
    known: Drive | None = None


def _source(record: Record, drive: Drive | None, warnings: list[str]) -> _Source:
    tick = record.sample_time
    if not record.has("target_torque"):
        return _Source("actual_torque", record.channels["actual_torque"], True, Drive(), None, np.zeros(1), None)
    target = record.channels["target_torque"]
    limited = limited_rows(record, "actual_torque" if record.has("actual_torque") else "target_torque")
    torques = _torques(record, limited, warnings) if drive is None and record.has("actual_torque") else None
    known = _drive_of(torques) if torques is not None and torques.lag is not None else drive
    if record.has("actual_torque") and _differs(record):
        what = "actual_torque is not what a delay and a current loop make of target_torque: the joint is fitted to actual_torque"
        warnings.extend(limited_text(limited, "is what the joint is fitted to") or [what])
        return _Source("actual_torque", record.channels["actual_torque"], True, Drive(), None, np.zeros(1), torques, known)
    warnings.extend(limited_text(limited, "is taken for what the joint got"))
    if drive is not None:
        lag = drive.delay + (0.0 if drive.is_ideal else 2 * drive.damping_ratio / drive.bandwidth) + tick / 2
        return _Source("target_torque", target, False, drive, None, np.array([lag]), None)
    if torques is None or torques.lag is None or known is None:
        warnings.append("no torque log tells the current loop: it is fitted to the motion, which hardly tells it from a delay")
        prior = (SEARCHED / 4, math.inf)
        return _Source("target_torque", target, False, Drive(), prior, tick * (0.5 + np.arange(0.0, SEARCHED, 0.5)), None)
    warnings.extend(torques.warnings)
    prior = known.delay / tick, math.hypot(torques.lag.standard_error / tick, DELAY_FLOOR)
    return _Source("target_torque", target, False, known, prior, np.array([torques.lag.value + tick / 2]), torques)


def _torques(record: Record, limited: Limited, warnings: list[str]) -> TorqueDelay | None:
    """Delay from the torques, with the command clipped at its limits; None if they do not tell it, with a warning."""
    low, high = (bound if math.isfinite(bound) else far for bound, far in ((limited.low, -math.inf), (limited.high, math.inf)))
    target = np.clip(record.channels["target_torque"], low, high)
    try:
        return identify_delay(Record(record.time, {**record.channels, "target_torque": target}, record.sample_time))
    except GainroomError as error:
        warnings.append(str(error) if _differs(record) else f"{error}; the delay is fitted to the motion")
        return None


def _drive_of(torques: TorqueDelay) -> Drive:
    """Drive with delay and current loop as a joint feels them."""
    assert torques.lag is not None
    assert torques.bandwidth is not None
    assert torques.damping_ratio is not None
    delay = torques.effective.value
    if math.isinf(torques.bandwidth.high):  # any of a tick: the one that with this bandwidth has the lag that is measured
        delay = max(delay - torques.delay.value + torques.lag.value - 2 * torques.damping_ratio.value / torques.bandwidth.value, 0.0)
    return Drive(torques.bandwidth.value, torques.damping_ratio.value, delay)


def _differs(record: Record) -> bool:
    """True if actual_torque differs from every delayed and filtered target_torque, with gain 1, by more than white noise."""
    target, actual = record.channels["target_torque"], record.channels["actual_torque"]
    taps = min(math.ceil(SETTLES / record.sample_time), MOST_TAPS)
    columns = np.column_stack([np.lib.stride_tricks.sliding_window_view(target, taps), np.ones(len(target) - taps + 1)])
    factors = np.linalg.lstsq(columns, actual[taps - 1 :], rcond=1e-10)[0]
    rest = actual[taps - 1 :] - columns @ factors
    noise = float(np.mean(np.diff(rest, 3) ** 2)) / 20  # third differences of white noise have 20 times its power
    gain = abs(float(factors[:-1].sum()) - 1) if np.mean(target) ** 2 < np.var(target) else 0.0
    return float(np.var(rest)) - noise > MOST_DIFFERENT * float(np.var(actual)) or gain > MOST_GAIN


def _responses(record: Record, source: _Source) -> tuple[FrequencyResponse, FrequencyResponse]:
    """Measured response, and that to the part of the torque that feedback did not make; of all lines if averages are too coarse.

    Raises GainroomError where neither tells enough frequencies.
    """
    position, tick = record.channels["motor_position"], record.sample_time
    given, lines, what = given_torque(source.torque, position), 0, ""
    own = "is excitation of its own, more than what feedback makes of the position,"
    for response in (frequency_response, fine_response):
        measured, seen = response(source.torque, position, tick), response(source.torque, position, tick, given)
        # A loop that rings makes the torque at its own frequency far stronger than the excitation is: not so what feedback did not make.
        if measured.frequencies >= LEAST_LINES <= seen.lines:
            return measured, seen
        lines, what = min((measured.frequencies, "drives the motion"), (seen.lines, own))
    raise GainroomError(
        f"joint: {source.name} {what} at {lines} frequencies; {LEAST_LINES} are needed: record a multisine or chirp of torque, "
        "well above friction, from below the antiresonance to above the resonance (gainroom identify plan makes one), or for longer than "
        f"{len(position) * tick:.3g} s"
    )


def _require_motion(record: Record, torque: Floats) -> None:
    for name in ("motor_position", "link_position"):
        if not record.has(name):
            continue
        values = record.channels[name]
        step = resolution(values)
        if np.ptp(values) == 0 or np.ptp(values) < LEAST_STEPS * step:
            raise GainroomError(
                f"joint: {name} moves by {np.ptp(values):.3g} rad, {LEAST_STEPS} steps of its encoder ({step:.3g} rad) are needed: "
                "record with a larger torque"
            )
    if np.ptp(torque) == 0:
        raise GainroomError("joint: the torque does not change: record a multisine or chirp of torque, well above friction")


def _selected(record: Record, source: _Source, measured: FrequencyResponse, seen: FrequencyResponse, warnings: list[str]) -> JointFit:
    """Selected model: two masses with friction, unless the log needs less."""
    tick = record.sample_time
    rough = rough_joint(measured, tick, source.delays, elastic=True)
    if rough.opposite:
        raise GainroomError(f"joint: the motion goes against {source.name}: turn the sign of one of the two columns")
    stiff = rough_joint(measured, tick, source.delays, elastic=False)
    full = _Fitting(record, source, rough, elastic=True, friction=True)
    whole = full.short() if full.short().converged else full.again()
    if _unknown(whole):  # feedback may have made most of the torque; what it did not make shows another joint
        other = _Fitting(record, source, rough_joint(seen, tick, source.delays, elastic=True), elastic=True, friction=True)
        full = min((full, other), key=lambda fitting: fitting.short().cost)
        whole = full.short()
    rigid = _Fitting(record, source, stiff, elastic=False, friction=True)
    rows = len(whole.errors)
    if _unknown(whole) or _criterion(rigid.short(), rows) < _criterion(whole, rows):
        warnings.append(
            f"no resonance is found between {measured.omega[measured.excited][0] / 2 / math.pi:.3g} and "
            f"{measured.omega[measured.excited][-1] / 2 / math.pi:.3g} Hz: the joint is fitted as rigid; to find its stiffness "
            "excite higher frequencies, up to a fifth of the tick rate"
        )
        return rigid.result("rigid", measured, seen, warnings)
    free = _Fitting(record, source, rough, elastic=True, friction=False)
    if _criterion(free.short(full), rows) < _criterion(whole, rows):
        return free.result("two-mass", measured, seen, warnings)
    return full.result("two-mass with friction", measured, seen, warnings)


def _unknown(fit: Maximum) -> bool:
    """True if a fit of two masses leaves the stiffness undetermined."""
    return bool(fit.variance[2, 2] ** 0.5 > MOST_RELATIVE)


def _criterion(fit: Maximum, rows: int) -> float:
    """Bayesian information criterion (Schwarz 1978), per row."""
    return fit.cost + len(fit.parameters) * math.log(rows) / rows


class _Fitting:
    """Fit of one model to one log."""

    def __init__(self, record: Record, source: _Source, rough: Rough, elastic: bool, friction: bool) -> None:
        self.record, self.source = record, source
        names = [name for name in ("motor_position", "link_position") if record.has(name)]
        self.positions = np.column_stack([record.channels[name] for name in names])
        self.model = JointModel.of(
            source.torque, self.positions, source.drive, record.sample_time, elastic, friction,
            (source.prior is not None, source.prior is not None and source.torques is None, source.sampled),
        )  # fmt: skip
        self.signals = self._signals(rough.joint)
        searched = source.prior is not None and len(source.delays) > 1
        start = rough.delay - USUAL_LAG * record.sample_time if searched else source.drive.delay
        self.start = self.model.start(rough.joint, max(start, 0.0), self.signals)
        self.prior = self.model.prior(self.start, source.prior)
        self._short: Maximum | None = None

    def _signals(self, joint: ElasticJoint, weight: Floats = NO_WEIGHT, cautious: float = 0.0) -> Signals:
        linked = self.positions.shape[1] == 2
        motion = motion_of(self.positions, linked, self.record.sample_time, joint, cautious, weight)
        return Signals(self.source.torque, self.source.sampled, self.positions, motion, self.record.sample_time)

    def reduced(self, other: "_Fitting") -> Floats:
        """Point of `other`'s short fit, reduced to the parameters of this model."""
        found = dict(zip(other.model.names, other.short().parameters, strict=True))
        return np.array([found[name] for name in self.model.names])

    def short(self, like: "_Fitting | None" = None) -> Maximum:
        """Fit of the middle of a long log; `like`: a richer model, from whose maximum the search starts."""
        if self._short is None:
            start, iterations = (self.start, 25) if like is None else (self.reduced(like), 8)
            self._short = likeliest(self.model, self._middle, start, self.prior, iterations)
        return self._short

    @property
    def _middle(self) -> Signals:
        first = max(len(self.source.torque) - ROUGH_ROWS, 0) // 2
        return self.signals.rows(slice(first, first + ROUGH_ROWS))

    def again(self) -> Maximum:
        """Fit from noise and friction that suit the rough joint, if the search from the least possible noise has not converged."""
        mean, information = self.prior
        held = np.where(np.isin(self.model.names, INERTIAL), HELD, information)
        first = likeliest(self.model, self._middle, self.start, (mean, held), 25)
        found = likeliest(self.model, self._middle, first.parameters, self.prior, 25)
        self._short = min(self.short(), found, key=lambda fit: fit.cost)
        return self._short

    def result(self, name: str, measured: FrequencyResponse, seen: FrequencyResponse, warnings: list[str]) -> JointFit:
        """Result on the whole log; `measured`: response to the torque, `seen`: to the part that feedback did not make."""
        best = self.short()
        joint, _, friction, *_ = self.model.parts(best.parameters)
        self.signals = self._signals(joint, weight := friction[3:])
        best = self._not_ahead(likeliest(self.model, self.signals, best.parameters, self.prior, 30))
        joint, drive, friction, noise, between = self.model.parts(best.parameters)
        # The fit under another law of friction is as likely: the difference is a deviation that no amount of data averages out.
        # The wider law is one that the fitted friction stands for, so that it says nothing of the friction's own numbers.
        variance, inertial = best.variance_of(self._blocks(joint)), np.isin(self.model.names, INERTIAL)
        for velocity in STRIBECK_VELOCITIES:
            other = likeliest(self.model, self._signals(joint, weight, velocity), best.parameters, self.prior, 1)
            difference = np.where(inertial | (velocity == STRIBECK_VELOCITIES[0]), other.parameters - best.parameters, 0.0)
            variance = variance + np.outer(difference, difference)
        variance = variance + self.model.weight_error(best.parameters, best.variance, float(np.std(self.positions[:, 0])))
        balance = torque_balance(Spectra(self.signals, measured), joint, drive, between, noise, friction[:2])
        tests = residual_tests(best.errors, best.variances, self.signals, measured, balance)
        rivals = () if tests.adequate else self._rivals(drive, between, measured)
        warnings = [*warnings, *([rivals_text(rivals)] if rivals else [])]
        law = MODEL_ERROR + MODEL_ERROR_EXPLAINED * tests.explained
        variance = variance + self.model.law_error(best.parameters, law, float(measured.omega[measured.excited][-1]))
        physical = self.model.physical
        errors = np.sqrt(np.diag(variance))
        self._require_told(float(errors[0] if name == "rigid" else np.hypot(errors[0], errors[1])), tests, rivals)
        apart = encoders_apart(self.positions)
        if apart and noise.readings[-1] > UNUSED * np.std(self.positions[:, -1]):
            warnings = [*warnings, f"the fit makes no use of link_position: {apart[0].lower()}{apart[1:]}"]
        parameters = self.model.estimates(best.parameters, variance)
        if name != "rigid":
            parameters |= resonances(best.parameters, variance)
        # A wrong model's delay and friction hold whatever else it does not explain.
        _refuse_impossible(parameters, self.record.sample_time, delayed=not rivals)
        if not (rivals or tests.follows or tests.repeats):
            self._require_over_friction(parameters)
        scale = self.model.slopes(best.parameters)
        covariance = variance[: len(physical), : len(physical)] * np.outer(scale, scale)
        if self.source.torques is not None and self.source.torques.lag is not None:
            delay = self.source.torques.effective  # the fit's: what remains of it beside a held current loop
            if self.source.sampled:
                rough = CUT_DELAY * self.record.sample_time
                delay = Estimate(delay.value, max(delay.low - rough, 0.0), delay.high + rough, math.hypot(delay.standard_error, rough / 2))
            parameters["delay"] = delay
            if "delay" in physical:
                place = physical.index("delay")
                covariance[place] = covariance[:, place] = 0.0
                covariance[place, place] = (delay.half_width / quantile(FREEDOM)) ** 2
        if not best.converged and tests.explained:
            warnings = [*warnings, "the search has not settled: values may be off by more than their intervals; look at the log's columns"]
        if self.model.elastic and self.model.friction:
            beside, note = damping_beside_friction(parameters, self.signals.motion.speed)
            place = physical.index("damping")
            covariance[place, place] += beside.standard_error**2 - parameters["damping"].standard_error ** 2
            parameters["damping"], warnings = beside, [*warnings, *note]
        parameters, note = friction_not_below_zero(parameters)
        if self.model.friction:
            wider, place = viscous_beside_friction(parameters, self.signals.motion.speed), physical.index("viscous")
            covariance[place, place] += wider.standard_error**2 - parameters["viscous"].standard_error ** 2
            parameters["viscous"] = wider
        return JointFit(
            name, parameters, physical, covariance, joint, self.source.known or drive, self.source.name, seen, tests, self.source.torques,
            self.record.sample_time, (float(self.record.time[0]), float(self.record.time[-1])), rivals, (*warnings, *note),
        )  # fmt: skip

    def _not_ahead(self, best: Maximum) -> Maximum:
        """Maximum with the delay fixed at 0 if the best delay is slightly below 0, which cannot be simulated; else `best`."""
        if "delay" not in self.model.names:
            return best
        place = self.model.names.index("delay")
        if not -MOST_AHEAD < best.parameters[place] < 0:
            return best
        point = np.where(np.arange(len(best.parameters)) == place, 0.0, best.parameters)
        return likeliest(self.model, self.signals, point, self.prior, 0)

    def _blocks(self, joint: ElasticJoint) -> int:
        """Number of blocks of time that are at least MEMORY periods of the slower resonance, as long as the residual is correlated."""
        if not math.isfinite(joint.stiffness):
            return BLOCKS
        periods = len(self.source.torque) * self.record.sample_time * joint.antiresonance / (2 * math.pi)
        return int(np.clip(periods / MEMORY, FEWEST_BLOCKS, BLOCKS))

    def _rivals(self, drive: Drive, between: Between, measured: FrequencyResponse) -> tuple[Rival, ...]:
        """Models that explain the middle of the log better."""
        middle = self._middle
        first = max(len(self.source.torque) - ROUGH_ROWS, 0) // 2
        made = None if middle.sampled else lambda command: through_drive(command, drive, middle.sample_time)
        begin = float(self.record.time[first])
        return tuple(rivals_of(Spectra(middle, measured), acting_torque(middle, drive, between), made, begin))

    def _require_told(self, inertia: float, tests: Residuals, rivals: Sequence[Rival]) -> None:
        """Raise GainroomError if the log does not tell the whole inertia, of relative error `inertia`, or its channels disagree.

        Not where `rivals` say why: that is the answer.
        """
        apart = encoders_apart(self.positions)
        if rivals and not apart:
            return
        if inertia > 2 * MOST_INERTIA and not tests.adequate:
            raise GainroomError(
                f"joint: neither a rigid nor a two-mass joint with a linear spring explains the motion: {self.source.name} still explains "
                f"{100 * tests.explained:.0f} % of what is left; "
                + (apart or "look whether the position is that of the motor, and record without limits on the torque")
            )
        if apart and not tests.adequate:
            raise GainroomError(f"joint: {apart}")
        if inertia > 2 * MOST_INERTIA:
            raise GainroomError(
                f"joint: the log tells the inertia to ± {100 * quantile(FREEDOM) * inertia:.0f} % only: record a multisine or chirp of "
                "torque, well above friction, at frequencies where the joint still moves by many steps of its encoder"
            )

    def _require_over_friction(self, parameters: Mapping[str, Estimate]) -> None:
        """Raise GainroomError if friction takes too much of the torque."""
        dry = sum(abs(parameters[side].value) for side in ("coulomb", "link_coulomb") if side in parameters)
        size = float(np.std(self.source.torque))
        if size < LEAST_OVER_FRICTION * dry:
            raise GainroomError(
                f"joint: the torque, {size:.3g} N·m (root mean square), is {size / dry:.2g} times Coulomb friction, {dry:.3g} N·m; "
                f"{LEAST_OVER_FRICTION:g} times are needed, as no law of friction is exact: record a larger torque, on top of slow motion"
            )


def _refuse_impossible(parameters: Mapping[str, Estimate], tick: float, delayed: bool) -> None:
    """Raise GainroomError for a resonance above half the tick rate and, if the delay is the joint's (`delayed`), for one below 0."""
    resonance, delay, highest = parameters.get("resonance"), parameters.get("delay"), math.pi / tick
    explains = "no joint explains this motion; look at signs, units and columns, and whether rows are left out"
    if resonance is not None and resonance.value > highest:
        seen, most = (omega / 2 / math.pi for omega in (resonance.value, highest))
        raise GainroomError(f"joint: the resonance that fits, {seen:.3g} Hz, is above half the tick rate, {most:.4g} Hz: {explains}")
    if delayed and delay is not None and delay.high < -tick:
        raise GainroomError(f"joint: the delay that fits, {1e3 * delay.value:.3g} ms, is negative: {explains}")


def likeliest(model: JointModel, signals: Signals, start: Floats, prior: Prior, iterations: int) -> Maximum:
    """Maximum of `model` near `start` (p,) for `signals`. Raises GainroomError if nothing is predicted."""

    def predict(point: Floats) -> tuple[Floats, Floats]:
        try:
            errors, variances = prediction_errors(signals, *model.parts(point))
        except (np.linalg.LinAlgError, GainroomError, OverflowError, ValueError):
            return np.full(signals.positions.size, np.inf), np.ones(signals.positions.size)
        return errors.ravel(), variances.ravel()

    used = np.ones(signals.positions.shape)
    used[: min(UNKNOWN, len(used) // 3)] = 0.0
    try:
        return maximize(predict, start, used.ravel(), np.stack(prior), iterations)
    except np.linalg.LinAlgError as error:
        raise GainroomError("joint: no such joint explains the motion: look at signs, units and columns") from error


def resonances(point: Floats, variance: Floats) -> dict[str, Estimate]:
    """Resonance and antiresonance from log J_M, log J_L, log K, the first three of the point."""
    motor, link, stiffness = np.exp(point[:3])
    share = motor / (motor + link)  # ω_r² = K (1/J_M + 1/J_L)
    towards = {"resonance": 0.5 * np.array([share - 1, -share, 1.0]), "antiresonance": 0.5 * np.array([0.0, -1.0, 1.0])}
    values = {"resonance": math.sqrt(stiffness * (1 / motor + 1 / link)), "antiresonance": math.sqrt(stiffness / link)}
    errors = {name: float(np.sqrt(direction @ variance[:3, :3] @ direction)) for name, direction in towards.items()}
    return {name: log_interval(values[name], error, FREEDOM) for name, error in errors.items()}
