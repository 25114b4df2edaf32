"""LeRobot's data sets (github.com/huggingface/lerobot), of version 2 and 3: set-points `action` beside what the joints do.

meta/info.json names the entries of the lists in data/chunk-*/episode_*.parquet (2: a file per episode) or file-*.parquet (3: several
episodes in a file, told apart by episode_index). Neither says the unit: degrees, radians, −100 … 100 of the calibrated range
(MotorNormMode in lerobot's motors/motors_bus.py), or whatever a robot's program hands over.
"""

import contextlib
import json
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ....errors import GainroomError, first_of_many, one_line
from ....io.bounded_text import bounded_text
from ....system.linear.arrays import Floats
from ..table import MOST_EXACT, Column, LogFormat, Table, bounded
from ..units import UNKNOWN
from ..vocabulary import ELSEWHERE
from .parquet import Parquet
from .ros_types import MOST_ENTRIES

INFO = Path("meta", "info.json")
MOST_INFO = 1 << 24
"""Bytes of meta/info.json: names of some hundred joints and of every camera's codec."""
MOST_FILES = 100_000
FILE = re.compile(r"(episode_|file[-_])([0-9]{1,9})\.parquet")
CHUNK = re.compile(r"chunk-[0-9]{1,9}")
ACTION, EPISODE, STAMPS = "action", "episode_index", "timestamp"
QUANTITIES = {
    ACTION: "position",
    "observation.state": "position",
    "observation.velocity": "velocity",
    "observation.effort": "effort",
    "observation.current": "current",
}
"""Features with an entry per joint, and the quantity of entries that name none."""
BOOKKEEPING = ("frame_index", EPISODE, "index", "task_index", "next.done", "next.reward", "next.success")
"""Columns of every data set that are no joint's."""
SUFFIXES = {"pos": "position", "position": "position", "vel": "velocity", "velocity": "velocity", "effort": "effort", "torque": "effort"}
SUFFIXES |= {"tau": "effort", "current": "current", "cur": "current"}
"""Endings of names with a dot, `shoulder_pan.pos`, and their quantities."""
NAMED_UNIT = re.compile(r"(.+?)[_.](rad|deg)")
NO_JOINTS = ELSEWHERE | {*"xyz", *("qx", "qy", "qz", "qw", "rx", "ry", "rz"), "eef", "quat", "euler", "axis", "orientation", "ori"}
"""Words in the name of an entry that is a hand's place or a base's motion."""


class LeRobot(LogFormat):
    """Reader of one episode of a data set, from its folder or from one of its Parquet files."""

    name = "LeRobot"
    title = "a LeRobot data set"
    endings = ()

    def __init__(self, episode: int | None = None) -> None:
        self.episode = episode

    def is_of(self, path: Path) -> bool:
        return _root_of(path) is not None

    def is_guarded(self, path: Path) -> bool:
        return True

    def of_episode(self, path: Path, episode: int) -> LogFormat:
        return LeRobot(episode)

    @contextlib.contextmanager
    def table(self, path: Path, time: str | None) -> Iterator[Table]:
        root = _root_of(path)
        if root is None:
            raise GainroomError(f"{path}: has no {INFO}, which a LeRobot data set has")
        about = _about(root / INFO)
        files = _files(root) if path.is_dir() else [path]
        file, episode, note = _chosen(path, files, self.episode)
        with Parquet().table(file, time) as rows:
            yield _Episode(path, rows, about, episode, note)


def _root_of(path: Path) -> Path | None:
    """Folder of the data set that `path` is, or is a data file of; None if it is none."""
    if path.is_dir():
        return path if (path / INFO).is_file() else None
    parts = path.absolute().parts
    if len(parts) < 4 or parts[-3] != "data" or not CHUNK.fullmatch(parts[-2]) or not FILE.fullmatch(parts[-1]):
        return None
    root = path.absolute().parents[2]
    return root if (root / INFO).is_file() else None


def _files(root: Path) -> list[Path]:
    """Data files in their order. Raises GainroomError where there is none, or one lies outside the data set."""
    chunks = sorted(each for each in (root / "data").iterdir() if CHUNK.fullmatch(each.name)) if (root / "data").is_dir() else []
    files = [each for chunk in chunks for each in sorted(chunk.iterdir()) if FILE.fullmatch(each.name)]
    if not files:
        raise GainroomError(f"{root}: has no data/chunk-*/episode_*.parquet or file-*.parquet")
    bounded(root, "number of files", len(files), MOST_FILES)
    # The hub's cache has its content beside the snapshots, in links.
    allowed = [root.resolve(), *([root.parent.parent.resolve() / "blobs"] if root.parent.name == "snapshots" else [])]
    outside = [each for each in files if not any(each.resolve().is_relative_to(folder) for folder in allowed)]
    if outside:
        raise GainroomError(f"{outside[0]}: is a link out of the data set")
    return files


def _chosen(path: Path, files: Sequence[Path], wanted: int | None) -> tuple[Path, int | None, str]:
    """File that holds an episode, the episode's number where the file holds several, and a note on others; None: the first.

    Raises GainroomError where no file holds it.
    """
    by_number = {int(found[2]): file for file in files if (found := FILE.fullmatch(file.name)) and found[1] == "episode_"}
    if by_number:
        episode = min(by_number) if wanted is None else wanted
        if episode not in by_number:
            raise _no_episode(path, episode, sorted(by_number))
        return by_number[episode], None, _others(episode, len(by_number), wanted)
    seen: list[int] = []
    for file in files:
        with Parquet().table(file, None) as rows:
            if EPISODE not in {column.name for column in rows.columns}:
                raise GainroomError(f"{file}: has no column {EPISODE}, which tells its episodes apart")
            there = {int(each) for (part,) in rows.blocks([EPISODE]) for each in np.unique(part[np.abs(part) < MOST_EXACT])}
        if there and (wanted is None or wanted in there):
            episode = min(there) if wanted is None else wanted
            return file, episode, _others(episode, max(len(there), 2 if len(files) > 1 else 1), wanted)
        seen += there
    if not seen:
        raise GainroomError(f"{path}: has no row with a number in {EPISODE}")
    raise _no_episode(path, wanted or 0, sorted(seen))


def _no_episode(path: Path, episode: int, there: Sequence[int]) -> GainroomError:
    span = f"{there[0]}" if len(there) == 1 else f"{len(there)} from {there[0]} to {there[-1]}"
    return GainroomError(f"{path}: --episode {episode}: is not there; its episodes are {span}")


def _others(episode: int, count: int, wanted: int | None) -> str:
    return f"episode {episode} is read, of several: --episode says another" if wanted is None and count > 1 else ""


@dataclass(frozen=True)
class _About:
    """Content of meta/info.json: frames per second, and the names of the entries by feature."""

    rate: float
    names: Mapping[str, Sequence[str]]


def _about(info: Path) -> _About:
    """Content of meta/info.json. Raises GainroomError."""
    try:
        data = json.loads(bounded_text(info, MOST_INFO, "the description of a data set"))
    except (ValueError, RecursionError) as error:
        raise GainroomError(f"{info}: is not JSON: {one_line(error, 120)}") from error
    features = data.get("features") if isinstance(data, dict) else None
    if not isinstance(data, dict) or not isinstance(features, dict):
        raise GainroomError(f"{info}: features must be a section, with action and observation.state among them")
    rate = data.get("fps")
    if isinstance(rate, bool) or not isinstance(rate, int | float) or not 0 < rate <= 1e6:
        raise GainroomError(f"{info}: fps: {one_line(repr(rate), 40)} must be a number > 0, of rows per second")
    named = {key: _names(info, key, each.get("names")) for key in QUANTITIES if isinstance(each := features.get(key), dict)}
    return _About(float(rate), named)


def _names(info: Path, key: str, given: object) -> list[str]:
    """Names of a feature's entries: a list, or lists by group of motors; [] where they are not said. Raises GainroomError."""
    lists = [*given.values()] if isinstance(given, dict) else [given]
    flat = [each for one in lists if isinstance(one, list) for each in one]
    flat = [each for one in flat for each in (one if isinstance(one, list) else [one])]
    if given is not None and (not all(isinstance(each, str) and 0 < len(each) <= 100 for each in flat) or not flat):
        raise GainroomError(f"{info}: features.{key}.names must be a list of names: {one_line(repr(given), 60)}")
    bounded(info, f"number of names of {key}", len(flat), MOST_ENTRIES)
    return flat


class _Episode(Table):
    """Rows of one episode; columns `action[shoulder_pan.pos]`.

    episode   its number, where the file holds several; None: all rows are of one
    """

    def __init__(self, path: Path, rows: Table, about: _About, episode: int | None, note: str) -> None:
        super().__init__()
        self._rows, self._episode = rows, episode
        entries: dict[str, list[str]] = {key: [] for key in QUANTITIES}
        own: dict[str, str] = {}
        for column in rows.columns:
            key, _, index = column.name.partition("[")
            if key in QUANTITIES and index:
                entries[key].append(column.name)
            elif column.name not in BOOKKEEPING:
                own[column.name] = column.name
        columns = [Column(name, unit="s" if name == STAMPS else "") for name in own]
        others: list[str] = []
        for key, inner in entries.items():
            names = self._named(path, key, about, len(inner))
            for name, source in zip(names, inner, strict=True):
                joint, quantity, unit = _entry(name, QUANTITIES[key])
                shown = f"{key}[{name}]"
                if not joint or shown in own:
                    others.append(source if shown in own else shown)
                    continue
                own[shown] = source
                columns.append(Column(shown, quantity, joint, unit, commanded=key == ACTION))
        self._own = own
        self.columns = self._with_units(columns)
        self.notes = [note] if note else []
        if any(column.name == STAMPS for column in columns):
            self.notes.append(f"time stamps of LeRobot are frame numbers at {about.rate:g} Hz, not times that were measured")
        if others:
            self.notes.append(f"no joint's position, velocity, torque or current: {first_of_many(others)}")

    def _named(self, path: Path, key: str, about: _About, count: int) -> Sequence[str]:
        """Names of the entries of a feature: its own, else those of the other features, else numbers. Raises GainroomError."""
        own = about.names.get(key) or next((names for names in about.names.values() if names), [])
        if count and own and len(own) != count and about.names.get(key):
            raise GainroomError(f"{path}: {key} has {count} entries, and {INFO} names {len(own)}: which is which joint's is not known")
        return own if len(own) == count else [str(k) for k in range(count)]

    def _with_units(self, columns: Sequence[Column]) -> list[Column]:
        """Columns with the unit UNKNOWN where none is said: LeRobot's are degrees, parts of a range, counts or radians, by robot."""
        unsaid = ("position", "velocity", "current")
        return [
            Column(each.name, each.label, each.joint, UNKNOWN, each.commanded) if each.label in unsaid and not each.unit else each
            for each in columns
        ]

    def blocks(self, names: Sequence[str], held: Sequence[str] = ()) -> Iterator[list[Floats]]:
        if not names:
            return
        extra = [] if self._episode is None else [EPISODE]
        for part in self._rows.blocks([*(self._own[name] for name in names), *extra], held):
            self.complete, self.share = self._rows.complete, self._rows.share
            self.taken_off = {name: self._rows.taken_off[source] for name, source in self._own.items() if source in self._rows.taken_off}
            if self._episode is None:
                yield part
                continue
            *values, episodes = part
            mine = episodes == self._episode
            if mine.any():
                yield [each[mine] for each in values]


def _entry(name: str, quantity: str) -> tuple[str, str, str]:
    """Joint, quantity and unit of an entry's name; the joint "" for what is no joint's."""
    unit = ""
    if found := NAMED_UNIT.fullmatch(name):
        name, unit = found[1], found[2]
    stem, dot, suffix = name.rpartition(".")
    if dot and suffix.lower() not in SUFFIXES:
        return "", quantity, unit
    if dot:
        name, quantity = stem, SUFFIXES[suffix.lower()]
    words = {each.lower() for each in re.findall(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+", name)}
    joint = "" if words & NO_JOINTS or name == "theta" else name  # theta.vel is a mobile base's
    return joint, quantity, {"velocity": f"{unit}/s"}.get(quantity, unit) if unit and quantity in ("position", "velocity") else ""
