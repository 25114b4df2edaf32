"""The one error that gainroom raises, and the checks that raise it."""

import contextlib
import math
from collections.abc import Iterator

import numpy as np

from .messages import one_line


class GainroomError(ValueError):
    """An input or a call that gainroom cannot answer; the message is one line and names the thing, its value and what is allowed."""


@contextlib.contextmanager
def computable(owner: str) -> Iterator[None]:
    """Turns a failure of linear algebra into a GainroomError that names `owner`: numbers that doubles cannot hold apart."""
    try:
        yield
    except np.linalg.LinAlgError as error:
        problem = one_line(error).rstrip(".").lower()
        raise GainroomError(f"{owner}: cannot be computed ({problem}): look for values that are many orders of magnitude off") from error


@contextlib.contextmanager
def named(owner: str) -> Iterator[None]:
    """Errors within name `owner`, where they do not begin with it already."""
    try:
        yield
    except GainroomError as error:
        told = str(error)
        raise GainroomError(told if told.startswith(owner) else f"{owner}: {told}") from error


def require_positive(owner: str, name: str, value: float, unit: str = "", *, zero: bool = False, infinite: bool = False) -> float:
    """Return `value` as a float when it is > 0 (>= 0 with `zero`) and finite (or +inf with `infinite`); raise GainroomError otherwise."""
    allowed = f"a number {'>=' if zero else '>'} 0" + (" or inf" if infinite else "")
    if isinstance(value, bool | str) or not np.isscalar(value) or isinstance(value, complex):
        raise GainroomError(f"{owner}: {name} {value!r} must be {allowed}")
    number = float(value)  # type: ignore[arg-type]
    if math.isnan(number) or number < 0 or (number == 0 and not zero) or (math.isinf(number) and not infinite):
        raise GainroomError(f"{owner}: {name} {number:g}{' ' + unit if unit else ''} must be {allowed}")
    return number


def require_count(owner: str, name: str, value: object, least: int) -> int:
    """Return `value` when it is a whole number >= `least`; raise GainroomError otherwise."""
    if not isinstance(value, int | np.integer) or isinstance(value, bool) or value < least:
        raise GainroomError(f"{owner}: {name} {value!r} must be a whole number >= {least}")
    return int(value)


def require_finite(owner: str, name: str, value: object) -> np.ndarray:
    """Return `value` as a float array when every element is a finite real number; raise GainroomError otherwise."""
    try:
        given = np.asarray(value)
        if np.iscomplexobj(given):
            raise TypeError  # numpy would drop the imaginary parts
        array = np.asarray(given, dtype=float)
    except (TypeError, ValueError) as error:
        raise GainroomError(f"{owner}: {name} {one_line(repr(value), 120)} must be a real number or an array of them") from error
    if not np.all(np.isfinite(array)):
        raise GainroomError(f"{owner}: {name} {one_line(repr(value), 120)} must be finite")
    return array
