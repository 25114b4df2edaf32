"""Tries an installed gainroom: a joint of its examples and, if one is named, a robot of audit (`smoke.py examples/robot.xml`)."""

import json
import subprocess
import sys
import tempfile
from pathlib import Path


def said(*words: str, status: int, folder: str) -> str:
    """Output of the command, which ends with `status`."""
    done = subprocess.run(
        [sys.executable, "-m", "gainroom", *words], cwd=folder, capture_output=True, text=True, encoding="utf-8", check=False
    )
    if done.returncode != status:
        sys.exit(f"gainroom {' '.join(words)}: exit status {done.returncode}, not {status}\n{done.stdout}{done.stderr}")
    return done.stdout


def main() -> None:
    """The paper's joint is stable at its gains and misses margins, for it vibrates at kd 80 instead of 70."""
    with tempfile.TemporaryDirectory() as folder:
        print(said("--version", status=0, folder=folder).strip())
        Path(folder, "joint.yaml").write_text(said("example", "testbed", status=0, folder=folder), "utf-8")
        facts = json.loads(said("joint", "joint.yaml", "--json", "--report", "joint.html", status=1, folder=folder))
        assert facts["stable"] is True
        assert Path(folder, "joint.html").stat().st_size > 10_000  # a page with its figures
        for model in sys.argv[1:]:
            words = ("audit", str(Path(model).resolve()), "--delay-ms", "1.5", "--rate-hz", "2000", "--json")
            assert json.loads(said(*words, status=1, folder=folder))["stable"] is True  # as the README says: stable, and not safe


main()
