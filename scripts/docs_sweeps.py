"""Writes docs/gallery_sweeps.md and its pictures: public robots with public gains, swept over their joint ranges.

Robots are those of the package example-robot-data, and one of robot_descriptions, which must be installed; every number on the
page is one that `gainroom sweep` prints for the file beside it. `python scripts/docs_sweeps.py NAME …` only looks at some of the
robots, and writes nothing.
"""

import math
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import yaml

import gainroom as gr
from gainroom.files.robot_yaml import load_robot_system
from gainroom.files.sweep_options import SweepOptions, sweep_plan
from gainroom.report.robot_skeleton import view_of
from gainroom.studies.sweep.run import run
from gainroom.studies.sweep.store import Store
from gainroom.studies.sweep.summary import SweepSummary, summarized

DOCS = Path(__file__).resolve().parents[1] / "docs"
PAGE = DOCS / "gallery_sweeps.md"
SAMPLES, RATE, MARGIN = 4096, 1000.0, 6.0
DELAYS = (2.0, 4.0)
COLORS = ("#0072B2", "#D55E00")
BINS = 60
GITHUB = "https://github.com"
DATA = "example-robot-data"
Gains = dict[str, tuple[float, float, float]]


@dataclass(frozen=True)
class Case:
    """A robot; gains by joint pattern: kp [N m/rad], kd [N m s/rad], motor inertia at the joint [kg m²].

    file        of example-robot-data, or a name of robot_descriptions
    source      where gains and inertias are from, as Markdown
    ranges      in place of the model's joint limits, where these say nothing
    gearbox     stiffness [N m/rad] and damping [N m s/rad] of every joint; None: rigid
    delays      [ms], the shorter first
    """

    title: str
    kind: str
    file: str
    base: str
    contacts: dict[str, list[dict[str, str] | str]]
    gains: Gains
    source: str
    ranges: tuple[str, ...] = ()
    locked: tuple[str, ...] = ()
    gearbox: tuple[float, float] | None = None
    delays: tuple[float, float] = DELAYS

    def text(self, delay: float) -> str:
        """Text of its robot.yaml, with `delay` in ms."""
        gearbox = {} if self.gearbox is None else {"default": dict(zip(("stiffness", "damping"), self.gearbox, strict=True))}
        data = {
            "model": {**({"package": DATA} if "/" in self.file else {}), "file": self.file, "base": self.base},
            "joints": {
                **gearbox,
                **{pattern: {"motor_inertia": float(f"{inertia:.6g}")} for pattern, (_, _, inertia) in self.gains.items()},
                "locked": [*self.locked],
            },
            "drive": {"bandwidth": math.inf, "delay_ms": delay},
            "contacts": self.contacts,
            "control": {
                "type": "pd",
                "feedback": "motor",
                "sample_rate_hz": RATE,
                "kp": {pattern: float(f"{kp:.6g}") for pattern, (kp, _, _) in self.gains.items()},
                "kd": {pattern: float(f"{kd:.6g}") for pattern, (_, kd, _) in self.gains.items()},
            },
            "limits": {"gain_margin_db": MARGIN},
        }
        if not self.contacts:
            del data["contacts"]
        return yaml.safe_dump(data, sort_keys=False, default_flow_style=None, width=110)


def two_stages(rotors: tuple[float, float, float], gears: tuple[float, float]) -> float:
    """Inertia of a motor behind two planetary stages, at the joint: each rotor times the square of the gears behind it."""
    first, second = gears
    return rotors[0] * (first * second) ** 2 + rotors[1] * second**2 + rotors[2]


def ten_hertz(inertia: float) -> tuple[float, float, float]:
    """mjlab's rule: 10 Hz and twice the critical damping on the motor's inertia alone."""
    omega = 2 * math.pi * 10
    return inertia * omega**2, 4 * inertia * omega, inertia


SMALL = two_stages((0.139e-4, 0.017e-4, 0.169e-4), (1 + 46 / 18, 1 + 56 / 16))
MIDDLE = two_stages((0.489e-4, 0.098e-4, 0.533e-4), (4.5, 1 + 48 / 22))
LARGE = two_stages((0.489e-4, 0.109e-4, 0.738e-4), (4.5, 5.0))
WRIST = two_stages((0.068e-4, 0.0, 0.0), (5.0, 5.0))
GO1_ROTOR = 0.000111842


def point(*frames: str) -> list[dict[str, str] | str]:
    """Point feet."""
    return [{"frame": frame, "type": "point"} for frame in frames]


CASES = {
    "panda": Case(
        "Franka Panda",
        "arm, 7 joints",
        "panda_description/urdf/panda.urdf",
        "fixed",
        {},
        {"panda_joint[1-4]": (600, 50, 0.1), "panda_joint5": (250, 30, 0.1), "panda_joint6": (150, 25, 0.1), "panda_joint7": (50, 15, 0.1)},
        f"kp and kd of libfranka's example [joint_impedance_control.cpp]({GITHUB}/frankaemika/libfranka/blob/main/examples/"
        "joint_impedance_control.cpp), which runs on a computer at 1 kHz; motor inertia: the armature of MuJoCo Menagerie's "
        f"[panda.xml]({GITHUB}/google-deepmind/mujoco_menagerie/blob/main/franka_emika_panda/panda.xml)",
        locked=("panda_finger_.*",),
    ),
    "go1": Case(
        "Unitree Go1",
        "quadruped, 12 joints",
        "go1_description/urdf/go1.urdf",
        "floating",
        {"four": point("FL_foot", "FR_foot", "RL_foot", "RR_foot"), "diagonal": point("FL_foot", "RR_foot"), "flight": []},
        {".*_(hip|thigh)_joint": (35, 0.5, 6**2 * GO1_ROTOR), ".*_calf_joint": (35, 0.5, 9**2 * GO1_ROTOR)},
        "gains, rotor inertia and gear ratios of mjlab's "
        f"[go1_constants.py]({GITHUB}/mujocolab/mjlab/blob/main/src/mjlab/asset_zoo/robots/unitree_go1/go1_constants.py)",
    ),
    "g1": Case(
        "Unitree G1",
        "humanoid, 29 joints",
        "g1_description/urdf/g1_29dof_rev_1_0.urdf",
        "floating",
        {"double": ["left_ankle_roll_link", "right_ankle_roll_link"], "left": ["left_ankle_roll_link"], "flight": []},
        {
            ".*_(elbow|shoulder_pitch|shoulder_roll|shoulder_yaw|wrist_roll)_joint": ten_hertz(SMALL),
            ".*_hip_(pitch|yaw)_joint|waist_yaw_joint": ten_hertz(MIDDLE),
            ".*_(hip_roll|knee)_joint": ten_hertz(LARGE),
            ".*_wrist_(pitch|yaw)_joint": ten_hertz(WRIST),
            "waist_(pitch|roll)_joint|.*_ankle_.*_joint": ten_hertz(2 * SMALL),
        },
        "gains, rotor inertias and gears of mjlab's "
        f"[g1_constants.py]({GITHUB}/mujocolab/mjlab/blob/main/src/mjlab/asset_zoo/robots/unitree_g1/g1_constants.py)",
    ),
    "bolt": Case(
        "ODRI Bolt",
        "biped on point feet, 6 joints",
        "bolt_description/robots/bolt.urdf",
        "floating",
        {"double": point("FL_FOOT", "FR_FOOT"), "left": point("FL_FOOT"), "flight": []},
        {".*": (5.0, 0.1, 9**2 * 4.5e-6)},
        "gains, rotor inertia and gear ratio of robot_properties_bolt's "
        f"[config.py]({GITHUB}/open-dynamic-robot-initiative/robot_properties_bolt/blob/master/src/robot_properties_bolt/config.py)",
        ranges=(".*=-3.14159:3.14159",),
    ),
    "berkeley": Case(
        "Berkeley Humanoid",
        "biped, 12 joints",
        "berkeley_humanoid_description",
        "floating",
        {"double": ["LL_FOOT", "LR_FOOT"], "left": ["LL_FOOT"], "flight": []},
        {
            ".*_H(R|AA)": (10.0, 1.5, 9**2 * 6.9e-5),
            ".*_HFE": (15.0, 1.5, 9**2 * 9.4e-5),
            ".*_KFE": (15.0, 1.5, 9**2 * 1.5e-4),
            ".*_FFE": (1.0, 0.1, 9**2 * 6.9e-5),
            ".*_FAA": (1.0, 0.1, 9**2 * 6.1e-6),
        },
        f"the model of [robot_descriptions](https://pypi.org/project/robot_descriptions/); gains and armature of its authors' "
        f"[berkeley_humanoid.py]({GITHUB}/HybridRobotics/isaac_berkeley_humanoid/blob/main/exts/berkeley_humanoid/berkeley_humanoid/"
        "assets/berkeley_humanoid.py)",
    ),
    "talos": Case(
        "PAL TALOS",
        "the legs of a humanoid, 12 joints, with elastic gearboxes",
        "talos_data/robots/talos_reduced.urdf",
        "floating",
        {"double": ["left_sole_link", "right_sole_link"], "left": ["left_sole_link"], "flight": []},
        {
            "leg_.*_1_joint": (5000.0, 20.0, 1.94),
            "leg_.*_2_joint": (5000.0, 20.0, 2.11),
            "leg_.*_[35]_joint": (5000.0, 20.0, 2.07),
            "leg_.*_4_joint": (5000.0, 20.0, 4.05),
            "leg_.*_6_joint": (5000.0, 20.0, 0.88),
        },
        "kp and kd (without ki) of the simulated robot's "
        f"[joint_pos_ctrl_gains_sim.py]({GITHUB}/stack-of-tasks/talos-torque-control/blob/master/python/dynamic_graph/sot/torque_control/"
        f"talos/joint_pos_ctrl_gains_sim.py); rotors, gear ratios and the nominal stiffness of 10 kN·m/rad of [talos_robot]({GITHUB}/"
        "pal-robotics/talos_robot). The damping of the gearboxes is not public: 20 N·m·s/rad is assumed. kd is 4 ms of kp: "
        "behind a delay of 4 ms no factor on these gains is stable, however large the gain margin at 2 ms is. Delays here are 1 and 2 ms",
        locked=("torso_.*", "arm_.*", "head_.*", "gripper_.*"),
        gearbox=(1e4, 20.0),
        delays=(1.0, 2.0),
    ),
}


Swept = tuple[SweepSummary, Any]
"""Summary of a sweep, as `gainroom sweep` prints it, and the labelled arrays that it stores."""


def swept(case: Case, delay: float, folder: Path, samples: int = SAMPLES) -> Swept:
    """Sweep as `gainroom sweep` runs it, without the local search at its end."""
    file = folder / f"robot_{delay:g}.yaml"
    file.write_text(case.text(delay), "utf-8")
    plan = sweep_plan(load_robot_system(file), SweepOptions(samples, ranges=case.ranges))
    store = Store.of(folder / f"sweep_{delay:g}.zarr", plan)
    run(store)
    found = summarized(plan, store.finished())
    assert not found.unknown, "a limit is not known"
    assert not found.uncertified, "a limit is not certified"
    return found, gr.open_sweep(store.path).load()


def rows(delay: float, found: SweepSummary) -> list[str]:
    """Rows of the table: one for each contact state."""
    names = found.plan.robot.joint_names
    return [
        f"| {delay:g} | {one.name} | {decibels(one.worst[0].gain)} | {decibels(one.quantile(0.5))} | {percent(one.short, one.count)} | "
        f"{percent(one.unstable, one.count)} | {one.worst[0].frequency / 2 / math.pi:.3g} | {names[one.worst[0].joint]} |"
        for one in found.contacts
    ]


def decibels(factor: float) -> str:
    """A gain limit as a gain margin."""
    return f"{20 * math.log10(factor):.1f}"


def percent(part: int, whole: int) -> str:
    """Percentage: not 0 if there is one, and not 100 if one is left."""
    share = 100 * part / whole
    return "0" if not part else "100" if part == whole else f"{min(max(share, 0.1), 99.9):.1f}"


def drawn(name: str, found: dict[float, Swept]) -> None:
    """The worst posture at the shorter delay from its right and from the front, and how limits spread at both."""
    first, _ = found[min(found)]
    worst = first.worst_posture
    assert worst is not None
    contact, system = first.plan.contacts[worst.contact], worst.system(first.plan)
    model = system.source.linearize(worst.name, contact)
    limit = gr.gain_limit(system.loop(model))
    assert math.isclose(limit.gain, worst.gain, rel_tol=3e-6), "computed alone it is another limit"
    figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.4), width_ratios=(1.15, 1))
    skeleton(figure, left, model, np.abs(limit.mode))
    left.set_title(f"worst posture, {contact}, {min(found):g} ms: {first.plan.robot.joint_names[worst.joint]}", fontsize=10)
    spread(right, found)
    figure.savefig(DOCS / "images" / f"sweep-{name}.svg", metadata={"Date": None})
    plt.close(figure)


def skeleton(figure: Any, axes: Any, model: Any, parts: np.ndarray) -> None:
    """Links as lines, joints as dots by their part in the vibration, seen from its right and from the front."""
    bones, view = model.body.skeleton(model.q), view_of([model], 0.5)
    moving = bones.joints >= 0
    for project, name in ((view.side, "from its right"), (view.front, "from the front")):
        plane = project(bones.positions)
        for k, parent in enumerate(bones.parents):
            if parent >= 0:
                axes.plot(*plane[[k, parent]].T, color="#8a8a8a", linewidth=3, solid_capstyle="round", zorder=1)
        feet = [project(model.body.frame_placement(model.q, one.frame)[1][None])[0] for one in model.contacts]
        if feet:
            axes.plot(*np.transpose(feet), "s", color="#1b1b1b", markersize=8, zorder=2)
        shares = parts[bones.joints[moving]]
        order = np.argsort(shares)
        dots = axes.scatter(
            *plane[moving][order].T, c=shares[order], cmap="YlOrBr", vmin=0, vmax=1, s=55, edgecolors="#4a4a4a", linewidths=0.8, zorder=3
        )
        middle = 0.5 * (plane[:, 0].min() + plane[:, 0].max())
        axes.text(middle, view.low[1] - 0.04 * view.size, name, ha="center", va="top", fontsize=9, color="#5a5a5a")
    axes.set_aspect("equal", adjustable="datalim")
    axes.axis("off")
    axes.set(xlim=(view.low[0], view.high[0]), ylim=(view.low[1] - 0.2 * view.size, view.high[1]))
    figure.colorbar(dots, ax=axes, shrink=0.55, label="part in the vibration", pad=0.02)


def spread(axes: Any, found: dict[float, Swept]) -> None:
    """Histograms of the gain margin over all contact states, one for each delay, with what is below the margin shaded."""
    levels = {delay: 20 * np.log10(arrays.gain.values.ravel()) for delay, (_, arrays) in found.items()}
    every = np.concatenate([*levels.values()])
    edges = np.linspace(min(every.min(), 0), max(every.max(), MARGIN + 0.5), BINS + 1)
    for (delay, level), color, style in zip(levels.items(), COLORS, ("-", "--"), strict=True):
        counts = 100 * np.histogram(level, edges)[0] / len(level)
        axes.stairs(counts, edges, color=color, linestyle=style, linewidth=1.6, label=f"{delay:g} ms of delay")
    axes.axvspan(edges[0], MARGIN, color="#000000", alpha=0.06, linewidth=0)
    axes.axvline(MARGIN, color="k", linestyle=":", linewidth=1)
    axes.set(xlabel="gain margin [dB]", ylabel="postures [%]", xlim=(edges[0], edges[-1]), ylim=(0, None))
    axes.text(MARGIN, 1.01, f"{MARGIN:g} dB", transform=axes.get_xaxis_transform(), ha="center", va="bottom", fontsize=9)
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.06), ncols=2, frameon=False)


HEAD = f"""# Public robots, every posture

What public gains leave over the whole workspace: robots of the packages
[example-robot-data](https://pypi.org/project/example-robot-data/) and
[robot_descriptions](https://pypi.org/project/robot_descriptions/) with gains that are public, swept by
`gainroom sweep` ([sweep.md](sweep.md)) in {SAMPLES} postures, spread evenly over the joints' ranges, in each contact
state. Written by [scripts/docs_sweeps.py](../scripts/docs_sweeps.py), which has every gain and its source.

What is assumed, the same for all robots:

- Delay from measurement to motor torque of {DELAYS[0]:g} and {DELAYS[1]:g} ms (TALOS: 1 and 2 ms), kp and kd both behind
  it, and control at {RATE / 1000:g} kHz with the velocity from a backward difference. Unitree's motors run kp and kd on their own drives,
  with far less delay: these numbers are of the same gains run on a computer across a bus.
- Gearboxes are rigid, but those of TALOS, whose stiffness is public; current loops are infinitely fast. Both are
  optimistic: elastic gearboxes leave less.
- No friction, no gravity stiffness; feet neither slip nor lift. Whether links collide and whether the robot could stand
  like that is not checked.
- Only the gain margin: the factor on all gains at which the robot starts to vibrate, in dB. Every limit is certified.
  0 dB or less is unstable.

The worst of {SAMPLES} postures is not the worst of the workspace: fewer than {100 * (1 - 0.05 ** (1 / SAMPLES)):.2g} %
of further ones lie lower (95 % confidence). Columns: the lowest and the median gain margin, the share of postures below
{MARGIN:g} dB and the share that is unstable; frequency and joint are those of the worst posture's vibration.
"""
NAMES = ("delay [ms]", "contact", "lowest [dB]", "median [dB]", "below 6 dB [%]", "unstable [%]", "at [Hz]", "mainly")
COLUMNS = f"| {' | '.join(NAMES)} |\n{'|---' * len(NAMES)}|\n"


def section(name: str, case: Case, found: dict[float, Swept]) -> str:
    """Section of the page for one robot."""
    table = COLUMNS + "\n".join(line for delay, (said, _) in found.items() for line in rows(delay, said))
    often = joints(found[min(found)][1])
    command = " ".join(["gainroom sweep robot.yaml", f"--samples {SAMPLES}", *(f"--range '{one}'" for one in case.ranges)])
    ranges = " Its model states no limits of use; every joint is turned once around." if case.ranges else ""
    return f"""
## {case.title}: {case.kind}

From: {case.source}.{ranges}

![{case.title}: its worst posture, and how gain margins spread over the workspace](images/sweep-{name}.svg)

{table}

Joints that limit most often, all contact states at {min(found):g} ms: {often}.

`{command}` with

```yaml
{case.text(min(found))}```
"""


def joints(arrays: Any) -> str:
    """Joints that move most in the vibration at the limit, with the share of postures."""
    limiting = arrays.limiting_joint.values.ravel()
    counts = np.bincount(limiting[limiting >= 0], minlength=arrays.sizes["joint"])
    order = [k for k in np.argsort(-counts, kind="stable")[:4].tolist() if counts[k]]
    return ", ".join(f"{arrays.joint.values[k]} {percent(int(counts[k]), len(limiting))} %" for k in order)


def main(names: list[str]) -> None:
    """Sweep, draw and write; for some robots only print."""
    plt.rcParams |= {"figure.constrained_layout.use": True, "font.size": 10, "svg.hashsalt": "gainroom", "svg.fonttype": "none"}
    plt.rcParams |= {"axes.spines.top": False, "axes.spines.right": False}
    parts = [HEAD]
    for name in names or CASES:
        with tempfile.TemporaryDirectory() as folder:
            found = {delay: swept(CASES[name], delay, Path(folder)) for delay in CASES[name].delays}
            parts.append(section(name, CASES[name], found))
            drawn(name, found)
            print(parts[-1].partition("`gainroom")[0])
    if not names:
        PAGE.write_text("".join(parts), "utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
