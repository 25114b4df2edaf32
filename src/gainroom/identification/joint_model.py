"""Parameters of a joint's fit, and their point in the search."""

import math
from dataclasses import dataclass, replace

import numpy as np

from ..system.drive import Drive
from ..system.elastic_joint import ElasticJoint
from ..system.linear.arrays import Floats
from .estimate import FREEDOM, Estimate, interval, log_interval
from .prediction import Between, Noise, Signals
from .record import resolution

Prior = tuple[Floats, Floats]
"""Mean and information (p,) of prior knowledge."""
LOGARITHMIC = ("motor_inertia", "inertia", "link_inertia", "stiffness", "damping")
LAW_DAMPING, LAW_OTHER, LAW_OWN, LAW_COMMON, LAW_DELAY = 40.0, 0.08, 0.07, 0.7, 5.0
"""Errors that a wrong law of friction causes, in this order: ratio of the damping's to the stiffness's; share of the motor's friction that
is assigned to the link; relative error of the motor's friction; share of the variance that inertias and stiffness have in common; ratio of
the phase's error to the stiffness's."""
BEFOREHAND = {
    "viscous": (0.0, 0.3),
    "coulomb": (0.0, 0.5),
    "link_coulomb": (0.0, 0.3),
    "weight_sine": (0.0, 1.0),
    "weight_cosine": (0.0, 1.0),
    "noise torque": (math.log(0.01), 3.0),
    "noise drift": (math.log(1e-3), 3.0),
    "noise turning": (math.log(0.05), 2.0),
    "bandwidth": (math.log(1.5), 1.0),
    "damping ratio": (math.log(0.8), 0.25),
    "early": (0.0, 0.5),
    "curved": (-1 / 12, 0.2),
}
"""Prior mean and deviation, of torques in units of the torque, of log ω_c T: they decide only if the log says nothing."""
WEIGHT, WEIGHT_ALONE = {"motor_inertia": -0.2, "link_inertia": -1.9, "stiffness": -0.9}, 0.4
"""Change of the logarithms per W/K of a weight that is not in the model, measured on simulated joints of 8 to 26 Hz;
and the part of the stiffness's change that is independent of the inertias."""
TELLS, MOST_WEIGHT = 0.1, 0.02  # [rad] deviation of the angle from which on a weight's change is told; of W/K: more would be seen
DAMPING_DEVIATION, READING_DEVIATION = 2.0, 1.5  # of the logarithms, about their start


@dataclass(frozen=True)
class JointModel:
    """Model of a joint with its free parameters.

    Inertias, stiffness, damping and noise are logarithms in the point; friction is in units of `torque` [N m] and `speed` [rad/s]; the
    delay in ticks.

    free_delay, free_drive   delay and the current loop are fitted; sampled: and so is what the torque does between its samples
    """

    elastic: bool
    friction: bool
    free_delay: bool
    free_drive: bool
    sampled: bool
    torque: float
    speed: float
    drive: Drive
    sample_time: float
    outputs: int

    @classmethod
    def of(
        cls, torque: Floats, positions: Floats, drive: Drive, tick: float, elastic: bool, friction: bool, free: tuple[bool, bool, bool]
    ) -> "JointModel":
        """Model with units of the size of the signals; `free`: delay, current loop, and the course of a sampled torque between samples."""
        speed = float(np.std(np.diff(positions[:, 0]))) / tick
        return cls(elastic, friction, *free, float(np.std(torque)), speed, drive, tick, positions.shape[1])

    @property
    def physical(self) -> tuple[str, ...]:
        """Parameters of the joint, which come first in the point."""
        names = ["motor_inertia", "link_inertia", "stiffness", "damping"] if self.elastic else ["inertia"]
        names += ["viscous", "coulomb"] if self.friction else []
        names += ["link_coulomb"] if self.friction and self.elastic else []
        names += ["weight_sine", "weight_cosine"]
        return (*names, *(["delay"] if self.free_delay else []))

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all parameters of the point."""
        between = [*(["bandwidth", "damping ratio"] if self.free_drive else []), *(["early", "curved"] if self.sampled else [])]
        readings = [f"noise reading {k}" for k in range(self.outputs)]
        return (*self.physical, *between, "noise torque", "noise drift", "noise turning", *readings)

    def start(self, joint: ElasticJoint, delay: float, signals: Signals) -> Floats:
        """Point of a rough joint and a delay [s]."""
        jumps = np.median(np.abs(np.diff(signals.positions, 3, axis=0)), axis=0) / 3.0  # of white noise: 0.67 √20 of its deviation
        steps = np.array([resolution(column) for column in signals.positions.T]) / math.sqrt(12)
        readings = np.maximum(np.maximum(steps, 0.3 * jumps), 1e-12)
        values = {
            "motor_inertia": math.log(joint.motor_inertia),
            "inertia": math.log(joint.motor_inertia + joint.link_inertia),
            "link_inertia": math.log(joint.link_inertia),
            "stiffness": math.log(joint.stiffness) if self.elastic else 0.0,
            "damping": math.log(joint.damping) if joint.damping > 0 else 0.0,
            "viscous": 0.0,
            "coulomb": 0.02,
            "link_coulomb": 0.0,
            "weight_sine": 0.0,
            "weight_cosine": 0.0,
            "delay": delay / self.sample_time,
            **{
                name: BEFOREHAND[name][0]
                for name in BEFOREHAND
                if name.startswith(("noise", "bandwidth", "damping ratio", "early", "curved"))
            },
            **{f"noise reading {k}": math.log(value) for k, value in enumerate(readings)},
        }
        return np.array([values[name] for name in self.names])

    def prior(self, start: Floats, delay: tuple[float, float] | None) -> Prior:
        """Prior of the parameters; that of the `delay` has the given mean and deviation [ticks]."""
        mean, deviation = np.array(start), np.full(len(start), math.inf)
        for k, name in enumerate(self.names):
            if name in BEFOREHAND:
                mean[k], deviation[k] = BEFOREHAND[name]
            elif name == "damping":
                deviation[k] = DAMPING_DEVIATION
            elif name.startswith("noise reading"):
                deviation[k] = READING_DEVIATION
            elif name == "delay" and delay is not None:
                mean[k], deviation[k] = delay
        return mean, deviation**-2.0

    def parts(self, point: Floats) -> tuple[ElasticJoint, Drive, Floats, Noise, Between]:
        """Joint, drive, friction (5,), noise and course of a sampled torque at a point, for prediction_errors."""
        v = dict(zip(self.names, point.tolist(), strict=True))
        if self.elastic:
            motor, link, stiffness, damping = (math.exp(v[name]) for name in ("motor_inertia", "link_inertia", "stiffness", "damping"))
            joint = ElasticJoint(motor, link, stiffness, damping)
        else:
            joint = ElasticJoint(math.exp(v["inertia"]) / 2, math.exp(v["inertia"]) / 2)
        friction = np.array([v.get(name, 0.0) for name in ("coulomb", "link_coulomb", "viscous", "weight_sine", "weight_cosine")])
        friction *= self.torque * np.array([1, 1, 1 / self.speed, 1, 1])
        drive = replace(self.drive, delay=max(v["delay"], 0.0) * self.sample_time) if self.free_delay else self.drive
        if self.free_drive:
            drive = replace(drive, bandwidth=math.exp(v["bandwidth"]) / self.sample_time, damping_ratio=math.exp(v["damping ratio"]))
        between = Between(v["early"], v["curved"]) if self.sampled else Between()
        torque, drift, turning = (self.torque * math.exp(v[f"noise {name}"]) for name in ("torque", "drift", "turning"))
        readings = np.exp([v[f"noise reading {k}"] for k in range(self.outputs)])
        return joint, drive, friction, Noise(torque, drift, turning, readings), between

    def law_error(self, point: Floats, relative: float, fastest: float = math.inf) -> Floats:
        """Covariance (p, p) of the point if the joint's law is wrong by `relative`, relative to inertia and stiffness.

        What is wrong with the torque scales both inertias and the stiffness alike, and leaves the resonance. A delay taken for a lag of the
        current loop shows in the cube of the frequency alone, of which `fastest` [rad/s] is the highest that is excited.
        """
        sizes: dict[str, float] = dict.fromkeys(("motor_inertia", "inertia", "link_inertia", "stiffness"), relative)
        scaled = np.array([sizes.get(name, 0.0) for name in self.names])
        alone = {"damping": LAW_DAMPING * relative}
        if self.friction:
            dry = abs(float(point[self.names.index("coulomb")]))
            alone |= {"link_coulomb": LAW_OTHER * dry, "coulomb": LAW_OWN * dry}
        if self.free_drive:
            speed, ratio = (math.exp(point[self.names.index(name)]) for name in ("bandwidth", "damping ratio"))
            alone["delay"] = min(LAW_DELAY * relative * speed**2 / (fastest * self.sample_time) ** 3, 2 * ratio / speed)
        others = np.diag([alone.get(name, 0.0) ** 2 for name in self.names])
        return LAW_COMMON * np.outer(scaled, scaled) + (1 - LAW_COMMON) * np.diag(scaled**2) + others

    def weight_error(self, point: Floats, variance: Floats, swing: float) -> Floats:
        """Covariance (p, p) of the point from a weight that pulls the link back as a spring to the ground, W of a stiffness K + W.

        W is the torque of the weight, as far as it is known. Where the joint swings by much (`swing`, deviation [rad]), the change of that
        torque is fitted (prediction.py). Else it is taken for stiffness, K/J_L = (K + W)/J_L: link inertia and stiffness are off by 2 and
        1 W/K.
        """
        if not self.elastic:
            return np.zeros_like(variance)
        places = [self.names.index(name) for name in ("weight_sine", "weight_cosine")]
        size = float(np.sqrt(np.sum(point[places] ** 2))) / (1 + (swing / TELLS) ** 2)
        unknown = self.torque * math.hypot(size, float(variance[places[0], places[0]] ** 0.5))
        share = min(unknown / math.exp(point[self.names.index("stiffness")]), MOST_WEIGHT)
        common = np.array([WEIGHT.get(name, 0.0) for name in self.names])
        alone = np.array([WEIGHT_ALONE if name == "stiffness" else 0.0 for name in self.names])
        return share**2 * (np.outer(common, common) + np.diag(alone**2))

    def slopes(self, point: Floats) -> Floats:
        """Derivatives (p,) of the physical parameters in SI by the point."""
        units = dict.fromkeys(self.physical, self.torque) | {"viscous": self.torque / self.speed, "delay": self.sample_time}
        return np.array(
            [math.exp(value) if name in LOGARITHMIC else units[name] for name, value in zip(self.physical, point, strict=False)]
        )

    def estimates(self, point: Floats, variance: Floats) -> dict[str, Estimate]:
        """Estimates of the physical parameters in SI."""
        found = {}
        for k, (name, slope) in enumerate(zip(self.physical, self.slopes(point), strict=True)):
            error = float(variance[k, k] ** 0.5)
            if name in LOGARITHMIC:
                found[name] = log_interval(math.exp(point[k]), error, FREEDOM)
            else:
                found[name] = interval(float(point[k] * slope), error * slope, FREEDOM)
        return found
