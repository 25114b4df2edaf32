"""What other commands do with a workspace: audit looks at all of it, robot names worse postures and takes a sweep's."""

import json
import re
import shlex
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest

import gainroom as gr
from gainroom.analysis.margin_record import NUDGE
from gainroom.cli import main
from gainroom.files.robot_yaml import load_robot_system
from gainroom.robot.linearize import linearize
from gainroom.studies.sweep.limits import configurations
from gainroom.studies.sweep.workspace import latin_hypercube
from gainroom.studies.verdict import STATUS
from robot_files import ROBOT, write_arm

BIPED = files("gainroom") / "robot" / "models" / "biped.urdf"
PROVED = 1 - NUDGE
QUICK = ROBOT.partition("tasks:")[0] + "limits: {gain_margin_db: 6}\n"
STRETCHED = QUICK.replace("shoulder: 0.4, elbow: 0.9", "shoulder: 0.0, elbow: 0.0")


def alone(file, angles) -> float:
    """gain_limit of the file's gains at joint positions (n,)."""
    system = load_robot_system(file)
    robot = system.source
    q = configurations(robot.body, np.array([angles]))[0]
    return gr.gain_limit(system.loop(linearize(robot.body, robot.actuators, q))).gain


@pytest.mark.slow
def test_robot_names_a_posture_that_is_worse_than_the_file_s(tmp_path, capsys):
    """The arm bends: some posture has a limit more than 1 % below that of the file's, which is the highest of a search."""
    light = STRETCHED.replace("motor_inertia: 0.5", "motor_inertia: 0.02").replace("kp: 400.0, kd: 30.0", "kp: 40.0, kd: 2.0")
    file = write_arm(tmp_path, light)
    angles = np.random.default_rng(0).uniform(-np.pi, np.pi, (60, 2))
    limits = [alone(file, one) for one in angles]
    best = angles[int(np.argmax(limits))]
    file.write_text(light.replace("shoulder: 0.0, elbow: 0.0", f"shoulder: {best[0]}, elbow: {best[1]}"))
    assert min(limits) < 0.985 * max(limits)
    assert main(["robot", str(file), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    worse = found["worse_posture"]
    known = min(state["gain_limit"] for state in found["states"])
    assert worse["gain_limit"] < 0.99 * known
    assert worse["gain_limit"] == pytest.approx(alone(file, list(worse["angles"].values())) * PROVED, rel=1e-9)
    assert main(["robot", str(file)]) == 0
    assert "Another posture is worse than the file's" in " ".join(capsys.readouterr().out.split())


@pytest.mark.parametrize(("count", "size"), [(32, 29), (256, 3), (1, 2)])
def test_postures_in_passing_fill_every_range(count, size):
    """Of `count` equal parts of each joint's range every one has exactly one posture: a Latin hypercube, the same every time."""
    points = latin_hypercube(count, size)
    parts = np.sort(np.floor(points * count), axis=0)
    np.testing.assert_array_equal(parts, np.tile(np.arange(count)[:, None], (1, size)))
    np.testing.assert_array_equal(points, latin_hypercube(count, size))
    if size > 2:  # shuffled apart: five times the chance's size
        assert np.abs(np.corrcoef(points.T) - np.eye(size)).max() < 5 / np.sqrt(count)


@pytest.mark.slow
def test_robot_takes_the_worst_postures_of_a_sweep(tmp_path, capsys):
    """They stand among its states, and recommended gains have the margin in every swept posture, not in the file's alone."""
    file, store = write_arm(tmp_path, STRETCHED.replace("delay_ms: 2.0", "delay_ms: 5.0")), tmp_path / "sweep.zarr"
    assert main(["sweep", str(file), "--samples", "300", "--output", str(store), "--json"]) == 0
    worst = json.loads(capsys.readouterr().out)["worst"]
    assert main(["robot", str(file), "--sweep", str(store), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    states = {state["posture"]: state["gain_limit"] for state in found["states"]}
    assert states[f"sweep {worst['posture']}"] * PROVED == pytest.approx(worst["gain_limit"], rel=1e-9)
    swept = found["swept"]
    assert swept["limits"] == 300
    assert "swept 3" in states  # the recommended gains of the first round were short of it there
    assert swept["below_margin_share"] == 0
    assert swept["worst"]["gain_limit"] >= 10 ** (6 / 20)


def test_a_sweep_of_another_robot_is_refused(tmp_path, capsys):
    file, store = write_arm(tmp_path, STRETCHED), tmp_path / "sweep.zarr"
    assert main(["sweep", str(file), "--samples", "20", "--output", str(store), "--json"]) == 0
    biped = tmp_path / "biped.yaml"
    biped.write_text((files("gainroom") / "files" / "examples" / "biped.yaml").read_text())
    capsys.readouterr()
    for given, words in ((store, "is a sweep of a robot with other joints"), (tmp_path, "is not the store of a sweep")):
        assert main(["robot", str(biped), "--sweep", str(given)]) == 2
        assert words in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.parametrize("factor", [1.0, 6.0])
def test_audit_looks_at_the_whole_workspace(tmp_path, capsys, factor):
    """Against gain_limit at the posture it names, and by count of random ones."""
    gains = tmp_path / "gains.yaml"
    gains.write_text(f"default: {{kp: {400 * factor}, kd: {30 * factor}, motor_inertia: 1.0}}\n")
    call = ["audit", str(BIPED), "--delay-ms", "2", "--gains", str(gains), "--base", "fixed", "--workspace", "100", "--json"]
    status = main(call)
    found = json.loads(capsys.readouterr().out)
    swept = found["workspace"]
    assert swept["limits"] == 100
    assert status == STATUS[found["verdict"]]
    assert (found["verdict"] == "unsafe") is (not (found["requirements_met"] and swept["safe"]))  # else the rate is not given
    assert swept["worst"]["gain_limit"] <= found["gain_limit"] * (1 + 1e-9)
    assert (swept["below_margin_share"] > 0) is (not swept["gain_margin_met"])
    assert main(call[:-1]) == status
    assert "Workspace:" in capsys.readouterr().out


@pytest.mark.slow
def test_an_audit_requires_the_extra_delay_in_every_posture(tmp_path, capsys):
    """Safe with a bent knee, unstable with 3 ms more delay in the posture that it names and in as many as it says: by eigenvalues."""
    gains = tmp_path / "gains.yaml"
    gains.write_text("default: {kp: 546, kd: 54.6, motor_inertia: 0.2}\n")
    call = ["audit", str(BIPED), "--delay-ms", "2", "--rate-hz", "1000", "--gains", str(gains), "--base", "fixed", "--delay-margin-ms", "3"]
    call += ["--peak-sensitivity", "4"]  # of delay alone is this
    call += ["--posture", ".*knee.*=1.5", "--workspace", "60"]
    robot = tmp_path / "robot.yaml"
    assert main([*call, "--write-robot", str(robot), "--json"]) == 1
    found = json.loads(capsys.readouterr().out)
    assert found["requirements_met"]
    swept = found["workspace"]
    assert swept["gain_margin_met"]
    assert not swept["safe"]
    assert swept["unmet"] == ["delay_margin"]
    source = load_robot_system(robot).source

    def growth(angles: np.ndarray, factor: float, ticks: int) -> float:
        """ln of the spectral radius of M a = u under PD by backward differences, held for 1 ms, so many ticks late."""
        model = linearize(source.body, source.actuators, configurations(source.body, np.atleast_2d(angles))[0])
        push = np.linalg.inv(np.linalg.inv(model.link_inverse_inertia) + np.diag(model.motor_inertia))
        size, tick, eye = model.size, 1e-3, np.eye(model.size)
        blocks = 3 + ticks  # positions, velocities, positions before, torques on the way
        matrix = np.zeros((blocks * size, blocks * size))

        def at(row: int, column: int, value: np.ndarray) -> None:
            matrix[row * size : (row + 1) * size, column * size : (column + 1) * size] = value

        for row, column, value in ((0, 0, eye), (0, 1, tick * eye), (1, 1, eye), (2, 0, eye)):
            at(row, column, value)
        at(0, 2 + ticks, 0.5 * tick**2 * push)
        at(1, 2 + ticks, tick * push)
        at(3, 0, -factor * (546 + 54.6 / tick) * eye)
        at(3, 2, factor * 54.6 / tick * eye)
        for late in range(1, ticks):
            at(3 + late, 2 + late, eye)
        return float(np.log(np.abs(np.linalg.eigvals(matrix)).max()))

    later = swept["extra_delay"]
    angles = np.array(list(later["worst"]["angles"].values()))
    limit = later["worst"]["gain_limit"]
    assert limit < 1
    assert growth(angles, 0.999 * limit, 5) < 0 < growth(angles, 1.001 * limit, 5)
    assert growth(angles, 1.0, 2) < 0 < growth(angles, 1.0, 5)
    assert 0 < later["unstable_share"] < 1
    assert main(call) == 1
    said = " ".join(capsys.readouterr().out.split())
    assert said.startswith("In this posture: ")
    assert f"With 3 ms more delay, as required: unstable in {100 * later['unstable_share']:.3g} % of 60 postures" in said


@pytest.mark.slow
def test_an_audit_judges_what_else_is_asked_for_in_a_sample_of_the_workspace(tmp_path, capsys):
    """The phase margin that it names is that of the posture which it names; 5° more than that is missed there, and decides."""
    gains = tmp_path / "gains.yaml"
    gains.write_text("default: {kp: 8000, kd: 300, motor_inertia: 1.0, stiffness: 10000, damping: 20}\n")
    call = ["audit", str(BIPED), "--delay-ms", "2", "--gains", str(gains), "--base", "fixed", "--workspace", "24"]
    robot = tmp_path / "robot.yaml"
    assert main([*call, "--write-robot", str(robot), "--json"]) == 3  # not decided: the rate is not given
    found = json.loads(capsys.readouterr().out)["workspace"]
    assert found["unmet"] == []
    worst = {one["name"]: one for one in found["judged"]["requirements"]}["phase_margin"]
    system = load_robot_system(robot)
    q = configurations(system.source.body, np.array([list(worst["angles"].values())]))[0]
    margins = gr.joint_margins(system.loop(linearize(system.source.body, system.source.actuators, q)))
    assert worst["worst"] == pytest.approx(np.degrees(margins.phase_margin), rel=1e-9)
    assert main([*call, "--json", "--phase-margin-deg", str(worst["worst"] + 5)]) == 1
    found = json.loads(capsys.readouterr().out)["workspace"]
    assert found["unmet"] == ["phase_margin"]
    assert found["safe"] is False
    assert main([*call, "--phase-margin-deg", str(worst["worst"] + 5)]) == 1
    assert "Not met: phase margin" in " ".join(capsys.readouterr().out.split()).partition("Workspace:")[2]


@pytest.mark.slow
def test_what_else_fails_in_the_worst_postures_is_said(tmp_path, capsys):
    """The biped's gain margin holds everywhere; its phase margin does not, where gain limits are lowest."""
    biped = tmp_path / "biped.yaml"
    biped.write_text((files("gainroom") / "files" / "examples" / "biped.yaml").read_text())
    call = ["sweep", str(biped), "--samples", "80", "--contact", "left"]
    assert main([*call, "--json"]) == 1
    found = json.loads(capsys.readouterr().out)
    assert found["gain_margin_met"] is True
    system = load_robot_system(biped)
    robot = system.source
    q = configurations(robot.body, np.array([list(found["worst"]["angles"].values())]))[0]
    margins = gr.joint_margins(system.loop(linearize(robot.body, robot.actuators, q, robot.contacts["left"])))
    assert ("phase_margin" in found["unmet"]) is (margins.phase_margin < np.pi / 6)
    assert found["unmet"]
    assert main([*call, "--strict"]) == 1
    said = " ".join(capsys.readouterr().out.split())
    assert "Not met: phase margin" in said
    assert "Safe" not in said


@pytest.mark.slow
def test_the_audit_s_page_shows_the_workspace(tmp_path, capsys):
    """What JSON says of it, with the factor that is safe in all of it, and the command that asks for it."""
    gains, page = tmp_path / "gains.yaml", tmp_path / "audit.html"
    gains.write_text("default: {kp: 8000, kd: 600, motor_inertia: 1.0}\n")
    call = ["audit", str(BIPED), "--delay-ms", "2", "--gains", str(gains), "--base", "fixed", "--workspace", "100", "--json"]
    call += ["--delay-margin-ms", "1"]
    assert main([*call, "--report", str(page)]) == 1
    found = json.loads(capsys.readouterr().out)["workspace"]
    html = page.read_text("utf-8")
    assert "The workspace: 100 postures" in html
    assert "--workspace 100" in html
    assert f"{100 * found['safe_share']:.4g} % of 100 limits hold" in html.replace("none of", "0 % of")
    later = found["extra_delay"]["worst"]["gain_limit"]
    assert found["scale"] == pytest.approx(min(found["worst"]["gain_limit"] / 10 ** (6 / 20), later), rel=1e-12)
    kept = "keep the gain margin, and are stable with that extra delay, in every posture swept"
    assert f"All gains × {np.floor(1000 * found['scale']) / 1000:.4g} {kept}" in html
    assert "How limits spread over the workspace" in html
    assert "The worst posture, " in html


@pytest.mark.slow
def test_the_robot_s_page_shows_what_recommended_gains_keep_in_a_sweep(tmp_path, capsys):
    file, store, page = write_arm(tmp_path, STRETCHED), tmp_path / "sweep.zarr", tmp_path / "robot.html"
    assert main(["sweep", str(file), "--samples", "100", "--output", str(store), "--json"]) == 0
    capsys.readouterr()
    assert main(["robot", str(file), "--sweep", str(store), "--report", str(page)]) == 0
    said = " ".join(capsys.readouterr().out.split())
    html = page.read_text("utf-8")
    sentence = said[said.index("Recommended gains keep") :].partition("; the lowest")[0]
    assert sentence in html
    assert "Recommended gains in 100 swept postures" in html


def others(system, angles, contact):
    """Phase margin and Ms of a robot's loops at joint positions (n,), all margins worked out."""
    robot = system.source
    q = configurations(robot.body, np.array([angles]))[0]
    found = gr.joint_margins(system.loop(linearize(robot.body, robot.actuators, q, robot.contacts[contact])))
    return {"phase_margin": (np.degrees(found.common_phase_margin), np.degrees(found.one_loop_phase_margin)), "peak_sensitivity": found}


@pytest.mark.slow
def test_other_requirements_are_judged_in_a_sample_and_that_is_said(tmp_path, capsys):
    """The worst that is found is no better than in any of 8 postures of a sweep of 8, each worked out by itself."""
    biped = tmp_path / "biped.yaml"
    biped.write_text((files("gainroom") / "files" / "examples" / "biped.yaml").read_text())
    store = tmp_path / "sweep.zarr"
    call = ["sweep", str(biped), "--samples", "8", "--contact", "left", "--output", str(store)]
    assert main([*call, "--json"]) == 1
    judged = json.loads(capsys.readouterr().out)["judged"]
    assert judged["everywhere"] is True
    assert judged["count"] == 8
    system = load_robot_system(biped)
    every = [others(system, angles, "left") for angles in gr.open_sweep(store).angles.values]
    phases = [min(one["phase_margin"]) for one in every]
    peaks = [one["peak_sensitivity"].peak_sensitivity for one in every]
    rows = {row["name"]: row for row in judged["requirements"]}
    assert rows["phase_margin"]["worst"] == pytest.approx(min(phases), rel=1e-9)
    assert rows["phase_margin"]["missed"] == sum(one < 30 for one in phases) > 0
    assert rows["peak_sensitivity"]["worst"] == pytest.approx(max(peaks), rel=1e-2)
    assert rows["peak_sensitivity"]["missed"] == sum(one > 2 for one in peaks)
    assert main([*call, "--margins", "2", "--json"]) == 1
    fewer = json.loads(capsys.readouterr().out)["judged"]
    assert (fewer["lowest"], fewer["random"], fewer["everywhere"]) == (2, 2, False)
    assert 2 <= fewer["count"] <= 4
    assert {row["name"]: row["worst"] for row in fewer["requirements"]}["phase_margin"] >= min(phases) * (1 - 1e-9)
    assert main([*call, "--margins", "2"]) == 1
    assert "Judged in a sample, not everywhere: phase margin, peak sensitivity Ms" in " ".join(capsys.readouterr().out.split())
    assert main([*call, "--margins", "-1"]) == 2
    assert "--margins -1 must be from 0 to" in capsys.readouterr().err


@pytest.mark.slow
def test_the_gallery_s_numbers_are_those_of_the_command(tmp_path, capsys):
    """One robot's file as the page has it, typed anew: table rows, delay by delay, are what `gainroom sweep` prints."""
    page = (Path(__file__).parents[1] / "docs" / "gallery_sweeps.md").read_text("utf-8")
    section = page[page.index("## Franka Panda") :]
    text = re.search(r"```yaml\n(.*?)```", section, re.S)
    command = re.search(r"`gainroom (sweep robot.yaml [^`]*)`", section)
    table = [[cell.strip() for cell in line.strip("|").split("|")] for line in section.splitlines() if line.startswith(("| 2 |", "| 4 |"))]
    assert text is not None
    assert command is not None
    assert len(table) >= 2
    file = tmp_path / "robot.yaml"
    for delay, row in zip(("2", "4"), table, strict=False):
        file.write_text(text[1].replace("delay_ms: 2.0", f"delay_ms: {delay}.0"))
        main([*shlex.split(command[1].replace("robot.yaml", str(file))), "--workers", "1", "--json"])
        (one,) = json.loads(capsys.readouterr().out)["contacts"]
        assert row[:2] == [delay, one["contact"]]
        assert float(row[2]) == pytest.approx(20 * np.log10(one["gain_limit"]), abs=0.051)  # a digit behind the point
        assert float(row[3]) == pytest.approx(20 * np.log10(one["gain_limit_median"]), abs=0.051)
        assert float(row[4]) == pytest.approx(100 * one["below_margin"] / one["count"], abs=0.051)
        assert float(row[5]) == pytest.approx(100 * one["unstable"] / one["count"], abs=0.051)
        assert row[7] == one["limiting_joint"]


def test_where_contacts_hold_every_joint_nothing_can_vibrate(tmp_path, capsys):
    """A planar arm whose hand is held in place and orientation has no motion left: gearboxes, taken for rigid, pass it on."""
    rigid = QUICK.replace(", stiffness: 8000.0, damping: 4.0", "") + "contacts: {free: [], held: [lower]}\n"
    file = write_arm(tmp_path, rigid)
    assert main(["sweep", str(file), "--samples", "12", "--contact", "held", "--json"]) == 3
    found = json.loads(capsys.readouterr().out)
    assert found["unknown"] == found["uncertified"] == 0
    assert found["contacts"][0]["gain_limit"] is None
    assert found["sentence"].startswith("No common factor up to 1000 on all gains makes it vibrate")
    assert main(["sweep", str(file), "--samples", "12", "--contact", "free", "--json"]) == 3
    assert json.loads(capsys.readouterr().out)["contacts"][0]["gain_limit"] > 1


def test_gains_that_no_factor_makes_stable_are_said_to_be_so(tmp_path, capsys):
    """Undamped gearboxes behind 6 ms: the roots at their resonance lie to the right of the axis however low the gains are."""
    undamped = QUICK.replace("damping: 4.0", "damping: 0.0").replace("delay_ms: 2.0", "delay_ms: 6.0")
    file, page = write_arm(tmp_path, undamped), tmp_path / "page.html"
    system = load_robot_system(file)
    for factor in (1.0, 0.1, 1e-3):
        weak = system.with_controller(gr.PD(400.0 * factor, 30.0 * factor))
        assert not gr.is_stable(weak.loop(system.source.linearize("bent", "free")))
    assert main(["sweep", str(file), "--samples", "4", "--workers", "1", "--margins", "0", "--report", str(page)]) == 1
    text = " ".join(capsys.readouterr().out.split())
    assert "no common factor on these gains is stable" in text
    assert "Use:" not in text
    assert "no common factor on these gains is stable" in page.read_text("utf-8")
    assert main(["sweep", str(file), "--samples", "4", "--workers", "1", "--margins", "0", "--json"]) == 1
    found = json.loads(capsys.readouterr().out)
    assert found["scale"] is None
    assert found["worst"]["gain_limit"] == found["contacts"][0]["gain_limit_highest"] == 0


def swept(capsys, file: Path, *options: str) -> tuple[dict, str]:
    """What a sweep says in JSON, and in a terminal."""
    call = ["sweep", str(file), "--seed", "2", *options]
    assert main([*call, "--json"]) < 2
    found = json.loads(capsys.readouterr().out)
    assert main(call) < 2
    return found, " ".join(capsys.readouterr().out.split())


def with_gains(file: Path, factor: float) -> None:
    """The arm's gains times a factor, in digits that say the product exactly."""
    text = file.read_text("utf-8")
    kp, kd = (float(re.search(rf"\b{name}: ([\d.]+)", text)[1]) for name in ("kp", "kd"))
    file.write_text(text.replace(f"kp: {kp}", f"kp: {factor * kp!r}").replace(f"kd: {kd}", f"kd: {factor * kd!r}"), "utf-8")


@pytest.mark.slow
@pytest.mark.parametrize("limits", ["gain_margin_db: 6.0", *(f"gain_margin_db: 6.0, peak_sensitivity: {most}" for most in (1.3, 2.5))])
@pytest.mark.parametrize("samples", [1, *(pytest.param(count, marks=pytest.mark.slow) for count in (2, 3))])
def test_a_sweep_recommends_nothing_that_its_own_search_refutes(tmp_path, capsys, samples, limits):
    """Few postures, so that the search leads lower: the same sweep of the gains that were recommended finds the margin, search and all."""
    file = write_arm(tmp_path, ROBOT.partition("tasks:")[0] + f"limits: {{{limits}}}\n")
    with_gains(file, 6.0)
    first, text = swept(capsys, file, "--samples", str(samples))
    margin = 10 ** (6 / 20)
    assert first["searched"]["gain_limit"] < (1 - 1e-3) * first["worst"]["gain_limit"]  # else this test shows nothing
    assert first["scale"] == pytest.approx(first["searched"]["gain_limit"] / margin, rel=1e-12)
    use = re.search(r"(?:Use: a|With a)ll gains × ([\d.]+)[;\s]", text)
    with_gains(file, float(use[1]))
    again, _ = swept(capsys, file, "--samples", str(samples))
    assert again["searched"]["gain_limit"] >= margin * (1 - 1e-9)  # the limit of scaled gains is the scaled limit, to round-off
    recommended, failing = text.count("Use: all gains"), [one["name"] for one in again["judged"]["requirements"] if not one["met"]]
    assert recommended == (0 if failing else 1), failing
    assert all(name in again["unmet"] for name in failing)
