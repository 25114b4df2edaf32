"""mujoco.sysid on windows of a joint's log: a motor and a link on hinges with a spring between them, or one hinge."""

import contextlib
import io
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.interpolate import make_interp_spline

MODEL = """
<mujoco>
  <option timestep="{tick}" integrator="RK4" gravity="0 {gravity} 0"><flag contact="disable" limit="disable"/></option>
  <worldbody>{bodies}</worldbody>
  <tendon>{spring}</tendon>
  <actuator><motor joint="motor"/></actuator>
  <sensor><jointpos name="position" joint="motor"/></sensor>
</mujoco>
"""
# The joint's armature is all of the inertia but a billionth; friction acts within two ticks, the fastest that MuJoCo allows.
BODY = """
<body>
  <inertial pos="0 {arm} 0" mass="1e-9" diaginertia="1e-12 1e-12 1e-12"/>
  <joint name="{name}" type="hinge" axis="0 0 1" armature="1" solreffriction="{two_ticks} 1"/>
</body>
"""
SPRING = """
<fixed name="spring" stiffness="1" springlength="0"><joint joint="motor" coef="-1"/><joint joint="link" coef="1"/></fixed>
"""
PLACES = {  # places of each parameter in the model
    "motor_inertia": ("joint", "motor", "armature"),
    "inertia": ("joint", "motor", "armature"),
    "link_inertia": ("joint", "link", "armature"),
    "stiffness": ("tendon", "spring", "stiffness"),
    "damping": ("tendon", "spring", "damping"),
    "coulomb": ("joint", "motor", "frictionloss"),
    "link_coulomb": ("joint", "link", "frictionloss"),
}
MAY_BE_ZERO = ("damping", "coulomb", "link_coulomb")
ITERATIONS, TOLERANCE = 12, 1e-4
Intervals = dict[str, tuple[float, float, float]]


@dataclass(frozen=True)
class Given:
    """Data of a log of k ticks for the fit, SI.

    tick       [s]
    torque     (k,) mean over the tick that begins at each row
    position   (k,) of the motor, as measured
    states     (k, n) angles of motor and link, or of the motor alone, from which windows start
    rates      (k, n) their velocities
    weight     m g l [N m]
    """

    tick: float
    torque: np.ndarray
    position: np.ndarray
    states: np.ndarray
    rates: np.ndarray
    weight: float

    def windows(self, length: float, count: int) -> list[slice]:
        """Rows of `count` windows of a length [s], spread evenly from the beginning, both ends included."""
        size = round(length / self.tick)
        return [slice(first, first + size + 1) for first in np.linspace(0, len(self.torque) - size - 1, count).astype(int)]


def is_installed() -> bool:
    """False where mujoco or what its sysid needs is missing."""
    try:
        from mujoco import sysid
    except ImportError:
        return False
    return hasattr(sysid, "ParameterDict")


def over_ticks(torque: np.ndarray) -> np.ndarray:
    """(k,) mean over the tick that begins at each row of a torque that is read at the ticks."""
    integral = make_interp_spline(np.arange(len(torque)), torque, k=5).antiderivative()
    return np.append(np.diff(integral(np.arange(len(torque)))), torque[-1])


def true_rates(angles: np.ndarray, torque: np.ndarray, motor_inertia: float, tick: float) -> np.ndarray:
    """(k, 2) velocities from the exact `angles` (k, 2); the torque bends the motor's within a tick, which its own integral says."""
    time = np.arange(len(torque)) * tick
    once = make_interp_spline(time, torque / motor_inertia, k=5).antiderivative()
    alone = angles - np.column_stack([once.antiderivative()(time), 0 * time])
    return make_interp_spline(time, alone, k=5).derivative()(time) + np.column_stack([once(time), 0 * time])


def fit(given: Given, stages: Sequence[tuple[float, int]], start: dict[str, float]) -> Intervals:
    """Value, low and high of each parameter of `start`, where the search begins; a stiffness makes two hinges.

    Each stage has windows of a length [s] and their number, and goes on from what the one before has found: short windows lead to the
    right minimum, long ones tell more.
    """
    from mujoco import MjSpec, sysid

    spec = MjSpec.from_string(_model(given.tick, given.weight, "stiffness" in start))
    found = sysid.ParameterDict()
    for name, value in start.items():
        found.add(sysid.Parameter(name, 1.0, 0.0 if name in MAY_BE_ZERO else 0.05, 20.0, modifier=_modifier(name, value)))
    for length, count in stages:
        residual = _residual(given, given.windows(length, count), spec, sysid.apply_param_modifiers(found, spec))
        with contextlib.redirect_stdout(io.StringIO()):  # its search prints
            found, result = sysid.optimize(found.move_off_bounds(), residual, verbose=False, max_iters=ITERATIONS, xtol=TOLERANCE)
    covariance, half = sysid.calculate_intervals(residual(result.x, found)[0], np.asarray(result.jac))
    scale = np.array(list(start.values()))
    best, half = result.x * scale, half * scale
    intervals = {name: (float(x), float(x - h), float(x + h)) for name, x, h in zip(start, best, half, strict=True)}
    if "stiffness" in start:
        intervals["resonance"] = _resonance(best[:3], (covariance * np.outer(scale, scale))[:3, :3])
    return intervals


def _residual(given: Given, windows: list[slice], spec: Any, model: Any) -> Any:
    from mujoco import sysid

    time = np.arange(windows[0].stop - windows[0].start) * given.tick
    sequences = sysid.ModelSequences(
        "joint",
        spec,
        [f"rows {rows.start} to {rows.stop}" for rows in windows],
        [sysid.create_initial_state(model, given.states[rows.start], given.rates[rows.start], np.zeros(0)) for rows in windows],
        [sysid.TimeSeries(time, given.torque[rows, None]) for rows in windows],
        [sysid.TimeSeries.from_names(time, given.position[rows, None], model, ["motor_qpos"]) for rows in windows],
    )
    differences = _differences(float(np.std(given.position)))
    return sysid.build_residual_fn(models_sequences=[sequences], modify_residual=differences, resample_true=False, n_threads=1)


def _model(tick: float, weight: float, elastic: bool) -> str:
    """The weight hangs on the last hinge, a billionth of a kilogram at an arm of 1 m."""
    names = ("motor", "link") if elastic else ("motor",)
    bodies = "".join(BODY.format(name=name, arm=-1 if name == names[-1] else 0, two_ticks=2 * tick) for name in names)
    return MODEL.format(tick=tick, gravity=-1e9 * weight, bodies=bodies, spring=SPRING if elastic else "")


def _modifier(name: str, unit: float) -> Any:
    kind, element, attribute = PLACES[name]

    def change(spec: Any, parameter: Any) -> None:
        target, value = getattr(spec, kind)(element), float(parameter.value[0]) * unit
        before = getattr(target, attribute)  # some are polynomials' coefficients
        setattr(target, attribute, np.append(value, np.zeros(len(before) - 1)) if np.ndim(before) else value)

    return change


def _differences(scale: float) -> Any:
    """Residuals on one scale in all windows; its own divides by the size of the position in each window.

    Angles of the state are those at the end of each step; a sensor's value is from its beginning.
    """
    from mujoco import sysid

    def residuals(params: Any, predicted: Any, measured: Any, model: Any, everything: bool, state: np.ndarray) -> Any:
        motion = sysid.TimeSeries(state[:, 0], state[:, 1:2], measured.signal_mapping)
        seen = sysid.TimeSeries(measured.times[1:], measured.data[1:], measured.signal_mapping)
        return (seen.data - motion.data) / scale, motion, seen

    return residuals


def _resonance(point: np.ndarray, covariance: np.ndarray) -> tuple[float, float, float]:
    """√(K (1/J_M + 1/J_L)), with its interval to first order."""
    motor, link, stiffness = point
    value = float(np.sqrt(stiffness * (1 / motor + 1 / link)))
    slope = np.array([-stiffness / motor**2, -stiffness / link**2, 1 / motor + 1 / link]) / (2 * value)
    half = 1.96 * float(np.sqrt(slope @ covariance @ slope))
    return value, value - half, value + half
