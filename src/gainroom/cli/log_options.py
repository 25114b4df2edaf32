"""The options of every command that reads a log."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from .options import number_option

if TYPE_CHECKING:
    from ..files.logs import LogOptions

Number = float | None
LogFile = Annotated[
    Path,
    typer.Argument(metavar="LOG", help="CSV, Parquet, MCAP, ROS 2 bag, HDF5, MATLAB, JSON (BAM) or .pt (PACE).", show_default=False),
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


def log_words(
    file: Path,
    columns: list[str] | None = None,
    units: list[str] | None = None,
    rotor_side: str | None = None,
    gear_ratio: Number = None,
    rate_hz: Number = None,
    start: Number = None,
    end: Number = None,
    joints: list[str] | None = None,
) -> list[str]:
    """A log and its options as they are typed."""
    many = {"--columns": columns, "--units": units, "--joint": joints}
    words = [str(file), *(word for flag, values in many.items() for value in values or [] for word in (flag, value))]
    one = {"--rotor-side": rotor_side, "--gear-ratio": gear_ratio, "--rate-hz": rate_hz, "--start": start, "--end": end}
    return words + [word for flag, value in one.items() if value is not None for word in (flag, _typed(value))]


def _typed(value: str | float) -> str:
    return value if isinstance(value, str) else repr(value).removesuffix(".0")


def log_options(
    columns: list[str] | None = None,
    units: list[str] | None = None,
    rotor_side: str | None = None,
    gear_ratio: Number = None,
    rate_hz: Number = None,
    start: Number = None,
    end: Number = None,
    joints: list[str] | None = None,
) -> "LogOptions":
    """What the options say; they overrule a file given as --columns. Raises GainroomError."""
    from ..errors import GainroomError, named
    from ..files.logs import LogOptions, load_options
    from ..files.logs.options import assignments

    given: dict[str, Any] = {}
    texts = []
    for text in columns or []:
        if "=" in text:
            texts.append(text)
        else:
            if Path(text).suffix not in (".yaml", ".yml"):
                raise GainroomError(f"--columns: {text!r} must be CHANNEL=NAME, or a file that ends in .yaml")
            given |= load_options(Path(text))
    given["columns"] = given.get("columns", {}) | assignments(texts, "--columns")
    given["units"] = given.get("units", {}) | assignments(units or [], "--units")
    more = {"gear_ratio": gear_ratio, "sample_rate": rate_hz, "start": start, "end": end}
    given |= {name: value for name, value in more.items() if value is not None}
    if rotor_side:
        given["rotor_side"] = tuple(part.strip() for part in rotor_side.split(","))
    if joints:
        given["joints"] = tuple(joints)
    with named("options"):
        return LogOptions(**given)
