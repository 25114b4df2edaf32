"""What a user of the package may add from outside, with nothing else touched."""

import json

import pytest

from gainroom.cli import main
from gainroom.report.columns import JOINT, Column
from robot_files import write_arm


def test_a_column_is_one_entry(tmp_path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch):
    """It stands in the terminal's table with its definition, in JSON, and on the page."""
    path = write_arm(tmp_path)
    monkeypatch.setattr("gainroom.studies.robot._recommended", lambda spec, tell: ())  # which takes longest, and has other columns
    rate = Column("kd/kp", "rate_s", lambda row: row.kd / row.kp, "s", "the time constant of the joint's zero")
    JOINT.append(rate)
    try:
        page = tmp_path / "page.html"
        main(["robot", str(path), "--report", str(page)])
        terminal = " ".join(capsys.readouterr().out.split())
        main(["robot", str(path), "--json"])
        (row, *_) = json.loads(capsys.readouterr().out)["states"][0]["joints"]
    finally:
        JOINT.remove(rate)
    assert "kd/kp: the time constant of the joint's zero" in terminal
    assert row["rate_s"] == pytest.approx(row["kd"] / row["kp"])
    shown = rate.text(type("Row", (), {"kd": row["kd"], "kp": row["kp"]}))
    assert shown in terminal
    html = page.read_text("utf-8")
    assert '<th scope="col">kd/kp</th>' in html
    assert f"<td>{shown}</td>" in html
