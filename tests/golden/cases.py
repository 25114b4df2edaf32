"""The table of cases: which commands are run on which inputs, and where these come from.

A case is one command line. A command that answers for programs too is run twice: for a person, and with `--json --report page.html`.
"""

from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path

from . import joint_inputs, log_inputs, robot_inputs

ROOT = Path(__file__).resolve().parents[2]
PAGE, ANSWER = "page.html", "answer.json"
SHIPPED = ("fig9", "talos-knee", "testbed", "testbed-sampled", "testbed-simulated", "biped", "biped-simulated")
COMMANDS = (
    *("joint", "robot", "audit", "sweep", "export", "compare", "simulate", "verify", "log", "diagnose"),
    *("app", "example", "reproduce", "identify"),
    *(f"identify {each}" for each in ("delay", "joint", "gains", "stiffness", "plan")),
)


@dataclass(frozen=True)
class Case:
    """A command line, as typed behind `gainroom`.

    json     also run with --json
    page     that run writes a page, too
    person   run without --json; not where that takes long and says the same
    answer   a command whose answer with --json is ANSWER, an input of this case
    """

    line: str
    json: bool = True
    page: bool = True
    person: bool = True
    answer: str = ""

    @property
    def name(self) -> str:
        """What its recording is called: command and input, words of the line."""
        kept = "".join(letter if letter.isalnum() or letter in "._-" else " " for letter in self.line.replace("example-robot-data:", ""))
        return "-".join(word.strip("-") for word in kept.split() if word.strip("-"))[:100]

    @property
    def lines(self) -> list[str]:
        """The command lines that are run one after the other."""
        for_program = [f"{self.line} --json" + (f" --report {PAGE}" if self.page else "")] if self.json else []
        return [self.line] * self.person + for_program


def write_inputs(folder: Path) -> None:
    """Every input of every case."""
    examples = files("gainroom") / "files" / "examples"
    texts: dict[str, str | bytes] = {f"{name}.yaml": (examples / f"{name}.yaml").read_text("utf-8") for name in SHIPPED}
    texts |= {"leg.xml": (ROOT / "examples" / "robot.xml").read_text("utf-8"), "shaky.yaml": log_inputs.JOINT}
    texts["leg_nan.xml"] = texts["leg.xml"].replace('mass="3.2"', 'mass="nan"')
    texts["leg_damaged.xml"] = texts["leg.xml"][:900]
    for module in (joint_inputs, robot_inputs):
        texts |= module.GOOD | module.HOSTILE
    texts |= robot_inputs.GAINS | log_inputs.written()
    for name, text in texts.items():
        (folder / name).write_bytes(text if isinstance(text, bytes) else text.encode())


def _each(template: str, names: str, **kind: bool) -> list[Case]:
    """One case for each name, in place of @."""
    return [Case(template.replace("@", name), **kind) for name in names.split()]


LEG, G1 = "leg.xml", "example-robot-data:g1_29dof_rev_1_0.urdf"
ELASTIC = "--stiffness 8000 --damping 2"

NOT_STUDIED = ("moved.yaml", "linear_run.yaml", "two_paths.yaml")
"""Joints for other commands, and those of which there is no page."""

JOINTS = [
    *_each("joint @.yaml", "fig9 talos-knee testbed testbed-sampled testbed-simulated"),
    *_each("joint @.yaml", " ".join(name.removesuffix(".yaml") for name in joint_inputs.GOOD if name not in NOT_STUDIED)),
    Case("joint two_paths.yaml", page=False),
    *_each("joint @.yaml --verbose", "fig9 unstable missed_in_range", json=False),
    *_each("joint @.yaml --strict", "testbed-sampled safe no_rate", json=False),
]
ROBOTS = [
    *_each("robot @.yaml", "arm arm_unstable arm_no_rate arm_uncertain arm_pid arm_ppi arm_rigid biped_left"),
    *_each("robot @.yaml", "biped_task panda talos_leg", person=False),
    Case("robot arm_two_paths.yaml", page=False),
    *_each("robot @.yaml --verbose", "arm arm_unstable", json=False),
    *_each("robot @.yaml --strict", "arm arm_no_rate arm_rigid biped_left", json=False),
]
AUDITS = [
    Case(f"audit {LEG} --delay-ms 1.5"),
    Case(f"audit {LEG} --delay-ms 1.5 --rate-hz 2000"),
    Case(f"audit {LEG} --delay-ms 1.5 --rate-hz 2000 --verbose", json=False),
    Case(f"audit {LEG} --delay-ms 1.5 --rate-hz 2000 {ELASTIC}"),
    Case(f"audit {LEG} --delay-ms 1.5 --rate-hz 2000 --gains leg_soft.yaml"),
    Case(f"audit {LEG} --delay-ms 1.5 --rate-hz 2000 --gains leg_soft.yaml --gearbox direct"),
    Case(f"audit {LEG} --delay-ms 1.5 --rate-hz 2000 --gains leg_soft.yaml --gearbox harmonic"),
    Case(f"audit {LEG} --delay-ms 1.5 --rate-hz 2000 --gains leg_hard.yaml"),
    Case(f"audit {LEG} --delay-ms 1.5 --rate-hz 2000 --gains leg_part.yaml {ELASTIC}"),
    Case(f"audit {LEG} --delay-ms 2 --rate-hz 1000 --simulator mujoco --timestep 0.005 --pd explicit"),
    Case(f"audit {LEG} --delay-ms 4 --rate-hz 500 --gains-run split --drive-rate-hz 5000 --drive-delay-ms 0.2 {ELASTIC}", page=False),
    Case(f"audit {LEG} --delay-ms 4 --gains-run drive --drive-rate-hz 5000 --drive-delay-ms 0.2 --margin-db 12 {ELASTIC}", page=False),
    Case(f"audit {LEG} --delay-ms 1.5 --rate-hz 2000 --gains leg_soft.yaml {ELASTIC} --workspace 8"),
    Case(f"audit {LEG} --delay-ms 1.5 --rate-hz 2000 --phase-margin-deg 45 --peak-sensitivity 1.5 {ELASTIC} --write-robot written.yaml"),
    Case(f"audit {G1} --base floating --gains g1_constants.py --delay-ms 3 --rate-hz 500 --contact left_ankle_roll_link --gains-run host"),
    Case("audit example-robot-data:go1.urdf --base floating --gains go1.yaml --motor-inertia 0.01 --delay-ms 2 --rate-hz 1000"),
    Case("audit example-robot-data:go2.urdf --base floating --gains go2.py --delay-ms 4 --rate-hz 200 --gearbox direct"),
    Case("audit example-robot-data:panda.urdf --gains panda_gains.yaml --stiffness 10000 --damping 5 --delay-ms 2 --rate-hz 1000"),
    Case(
        "audit example-robot-data:talos_reduced.urdf --gains talos_controllers.yaml --motor-inertia 2.0"
        " --stiffness 20000 --damping 20 --delay-ms 3 --contact left_sole_link"
    ),
    Case("audit grams.urdf --gains leg_soft.yaml --motor-inertia 0.02 --delay-ms 2 --rate-hz 1000"),
]
RUNS = [
    *_each("simulate @.yaml", "moved linear_run unstable no_rate biped_task biped_stands biped_falls solo arm"),
    Case("simulate linear_run.yaml --gain 1.6 --log run.csv"),
    Case("simulate moved.yaml --gain 3"),
    *_each("simulate @.yaml", "unstable_in_range missed_in_range two_paths ppi arm_unstable arm_uncertain arm_rigid talos_leg", page=False),
    *_each("verify @.yaml", "missed_in_range unstable_in_range arm_rigid", page=False),
    *_each("verify @.yaml", "testbed-sampled unstable arm no_rate"),
]
COMPARED = [
    Case("compare safe.yaml --structures pd,split --no-bound"),
    Case("compare missed_in_range.yaml --structures pd --write better.yaml", person=False, page=False),
    Case("compare rigid.yaml --structures pd,ppi --objective step_load", page=False),
]
SWEEPS = [
    Case("sweep arm.yaml --samples 24 --margins 4 --workers 1"),
    Case("sweep arm_unstable.yaml --samples 8 --margins 2 --workers 1"),
    Case("sweep arm_rigid.yaml --samples 8 --margins 2 --workers 1", page=False),
    Case("sweep arm_no_rate.yaml --grid elbow=0:2:5 --margins 0 --workers 1", page=False),
    Case("sweep arm_uncertain.yaml --samples 6 --draws 3 --margins 2 --workers 1 --strict", page=False),
    Case("sweep biped_left.yaml --samples 8 --margins 1 --workers 1 --output kept.zarr", page=False),
    Case("sweep talos_leg.yaml --samples 4 --margins 1 --workers 1", page=False),
]
LOGS = [
    *_each("log @", "calm.csv shaky_bare.csv log_cut.csv", page=False),
    Case("log renamed.csv --columns target_torque=iq_cmd,motor_position=enc --verbose", page=False),
    *_each("diagnose @", "calm.csv shaky.csv shaky_bare.csv"),
    Case("diagnose shaky.csv --joint shaky.yaml"),
    Case("diagnose calm.csv --joint shaky.yaml"),
    Case("diagnose shaky.csv --joint testbed-sampled.yaml", page=False),
    *_each("identify delay @", "excited.csv excited_motor.csv"),
    Case("identify joint excited.csv --output identified.yaml", person=False),
    Case("identify joint excited_motor.csv --delay-ms 2", page=False),
    Case("identify gains calm.csv --asked kp=300,kd=20"),
    Case("identify stiffness calm.csv"),
    Case("identify plan moved.yaml --max-torque 60 --duration 2 --output excitation.csv"),
]
EXPORTS = [
    Case("export leg_soft.yaml --to yaml --model leg.xml", page=False),
    Case("export leg_soft.yaml --to ros2_control --model leg.xml --output legs.yaml --write", page=False),
    Case("export leg_soft.yaml --to mjcf --onto leg.xml", json=False),
    Case("export panda_gains.yaml --to arrays", json=False),
    *_each("export g1_constants.py --to @ --model " + G1, "mjlab isaaclab legged_gym", json=False),
    Case("export leg_soft.yaml --to mjcf", json=False),
    Case("export answer.json --to yaml", page=False, answer="robot arm_unstable.yaml --json"),
    Case("export answer.json --to mjcf --onto leg.xml", page=False, answer=f"audit {LEG} --delay-ms 1.5 --rate-hz 2000 --json"),
    Case("export answer.json --to isaaclab", page=False, answer="robot arm_no_rate.yaml --json"),
]
OTHERS = [
    Case("app safe.yaml --export view.html --view kp=5000&kd=300&delay_ms=3 --no-browser", json=False),
    Case("example", page=False),
    *_each("example @", " ".join(SHIPPED), json=False),
    Case("--version", json=False),
    Case("", json=False),
    Case("--help", json=False),
    *(Case(f"{command} --help", json=False) for command in COMMANDS),
]
REFUSED = [
    *_each("joint @", " ".join(joint_inputs.HOSTILE), json=False),
    *_each("joint @", "gone.yaml . biped.yaml leg.xml --gian", json=False),
    *_each("compare @", "no_rate.yaml locked_output.yaml bad_key.yaml gone.yaml", json=False),
    Case("compare arm.yaml --joint elbwo", json=False),
    *_each("compare safe.yaml @", "--structures=pd,spilt --structures=torque_feedback --noise=-1 --objective=stiffness", json=False),
    *_each("simulate @", "bad_key.yaml damaged.yaml gone.yaml", json=False),
    Case("simulate safe.yaml --gain nan", json=False),
    *_each("robot @.yaml", "unknown_joint unknown_frame no_model robot_bad_key robot_nan fig9 damaged", json=False),
    *_each("sweep @.yaml --samples 4", "unknown_joint robot_nan fig9", json=False),
    Case("sweep arm.yaml --samples -1", json=False),
    Case("sweep arm.yaml --range wrist=0:1", json=False),
    *_each("audit @ --delay-ms 2", "leg_nan.xml leg_damaged.xml damaged.urdf nan.urdf gone.xml nobody-has-this-package:x.urdf", json=False),
    *_each(f"audit {LEG} --delay-ms 2 --gains @", "gains_bad_key.yaml gains_nan.yaml gains_no_joint.yaml", json=False),
    *_each(f"audit {LEG} --delay-ms 2 --gains @", "gains_damaged.py gains_damaged.yaml gone.yaml", json=False),
    Case(f"audit {LEG}", json=False),
    *_each(f"audit {LEG} @", "--delay-ms=nan --delay-ms=-1 --rate-hz=500", json=False),
    Case(f"audit {LEG} --delay-ms 2 --gearbox rubber", json=False),
    Case(f"audit {LEG} --delay-ms 2 --posture wrist=1", json=False),
    Case(f"audit {LEG} --delay-ms 2 --simulator gazebo", json=False),
    Case(f"audit {LEG} --delay-ms 2 --contact moon", json=False),
    *_each("diagnose @", "log_two_rows.csv log_no_numbers.csv log_nan.csv log_no_time.csv log_empty.csv", json=False),
    *_each("log @", "log_two_rows.csv log_no_numbers.csv log_nan.csv log_no_time.csv log_empty.csv", json=False),
    *_each("identify delay @", "shaky_bare.csv log_nan.csv log_empty.csv", json=False),
    *_each("identify joint @", "shaky_bare.csv log_two_rows.csv", json=False),
    Case("diagnose shaky.csv --joint bad_key.yaml", json=False),
    Case("identify plan bad_key.yaml --max-torque 10", json=False),
    Case("export gains_nan.yaml --to yaml", json=False),
    Case("export leg_soft.yaml --to gazebo", json=False),
    Case("frobnicate", json=False),
    Case("example nobody", json=False),
]
EVERY = (*JOINTS, *ROBOTS, *AUDITS, *RUNS, *COMPARED, *SWEEPS, *LOGS, *EXPORTS, *OTHERS, *REFUSED)
CASES = {case.name or "nothing": case for case in EVERY}
"""By name."""
