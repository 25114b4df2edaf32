"""What keys of robot.yaml may hold for each joint, direction or frame: one number for all, or several."""

from typing import Annotated, TypeVar

from pydantic import BeforeValidator

from ..io.validation import each, number
from ..robot.name_patterns import DEFAULT

T = TypeVar("T")

PerJoint = Annotated[dict[str, T], BeforeValidator(lambda value: value if isinstance(value, dict) else {DEFAULT: value})]
"""One value for all joints, or one per pattern."""
Angle = Annotated[float, number(least=-1e4, most=1e4)]
Weight = Annotated[float, number(above=0, most=1e6)]
Several = Annotated[float | list[float], each(number(least=0))]
Springs = Annotated[float | list[float], each(number(above=0, infinite=True))]
