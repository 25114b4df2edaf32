"""Systems of other libraries (python-control, scipy.signal), read by their attributes; nothing is imported from there."""

from typing import Any

import numpy as np

from ...errors import GainroomError, one_line, require_finite, require_positive
from .state_space import StateSpace, factored
from .transfer_function import Factored, polynomial_roots


def _sample_time_of(system: Any) -> float | None:
    """Sample time T_s [s] of a foreign system; None for continuous time. Raises GainroomError for dt=True."""
    step = getattr(system, "dt", None)
    if step is None or (step == 0 and not isinstance(step, bool)):
        return None
    if isinstance(step, bool):
        raise GainroomError("a discrete system must name its sample time (dt in seconds, not dt=True)")
    return require_positive("system", "dt", step, "s")


def is_lti(system: Any) -> bool:
    """True if `factored_from` can read the system."""
    return isinstance(system, Factored) or any(hasattr(system, name) for name in ("num", "A", "gain"))


def factored_from(system: Any) -> Factored:
    """A scalar LTI system as zeros, poles and gain in v.

    Raises GainroomError for several inputs or outputs, for what is not an LTI system, and for numbers that are not finite or not real.
    """
    return _checked(system if isinstance(system, Factored) else _read(system))


def _checked(system: Factored) -> Factored:
    for name in ("zeros", "poles"):
        roots = np.asarray(getattr(system, name))
        if not np.all(np.isfinite(roots)):
            raise GainroomError(f"system: {name} {one_line(repr(roots), 80)} must be finite")
        partner = np.abs(roots[:, None] - roots.conj()).min(axis=1, initial=np.inf)
        if np.any(partner > 1e-6 * np.abs(roots)):  # doubles leave far less of a pair's mismatch
            raise GainroomError(f"system: {name} {one_line(repr(roots), 80)} must be real or come in conjugate pairs")
    require_finite("system", "gain", system.gain)
    require_positive("system", "delay", system.delay, "s", zero=True)
    return system


def _read(system: Any) -> Factored:
    step = _sample_time_of(system)
    if hasattr(system, "num") and hasattr(system, "den"):
        num, den = _polynomial(system.num), _polynomial(system.den)
        if not np.any(num):
            return Factored(np.zeros(0, complex), np.zeros(0, complex), 0.0, 0.0, step)
        leading = np.trim_zeros(num, "f")[0] / np.trim_zeros(den, "f")[0]
        return in_v(polynomial_roots(num), polynomial_roots(den), leading, step)
    if hasattr(system, "A"):
        state = StateSpace(*(np.atleast_2d(require_finite("system", name, getattr(system, name))) for name in "ABCD"))
        if state.d.shape != (1, 1):
            raise GainroomError(f"a system with {state.d.shape[1]} inputs and {state.d.shape[0]} outputs must have one of each")
        if step is not None:  # z x = A x + B u, so δ x = (A − I)/T_s x + B/T_s u
            state = StateSpace((state.a - np.eye(len(state.a))) / step, state.b / step, state.c, state.d)
        return factored(state, np.linalg.eigvals(state.a).astype(complex), step)
    if hasattr(system, "gain") and hasattr(system, "zeros"):
        return in_v(
            np.asarray(system.zeros, complex), np.asarray(system.poles, complex), float(require_finite("system", "gain", system.gain)), step
        )
    raise GainroomError(f"{type(system).__name__} must be a python-control or scipy.signal LTI system, or a callable L(s)")


def _polynomial(value: Any) -> np.ndarray:
    """Coefficients of one polynomial, from the nested lists of a transfer function."""
    while isinstance(value, list | tuple) and len(value) == 1 and np.ndim(value[0]) > 0:
        value = value[0]
    array = np.squeeze(np.asarray(value, dtype=object if isinstance(value, list) else None))
    array = require_finite("system", "coefficients", array.tolist() if array.dtype == object else array)
    if array.ndim > 1:
        raise GainroomError(f"a transfer function of shape {array.shape} must have one input and one output")
    return np.atleast_1d(array)


def in_v(zeros: np.ndarray, poles: np.ndarray, gain: float, step: float | None) -> Factored:
    """Transfer function in v, from roots and gain in s or z."""
    if step is None:
        return Factored(zeros, poles, gain, 0.0, None)
    return Factored((zeros - 1) / step, (poles - 1) / step, gain * step ** (len(zeros) - len(poles)), 0.0, step)
