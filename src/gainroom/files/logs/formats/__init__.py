"""Kinds of files that hold logs. A new one is a file here with a subclass of LogFormat, and its line in FORMATS."""

from pathlib import Path

from ....errors import GainroomError
from ..table import LogFormat
from .bam import Bam
from .csv_text import CsvText
from .hdf5 import Hdf5
from .lerobot import LeRobot
from .matlab import Matlab
from .mcap_file import Mcap
from .npz import Npz
from .pace import Torch
from .parquet import Parquet
from .rosbag import Bag
from .rosbag1 import Ros1Bag

FORMATS: tuple[LogFormat, ...] = (CsvText(), Parquet(), LeRobot(), Mcap(), Bag(), Ros1Bag(), Hdf5(), Matlab(), Bam(), Npz(), Torch())


def format_of(path: Path, written: bool = False) -> LogFormat:
    """Format of a log: by where it lies, else by the ending of the file's name; another folder is a ROS 2 bag.

    written   only those that can be written, by their first ending

    Raises GainroomError for other endings.
    """
    choices = [form for form in FORMATS if form.makes is not None or not written]
    if not written and (own := next((form for form in choices if form.is_of(path)), None)) is not None:
        return own
    if not written and path.is_dir():
        return next(form for form in FORMATS if isinstance(form, Bag))
    ending = path.suffix.lower()
    for form in choices:
        if ending in (form.endings[:1] if written else form.endings):
            return form
    endings = [(form.endings[0] if written else ", ".join(form.endings)) for form in choices if form.endings]
    folders = "" if written else "; or be the folder of a ROS 2 bag or of a LeRobot data set"
    raise GainroomError(f"{path}: a log must end in {', '.join(endings)}{folders}")
