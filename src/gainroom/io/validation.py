"""Validation of the sections of a configuration file; an error is one line."""

import difflib
import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import cache
from types import FunctionType
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, TypeVar

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    ModelWrapValidatorHandler,
    PrivateAttr,
    ValidationError,
    ValidationInfo,
    ValidatorFunctionWrapHandler,
    WrapValidator,
    field_validator,
    model_validator,
)
from pydantic_core import InitErrorDetails, PydanticCustomError
from typing_extensions import Self

from ..errors import GainroomError, Together, UnjudgedError, listed
from .yaml_text import Problem, Wrong, shown

SMALLEST, LARGEST = 1e-12, 1e12
"""Bounds of a number in SI units: beyond them it is a mistake, and its square may leave the range of a float."""


def number(
    *, above: float | None = None, least: float | None = None, most: float = LARGEST, infinite: bool = False, unit: str = ""
) -> BeforeValidator:
    """Validator of a number (no bool, no text) > `above` or >= `least`, and <= `most`; .inf only if `infinite`. `unit`: of all of them."""
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
    """Hint for text in the place of a number, the end of a message."""
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
    """Validator of a number, or of a list of them, each valid under `end`."""

    def check(value: object) -> float | list[float]:
        return items(value, end) if isinstance(value, list) and value else end.func(value)  # type: ignore[call-arg]

    return BeforeValidator(check)


def items(values: Sequence[object], check: BeforeValidator) -> list[float]:
    """Values that pass `check`. Raises a validator's errors; if several are wrong, with their indices."""
    found, wrong = [], []
    for index, value in enumerate(values):
        try:
            found.append(check.func(value))  # type: ignore[call-arg]
        except PydanticCustomError as error:
            wrong.append(InitErrorDetails(type=error, loc=(index,), input=value))
    if len(wrong) == 1:
        raise wrong[0]["type"]  # type: ignore[misc] - a PydanticCustomError
    if wrong:
        raise ValidationError.from_exception_data("items", wrong)
    return found


def require_one_of(typed: str, value: str | None, allowed: Sequence[str]) -> None:
    """Raise GainroomError, which begins with the text `typed`, if a value is none of the allowed ones; None: it was not given."""
    if value is not None and value not in allowed:
        raise GainroomError(f"{typed}: must be {listed(allowed, 'or', len(allowed))}")


def refusal(message: str, key: str = "") -> PydanticCustomError:
    """Error to raise inside a validator; `key` is appended to the path that the message names."""
    return PydanticCustomError("refused", "{message}", {"message": message, "key": key})


Refusals = Iterator[PydanticCustomError]
Relation = TypeVar("Relation", bound=Callable[[Any], Refusals])


def relation(check: Relation) -> Relation:
    """Decorator of a validator of a Section's keys against each other: a method that yields refusals or raises GainroomError.

    It sees the keys whose own values are right, and ends unseen where it asks for another.
    """
    _RELATIONS.add(check)
    return check


_RELATIONS: set[Any] = set()
TOGETHER = object()
"""Context of a validation that returns the valid part of a section together with its problems (`partly`)."""


class Section(BaseModel):
    """Mapping with known keys.

    A field's description says what a missing key would hold: its meaning, its unit, and the allowed values.

    MEANT   what is meant by keys that others have for the same, where no likeness of names tells it

    Whatever is wrong is found at once: a value's own faults, unknown and missing keys, and `relation`s of keys.
    """

    MEANT: ClassVar[Mapping[str, str]] = {}

    model_config = ConfigDict(extra="forbid", frozen=True, defer_build=True)
    _faults: tuple[Problem, ...] = PrivateAttr(())
    _contradictions: tuple[Problem, ...] = PrivateAttr(())
    _unwritten: frozenset[str] = PrivateAttr(frozenset())
    """Fields that are not keys of the data; their own keys replace them."""

    @classmethod
    def prepared(cls, data: dict[str, Any]) -> dict[str, Any]:
        """Data with field names in the place of keys that differ from them."""
        return data

    @classmethod
    def allowed(cls) -> str:
        """Allowed content of a section, for messages."""
        return f"must be a section with keys among {', '.join(cls.model_fields)}"

    @field_validator("*", mode="wrap")
    @classmethod
    def _with_faults(cls, value: Any, handler: ValidatorFunctionWrapHandler) -> Any:
        if isinstance(value, Wrong):
            return value
        try:
            return handler(value)
        except ValidationError as error:
            return Wrong(tuple(_problems_of(error, value)))

    @model_validator(mode="wrap")
    @classmethod
    def _with_all_faults(cls, data: Any, handler: ModelWrapValidatorHandler[Self], info: ValidationInfo) -> Self:
        if isinstance(data, cls):  # made by a check, as made_when_read
            return data
        problems: list[Problem] = []
        if isinstance(data, dict):
            fields = cls.prepared(data)
            given = {key: value for key, value in fields.items() if key in cls.model_fields}
            unknown = {key: cls._meant(key) for key in fields if key not in cls.model_fields}
            problems += [(dotted(key), cls._unknown(meant)) for key, meant in unknown.items()]
            meant = {text.partition(" ")[0] for text in unknown.values()}
            for name, field in cls.model_fields.items():
                if name not in fields and (field.is_required() or name in meant):
                    problems += [] if name in meant else [(name, f"is missing: {field.description}")]
                    given[name] = Wrong()
        else:
            problems += [] if isinstance(data, Wrong) else [("", f"{shown(data)} {cls.allowed()}")]
            given = dict.fromkeys(cls.model_fields, Wrong())
        made = handler(given)
        for name in cls.model_fields:
            if isinstance(found := vars(made)[name], Wrong):
                problems += _below(name, found.problems)
                vars(made).pop(name)
        contradictions = tuple(made._contradicted())
        if (problems or contradictions) and info.context is not TOGETHER:
            path, message = (*problems, *contradictions)[0]
            raise refusal(message, path)
        made._faults, made._contradictions = tuple(problems), contradictions
        made._unwritten = frozenset(given) - data.keys() if isinstance(data, dict) else frozenset()
        return made

    @classmethod
    def _meant(cls, key: str) -> str:
        """Known key that an unknown key probably means; "" if there is none."""
        return cls.MEANT.get(key) or "".join(difflib.get_close_matches(key, cls.model_fields, 1, cutoff=0.5))

    @classmethod
    def _unknown(cls, meant: str) -> str:
        return f"unknown key{f'; did you mean {meant}?' if meant else ''} (allowed: {', '.join(cls.model_fields)})"

    def _contradicted(self) -> Iterator[Problem]:
        """Problems with keys that contradict each other."""
        for check in _relations_of(type(self)):
            try:
                for error in check(self):
                    yield _problem(error)
            except PydanticCustomError as error:
                yield _problem(error)
            except GainroomError as error:
                yield from (("", text) for text in error.problems)
            except UnjudgedError:
                pass

    def require_right(self) -> None:
        """Raise UnjudgedError if anything in the section is wrong."""
        if any(True for _ in self.problems()):
            raise UnjudgedError

    def is_right(self, name: str) -> bool:
        """True if the value of a field is valid."""
        return name in self.__dict__

    def is_given(self, name: str) -> bool:
        """True if a field has a value, valid or not."""
        return self.__dict__.get(name, Wrong) is not None

    @property
    def is_section(self) -> bool:
        """True if at least one field is valid: a section was given."""
        return bool(self.__dict__)

    def problems(self) -> Iterator[Problem]:
        """Problems of the section and of the sections inside it."""
        yield from self._faults
        for name, value in self.__dict__.items():
            yield from _below("" if name in self._unwritten else name, _within(value))
        yield from self._contradictions

    def model_dump(self, **options: Any) -> dict[str, Any]:
        """Values of the fields, as pydantic's model_dump. Raises UnjudgedError if one of them is not valid."""
        asked = set(options.get("include") or type(self).model_fields) - set(options.get("exclude") or ())
        if asked & type(self).model_fields.keys() - self.__dict__.keys():
            raise UnjudgedError
        return super().model_dump(**options)

    if not TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any:
            if name in type(self).__pydantic_fields__:
                raise UnjudgedError(name)
            return super().__getattr__(name)


@cache
def _relations_of(kind: type[Section]) -> list[Callable[[Any], Refusals]]:
    """Relations of a section, those of its base classes first."""
    every = (each for one in reversed(kind.__mro__) for each in vars(one).values())
    return [each for each in every if isinstance(each, FunctionType) and each in _RELATIONS]


def _within(value: Any) -> Iterator[Problem]:
    """Problems of the sections inside a value."""
    if isinstance(value, Section):
        yield from value.problems()
    elif isinstance(value, Wrong):
        yield from value.problems
    elif isinstance(value, dict):
        for key, each in value.items():
            yield from _below(dotted(str(key)), _within(each))
    elif isinstance(value, list | tuple):
        for index, each in enumerate(value):
            yield from _below(f"[{index}]", _within(each))


def _below(key: str, problems: Iterable[Problem]) -> list[Problem]:
    """Problems of the value of `key`, with paths that begin with it."""
    return [(_joined(key, path), message) for path, message in problems]


def _joined(path: str, key: str) -> str:
    return f"{path}{key}" if key.startswith("[") else ".".join(filter(None, (path, key)))


def known(value: Any) -> Any:
    """Value itself. Raises UnjudgedError if it is Wrong or missing."""
    if value is None or isinstance(value, Wrong):
        raise UnjudgedError
    return value


def _as_wrong(value: Any, handler: ValidatorFunctionWrapHandler) -> Any:
    try:
        return handler(value)
    except ValidationError as error:
        return Wrong(tuple(_problems_of(error, value)))


SEPARATELY = WrapValidator(_as_wrong)
"""Validator for one of several values of a field: an invalid one becomes Wrong and hides no problem of the others; see `known`."""


EXPECTED = {
    "bool_type": "true or false",
    "dict_type": "a section",
    "string_type": "a name",
    "string_too_short": "a name",
    "string_too_long": "a name of at most 200 characters",
    "too_short": "one entry or more; leave the section out where there is none",
}
"""Expected value by the type of pydantic's error."""

AnySection = TypeVar("AnySection", bound=Section)


def validate(model: type[AnySection], data: object, source: str, within: str = "") -> AnySection:
    """Section `model` of `data`. Raises GainroomError with all problems, each as SOURCE: key.path: message.

    within   the key whose value `data` is; "" for a whole file
    """
    with Together() as together:
        return partly(model, data, source, together, within)


def partly(model: type[AnySection], data: object, source: str, together: Together, within: str = "") -> AnySection:
    """Section made of the valid part of `data`; other keys raise UnjudgedError. The problems go to `together`. Otherwise as `validate`."""
    found = model.model_validate(data, context=TOGETHER)
    problems = dict.fromkeys(_said_of(_joined(within, path), message) for path, message in found.problems())
    if problems:
        together.add(GainroomError(*(": ".join(filter(None, (source, text))) for text in problems)))
    return found


def made_when_read(model: Callable[[], type[Section]], optional: bool = True) -> BeforeValidator:
    """Validator of a section whose keys are known only when it is read; None stays None if it is `optional`."""

    def check(value: object, info: ValidationInfo) -> Section | None:
        return None if value is None and optional else model().model_validate(value, context=info.context)

    return BeforeValidator(check)


def typed(kinds: Mapping[str, type[Section]], beside: str) -> BeforeValidator:
    """Validator of a section whose `type`, one of `kinds`, decides the keys that stand `beside` it: the type is validated first."""
    allowed = listed([*kinds], "or", len(kinds))

    def check(value: object, info: ValidationInfo) -> Section:
        if not isinstance(value, dict):
            raise refusal(f"{shown(value)} must be a section with the keys type, {beside}")
        if "type" not in value:
            raise refusal(f"is missing: it must be {allowed}", key="type")
        kind = kinds.get(value["type"]) if isinstance(value["type"], str) else None
        if kind is None:
            raise refusal(f"{shown(value['type'])} must be {allowed}", key="type")
        return kind.model_validate(value, context=info.context)

    return BeforeValidator(check)


def _said_of(path: str, message: str) -> str:
    """Message after its path: one sentence if the message begins with a verb, "drive.bandwidth is missing"."""
    return f"{path}{' ' if message.startswith(('is ', 'has ')) else ': '}{message}" if path else message


def _problem(error: PydanticCustomError) -> Problem:
    context: Any = error.context
    return context["key"], context["message"]


def _problems_of(error: ValidationError, value: object) -> list[Problem]:
    """Problems with `value`; where several types are allowed, those of the first type, or those that lie deeper in the value."""
    found: dict[str, str] = {}
    for each in error.errors(include_url=False, include_input=True):
        if not isinstance(each["input"], Wrong):
            found.setdefault(_path(value, each["loc"], each.get("ctx", {}).get("key", "")), _message(each))
    return [(path, text) for path, text in found.items() if not any(_leads_to(path, other) for other in found)]


def _leads_to(path: str, other: str) -> bool:
    """True if the place `other` lies inside the place `path`."""
    return other != path and other.startswith(path) and (not path or other[len(path)] in ".[")


def _message(error: Any) -> str:
    """Message for one of pydantic's errors: the problem, and the allowed values."""
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
    """Value that passes `check`. Raises GainroomError that names `owner`, UnjudgedError for a value that is Wrong."""
    if isinstance(value, Wrong):
        raise UnjudgedError
    try:
        return check.func(value)  # type: ignore[call-arg]
    except PydanticCustomError as error:
        raise GainroomError(f"{owner}: {error.message()}") from error


def dotted(*keys: str) -> str:
    """Path of keys that lead to a value, as in messages; a key that is no plain word stands in quotes."""
    return ".".join(key if re.fullmatch(r"[\w/-]+", key) else shown(key) for key in keys)


def _path(data: Any, location: tuple[Any, ...], key: str) -> str:
    """Path such as control.notches[0].width from ('control', 'notches', 0) and 'width', without pydantic's tags between."""
    path = ""
    for part in location:
        if isinstance(data, list) and isinstance(part, int):
            path += f"[{part}]"
        elif isinstance(data, dict) and part in data:
            path += f".{dotted(part)}"
        else:
            continue
        data = data[part]
    return _joined(path.removeprefix("."), key)
