"""Delayed PD torque on elastic joints, beside a simulator that moves the links: the model of an actuator in a trainer.

A simulator steps the links every dt, with a torque that it holds meanwhile. Between two of its steps this module moves what is in front of
the links: encoders that are sampled, commands that arrive late, current loops, rotors on gearbox springs.

**Paths.** A path samples its encoder every `period` and makes u = kp (x_d − y_k) + kd (ẋ_d − (y_k − y_{k−1})/period) of it, which the motor
has from `delay` on, until the next command comes. kp and kd share the path, or kd has one of its own. Delays may be any fraction of a
period, and jitter adds to each command's its own; a command that a later one overtook is dropped, as in system/jitter_margin.py.

**Substeps.** dt is divided into substeps h, of which every period is a multiple. In a substep commands enter as the straight line that has
their mean and their first moment, so that a fraction of a substep counts; rotor and current loop are then integrated exactly, with one
matrix exponential, and friction is the constant torque that would bring the rotor to rest, as far as it reaches.

**Links.** The joint's torque is the mean of the spring's over dt, so that no momentum is lost. Within dt the link moves as its own inertia
has it under that torque. Where it begins is not q: semi-implicit Euler, v' = v + dt a and q' = q + dt v', has q − v dt/2 follow the
trapezoidal rule, ∫v = dt (v + v')/2, whose error is −dt²/12 times the difference of the accelerations, and is taken back. Of an elastic
joint the acceleration is that of the spring, so that the correction is −dt²/12 a; of a rigid one, whose torque jumps, errors of steps are
summed, and forgotten over FORGOTTEN. Of the other torques on a link (weight, contacts) it is assumed that they balance the joint's on
average over AVERAGED, so that a link at rest is at rest within a step.

A single joint is then as exact as its link's inertia is known. Errors of an inertia that is off, as other joints and postures make it, are
of the order (Ω dt)², Ω = √(K/J_link): with none given they are those of the leapfrog scheme, which explodes at Ω dt = 2.

Nothing here needs torch: arrays are made and counted by a Library.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np
from scipy.linalg import expm

from ..errors import GainroomError, require_positive
from ..system.feedback import SIDES, Side
from ..system.linear.arrays import Floats

DAMPING_RATIO = 0.9
"""Damping ratio of a current loop, that of system/drive.py."""
MOST_SUBSTEPS = 100
"""Most substeps in a step of the simulator."""
AVERAGED, FORGOTTEN = 0.5, 0.2
"""Times [s] that are long beside a vibration and short beside a posture."""
LONGEST = 2.0
"""Ω dt at which links explode that are stepped explicitly; with an inertia that is right to a factor 1.6 it is higher."""
EQUAL = 1e-9
"""Relative deviation from a ratio of whole numbers that counts as rounding."""


@dataclass(frozen=True)
class Library:
    """Arrays that the model runs on.

    functions   numpy or torch: clip, einsum, minimum and where are called
    array       array of doubles, of an array or a number
    uniform     random array in [0, 1) of a shape
    """

    functions: Any
    array: Callable[[Any], Any]
    uniform: Callable[[tuple[int, ...]], Any]

    @classmethod
    def numpy(cls, seed: int = 0) -> "Library":
        """Library of numpy's arrays."""
        return cls(np, lambda values: np.asarray(values, dtype=float), np.random.default_rng(seed).random)

    @classmethod
    def torch(cls, device: str, seed: int = 0) -> "Library":
        """Library of torch's tensors on a device. Raises ImportError where torch is not installed."""
        import torch  # pyright: ignore[reportMissingImports] - trainers bring it, gainroom does not need it

        kind: dict[str, Any] = {"dtype": torch.float64, "device": device}
        drawn = torch.Generator(device=device)
        drawn.manual_seed(seed)
        return cls(torch, lambda values: torch.as_tensor(values, **kind), lambda shape: torch.rand(shape, generator=drawn, **kind))


@dataclass(kw_only=True)
class ElasticDelayed:
    """Numbers of an actuator, of all joints of a group; on the joint's side of the gearbox, SI. Trainers' configurations inherit them.

    motor_inertia       rotor inertia × gear ratio² [kg m²]
    gearbox_stiffness   inf: rigid [N m/rad]
    gearbox_damping     [N m s/rad]
    friction, viscous   of the motor: Coulomb friction [N m], viscous friction [N m s/rad]
    delay               of a command, from the encoder's sample to the torque [s]
    jitter              width of the range of uniform draws that add to the delay of each command [s]
    period              between two samples of the encoder [s]
    kd_delay, kd_period   of kd where it closes on a path of its own, as in the drive [s]; None: as kp
    encoder             side of the gearbox that the gains measure: "motor" or "link"
    bandwidth           of the current loop, with a damping ratio of 0.9; inf: ideal [rad/s]
    seed                of the jitter
    """

    motor_inertia: float
    gearbox_stiffness: float = math.inf
    gearbox_damping: float = 0.0
    friction: float = 0.0
    viscous: float = 0.0
    delay: float
    jitter: float = 0.0
    period: float
    kd_delay: float | None = None
    kd_period: float | None = None
    encoder: Side = "motor"
    bandwidth: float = math.inf
    seed: int = 0

    @property
    def is_rigid(self) -> bool:
        """True if the rotor moves with the link, whose armature it then is."""
        return math.isinf(self.gearbox_stiffness)

    @property
    def is_split(self) -> bool:
        """True if kd closes on a path of its own."""
        return self.kd_delay is not None or self.kd_period is not None

    def require_physical(self, owner: str) -> None:
        """Raise GainroomError, which begins with `owner`, for a value that is not physical."""
        units = {"gearbox_damping": "N·m·s/rad", "friction": "N·m", "viscous": "N·m·s/rad", "delay": "s", "jitter": "s"}
        require_positive(owner, "motor_inertia", self.motor_inertia, "kg·m²", zero=self.is_rigid)
        require_positive(owner, "gearbox_stiffness", self.gearbox_stiffness, "N·m/rad", infinite=True)
        require_positive(owner, "bandwidth", self.bandwidth, "rad/s", infinite=True)
        for name, unit in units.items():
            require_positive(owner, name, getattr(self, name), unit, zero=True)
        for name, zero in (("period", False), ("kd_period", False), ("kd_delay", True)):
            if (value := getattr(self, name)) is not None:
                require_positive(owner, name, value, "s", zero=zero)
        if self.encoder not in SIDES:
            raise GainroomError(f"{owner}: encoder {self.encoder!r} must be one of {', '.join(SIDES)}")
        if self.is_rigid and self.gearbox_damping:
            raise GainroomError(f"{owner}: gearbox_damping {self.gearbox_damping:g} N·m·s/rad acts on nothing where the gearbox is rigid")

    def require_step(self, owner: str, step: float, inverse_inertia: float) -> None:
        """Raise GainroomError, which begins with `owner`, if links explode on the gearbox's spring at a step [s] of the simulator.

        inverse_inertia   of the link by itself [1/(kg m²)]
        """
        if self.is_rigid:
            return
        longest = LONGEST / math.sqrt(self.gearbox_stiffness * inverse_inertia)
        if step >= longest:
            raise GainroomError(
                f"{owner}: gearbox_stiffness {self.gearbox_stiffness:g} N·m/rad on a link of {1 / inverse_inertia:.3g} kg·m² needs a "
                f"physics step below {1e3 * longest:.3g} ms, not {1e3 * step:g} ms"
            )


class _Path:
    """One path of commands, from a sampled encoder to the motor, of (envs, joints).

    Each command is kept as its difference to the one before, with the time until it arrives: what the motor has is the newest command less
    the differences that are still under way.
    """

    def __init__(self, library: Library, delay: float, jitter: float, period: float, every: int, shape: tuple[int, int]) -> None:
        self.library, self.delay, self.jitter, self.period, self.every = library, delay, jitter, period, every
        count = math.ceil((delay + jitter) / period) + 1  # more are never under way
        self.reading, self.newest = (library.array(np.zeros(shape)) for _ in range(2))
        self.steps, self.until = (library.array(np.zeros((count, *shape))) for _ in range(2))
        self._next = 0

    def restart(self, fresh: Any, position: Any, speed: Any) -> None:
        """Empties the path where `fresh` holds, of encoders that have moved to `position` at `speed`."""
        where = self.library.functions.where
        self.reading[...] = where(fresh, position - speed * self.period, self.reading)
        self.newest[...] = where(fresh, 0 * speed, self.newest)
        self.steps[...] = where(fresh, 0 * speed, self.steps)

    def speed(self, position: Any) -> Any:
        """Speed that the encoder shows at a sample of its position."""
        found = (position - self.reading) / self.period
        self.reading[...] = position
        return found

    def send(self, command: Any) -> None:
        """Sends a command, which overtakes those before it that would come later."""
        late = self.library.array(np.full(tuple(command.shape), self.delay))
        if self.jitter:
            late = late + self.jitter * self.library.uniform(tuple(command.shape))
        self.until[...] = self.library.functions.minimum(self.until, late)
        self.steps[self._next], self.until[self._next] = command - self.newest, late
        self.newest[...] = command
        self._next = (self._next + 1) % len(self.steps)

    def arriving(self, step: float) -> tuple[Any, Any]:
        """Mean over the next `step` [s] of what the motor has, and the slope of the line with the same first moment; time goes on by it."""
        there = self.library.functions.clip(1 - self.until / step, 0.0, 1.0)
        mean = self.newest - (self.steps * (1 - there)).sum(0)
        slope = (6 / step) * (self.steps * there * (1 - there)).sum(0)
        self.until -= step
        return mean, slope


class ElasticDelayedJoints:
    """State of the actuators of (envs, joints), which share their numbers.

    step          dt, of the simulator [s]
    link_inertia  (joints,) of each link by itself, in a usual posture, with the motor's where the gearbox is rigid [kg m²]; None: not
                  known, and links are stepped explicitly

    Raises GainroomError for values that are not physical, and for periods that have no common divisor with dt.
    """

    def __init__(
        self,
        numbers: ElasticDelayed,
        step: float,
        envs: int,
        joints: int,
        link_inertia: Sequence[float] | Floats | None = None,
        library: Library | None = None,
        owner: str = "actuator",
    ) -> None:
        numbers.require_physical(owner)
        require_positive(owner, "physics step", step, "s")
        inertia = np.full(joints, math.inf) if link_inertia is None else np.array(link_inertia, dtype=float)
        for each in inertia:
            require_positive(owner, "link_inertia", float(each), "kg·m²", infinite=True)
        self.library = library or Library.numpy(numbers.seed)
        kd_period = numbers.period if numbers.kd_period is None else numbers.kd_period
        self.substeps = substeps(owner, step, (numbers.period, *((kd_period,) if numbers.is_split else ())))
        self._numbers, self._step, self._h, shape = numbers, step, step / self.substeps, (envs, joints)
        self._motor_side = numbers.encoder == "motor" and not numbers.is_rigid
        own = np.stack([_transition(numbers, 1 / each, self._h) for each in inertia])
        self._states = own.shape[1] - 3
        self._matrix = self.library.array(own[:, :, :-1])
        self._braking = None
        if numbers.friction and not numbers.is_rigid:
            self._braking = self.library.array(own[:, 1, -1]), self.library.array(own[:, :, -1])
        self._inverse = self.library.array(1 / inertia)

        def path(delay: float, period: float) -> _Path:
            return _Path(self.library, delay, numbers.jitter, period, round(period / self._h), shape)

        self._host = path(numbers.delay, numbers.period)
        self._drive = path(numbers.delay if numbers.kd_delay is None else numbers.kd_delay, kd_period) if numbers.is_split else self._host
        self._all = self.library.array(np.zeros((*shape, self._states + 5)))  # the states, then what the matrix multiplies beside them
        self._average, self._ahead = (self.library.array(np.zeros(shape)) for _ in range(2))
        self._fresh = self.library.array(np.zeros(shape)) == 0
        self._any_fresh = True
        self._count = 0

    @property
    def motor_position(self) -> Any:
        """Positions of the rotors (envs, joints) [rad], on the joint's side. Raises GainroomError where they move with the links."""
        if self._numbers.is_rigid:
            raise GainroomError("a rigid gearbox has no motor of its own: it is where the link is")
        return self._all[..., 0]

    def reset(self, envs: Any = slice(None)) -> None:
        """Puts the rotors of `envs`, indices or a slice, where the links are at the next step; no command is under way then."""
        self._fresh[envs] = True
        self._any_fresh = True

    def torque(self, position: Any, velocity: Any, target: Any, target_velocity: Any, effort: Any, kp: Any, kd: Any, limit: Any) -> Any:
        """Torque (envs, joints) on the links for the simulator's next step [N m]; the state goes on by it.

        position, velocity   of the links, as the simulator has them before the step
        target, target_velocity, effort   what the policy commands: set-points of kp and kd, and a torque that goes with kp's
        kp, kd, limit        gains, and the limit of the motor's torque

        All (envs, joints).
        """
        position, velocity, target, target_velocity, effort, kp, kd, limit = map(
            self.library.array, (position, velocity, target, target_velocity, effort, kp, kd, limit)
        )
        clip, states, impulse = self.library.functions.clip, self._states, 0.0
        begun = position - velocity * (self._step / 2)
        if self._any_fresh:
            self._restart(begun, velocity)
        pull = -self._inverse * self._average
        link, speed = self._corrected(begun, velocity, pull), velocity
        first = link
        self._all[..., states + 4] = pull
        for _ in range(self.substeps):
            seen = self._all[..., 0] if self._motor_side else link
            self._sample(seen, target, target_velocity, effort, kp, kd)
            mean, slope = self._host.arriving(self._h)
            if self._drive is not self._host:
                own = self._drive.arriving(self._h)
                mean, slope = mean + own[0], slope + own[1]
            held = clip(mean, -limit, limit)
            slope = slope * (held == mean)
            beside = held - slope * (self._h / 2), slope, link, speed
            for k, value in enumerate(beside):
                self._all[..., states + k] = value
            found = self.library.functions.einsum("eja,jba->ejb", self._all, self._matrix)
            if self._braking is not None:
                by_speed, column = self._braking
                friction = self._numbers.friction
                found = found + clip(-found[..., 1] / by_speed, -friction, friction)[..., None] * column
            self._all[..., :states] = found[..., :states]
            impulse, link, speed = impulse + found[..., states], found[..., states + 1], found[..., states + 2]
            self._count += 1
        torque = impulse / self._step
        self._average += (1 - math.exp(-self._step / AVERAGED)) * (torque - self._average)
        if self._numbers.is_rigid:
            self._ahead *= math.exp(-self._step / FORGOTTEN)
            self._ahead += link - first - (self._step / 2) * (velocity + speed)
        return torque

    def _corrected(self, begun: Any, velocity: Any, pull: Any) -> Any:
        """Positions of the links, of those that the trapezoidal rule has, at the beginning of a step."""
        if self._numbers.is_rigid:
            return begun + self._ahead
        stiffness, damping = self._numbers.gearbox_stiffness, self._numbers.gearbox_damping
        late = self._inverse * (self._step**2 / 12)
        by_others = begun - late * (stiffness * self._all[..., 0] + damping * (self._all[..., 1] - velocity)) - self._step**2 / 12 * pull
        return by_others / (1 - late * stiffness)

    def _sample(self, seen: Any, target: Any, target_velocity: Any, effort: Any, kp: Any, kd: Any) -> None:
        """Commands of the paths that sample now."""
        if self._count % self._host.every == 0:
            command = kp * (target - seen) + effort
            if self._drive is self._host:
                command = command + kd * (target_velocity - self._host.speed(seen))
            self._host.send(command)
        if self._drive is not self._host and self._count % self._drive.every == 0:
            self._drive.send(kd * (target_velocity - self._drive.speed(seen)))

    def _restart(self, link: Any, velocity: Any) -> None:
        """Start of the environments that were reset."""
        where = self.library.functions.where
        start = [0 * link] * self._states if self._numbers.is_rigid else [link, velocity, *[0 * link] * (self._states - 2)]
        for k, value in enumerate(start):
            self._all[..., k] = where(self._fresh, value, self._all[..., k])
        for held in (self._average, self._ahead):
            held[...] = where(self._fresh, 0 * link, held)
        for path in {id(each): each for each in (self._host, self._drive)}.values():
            path.restart(self._fresh, link, velocity)
        self._fresh[...] = False
        self._any_fresh = False


def substeps(owner: str, step: float, periods: Sequence[float]) -> int:
    """Least number of substeps in a step, of which every period is a multiple.

    Raises GainroomError, which begins with `owner`, where it is more than MOST_SUBSTEPS.
    """
    ratios = [Fraction(period / step).limit_denominator(MOST_SUBSTEPS) for period in periods]
    count = math.lcm(*(ratio.denominator for ratio in ratios))
    exact = all(ratio > 0 and abs(float(ratio) * step - period) <= EQUAL * period for ratio, period in zip(ratios, periods, strict=True))
    if not exact or count > MOST_SUBSTEPS:
        given = " and ".join(f"{1e3 * period:g} ms" for period in dict.fromkeys(periods))
        raise GainroomError(
            f"{owner}: period {given} and the physics step {1e3 * step:g} ms must be multiples of one time, "
            f"at least 1/{MOST_SUBSTEPS} of the step"
        )
    return count


def _transition(numbers: ElasticDelayed, inverse_inertia: float, step: float) -> Floats:
    """Matrix over a `step` [s], exactly.

    From: states, u, u̇, position and speed of the link, its acceleration by other torques, torque of friction. To: states, impulse on the
    link, its position and speed. States: position and speed of the rotor where the gearbox is elastic, then torque and its rate where the
    current loop is not ideal.

    inverse_inertia   of the link [1/(kg m²)]
    """
    rotor, current = 0 if numbers.is_rigid else 2, 0 if math.isinf(numbers.bandwidth) else 2
    states = rotor + current
    command, rate, link, speed, pull, brake, impulse = range(states, states + 7)
    torque = rotor if current else command
    flow = np.zeros((states + 7, states + 7))
    flow[command, rate] = flow[link, speed] = flow[speed, pull] = 1.0
    if current:
        w = numbers.bandwidth
        flow[torque, torque + 1] = 1.0
        flow[torque + 1, [command, torque, torque + 1]] = w * w, -w * w, -2 * DAMPING_RATIO * w
    if numbers.is_rigid:
        flow[impulse, torque] = 1.0
    else:
        flow[0, 1] = 1.0
        flow[impulse, [0, link]] = numbers.gearbox_stiffness * np.array([1.0, -1.0])
        flow[impulse, [1, speed]] = numbers.gearbox_damping * np.array([1.0, -1.0])
        flow[1] = -flow[impulse]
        flow[1, [torque, brake]] += 1.0
        flow[1, 1] -= numbers.viscous
        flow[1] /= numbers.motor_inertia
    flow[speed] += inverse_inertia * flow[impulse]
    return expm(step * flow)[[*range(states), impulse, link, speed], :impulse]
