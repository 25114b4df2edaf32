"""Files of joints and robots, drawn by kind with a seed each: what every command that judges is given."""

import random
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import yaml

from gainroom.cli.example import example_texts
from robot_truths import hinge, link

Sections = dict[str, dict[str, Any]]
USUAL = {"gain_margin_db": 6.0, "phase_margin_deg": 30.0, "peak_sensitivity": 2.0}
CROSSOVER = 30.0
"""[rad/s] of a rigid joint with the gains that are drawn, times a factor: safe, short of a margin or unstable with some ms of delay."""
FACTORS = (0.3, 0.8, 2.0, 5.0)


def changed(base: Mapping[str, Any], change: Mapping[str, Any]) -> dict[str, Any]:
    """Sections with the keys of a change; None takes one away, a function is given what stood there."""
    whole = dict(base)
    for key, value in change.items():
        old = whole.get(key)
        if isinstance(value, dict) and key != "limits":
            whole[key] = changed(old if isinstance(old, dict) else {}, value)
        else:
            whole[key] = value(old) if callable(value) else value
    return {key: value for key, value in whole.items() if value is not None}


def times(factor: float) -> Callable[[float], float]:
    return lambda value: factor * value


def pd_of(draw: random.Random, inertia: float, factor: float) -> dict[str, Any]:
    """The control section with a PD under which an inertia [kg m²], if it were rigid, crosses at CROSSOVER times a factor."""
    crossover = CROSSOVER * factor
    return {
        "type": "pd",
        "kp": 0.3 * inertia * crossover**2,
        "kd": inertia * crossover,
        "feedback": "motor",
        "sample_rate_hz": draw.choice((500, 1000, 2000)),
    }


def joint(draw: random.Random) -> Sections:
    """A joint with such a PD, for one of FACTORS."""
    motor, load, factor = draw.uniform(0.1, 1.0), draw.uniform(0.5, 8.0), draw.choice(FACTORS)
    inertia = motor * (1 + load)
    return {
        "joint": {"motor_inertia": motor, "link_inertia": motor * load, "stiffness": 1e5 * inertia, "damping": draw.uniform(0.5, 3.0)},
        "drive": {"bandwidth": 4000.0, "delay_ms": draw.uniform(1.0, 3.0)},
        "control": pd_of(draw, inertia, factor),
        "scenario": {"duration": 0.2},
    }


RATELESS = {"control": {"sample_rate_hz": None}, "scenario": None}
JOINTS: dict[str, Callable[[random.Random], dict[str, Any]]] = {
    "pd": lambda draw: {},
    "pid": lambda draw: {"control": {"type": "pid", "ki": draw.uniform(10, 2000)}},
    "p/pi": lambda draw: {
        "control": {"type": "ppi", "kv": draw.uniform(5, 60), "kp": draw.uniform(3, 40), "kd": None, "ki": draw.uniform(0, 200)}
    },
    "p/p": lambda draw: {"control": {"type": "ppi", "kv": draw.uniform(5, 60), "kp": draw.uniform(3, 40), "kd": None, "ki": 0}},
    "notch": lambda draw: {"control": {"notches": [{"frequency_hz": draw.uniform(40, 200), "depth": draw.uniform(0.05, 0.9)}]}},
    "filtered": lambda draw: {"control": {"velocity_filter": {"bandwidth_hz": draw.uniform(40, 200), "order": draw.choice((1, 2))}}},
    "link side": lambda draw: {"control": {"feedback": "link", "kp": times(0.3), "kd": times(0.3)}},
    "rigid": lambda draw: {"joint": {"stiffness": "rigid", "damping": None}},
    "locked": lambda draw: {"joint": {"link_inertia": float("inf")}},
    "rubbed": lambda draw: {"joint": {"motor_viscous": draw.uniform(0, 5), "link_viscous": draw.uniform(0, 5)}},
    "ticks": lambda draw: {"drive": {"delay_ms": None, "delay_ticks": draw.choice((1, 1.5, 3))}},
    "ideal loop": lambda draw: {"drive": {"bandwidth": float("inf"), "delay_ms": draw.choice((0.0, 1.0))}},
    "nothing required": lambda draw: {"limits": {}},
    "delay margin": lambda draw: {"limits": {**USUAL, "delay_margin_ms": draw.uniform(0.5, 6)}},
    "one limit": lambda draw: {"limits": dict([draw.choice([*USUAL.items()])])},
    "range of delay": lambda draw: {"uncertainty": {"delay_ms": [0.5, draw.uniform(3, 9)]}},
    "ranges": lambda draw: {"uncertainty": {"stiffness": f"{draw.randint(5, 60)}%", "link_inertia": "30%", "damping": "50%"}},
    "delay margin in a range": lambda draw: {"limits": {"delay_margin_ms": draw.uniform(0.5, 4)}, "uncertainty": {"motor_inertia": "20%"}},
    "no rate": lambda draw: RATELESS,
    "no rate and more": lambda draw: {**RATELESS, "limits": {"phase_margin_deg": 40.0}, "joint": {"damping": 0.0}},
    "continuous": lambda draw: {**RATELESS, "drive": {"clock": "continuous"}},
    "sampling in delay": lambda draw: {**RATELESS, "drive": {"delay_includes_sampling": True}},
    "two paths": lambda draw: {
        "control": {"sample_rate_hz": 500, "kd_path": {"delay_ms": draw.uniform(0.1, 2), "sample_rate_hz": 5000}},
        "limits": draw.choice(({"gain_margin_db": 6.0}, {"phase_margin_deg": 30.0}, None)),
    },
}
"""Kinds of joints: what is changed of a usual one."""


def drawn_joint(kind: str) -> dict[str, Any]:
    draw = random.Random(f"joint {kind}")
    return changed(joint(draw), JOINTS[kind](draw))


def as_robot(sections: Mapping[str, Any], folder: Path) -> dict[str, Any] | None:
    """The same joint as a robot, beside its URDF in the folder: a link about a vertical axis; None where a robot.yaml does not have it."""
    own = dict(sections["joint"])
    inertia = own.pop("link_inertia")
    if inertia == float("inf") or "link_inertia" in sections.get("uncertainty", {}):
        return None
    links = link("base") + link("load", 5.0, (0.0, 0.0, 0.0), (inertia, inertia, inertia))
    (folder / "joint.urdf").write_text(f'<robot name="joint">{links}{hinge("joint", "base", "load", axis="0 0 1")}</robot>', "utf-8")
    others = {key: value for key, value in sections.items() if key not in ("joint", "scenario")}
    return {"model": {"file": "joint.urdf", "base": "fixed"}, "joints": {"default": own}, **others}


def arm_urdf(draw: random.Random, count: int, floating: bool) -> str:
    """A chain of `count` hinges in any direction; its last link has a frame at its end; a floating one has a base of 12 kg."""
    links, joints, parent = [link("base", 12.0, (0.0, 0.0, 0.0), (0.2, 0.3, 0.25)) if floating else link("base")], [], "base"
    for k in range(count):
        mass, length = draw.uniform(1.0, 5.0), draw.uniform(0.2, 0.4)
        swing = mass * length**2 / 12
        links.append(link(f"link{k}", mass, (0.0, 0.0, -length / 2), (swing, 1.1 * swing, 0.2 * swing)))
        joints.append(
            hinge(f"j{k}", parent, f"link{k}", at=(0.0, 0.0, -length if k else -0.1), axis=draw.choice(("0 1 0", "1 0 0", "0 1 0.3")))
        )
        parent = f"link{k}"
    end = f'<joint name="end" type="fixed"><parent link="{parent}"/><child link="foot"/><origin xyz="0 0 -0.3"/></joint>'
    return f'<robot name="arm">{"".join(links)}{link("foot")}{"".join(joints)}{end}</robot>'


def robot(draw: random.Random, count: int) -> dict[str, Any]:
    """Of such an arm, with gains as `joint` has them."""
    motor, factor = draw.uniform(0.1, 0.6), draw.choice(FACTORS)
    inertia = motor + 0.3
    return {
        "model": {"file": "arm.urdf", "base": "fixed"},
        "joints": {"default": {"motor_inertia": motor, "stiffness": 1e5 * inertia, "damping": draw.uniform(0.5, 3.0)}},
        "drive": {"bandwidth": 4000.0, "delay_ms": draw.uniform(1.0, 3.0)},
        "postures": {f"p{k}": {f"j{i}": draw.uniform(-1.2, 1.2) for i in range(count)} for k in range(2)},
        "control": pd_of(draw, inertia, factor),
        "scenario": {"duration": 0.2},
    }


FLOATS = {"model": {"base": "floating"}, "contacts": {"air": [], "stands": ["foot"]}}
TASKS = [
    {"name": "tip", "type": "position", "frame": "foot", "kp": 400.0, "kd": 40.0},
    {"name": "rest", "type": "posture", "kp": 200.0, "kd": 30.0},
]
ROBOTS: dict[str, tuple[int, Callable[[random.Random], dict[str, Any]]]] = {
    "one joint": (1, lambda draw: {}),
    "two joints": (2, lambda draw: {}),
    "three joints": (3, lambda draw: {}),
    "four joints": (4, lambda draw: {}),
    "rigid": (2, lambda draw: {"joints": {"default": {"stiffness": "rigid", "damping": None}}}),
    "gearbox unknown": (2, lambda draw: {"joints": {"default": {"stiffness": None, "damping": None}}}),
    "one gearbox unknown": (
        2,
        lambda draw: {"joints": {"default": {"stiffness": None, "damping": None}, "j0": {"stiffness": 2e4, "damping": 3.0}}},
    ),
    "motors unknown": (2, lambda draw: {"joints": {"default": {"motor_inertia": None, "stiffness": "rigid", "damping": None}}}),
    "nothing known": (2, lambda draw: {"joints": None, **RATELESS}),
    "no rate": (2, lambda draw: RATELESS),
    "continuous": (2, lambda draw: {**RATELESS, "drive": {"clock": "continuous"}}),
    "pid": (2, lambda draw: {"control": {"type": "pid", "ki": draw.uniform(10, 900)}}),
    "p/pi": (
        2,
        lambda draw: {
            "control": {"type": "ppi", "kp": draw.uniform(3, 40), "kv": draw.uniform(5, 60), "kd": None, "ki": draw.uniform(1, 90)}
        },
    ),
    "filtered": (2, lambda draw: {"control": {"velocity_filter": {"bandwidth_hz": 90.0}, "notches": [{"frequency_hz": 60.0}]}}),
    "link side": (2, lambda draw: {"control": {"feedback": "link", "kp": times(0.3), "kd": times(0.3)}}),
    "nothing required": (2, lambda draw: {"limits": {}}),
    "delay margin": (2, lambda draw: {"limits": {**USUAL, "delay_margin_ms": draw.uniform(0.5, 6)}}),
    "ranges": (2, lambda draw: {"uncertainty": {"delay_ms": [0.5, draw.uniform(3, 6)], "stiffness": "30%"}}),
    "floats": (3, lambda draw: {**FLOATS, "model": {"base": "floating"}}),
    "floats and topples": (
        3,
        lambda draw: {**FLOATS, "model": {"base": "floating", "gravity_stiffness": True}, "control": {"kp": times(0.02), "kd": times(0.1)}},
    ),
    "on a point": (3, lambda draw: {**FLOATS, "contacts": {"point": [{"frame": "foot", "type": "point"}]}}),
    "soft ground": (
        3,
        lambda draw: {**FLOATS, "contacts": {"soft": [{"frame": "foot", "stiffness": [2e5, 2e3], "damping": [500.0, 10.0]}]}},
    ),
    "held by contacts": (2, lambda draw: {"contacts": {"free": [], "held": ["foot"]}}),
    "tasks": (4, lambda draw: {"control": {"space": "task", "kp": None, "kd": None}, "tasks": TASKS}),
    "payload": (2, lambda draw: {"model": {"payload": {"frame": "foot", "mass": 3.0}}}),
    "gains of each": (
        3,
        lambda draw: {"control": {"kp": {"default": 200.0, "j1": draw.uniform(0, 900)}, "kd": {"default": 15.0, "j2": 60.0}}},
    ),
    "grams": (2, lambda draw: {}),
    "two paths": (
        2,
        lambda draw: {"control": {"sample_rate_hz": 500, "kd_path": {"delay_ms": draw.uniform(0.1, 2), "sample_rate_hz": 5000}}},
    ),
}
"""Kinds of robots: how many joints, and what is changed of a usual one."""


def drawn_robot(kind: str, folder: Path) -> dict[str, Any]:
    """The sections of a robot.yaml, beside its URDF in the folder."""
    draw, (count, change) = random.Random(f"robot {kind}"), ROBOTS[kind]
    sections = changed(robot(draw, count), change(draw))
    text = arm_urdf(draw, count, sections["model"]["base"] == "floating")
    if kind == "grams":
        text = text.replace('<mass value="', '<mass value="1000')
    (folder / "arm.urdf").write_text(text, "utf-8")
    return sections


def written(folder: Path, sections: Mapping[str, Any], name: str) -> Path:
    path = folder / name
    path.write_text(yaml.safe_dump(dict(sections), sort_keys=False), "utf-8")
    return path


def shipped(name: str) -> dict[str, Any]:
    """An example of the package."""
    return yaml.safe_load(example_texts()[name])


AUDITS: dict[str, tuple[int, tuple[str, ...]]] = {
    "plain": (2, ("--rate-hz", "1000", "--stiffness", "20000", "--damping", "3")),
    "four joints": (4, ("--rate-hz", "1000", "--stiffness", "20000", "--damping", "3")),
    "no rate": (2, ("--stiffness", "20000", "--damping", "3")),
    "gearbox unknown": (2, ("--rate-hz", "1000")),
    "direct": (2, ("--rate-hz", "1000", "--gearbox", "direct")),
    "one is direct": (2, ("--rate-hz", "1000", "--gearbox", "j0=direct")),
    "motors unknown": (2, ("--rate-hz", "1000", "--stiffness", "inf")),
    "nothing known": (2, ()),
    "in the drive": (2, ("--gains-run", "drive", "--drive-rate-hz", "8000", "--drive-delay-ms", "0.3", "--stiffness", "inf")),
    "kd runs in the drive": (
        2,
        ("--gains-run", "split", "--drive-rate-hz", "1000", "--drive-delay-ms", "3", "--rate-hz", "500", "--stiffness", "inf"),
    ),
    "delay margin": (2, ("--rate-hz", "1000", "--stiffness", "inf", "--delay-margin-ms", "3")),
    "other limits": (2, ("--rate-hz", "1000", "--stiffness", "inf", "--margin-db", "8", "--peak-sensitivity", "1.7")),
    "other margins": (2, ("--rate-hz", "1000", "--stiffness", "inf", "--require", "phase_margin_deg=45", "--require", "gain_margin_db=3")),
    "bent": (3, ("--rate-hz", "1000", "--stiffness", "20000", "--damping", "3", "--posture", "j1=0.8")),
    "floats": (3, ("--rate-hz", "1000", "--stiffness", "20000", "--damping", "3", "--base", "floating")),
    "stands": (3, ("--rate-hz", "1000", "--stiffness", "20000", "--damping", "3", "--base", "floating", "--contact", "foot")),
    "slow loop": (2, ("--rate-hz", "250", "--stiffness", "inf", "--bandwidth", "600")),
    "grams": (2, ("--rate-hz", "1000", "--stiffness", "inf")),
}
"""Kinds of audits of arms: how many joints, and what is typed beside the model, its delay and its gains."""


def drawn_audit(kind: str, folder: Path) -> list[str]:
    """The words of an audit, beside its files in the folder."""
    draw, (count, typed) = random.Random(f"audit {kind}"), AUDITS[kind]
    text = arm_urdf(draw, count, "floating" in typed)
    (folder / "arm.urdf").write_text(text.replace('<mass value="', '<mass value="1000') if kind == "grams" else text, "utf-8")
    own = robot(draw, count)
    motor = {} if kind in ("motors unknown", "nothing known") else {"motor_inertia": own["joints"]["default"]["motor_inertia"]}
    stiff = 15.0 if "split" in typed else 1.0  # else kp's path may have half a second of delay, which takes minutes to find
    gains = {f"j{k}": {"kp": stiff * own["control"]["kp"], "kd": own["control"]["kd"], **motor} for k in range(count)}
    written(folder, {"gains": gains}, "gains.yaml")
    return ["audit", str(folder / "arm.urdf"), "--delay-ms", "2", "--gains", str(folder / "gains.yaml"), *typed]
