"""The options of every command that reads a log."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from .options import Number, number_option

if TYPE_CHECKING:
    from ..files.logs import LogOptions


@dataclass(frozen=True)
class LogCall:
    """A log and the options on how to read it, as they are typed."""

    file: Annotated[
        Path,
        typer.Argument(metavar="LOG", help="{log formats}.", show_default=False),
    ]
    columns: Annotated[
        list[str] | None,
        typer.Option(
            "--columns",
            metavar="CHANNEL=NAME,…",
            help="Which column is what: target_torque=cmd,time=t; or a YAML file with columns, units and more. May be given again.",
        ),
    ] = None
    units: Annotated[
        list[str] | None,
        typer.Option(
            "--units",
            metavar="CHANNEL=UNIT,…",
            help="time=us,motor_position=deg,target_torque=Nmm; counts/4096; norm/220; a number multiplies; - turns.",
        ),
    ] = None
    rotor_side: Annotated[
        str | None,
        typer.Option("--rotor-side", metavar="CHANNEL,…", help="Channels that the log holds before the gearbox; with --gear-ratio."),
    ] = None
    gear_ratio: Annotated[Number, number_option("--gear-ratio", "", "Motor turns per turn of the joint.")] = None
    rate_hz: Annotated[Number, number_option("--rate-hz", "in Hz", "Of the rows [Hz], whatever their time stamps are.")] = None
    start: Annotated[Number, number_option("--start", "in seconds", "Read from here on [s after the first row].")] = None
    end: Annotated[Number, number_option("--end", "in seconds", "Read up to here [s after the first row].")] = None
    joint: Annotated[list[str] | None, typer.Option("--joint", metavar="NAME", help="A joint, or a pattern; may be given again.")] = None
    episode: Annotated[int | None, typer.Option("--episode", metavar="N", help="Of a LeRobot data set; else the first.")] = None

    def options(self) -> "LogOptions":
        """Log options; flags overrule a file given as --columns. Raises GainroomError."""
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
        window = {"start": self.start, "end": self.end, "episode": self.episode}
        more = {"gear_ratio": self.gear_ratio, "sample_rate": self.rate_hz, **window}
        given |= {name: value for name, value in more.items() if value is not None}
        if self.rotor_side:
            given["rotor_side"] = tuple(part.strip() for part in self.rotor_side.split(","))
        if self.joint:
            given["joints"] = tuple(self.joint)
        with named("options"):
            return LogOptions(**given)
