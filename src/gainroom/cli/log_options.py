"""The options of every command that reads a log."""

import inspect
from collections.abc import Callable
from dataclasses import dataclass
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from .options import number_option

if TYPE_CHECKING:
    from ..files.logs import LogOptions

Number = float | None
LogFile = Annotated[
    Path, typer.Argument(metavar="LOG", help="CSV, Parquet, MCAP, ROS 2 bag, HDF5, MATLAB, JSON (BAM) or .pt (PACE).", show_default=False)
]
Columns = Annotated[
    list[str] | None,
    typer.Option(
        "--columns",
        metavar="CHANNEL=NAME,…",
        help="Which column is what: target_torque=cmd,time=t; or a YAML file with columns, units and more. May be given again.",
    ),
]
Units = Annotated[
    list[str] | None,
    typer.Option(
        "--units", metavar="CHANNEL=UNIT,…", help="time=us,motor_position=deg,target_torque=Nmm; ticks/4096; a number multiplies; - turns."
    ),
]
RotorSide = Annotated[
    str | None, typer.Option("--rotor-side", metavar="CHANNEL,…", help="Channels that the log holds before the gearbox; with --gear-ratio.")
]
GearRatio = Annotated[Number, number_option("--gear-ratio", "", "Motor turns per turn of the joint.")]
RateHz = Annotated[Number, number_option("--rate-hz", "in Hz", "Of the rows [Hz], whatever their time stamps are.")]
Start = Annotated[Number, number_option("--start", "in seconds", "Read from here on [s after the first row].")]
End = Annotated[Number, number_option("--end", "in seconds", "Read up to here [s after the first row].")]
Joints = Annotated[list[str] | None, typer.Option("--joint", metavar="NAME", help="A joint, or a pattern; may be given again.")]


@dataclass(frozen=True)
class LogCall:
    """A log and the options on how to read it, as they are typed; the fields are the options of `reads_log`."""

    file: LogFile
    columns: Columns = None
    units: Units = None
    rotor_side: RotorSide = None
    gear_ratio: GearRatio = None
    rate_hz: RateHz = None
    start: Start = None
    end: End = None
    joint: Joints = None

    def words(self) -> "list[str | Path | tuple[str, Any]]":
        """For the line that runs the command again."""
        many = {"--columns": self.columns, "--units": self.units, "--joint": self.joint}
        one = {"--rotor-side": self.rotor_side, "--gear-ratio": self.gear_ratio, "--rate-hz": self.rate_hz, "--start": self.start}
        return [self.file, *((flag, value) for flag, values in many.items() for value in values or []), *one.items(), ("--end", self.end)]

    def options(self) -> "LogOptions":
        """What the options say; they overrule a file given as --columns. Raises GainroomError."""
        from ..errors import GainroomError, named
        from ..files.logs import LogOptions, load_options
        from ..files.logs.options import assignments

        given: dict[str, Any] = {}
        texts = []
        for text in self.columns or []:
            if "=" in text:
                texts.append(text)
            else:
                if Path(text).suffix not in (".yaml", ".yml"):
                    raise GainroomError(f"--columns: {text!r} must be CHANNEL=NAME, or a file that ends in .yaml")
                given |= load_options(Path(text))
        given["columns"] = given.get("columns", {}) | assignments(texts, "--columns")
        given["units"] = given.get("units", {}) | assignments(self.units or [], "--units")
        more = {"gear_ratio": self.gear_ratio, "sample_rate": self.rate_hz, "start": self.start, "end": self.end}
        given |= {name: value for name, value in more.items() if value is not None}
        if self.rotor_side:
            given["rotor_side"] = tuple(part.strip() for part in self.rotor_side.split(","))
        if self.joint:
            given["joints"] = tuple(self.joint)
        with named("options"):
            return LogOptions(**given)


def reads_log(command: Callable[..., int]) -> Callable[..., int]:
    """A command whose first parameter is a LogCall, as typer takes it: the log, the command's own options, and those of the log.

    An option of the command's own stands for that of the log of the same name.
    """
    own = list(inspect.signature(command, eval_str=True).parameters.values())[1:]
    file, *others = inspect.signature(LogCall, eval_str=True).parameters.values()
    shared = [file, *(option for option in others if option.name not in {each.name for each in own})]

    @wraps(command)
    def called(**values: Any) -> int:
        log = LogCall(**{option.name: values.pop(option.name) for option in shared})
        return command(log, **values)

    parameters = [each.replace(kind=inspect.Parameter.KEYWORD_ONLY) for each in (file, *own, *shared[1:])]
    called.__annotations__ = {each.name: each.annotation for each in parameters} | {"return": int}
    called.__signature__ = inspect.Signature(parameters)  # pyright: ignore[reportAttributeAccessIssue]
    return called
