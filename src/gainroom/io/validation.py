"""Validation of the sections of a configuration file; an error is one line."""

import difflib
import math
import re
from collections.abc import Callable, Mapping, Sequence
from typing import Annotated, Any, ClassVar, TypeVar

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError, model_validator
from pydantic_core import PydanticCustomError

from ..errors import GainroomError, listed
from .yaml_text import shown

SMALLEST, LARGEST = 1e-12, 1e12
"""Beyond these a number in SI units is a slip of the pen, and its square may leave the range of a float."""


def number(
    *, above: float | None = None, least: float | None = None, most: float = LARGEST, infinite: bool = False, unit: str = ""
) -> BeforeValidator:
    """A check: a number (no bool, no text) > `above` or >= `least`, and <= `most`; .inf only where `infinite`. `unit`: of all of them."""
    unit = f" {unit}" if unit else ""

    def check(value: object) -> float:
        if isinstance(value, str):
            raise refusal(f"{shown(value)} is text and must be a number{_number_hint(value)}")
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise refusal(f"{shown(value)} is not a number")
        if math.isnan(value):
            raise refusal(f"{value} is not a number")
        if value == math.inf and infinite:
            return math.inf
        if above is not None and value <= above:
            raise refusal(f"{value} must be > {above:g}{unit}")
        if least is not None and value < least:
            raise refusal(f"{value} must be >= {least:g}{unit}")
        if value > most:
            raise refusal(f"{value} must be <= {most:g}{unit}" + (", or .inf" if infinite else ""))
        if 0 < abs(value) < SMALLEST:
            raise refusal(f"{value} must be >= {SMALLEST:g}" + ("" if above == 0 else ", or 0"))
        return float(value)

    return BeforeValidator(check)


def _number_hint(text: str) -> str:
    """What probably was meant by text in a number's place."""
    if re.fullmatch(r"[-+]?[0-9]+,[0-9]+", text):
        return f": the decimal sign is a point, {text.replace(',', '.')}"
    if re.fullmatch(r"[-+]?[0-9.]+([eE][-+]?[0-9]+)?", text):
        return ", without quotes"
    return ", without a unit: SI, unless the key's name has another" if text[:1].isdigit() else ""


Positive = Annotated[float, number(above=0)]
NotNegative = Annotated[float, number(least=0)]
PositiveOrInfinite = Annotated[float, number(above=0, infinite=True)]
Flag = Annotated[bool, Field(strict=True)]
Name = Annotated[str, Field(strict=True, min_length=1, max_length=200)]


def each(end: BeforeValidator) -> BeforeValidator:
    """A check: a number, or a list of them, each as `end` allows."""

    def check(value: object) -> float | list[float]:
        if isinstance(value, list) and value:
            return [end.func(item) for item in value]  # type: ignore[call-arg]
        return end.func(value)  # type: ignore[call-arg]

    return BeforeValidator(check)


def require_one_of(typed: str, value: str | None, allowed: Sequence[str]) -> None:
    """Raise GainroomError, which begins with what was `typed`, where a value is none of the allowed ones; None: it was not given."""
    if value is not None and value not in allowed:
        raise GainroomError(f"{typed}: must be {listed(allowed, 'or', len(allowed))}")


def typed(*kinds: str, beside: str) -> BeforeValidator:
    """A check of a section whose `type`, one of `kinds`, decides which keys it has `beside`: the type comes first."""
    *others, last = kinds
    allowed = f"{', '.join(others)} or {last}"

    def check(value: object) -> object:
        if not isinstance(value, dict):
            raise refusal(f"{shown(value)} must be a section with the keys type, {beside}")
        if "type" not in value:
            raise refusal(f"is missing: it must be {allowed}", key="type")
        if value["type"] not in kinds:
            raise refusal(f"{shown(value['type'])} must be {allowed}", key="type")
        return value

    return BeforeValidator(check)


def refusal(message: str, key: str = "") -> PydanticCustomError:
    """An error to raise inside a check; `key` is appended to the path that the message names."""
    return PydanticCustomError("refused", "{message}", {"message": message, "key": key})


class Section(BaseModel):
    """A mapping with known keys. A field's description says what a missing key would hold: what it is, its unit, and what is allowed.

    MEANT   what is meant by keys that others have for the same, where no likeness of names tells it
    """

    MEANT: ClassVar[Mapping[str, str]] = {}

    model_config = ConfigDict(extra="forbid", frozen=True, defer_build=True)

    @model_validator(mode="before")
    @classmethod
    def _check_keys(cls, data: Any) -> Any:
        allowed = ", ".join(cls.model_fields)
        if not isinstance(data, dict):
            raise refusal(f"{shown(data)} must be a section with keys among {allowed}")
        for key in data:
            if key not in cls.model_fields:
                nearest = [cls.MEANT[key]] if key in cls.MEANT else difflib.get_close_matches(key, cls.model_fields, 1, cutoff=0.5)
                hint = f"; did you mean {nearest[0]}?" if nearest else ""
                raise refusal(f"unknown key{hint} (allowed: {allowed})", key=dotted(key))
        for name, field in cls.model_fields.items():
            if field.is_required() and name not in data:
                raise refusal(f"is missing: {field.description}", key=name)
        return data


EXPECTED = {
    "bool_type": "true or false",
    "dict_type": "a section",
    "string_type": "a name",
    "string_too_short": "a name",
    "string_too_long": "a name of at most 200 characters",
    "too_short": "one entry or more; leave the section out where there is none",
}
"""What a value must be, by the type of pydantic's error."""

AnySection = TypeVar("AnySection", bound=Section)


def validate(model: type[AnySection], data: object, source: str, within: str = "") -> AnySection:
    """`data` as a `model`. Raises GainroomError about the first thing that is wrong: SOURCE: key.path: message.

    within   the key whose value `data` is; "" for a whole file
    """
    try:
        return model.model_validate(data)
    except ValidationError as error:
        message, path = _first(error, data)
        path = ".".join(filter(None, (within, path)))
        raise GainroomError(": ".join(filter(None, (source, _said_of(path, message))))) from error


def made_when_read(model: Callable[[], type[Section]]) -> BeforeValidator:
    """A check of a section whose keys are known only when it is read; None stays None."""

    def check(value: object) -> Section | None:
        try:
            return None if value is None else model().model_validate(value)
        except ValidationError as error:
            raise refusal(*_first(error, value)) from None

    return BeforeValidator(check)


def _said_of(path: str, message: str) -> str:
    """A message after the path of what it is about: one sentence where it begins with a verb, "drive.bandwidth is missing"."""
    return f"{path}{' ' if message.startswith(('is ', 'has ')) else ': '}{message}" if path else message


def _first(error: ValidationError, data: object) -> tuple[str, str]:
    """The first thing that is wrong with `data`, and the path of keys that lead to it."""
    first = error.errors(include_url=False, include_input=True)[0]
    return _message(first), _path(data, first["loc"], first.get("ctx", {}).get("key", ""))


def _message(error: Any) -> str:
    """What is wrong with a value, and what is allowed, of one of pydantic's errors."""
    kind, value, context = error["type"], error["input"], error.get("ctx", {})
    if kind == "refused":
        return context["message"]
    if kind == "literal_error":
        allowed = context["expected"].replace("'", "")
        nearest = difflib.get_close_matches(str(value), re.split(r", | or ", allowed), 1)
        return f"{shown(value)} must be {allowed}" + (f"; did you mean {nearest[0]}?" if nearest else "")
    if kind == "list_type":
        return f"{shown(value)} must be a list" + (f": [{shown(value)}]" if isinstance(value, str) else ", [] for none")
    if kind == "too_long":
        return f"{len(value)} entries must be at most {context['max_length']}"
    return f"{shown(value)} must be {EXPECTED[kind]}" if kind in EXPECTED else f"{shown(value)}: {error['msg']}"


def checked(owner: str, value: object, check: BeforeValidator) -> float:
    """`value` as one of this module's checks lets it pass. Raises GainroomError that names `owner`."""
    try:
        return check.func(value)  # type: ignore[call-arg]
    except PydanticCustomError as error:
        raise GainroomError(f"{owner}: {error.message()}") from error


def dotted(*keys: str) -> str:
    """The path of keys that lead to a value, as messages write it; a key that is no plain word stands in quotes."""
    return ".".join(key if re.fullmatch(r"[\w/-]+", key) else shown(key) for key in keys)


def _path(data: Any, location: tuple[Any, ...], key: str) -> str:
    """('control', 'notches', 0) and 'width' as control.notches[0].width, without pydantic's tags between."""
    path = ""
    for part in location:
        if isinstance(data, list) and isinstance(part, int):
            path += f"[{part}]"
        elif isinstance(data, dict) and part in data:
            path += f".{dotted(part)}"
        else:
            continue
        data = data[part]
    return (f"{path}.{key}" if key else path).removeprefix(".")
