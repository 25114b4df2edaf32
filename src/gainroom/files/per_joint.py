"""What keys of robot.yaml may hold: names, flags, a number or one for each joint, direction or frame."""

import math
from collections.abc import Callable
from typing import Annotated, Any

from pydantic import BeforeValidator

from ..io.validation import NotNegative, number, refusal
from ..io.yaml_text import shown
from ..robot.name_patterns import DEFAULT

MOST_NAMES = 50
"""Postures, contact states or tasks in one file."""


def _word(value: object) -> str:
    if not isinstance(value, str) or not value or len(value) > 200:
        raise refusal(f"{shown(value)} must be a name")
    return value


def _rigid(value: object) -> object:
    return math.inf if value == "rigid" else value


def each(end: BeforeValidator) -> BeforeValidator:
    """A check: a number, or a list of them, each as `end` allows."""

    def check(value: object) -> float | list[float]:
        if isinstance(value, list) and value:
            return [end.func(item) for item in value]  # type: ignore[call-arg]
        return end.func(value)  # type: ignore[call-arg]

    return BeforeValidator(check)


def of_type(kind: type | tuple[type, ...], words: str) -> Callable[[Any], Any]:
    """A check: a value of this type."""

    def check(value: Any) -> Any:
        if not isinstance(value, kind):
            raise refusal(f"{shown(value)} must be {words}")
        return value

    return check


_flag, mapping, a_list = of_type(bool, "true or false"), of_type(dict, "a section"), of_type(list, "a list")


def per_joint(value: Any) -> Any:
    """One value for all joints, or one per pattern."""
    return value if isinstance(value, dict) else {DEFAULT: value}


def list_of(what: str, empty: str = "") -> Callable[[Any], Any]:
    """A check: a list; one thing by itself is refused with the list that was meant."""

    def check(value: Any) -> Any:
        if isinstance(value, str):
            raise refusal(f"{shown(value)} must be a list of {what}: [{shown(value)}]{empty}")
        return of_type(list, f"a list of {what}{empty}")(value)

    return check


def at_most(value: Any) -> Any:
    """A check: no more than MOST_NAMES entries."""
    if len(value) > MOST_NAMES:
        raise refusal(f"{len(value)} entries must be at most {MOST_NAMES}")
    return value


def named(value: Any) -> Any:
    """A section with one entry or more, each under a name."""
    if not mapping(value):
        raise refusal("is empty; give at least one, or leave the section out")
    return at_most(value)


Name = Annotated[str, BeforeValidator(_word)]
Flag = Annotated[bool, BeforeValidator(_flag)]
Angle = Annotated[float, number(least=-1e4, most=1e4)]
Stiffness = Annotated[float, number(above=0, infinite=True), BeforeValidator(_rigid)]
PerJoint = Annotated[dict[str, NotNegative], BeforeValidator(per_joint)]
Weight = Annotated[float, number(above=0, most=1e6)]
Weights = Annotated[dict[str, Weight], BeforeValidator(per_joint)]
Several = Annotated[float | list[float], each(number(least=0))]
Springs = Annotated[float | list[float], each(number(above=0, infinite=True))]
