"""ROS 2 bags: a folder with metadata.yaml and files in SQLite (.db3) or MCAP, or one such file alone."""

import contextlib
import re
import sqlite3
import sys
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import quote

from ....errors import GainroomError, one_line
from ....io.yaml_text import parse_yaml, read_text
from ..table import MOST_PIECE, LogFormat, Table, checked_file, library
from .mcap_file import McapMessages, message_table
from .messages import Messages, Topic

METADATA = "metadata.yaml"
MOST_FILES = 1000
MOST_TOPICS = 10_000


class Bag(LogFormat):
    """Reader of a ROS 2 bag: a folder of SQLite or MCAP files, or a single .db3 file; single MCAP files have mcap_file.py."""

    name = "ROS 2 bag"
    title = "a ROS 2 bag"
    endings = (".db3",)

    def is_guarded(self, path: Path) -> bool:
        return True

    @contextlib.contextmanager
    def table(self, path: Path, time: str | None) -> Iterator[Table]:
        files = _files(path) if path.is_dir() else [path]
        if any(file.suffix == ".mcap" for file in files):
            library("mcap", "mcap.stream_reader")
        for file in files:
            checked_file(file)
        sources: list[Messages] = [McapMessages(file) if file.suffix == ".mcap" else SqliteMessages(file) for file in files]

        def messages() -> Iterator[tuple[Topic, int, bytes]]:
            for source in sources:
                yield from source()

        yield message_table(path, messages, [source for source in sources if isinstance(source, McapMessages)])


def _files(folder: Path) -> list[Path]:
    """Files of a bag, in the order of its metadata.yaml, otherwise by name. Raises GainroomError if one is outside the folder."""
    if not (folder / METADATA).exists():
        files = sorted(file for file in folder.iterdir() if file.suffix in (".db3", ".mcap"))
        if not files:
            raise GainroomError(f"{folder}: is a directory without {METADATA}, .db3 or .mcap; a ROS 2 bag has them")
        return files[:MOST_FILES]
    where = folder / METADATA
    data = parse_yaml(read_text(where), str(where))
    about = data.get("rosbag2_bagfile_information") if isinstance(data, dict) else None
    names = about.get("relative_file_paths") if isinstance(about, dict) else None
    if not isinstance(about, dict) or not isinstance(names, list) or not 0 < len(names) <= MOST_FILES:
        raise GainroomError(f"{where}: rosbag2_bagfile_information.relative_file_paths must list the bag's files, 1 to {MOST_FILES}")
    if str(about.get("compression_mode") or "none").lower() != "none":
        raise GainroomError(
            f"{where}: compression_mode {one_line(about['compression_mode'], 40)!r} is not read; unpack it with ros2 bag convert"
        )
    return [_inside(folder, name, where) for name in names]


def _inside(folder: Path, name: object, where: Path) -> Path:
    """Path of a file of the bag. Refused is one outside its folder, by `..`, by an absolute path or by a link.

    Before version 4 the names in the file begin with the folder's own, as it was called when it was recorded.
    """
    path = folder / str(name)
    if isinstance(name, str) and re.fullmatch(r"[^/\0]*[^./\0]/[^/\0]+", name) and not path.exists():
        path = folder / name.rpartition("/")[2]
    if not isinstance(name, str) or "\0" in name or not path.resolve().is_relative_to(folder.resolve()):
        raise GainroomError(f"{where}: relative_file_paths: {one_line(repr(name), 80)} must be a file in the bag's folder")
    if path.suffix not in (".db3", ".mcap"):
        raise GainroomError(f"{where}: relative_file_paths: {one_line(repr(name), 80)} must end in .db3 or .mcap")
    return path


class SqliteMessages:
    """Messages of a .db3 file, in the order in which they were written."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def __call__(self) -> Iterator[tuple[Topic, int, bytes]]:
        place = f"file:{quote(str(self._path.resolve()))}?mode=ro&immutable=1"
        with contextlib.closing(sqlite3.connect(place, uri=True)) as database:
            database.execute("PRAGMA trusted_schema = OFF")
            if sys.version_info >= (3, 11):  # before, the bounds of the child that reads are all there are
                database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, MOST_PIECE)
            self._check(database)
            topics = self._topics(database)
            for number, stamp, data in database.execute("SELECT topic_id, timestamp, data FROM messages ORDER BY id"):
                if number in topics and isinstance(data, bytes) and isinstance(stamp, int):
                    yield topics[number], stamp, data

    def _check(self, database: sqlite3.Connection) -> None:
        """Raises GainroomError unless topics and messages are plain tables: the content of a computed column is not in the file."""
        found = dict(database.execute("SELECT name, sql FROM sqlite_master WHERE type = 'table' AND name IN ('topics', 'messages')"))
        if set(found) != {"topics", "messages"}:
            raise GainroomError(f"{self._path}: has no tables topics and messages, as a ROS 2 bag has")
        for name, text in found.items():
            hidden = [row for row in database.execute(f"PRAGMA table_xinfo({name})") if row[6]]
            if hidden or str(text).lstrip().upper().startswith("CREATE VIRTUAL"):
                raise GainroomError(f"{self._path}: table {name} is computed, and that of a ROS 2 bag is not")

    def _topics(self, database: sqlite3.Connection) -> dict[int, Topic]:
        definitions: dict[str, tuple[str, str]] = {}
        if database.execute("SELECT 1 FROM sqlite_master WHERE type = 'table' AND name = 'message_definitions'").fetchone():
            rows = database.execute("SELECT topic_type, encoding, encoded_message_definition FROM message_definitions")
            definitions = {str(name): (str(encoding), str(text)) for name, encoding, text in rows.fetchmany(MOST_TOPICS)}
        rows = database.execute("SELECT id, name, type, serialization_format FROM topics").fetchmany(MOST_TOPICS)
        return {
            number: Topic(str(name).strip("/"), str(encoding), str(kind), *definitions.get(str(kind), ("", "")))
            for number, name, kind, encoding in rows
        }
