"""Parquet files that the library ends its process on, and pages whose numbers were changed: one line, and our process goes on."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from gainroom.files.logs import open_log, read_log
from refusals import assert_refused

ROWS = 80


def whole(path: Path) -> bytes:
    """A log with columns of numbers, of lists of numbers, and of words."""
    import pyarrow
    import pyarrow.parquet

    angle = np.random.default_rng(0).normal(size=(ROWS, 2))
    columns = {
        "time": 1e-3 * np.arange(ROWS),
        "q_hip": angle[:, 0],
        "action": pyarrow.array(angle.tolist(), pyarrow.list_(pyarrow.float64())),
        "mode": ["run"] * ROWS,
    }
    pyarrow.parquet.write_table(pyarrow.table(columns), path)
    return path.read_bytes()


def ends_in_process(path: Path) -> bool:
    """Whether the library takes its process with it, asked without this package."""
    program = (
        "import sys, pyarrow.parquet as p; group = p.ParquetFile(sys.argv[1]).metadata.row_group(0); list(map(group.column, range(4)))"
    )
    return subprocess.run([sys.executable, "-c", program, str(path)], capture_output=True, check=False).returncode < 0


@pytest.mark.parametrize("name", ["q_hip", *(pytest.param(name, marks=pytest.mark.slow) for name in ("element", "mode"))])
def test_a_column_that_says_it_lacks_nothing(name: str, tmp_path: Path):
    """OPTIONAL in the footer changed to REQUIRED, by one byte: the statistics then do not fit the column, and the library aborts.

    `element` is that of the lists.

    In Thrift's compact protocol: field 3 (0x25) of value 1 (zigzag 0x02), then field 4 (0x18), the name with its length.
    """
    path = tmp_path / "log.parquet"
    content = whole(path)
    behind = bytes([0x18, len(name)]) + name.encode()
    place = content.index(b"\x25\x02" + behind)
    path.write_bytes(content[:place] + b"\x25\x00" + content[place + 2 :])
    assert ends_in_process(path), "this version of the library does not end: nothing is tested"
    assert_refused(lambda: read_log(path), ["log.parquet", "damaged", "Parquet"])


def test_the_pages_of_our_own_logs_have_checksums(tmp_path: Path):
    """A changed bit of a number is found; without checksums it would be another number."""
    path = tmp_path / "log.parquet"
    angle = np.random.default_rng(0).normal(size=(ROWS, 1))
    with open_log(path, ("joint",), ("motor_position",)) as log:
        log.write({"time": 1e-3 * np.arange(ROWS), "motor_position": angle})
    content = path.read_bytes()
    place = content.index(angle[50].tobytes())
    path.write_bytes(content[:place] + bytes([content[place] ^ 8]) + content[place + 1 :])
    assert_refused(lambda: read_log(path), ["log.parquet", "CRC"])
