"""The documentation is true: its blocks run and print what they show, its links lead somewhere, every key has its line."""

import importlib.util
import json
import re
from collections.abc import Callable
from pathlib import Path

import pytest

from gainroom.cli import main
from gainroom.files import joint_scenario as scenario_sections, joint_yaml as config, system_sections as config_sections
from gainroom.files.compare_section import ComparedSensorsSection, CompareSection
from gainroom.files.gain_formats import actuator_configs, gain_arrays, gain_record, ros2_control
from gainroom.files.identified_section import IdentifiedSection
from robot_files import write_arm

ROOT = Path(__file__).parents[1]
_spec = importlib.util.spec_from_file_location("docs_output", ROOT / "scripts" / "docs_output.py")
assert _spec is not None
assert _spec.loader is not None
docs_output = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(docs_output)

DOCUMENTS = [*docs_output.documents(), ROOT / "CHANGELOG.md", ROOT / "CONTRIBUTING.md"]
SECTIONS = [
    config.JointSection,
    config_sections.DriveSection,
    config_sections.control_section(config.JointControlSection),
    config_sections.LowPassSection,
    config_sections.NotchSection,
    config_sections.BiquadSection,
    config_sections.GainPathSection,
    config_sections.limits_section(),
    config.JointUncertaintySection,
    IdentifiedSection,
    CompareSection,
    ComparedSensorsSection,
    scenario_sections.ScenarioSection,
    scenario_sections.StepSection,
    scenario_sections.MoveSection,
    scenario_sections.ChirpSection,
    scenario_sections.MultisineSection,
    scenario_sections.DisturbanceSection,
    scenario_sections.FrictionSection,
    scenario_sections.FrictionsSection,
]


@pytest.mark.slow
@pytest.mark.parametrize("path", docs_output.documents(), ids=lambda path: path.name)
def test_blocks_run_and_print_what_is_shown(path: Path, tmp_path: Path):
    text = path.read_text("utf-8")
    fresh = path.name == "README.md"  # and tests/test_faults.py, test_kills.py, test_cli.py: how a command starts is tested, too
    assert docs_output.renewed(text, tmp_path, fresh) == text, f"run: python {Path(docs_output.__file__).relative_to(ROOT)}"


def test_a_named_block_is_a_file_and_a_hidden_command_runs_without_a_trace():
    text = "<!-- file: a.txt -->\n```yaml\nx: 1\n```\n<!-- run: echo y >> a.txt -->\n```console\n$ cat a.txt\nold\n```\n"
    assert docs_output.renewed(text) == text.replace("old\n", "x: 1\ny\n")


def test_progress_is_no_output():
    """It comes with the time that a machine takes; errors are shown, and a command's own redirection holds."""
    script = "echo 'gainroom: robot: 80 % done, 10 s so far, about 2 s left' >&2; echo said; echo wrong >&2"
    page = f"```console\n$ {{ {script}; }}\n$ {{ {script}; }} > out.txt 2> err.txt\n$ cat out.txt\n```\n"
    shown = docs_output.renewed(page).splitlines()
    assert [line for line in shown if not line.startswith(("$", "`"))] == ["said", "wrong", "said"]


NEAR = [("z  1\u202f100   0.5 Hz", True), ("z  1\u202f120   0.5 Hz", False), ("y  1\u202f100   0.5 Hz", False)]


@pytest.mark.parametrize(("found", "near"), NEAR)
def test_what_a_search_finds_stays_while_it_is_near(found, near):
    """And nothing else does: the next block is exact."""
    shown = "z 1\u202f000 0.5 Hz"
    text = f"<!-- within: 10 -->\n```console\n$ echo '{found}'\n{shown}\n```\n```console\n$ echo 1.1\n1.0\n```\n"
    expected = text.replace("1.0\n```", "1.1\n```")
    assert docs_output.renewed(text) == (expected if near else expected.replace(shown, found))


def test_a_picture_that_a_block_makes_is_put_where_the_page_shows_it(tmp_path: Path):
    docs_output.renewed("![a](images/a.svg) ![b](images/b.svg)\n```python\nopen('a.svg', 'w').write('<svg/>')\n```\n", tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["a.svg"]


@pytest.mark.parametrize("path", DOCUMENTS, ids=lambda path: path.name)
def test_links_lead_somewhere(path: Path):
    for target in re.findall(r"\]\(([^)#\s]+)(?:#[^)]*)?\)", path.read_text("utf-8")):
        if not target.startswith("https://"):
            assert (path.parent / target).exists(), target


@pytest.mark.parametrize("section", SECTIONS, ids=lambda section: section.__name__)
def test_every_key_of_a_joint_file_is_documented(section):
    text = (ROOT / "docs" / "files.md").read_text("utf-8")
    assert [key for key in section.model_fields if f"`{key}`" not in text] == []


def test_every_key_of_gains_is_documented():
    text = (ROOT / "docs" / "gains.md").read_text("utf-8")
    keys = [
        *gain_record.GainSection.model_fields,
        *ros2_control.TERMS,
        *ros2_control.BESIDE,
        *(*gain_arrays.KP, *gain_arrays.KD, *gain_arrays.ORDERS, *gain_arrays.INDICES),
        *(*actuator_configs.TARGETS, *actuator_configs.EFFORT_LIMITS, *(key for pair in actuator_configs.LAGS for key in pair)),
    ]
    assert [key for key in keys if f"`{key}`" not in text] == []


@pytest.fixture
def told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Callable[..., dict]:
    """What a command prints with --json, in a folder with a small robot.yaml and its gains."""
    write_arm(tmp_path)
    (tmp_path / "gains.yaml").write_text('".*": {kp: 400, kd: 30, motor_inertia: 0.5}', "utf-8")
    monkeypatch.chdir(tmp_path)

    def run(*call: str) -> dict:
        assert main([*call, "--json"]) != 2
        return json.loads(capsys.readouterr().out)

    return run


def keys_of(value: object) -> set[str]:
    """Of every object in a JSON value."""
    if isinstance(value, list):
        return set().union(*map(keys_of, value))
    return {*value, *set().union(*map(keys_of, value.values()))} if isinstance(value, dict) else set()


@pytest.mark.parametrize(
    "call",
    [("robot", "robot.yaml"), ("audit", "robot.urdf", "--delay-ms", "2", "--gains", "gains.yaml", "--simulator", "mujoco")],
    ids=lambda call: call[0],
)
def test_every_key_of_a_robots_answer_is_documented(told: Callable[..., dict], call: tuple[str, ...]):
    facts = told(*call)
    facts["system"] = None  # whose keys are those of a robot.yaml
    names = set(facts.pop("posture", {})) | set().union(*(each["cost"] for each in facts.get("recommended") or []))
    section = (ROOT / "docs" / "robots.md").read_text("utf-8").partition(f"## What {call[0]} reports")[2].partition("\n## ")[0]
    assert sorted(key for key in keys_of(facts) - names if f"`{key}`" not in section) == []


@pytest.mark.slow
def test_every_key_of_a_comparison_is_documented(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    """But those of a controller, its parameters and margins, which other pages have, and names of what a joint has ranges of."""
    assert main(["example", "fig9"]) == 0
    text = re.sub(r" *clock: continuous.*", "", capsys.readouterr().out).replace(
        "feedback: motor", "feedback: motor\n  sample_rate_hz: 2000"
    )
    (tmp_path / "joint.yaml").write_text(text, "utf-8")
    assert main(["compare", str(tmp_path / "joint.yaml"), "--structures", "pd", "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    for row in facts["rows"]:
        row |= dict.fromkeys(("controller", "parameters", "margins", "worst_margins"))
        row["fragile"]["parameters"] = None
    facts["bound"]["certificate"] = facts["box"] = facts["ceilings"]["sensor_noise"] = None
    section = (ROOT / "docs" / "compare.md").read_text("utf-8").partition("## What `--json` has")[2]
    assert sorted(key for key in keys_of(facts) if f"`{key}`" not in section) == []


def test_the_documented_file_is_a_valid_one():
    block, scenario = re.findall(r"^```yaml\n(.*?)^```", (ROOT / "docs" / "files.md").read_text("utf-8"), re.MULTILINE | re.DOTALL)
    spec = config.parse_joint(block, "docs/files.md")
    assert spec.source.motor_inertia == pytest.approx(1.0)
    assert spec.uncertainty.stiffness == pytest.approx((8e3, 12e3))
    played = config.parse_simulation(block + scenario, "docs/files.md")
    assert played.scenario.duration == 2.0
    assert not played.is_linear
