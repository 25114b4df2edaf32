"""Error that gainroom raises, the checks that raise it, and the wording of messages: on one line, printable, not too long.

numpy is imported where it is needed: the command line loads this before anything else.
"""

import contextlib
import difflib
import math
import numbers
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from types import TracebackType
from typing import TYPE_CHECKING, Generic, TypeVar

if TYPE_CHECKING:
    import numpy as np

Made = TypeVar("Made", covariant=True)

MOST_SHOWN = 8
"""Maximum number of names in one message."""
MOST_DIGITS = 9
QUANTITIES = {
    "delay": (1e3, "ms"),
    "stiffness": (1.0, "N·m/rad"),
    "link_inertia": (1.0, "kg·m²"),
    "motor_inertia": (1.0, "kg·m²"),
    "damping": (1.0, "N·m·s/rad"),
    "resonance": (1 / (2 * math.pi), "Hz"),
    "damping_ratio": (100.0, "% of critical"),
}
"""Quantities of joint and drive that may be uncertain, by field name: factor from SI to the displayed unit, and that unit."""


THIN_SPACES = "\u2009\u202f"
"""Spaces between the thousands of a number."""


def printable(text: str) -> str:
    """Text on one line: white space becomes spaces, other characters that a terminal cannot show become ?."""
    return "".join(c if c.isprintable() or c in THIN_SPACES else " " if c.isspace() else "?" for c in text)


def one_line(message: object, most: int = 240) -> str:
    """Library's message, or a value, for use in a message: printable, runs of white space as one, at most `most` characters."""
    text = " ".join(printable(str(message)).split())
    return text if len(text) <= most else text[: most - 1] + "…"


def first_of_many(items: Sequence[str], most: int = MOST_SHOWN) -> str:
    """Text with the first `most` of several items, joined by commas; if there are more, "…" and the number of all items."""
    return ", ".join(items[:most]) + (f", … {len(items)} in all" if len(items) > most else "")


def apart(value: float, other: float, least: int) -> int:
    """Number of significant digits, `least` or more, that distinguish `value` from `other`: 5.9999 beside 6 must not read as 6."""
    if not (math.isfinite(value) and math.isfinite(other)):
        return least
    return next((count for count in range(least, MOST_DIGITS) if f"{value:.{count}g}" != f"{other:.{count}g}"), MOST_DIGITS)


def beside(value: float, other: float) -> str:
    """Value with three digits, or as many as distinguish it from `other`."""
    return f"{value:.{apart(value, other, 3)}g}"


def case_text(values: Mapping[str, float]) -> str:
    """Text of a case of uncertain values, by name in QUANTITIES, SI: "delay 7 ms, stiffness 8000 N·m/rad"."""
    shown = ((name, value, *QUANTITIES[name]) for name, value in values.items())
    return ", ".join(f"{name.replace('_', ' ')} {_four_digits(scale * value)} {unit}" for name, value, scale, unit in shown)


def _four_digits(value: float) -> str:
    text = f"{value:.4g}"
    return f"{float(text):.0f}" if "e+" in text and abs(value) < 1e7 else text


def nearest(name: str, names: Sequence[str], kind: str) -> str:
    """End of a message about an unknown name: the nearest known name, and the known names."""
    close = difflib.get_close_matches(name, names, 1, cutoff=0.5)
    hint = f"; did you mean {close[0]!r}?" if close else ""
    return f"{hint} ({kind}{'es' if kind.endswith('s') else 's'}: {first_of_many(names) or 'none'})"


def typo_of(name: str, known: Sequence[str]) -> str:
    """Known name that is nearly `name`; "" if `name` is known, or far from all."""
    close = [] if name in known else difflib.get_close_matches(name.lower(), known, 1, cutoff=0.75)
    return close[0] if close else ""


def listed(names: Sequence[str], word: str = "and", most: int = 4) -> str:
    """Names in a sentence, not too many, the last after `word`."""
    if len(names) > most:
        return f"{', '.join(names[:most])} {word} {len(names) - most} more"
    return f" {word} ".join([", ".join(names[:-1]), names[-1]]) if len(names) > 1 else "".join(names)


THIN = "\u202f"
"""Narrow no-break space between groups of three digits."""


_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def digits(value: float | None, unit: str = "", significant: int = 4) -> str:
    """Value with its unit; a dash if it is None or NaN."""
    if value is None or math.isnan(value):
        return "–"
    if math.isinf(value):
        return "∞" if value > 0 else "−∞"
    rounded = float(f"{value:.{significant}g}")
    if 1000 <= abs(rounded) < 1e7:
        text = f"{rounded:,.0f}".replace(",", THIN)
    elif rounded and (abs(rounded) < 1e-3 or abs(rounded) >= 1e7):
        mantissa, exponent = f"{rounded:.{significant - 1}e}".split("e")
        mantissa = mantissa.rstrip("0").rstrip(".") if "." in mantissa else mantissa
        text = f"{mantissa}·10{str(int(exponent)).translate(_RAISED)}"
    else:
        text = f"{rounded:.{significant}g}" if abs(rounded) < 10**significant else f"{rounded:.0f}"
    text = text.replace("-", "−")
    return text + (unit if unit == "°" else f" {unit}" if unit else "")


def frequency_text(omega: float) -> str:
    """Frequency [rad/s] as text for a sentence, in Hz."""
    text = f"{omega / (2 * math.pi):.3g}"
    return (f"{float(text):,.0f}".replace(",", THIN) if "e+" in text else text) + " Hz"


def at_frequency(omega: float, before: str = " at ", text: Callable[[float], str] = frequency_text) -> str:
    """Frequency as the end of a phrase, " at 3.2 Hz"; "" if it is not finite. `text` formats it."""
    return f"{before}{text(omega)}" if math.isfinite(omega) else ""


def option_name(name: str) -> str:
    """Option name of a parameter: "--delay-ms"."""
    return f"--{name.replace('_', '-')}"


MOST_PROBLEMS = 20
"""Maximum number of lines of one error."""


class GainroomError(ValueError):
    """Input or call that gainroom cannot answer: one line per problem that names the thing, its value and what is allowed.

    problems   all of them; as text the error has MOST_PROBLEMS, and how many more there are
    """

    def __init__(self, *problems: str) -> None:
        super().__init__("\n".join(shown_problems(problems)))
        self.problems = problems


def shown_problems(problems: Sequence[str]) -> list[str]:
    """First MOST_PROBLEMS problems, and the number of the others."""
    more = len(problems) - MOST_PROBLEMS
    return [*problems[:MOST_PROBLEMS], *([f"and {more} more"] if more > 0 else [])]


class UnjudgedError(Exception):
    """Result that cannot be computed because an input of it is wrong, which another error reports."""


class Step(Generic[Made]):
    """Result of a step of Together: calling it returns the value, or raises UnjudgedError if the step has failed."""

    def __init__(self, *made: Made) -> None:
        self._made = made

    @property
    def is_made(self) -> bool:
        """True if the step has succeeded."""
        return bool(self._made)

    def otherwise(self, other: "Step[Made]") -> "Step[Made]":
        """This step if it has succeeded, else the `other`."""
        return self if self._made else other

    def __call__(self) -> Made:
        if not self._made:
            raise UnjudgedError
        return self._made[0]


class Together:
    """Block whose problems are raised together at its end, each once: those of its steps, and the error that ends the block itself.

    A step that asks for what another one could not make is passed over: what is wrong there is said there.
    """

    def __init__(self) -> None:
        self._problems: dict[str, None] = {}
        self._errors: list[GainroomError] = []

    @property
    def failed(self) -> bool:
        """True if a step has failed so far."""
        return bool(self._errors)

    def __enter__(self) -> "Together":
        return self

    def step(self, make: Callable[[], Made]) -> Step[Made]:
        """Result of `make()`; its problems are collected."""
        try:
            return Step(make())
        except GainroomError as error:
            self.add(error)
        except UnjudgedError:
            pass
        return Step()

    def add(self, error: GainroomError) -> None:
        """Adds further problems."""
        self._errors.append(error)
        self._problems.update(dict.fromkeys(error.problems))

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        if isinstance(error, GainroomError):
            self.add(error)
        elif error is not None and not isinstance(error, UnjudgedError):
            return
        if len(self._errors) == 1:
            raise self._errors[0]
        if self._errors:
            raise GainroomError(*self._problems) from self._errors[0]


def all_of(makes: Iterable[Callable[[], Made]]) -> list[Made]:
    """Results of all calls. Raises GainroomError with the problems of all of them."""
    with Together() as together:
        found = [together.step(make) for make in makes]
        return [each() for each in found]


def refuse_all(problems: Iterable[str]) -> None:
    """Raise GainroomError with the problems, if there are any."""
    if found := list(problems):
        raise GainroomError(*found)


@contextlib.contextmanager
def computable(owner: str) -> Iterator[None]:
    """Context that turns a failure of linear algebra into a GainroomError that names the outermost `owner`."""
    import numpy as np

    try:
        yield
    except (np.linalg.LinAlgError, GainroomError) as error:
        cause = error.__cause__ if isinstance(error, GainroomError) else error
        if not isinstance(cause, np.linalg.LinAlgError):
            raise
        problem = one_line(cause).rstrip(".").lower()
        raise GainroomError(f"{owner}: cannot be computed ({problem}): look for values that are many orders of magnitude off") from cause


@contextlib.contextmanager
def named(owner: str) -> Iterator[None]:
    """Context whose errors name `owner`, unless they begin with it already."""
    try:
        yield
    except GainroomError as error:
        raise GainroomError(*(text if text.startswith(owner) else f"{owner}: {text}" for text in error.problems)) from error


def require_positive(owner: str, name: str, value: float, unit: str = "", *, zero: bool = False, infinite: bool = False) -> float:
    """Return `value` as a float when it is > 0 (>= 0 with `zero`) and finite (or +inf with `infinite`); raise GainroomError otherwise."""
    allowed = f"a number {'>=' if zero else '>'} 0" + (" or inf" if infinite else "")
    if isinstance(value, bool | str) or not isinstance(value, numbers.Real):
        raise GainroomError(f"{owner}: {name} {value!r} must be {allowed}")
    number = float(value)  # type: ignore[arg-type]
    if math.isnan(number) or number < 0 or (number == 0 and not zero) or (math.isinf(number) and not infinite):
        raise GainroomError(f"{owner}: {name} {number:g}{' ' + unit if unit else ''} must be {allowed}")
    return number


def require_count(owner: str, name: str, value: object, least: int) -> int:
    """Return `value` when it is a whole number >= `least`; raise GainroomError otherwise."""
    if not isinstance(value, numbers.Integral) or isinstance(value, bool) or value < least:
        raise GainroomError(f"{owner}: {name} {value!r} must be a whole number >= {least}")
    return int(value)


def require_finite(owner: str, name: str, value: object) -> "np.ndarray":
    """Return `value` as a float array when every element is a finite real number; raise GainroomError otherwise."""
    import numpy as np

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
