"""Python configurations in many spellings: as Python itself has them, or refused with the line; never a part of them."""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from random import Random
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings

from gainroom.errors import GainroomError
from gainroom.files.gain_files import gains_of, read_gains
from gainroom.files.gain_formats.actuator_configs import read_actuator_configs
from mutations import RANDOMS

JOINTS = ("hip_pitch", "hip_roll", "knee", "ankle_pitch", "ankle_roll", "toe")
PARTS = {"hip_.*": 2, "knee": 1, "ankle_.*": 2, "toe": 1}
BEFORE = """\
import math
from copy import deepcopy
from dataclasses import dataclass, replace
from functools import partial
from isaaclab.actuators import ImplicitActuatorCfg as Cfg

def plain(name, kp, kd=1.0, **more):
    return Cfg(joint_names_expr=[name], stiffness=kp, damping=kd, **more)

def fields(name, kp, *, kd):
    result = {"joint_names_expr": [name]}
    result["stiffness"] = kp
    result |= dict(damping=kd)
    return result

def chosen(kind, kp, kd):
    for name, pattern in PATTERNS.items():
        if name == kind:
            return plain(pattern, kp, kd)
    raise KeyError(kind)

PATTERNS = {"hip": "hip_.*", "knee": "knee", "ankle": "ankle_.*", "toe": "toe"}

@dataclass
class Motor:
    kp: float
    kd: float = 0.0

    @property
    def half(self):
        return self.kp / 2

    def cfg(self, *names):
        return Cfg(joint_names_expr=list(names), stiffness=2 * self.half, damping=self.kd)
"""


@dataclass
class Spelling:
    """One random way to write a robot: `lines` before it, and what it is."""

    random: Random
    count: int = 0

    def name(self) -> str:
        self.count += 1
        return f"N{self.count}"

    def number(self, value: float) -> str:
        """An expression of the very same double."""
        r = self.random
        ways = [f"{value}", f"({value * 2} / 2)", f"{value / 4} * 2**2", f"max({value}, 0.0)", f"[0.0, {value}][-1]", f"float('{value}')"]
        ways += [f"{{'x': {value}}}['x']", f"({value} if math.pi > 3 else None)", f"sum([{value / 2}] * 2)", f"(lambda x: x)({value})"]
        return r.choice(ways)

    def pattern(self, text: str) -> str:
        r = self.random
        head, tail = text[:2], text[2:]
        ways = [
            f"{text!r}",
            f"{head!r} + {tail!r}",
            f'f"{{{head!r}}}{tail}"',
            f"''.join([{head!r}, {tail!r}])",
            f"'{{}}{tail}'.format({head!r})",
        ]
        ways += [f"'%s{tail}' % {head!r}", f"{text.upper()!r}.lower()"]
        return r.choice(ways)

    def group(self, pattern: str, kp: float, kd: float, lines: list[str]) -> str:
        """An actuator: an expression, and lines before it."""
        r, name = self.random, self.name()
        p, k, d = self.pattern(pattern), self.number(kp), self.number(kd)
        kind = next(key for key, value in {"hip": "hip_.*", "knee": "knee", "ankle": "ankle_.*", "toe": "toe"}.items() if value == pattern)
        match r.randrange(12):
            case 0:
                return f"Cfg(joint_names_expr=[{p}], stiffness={k}, damping={d})"
            case 1:
                return f"plain({p}, {k}, kd={d})"
            case 2:
                return f"Cfg(**fields({p}, {k}, kd={d}))"
            case 3:
                return f"chosen({kind!r}, {k}, {d})"
            case 4:
                return f"Motor({k}, {d}).cfg({p})"
            case 5:
                lines.append(f"{name} = partial(Cfg, joint_names_expr=({p},), damping={d})")
                return f"{name}(stiffness={k})"
            case 6:
                lines += [f"{name} = plain('other', 1.0)", f"{name} = replace({name}, joint_names_expr=[{p}], stiffness={k}, damping={d})"]
                return name
            case 7:
                lines += [f"{name} = plain({p}, 1.0)", f"{name}.stiffness = {k}", f"setattr({name}, 'damping', {d})"]
                return f"deepcopy({name})"
            case 8:
                lines += [f"{name}, {name}_d = {k}, {d}", f"{name}_kp = {{{p}: {name}}}"]
                return f"Cfg(joint_names_expr=list({name}_kp), stiffness={name}_kp, damping={{'.*': {name}_d}})"
            case 9:
                lines += [f"class {name}(Cfg):", f"    joint_names_expr = [{p}]", f"    stiffness = {k}", f"    damping = {d}"]
                return f"{name}()"
            case 10:
                lines += [
                    f"def {name}(kp={k}):",
                    f"    kd = {d}",
                    "    if kp > 1e9:",
                    "        return None",
                    f"    return plain({p}, kp, kd=kd)",
                ]
                return f"{name}()"
        lines += [f"{name} = plain({p}, 0.0)", f"for {name}_x, {name}_y in (('stiffness', {k}), ('damping', {d})):",
                  f"    {name}.__dict__[{name}_x] = {name}_y"]  # fmt: skip
        return f"{name}.copy()"

    def robot(self, groups: list[tuple[str, float, float]]) -> str:
        """A file with ROBOT."""
        r = self.random
        lines: list[str] = []
        made = [self.group(*group, lines) for group in groups]
        split = r.randrange(len(made) + 1)
        one, other = made[:split], made[split:]
        match r.randrange(10):
            case 0:
                robot = f"Art(actuators=({''.join(each + ', ' for each in made)}))"
            case 1:
                robot = f"Art(actuators=[{', '.join(one)}] + [{', '.join(other)}])"
            case 2:
                lines.append(f"PART = ({''.join(each + ', ' for each in one)})")
                robot = f"Art(actuators=(*PART, {', '.join(other)}))"
            case 3:
                robot = f"Art(actuators={{**{self.mapping(one)}, **{self.mapping(other)}}})"
            case 4:
                robot = f"Art(actuators={self.mapping(one)} | dict({self.mapping(other)}))"
            case 5:
                lines += ["PART = {}", f"for k, x in enumerate([{', '.join(made)}]):", "    PART.update({f'g{k}': x})"]
                robot = "Art(actuators=PART)"
            case 6:
                lines += ["PART = []", *(f"PART.{r.choice(['append({})', 'extend([{}])', 'insert(0, {})']).format(each)}" for each in made)]
                robot = "Art(actuators=tuple(PART))"
            case 7:
                rows = ", ".join(f"({self.pattern(p)}, {self.number(kp)}, {self.number(kd)})" for p, kp, kd in groups)
                lines = [f"ROWS = [{rows}]"]
                robot = r.choice(
                    [
                        "Art(actuators={p: plain(p, kp, kd) for p, kp, kd in ROWS})",
                        "Art(actuators=tuple(plain(*row) for row in ROWS))",
                        "Art(actuators=[plain(p, kp, kd=kd) for p, kp, kd in ROWS if p != 'none'])",
                        "Art(actuators=list(map(lambda row: plain(*row), ROWS)))",
                        "Art(actuators=[plain(p, kp, kd) for p, (kp, kd) in zip([x[0] for x in ROWS], [x[1:] for x in ROWS])])",
                    ]
                )
            case 8:
                lines += [f"BASE = Art(actuators={self.mapping(one)})", f"MORE = {self.mapping(other)}"]
                lines += ["ROBOT = BASE.copy()", "for name in MORE:", "    ROBOT.actuators['x' + name] = MORE[name]"]
                return "\n".join([BEFORE, *lines, ""])
            case _:
                lines += ["def robot(spawn=None):", f"    parts = {self.mapping(made)}", "    return Art(spawn=spawn, actuators=parts)"]
                robot = "robot(spawn=UsdFileCfg(usd_path=f'{DIR}/a.usd'))"
        return "\n".join([BEFORE, *lines, f"ROBOT = {robot}", ""])

    def mapping(self, made: list[str]) -> str:
        return "{" + ", ".join(f"'{self.name()}': {each}" for each in made) + "}"


class Made:
    """A stand-in for the libraries' configurations, with what the texts above do to them."""

    def __init__(self, **fields: Any) -> None:
        for key in dir(type(self)):
            if not key.startswith("_") and not callable(getattr(type(self), key)):
                setattr(self, key, getattr(type(self), key))
        self.__dict__.update(fields)

    def copy(self) -> "Made":
        from copy import deepcopy

        return deepcopy(self)

    def __replace__(self, **changes: Any) -> "Made":
        return type(self)(**self.__dict__ | changes)


def run(text: str) -> dict[str, Any]:
    """What Python itself makes of a text."""
    import dataclasses

    text = re.sub(r"^from isaaclab.*$", "", text, flags=re.MULTILINE)
    text = text.replace("from dataclasses import dataclass, replace", "from dataclasses import dataclass")
    space: dict[str, Any] = {
        "Cfg": type("Cfg", (Made,), {}),
        "Art": type("Art", (Made,), {}),
        "UsdFileCfg": type("Usd", (Made,), {}),
        "DIR": "",
    }
    space["replace"] = lambda value, **changes: (
        value.__replace__(**changes) if isinstance(value, Made) else dataclasses.replace(value, **changes)
    )
    space["__name__"] = "robot"
    exec(text, space)
    return space


def run_gains(robot: Any) -> Iterator[tuple[float, float]]:
    """kp and kd of each joint; 0 where there is none."""
    actuators = robot.actuators.values() if isinstance(robot.actuators, dict) else robot.actuators
    for joint in JOINTS:
        mine = [each for each in actuators if any(re.fullmatch(pattern, joint) for pattern in each.joint_names_expr)]
        assert len(mine) <= 1
        yield tuple(_of(value, joint) for each in mine for value in (each.stiffness, each.damping)) or (0.0, 0.0)  # type: ignore[misc]


def _of(value: Any, joint: str) -> float:
    return next(v for p, v in value.items() if re.fullmatch(p, joint)) if isinstance(value, dict) else value


def drawn(random: Random) -> list[tuple[str, float, float]]:
    patterns = random.sample(sorted(PARTS), random.randint(1, len(PARTS)))
    return [(pattern, random.randint(1, 4000) / 16, random.randint(1, 400) / 64) for pattern in patterns]


@pytest.mark.slow
@settings(max_examples=150, deadline=None, suppress_health_check=list(HealthCheck))
@given(random=RANDOMS)
def test_every_spelling_is_read_as_the_literal(random: Random):
    """The groups that were drawn are the truth, and Python itself agrees. Halves and quarters of these numbers are exact."""
    groups = drawn(random)
    text = Spelling(random).robot(groups)
    expected = [next(((kp, kd) for pattern, kp, kd in groups if re.fullmatch(pattern, joint)), (0.0, 0.0)) for joint in JOINTS]
    assert list(run_gains(run(text)["ROBOT"])) == expected
    found = gains_of(read_actuator_configs(text, "r.py", "ROBOT"), JOINTS)
    assert list(zip(found.kp.tolist(), found.kd.tolist(), strict=True)) == expected


HIDDEN = ("os.environ.get('X')", "load('x')", "CONSTANT", "json.loads(TEXT)['x']", "X.y[2]", "math.gamma(3)", "f'{X:{Y}}'", "int(X)")


@pytest.mark.slow
@settings(max_examples=150, deadline=None, suppress_health_check=list(HealthCheck))
@given(random=RANDOMS)
def test_where_one_thing_is_not_known_all_is_refused_or_all_is_read(random: Random):
    """One number, name or condition of the text is replaced by what only running it can tell."""
    groups = drawn(random)
    text = Spelling(random).robot(groups)
    expected = [next(((kp, kd) for pattern, kp, kd in groups if re.fullmatch(pattern, joint)), (0.0, 0.0)) for joint in JOINTS]
    places = list(re.finditer(r"(?<![\w.'])\d+\.\d+|'hip_\.\*'|'knee'|'toe'|kp > 1e9|math\.pi > 3|name == kind|p != 'none'", text))
    place = random.choice(places)
    text = text[: place.start()] + random.choice(HIDDEN) + text[place.end() :]
    message = ""
    try:
        found = gains_of(read_actuator_configs(text, "r.py", "ROBOT"), JOINTS)
        assert list(zip(found.kp.tolist(), found.kd.tolist(), strict=True)) == expected
    except GainroomError as error:
        message = str(error)
    assert not message or re.match(r"r\.py: (line \d+: |.*\(line \d+\)$)", message)


GROUP = "Cfg(joint_names_expr=['{0}'], stiffness={1}, damping=1.0)"
TWO = f"A = {GROUP.format('knee', 10.0)}\nB = {GROUP.format('toe', 20.0)}\n"


def kp_of(text: str, name: str = "ROBOT", folder: Path | None = None) -> list[float]:
    """Of knee and toe."""
    return gains_of(read_actuator_configs(text, "r.py", name, folder), ("knee", "toe")).kp.tolist()


@pytest.mark.parametrize(
    ("text", "kp"),
    [
        ("ROBOT = Art(actuators=[A])\ndef add():\n    ROBOT.actuators.append(B)\nadd()", [10, 20]),
        ("ROBOT = Art(actuators=[A])\n(lambda: ROBOT.actuators.append(B))()", [10, 20]),
        ("ROBOT = Art(actuators={'a': A})\nf = ROBOT.actuators.setdefault\nf('b', B)", [10, 20]),
        ("ROBOT = Art(actuators={'a': A})\nvars(ROBOT)['actuators']['b'] = B", [10, 20]),
        ("ROBOT = Art(actuators={'a': A})\nglobals()['ROBOT'].actuators['b'] = B", [10, 20]),
        ("ROBOT = Art(actuators={'a': A, 'b': B})\ndel ROBOT.actuators['b']", [10, 0]),
        ("ROBOT = Art(actuators=[A, B])\nROBOT.actuators[1:] = []", [10, 0]),
        ("views = {'a': A}\nall = views.values()\nviews['b'] = B\nROBOT = Art(actuators=tuple(all))", [10, 20]),
        ("ROBOT = Art(actuators=tuple(x for x in [A, B] if x.stiffness > 15))", [0, 20]),
        ("import numpy as np\nkp = 3 * np.array([1.0, 2.0])\nA.stiffness = kp[1]\nROBOT = Art(actuators=[A])", [6, 0]),
        ("from copy import copy\nC = copy(A)\nC.stiffness = 7.0\nROBOT = Art(actuators=[A])", [10, 0]),
        ("from dataclasses import replace\nP = Part(of=A)\nreplace(P).of.stiffness = 7.0\nROBOT = Art(actuators=[A])", [7, 0]),
        ("class K:\n    of = {'a': A}\nclass L(K):\n    pass\nL.of['a'].stiffness = 7.0\nROBOT = Art(actuators=K.of)", [7, 0]),
        ("from isaaclab.assets import Art\nROBOT = Art(actuators=[A])\nA.stiffness = 7.0", [10, 0]),
        ("from mjlab.entity import Art\nROBOT = Art(actuators=[A])\nA.stiffness = 7.0", [7, 0]),
    ],
)
def test_changes_reach_what_they_reach_in_python(text: str, kp: list[float]):
    """Objects are shared or copied as Python shares them; Isaac Lab's configclass copies what it is made with, a dataclass does not."""
    assert kp_of(TWO + text) == kp


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("ROBOT = Art(actuators=[A, *MORE])", "line 3: ROBOT: actuators: 'MORE' is no name of this file"),
        ("ROBOT = Art(actuators={'a': A} | more())", "line 3: ROBOT: actuators: 'more()' is a call, and more is no name of this file"),
        ("ROBOT = Art(actuators={'a': A, **MORE})", "line 3: ROBOT: actuators: 'MORE' is no name of this file"),
        ("ROBOT = Art(actuators={'a': A, KEY: B})", "line 3: ROBOT: actuators: 'KEY' is no name of this file"),
        ("ROBOT = Art(actuators=[A, Legs()])", "line 3: ROBOT: actuators: Legs names no joints"),
        ("ROBOT = Art(actuators=[A, Cfg(['toe'], 3.0)])", "line 3: ROBOT: actuators: \"Cfg(['toe'], 3.0)\" is a call"),
        ("ROBOT = Art(actuators=[A, legs(joint_names_expr=['toe'], stiffness=1.0, damping=1.0)])", "and legs is no name of this file"),
        ("ROBOT = Art(actuators=[A, None])", "ROBOT: actuators: nothing is no actuator configuration"),
        (
            "ROBOT = Art(actuators=[A])\nfor x in MORE: ROBOT.actuators.append(x)",
            "line 4: ROBOT: actuators: 'for x in MORE' cannot be decided",
        ),
        ("ROBOT = Art(actuators=[A])\nMORE and ROBOT.actuators.append(B)", "line 4: ROBOT: actuators: 'MORE and"),
        ("ROBOT = Art(actuators=[A])\n[ROBOT.actuators.append(x) for x in MORE]", "line 4: ROBOT: actuators: '[ROBOT."),
        ("ROBOT = Art(actuators=[A])\ntry:\n    ROBOT.actuators.append(B)\nexcept: pass", "line 4: ROBOT: actuators: 'try' cannot"),
        (
            "ROBOT = Art(actuators=[A])\ndef add(x): x.actuators.append(B)\nif MORE: add(ROBOT)",
            "line 5: ROBOT: actuators: 'if MORE' cannot",
        ),
        ("ROBOT = Art(actuators=[A])\nacts = ROBOT.actuators\nif MORE: acts += [B]", "line 5: ROBOT: actuators: 'if MORE' cannot"),
        ("ROBOT = Art(actuators=[A])\nhelp(ROBOT.actuators)", "line 4: ROBOT: actuators: 'help(ROBOT.actuators)' is not run, and may"),
        ("def all():\n    yield A\n    yield B\nROBOT = Art(actuators=list(all()))", "line 6: ROBOT: actuators: 'all()' is a generator"),
        ("def f(n): return f(n)\nROBOT = Art(actuators=[f(1)])", "line 3: functions call each other more than 20 deep"),
        ("from more import *\nROBOT = Art(actuators=[A])", "line 3: ROBOT: actuators: 'A' may come with `from more import *`"),
        (
            "ROBOT = OTHER.replace(spawn=1)",
            "line 3: ROBOT: 'OTHER' is no name of this file: write its actuators here, or lay that file beside",
        ),
        ("from .base import ROBOT", "line 3: ROBOT: 'ROBOT' comes with `from .base`, and other files are not read"),
        ("ROBOT = Art(actuators=[A])\nA.effort_limit = LIMIT", "line 1: Cfg: effort_limit: 'LIMIT' is no name of this file (line 4)"),
        ("ROBOT = Art(actuators=[A])\nROBOT.actuators[0].__dict__.update(MORE)", "line 1: Cfg: 'MORE' is no name of this file and may"),
        (
            "class S(Cfg):\n    def __getattr__(self, name): return 3\nROBOT = Art(actuators=[A, S()])",
            "has __getattr__, which is not followed",
        ),
    ],
)
def test_whatever_stands_among_actuators_and_is_not_understood_is_refused(text: str, says: str):
    with pytest.raises(GainroomError) as caught:
        kp_of(TWO + text)
    assert str(caught.value).startswith("r.py: ")
    assert says in str(caught.value)


@pytest.mark.parametrize(
    "text",
    [
        "x = 10 ** 10 ** 10",
        "x = 'a' * 10 ** 9\ny = [0] * 10 ** 9\nz = [y, y] * 10 ** 9",
        "x = f'{1:999999999d}'\ny = '%999999999d' % 1\nz = '{:999999999}'.format(1)",
        "x = 'a'.join(['b' * 300] * 2000)\ny = ('a' * 300).replace('a', 'b' * 300)\nz = 'a'.zfill(10 ** 9)",
        "for i in range(10 ** 12): x = i",
        "x = [i for i in range(2000) for j in range(2000) for k in range(2000)]",
        "while True: x = 1",
        "x = [1]\nwhile True: x.append(x + x)",
        "x = 'a'\nwhile True: x += x",
        "x = {}\nwhile True: x = {'a': x, 'b': x}",
        "def f(n): return f(n - 1) + f(n - 1)\ndef g(): return f(10 ** 9)",
        "x = (lambda f: f(f))(lambda f: [f(f) for _ in range(1)]) if None else 1",
        "x = " + "(" * 80 + "1" + ",)" * 80,
        "x = sum([[1] * 2000] * 2000, [])",
        "x = list(map(str, range(2000)))\nfor a in x:\n    for b in x:\n        for c in x: y = a + b + c",
    ],
)
def test_bombs_beside_the_actuators_cost_little_and_harm_nothing(text: str):
    """The bounds on steps, items and text end each within a second or so; hours and gigabytes otherwise."""
    assert kp_of(f"{text}\n{TWO}ROBOT = Art(actuators=[A, B])") == [10, 20]


def write(folder: Path, **files: str) -> Path:
    for name, text in files.items():
        path = folder / f"{name.replace('__', '/')}.py"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, "utf-8")
    return folder


BESIDE = [
    ("from .base import BASE\nROBOT = BASE.copy()\nROBOT.actuators['b'].stiffness = 30.0", "base", [10, 30]),
    ("from base import BASE\nROBOT = BASE.replace(spawn=UNKNOWN)", "base", [10, 20]),
    ("from .sub.base import BASE\nROBOT = BASE.replace(spawn=UNKNOWN)", "sub__base", [10, 20]),
    ("from . import base\nROBOT = base.BASE", "base", [10, 20]),
    ("import base as b\nROBOT = b.BASE", "base", [10, 20]),
    ("from .base import A as LEG\nROBOT = Art(actuators=(LEG,))", "base", [10, 0]),
    ("from .base import make\nROBOT = Art(actuators=(make('toe', 5.0),))", "base", [0, 5]),
    ("from .base import *\nROBOT = Art(actuators=(A, B))", "base", [10, 20]),
    ("from robots.assets.base import BASE as ROBOT", "base", [10, 20]),
    ("from .base import ALL\nROBOT = Art(actuators={**ALL})", "base", [10, 20]),
]
BASE = (
    TWO
    + "ALL = {'a': A, 'b': B}\nBASE = Art(actuators=ALL)\ndef make(name, k): return Cfg(joint_names_expr=[name], stiffness=k, damping=1)\n"
)


@pytest.mark.parametrize(("text", "file", "kp"), BESIDE)
def test_names_of_a_file_beside_are_read_there(tmp_path: Path, text: str, file: str, kp: list[float]):
    folder = write(tmp_path / "robots" / "assets", **{file: BASE, "r": text})
    assert gains_of(read_gains(Path(f"{folder / 'r.py'}:ROBOT")), ("knee", "toe")).kp.tolist() == kp


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("from ..base import BASE as ROBOT", "comes with `from ..base`, and other files are not read"),
        ("from .link import BASE as ROBOT", "comes with `from .link`, and other files are not read"),
        ("from .round import ROBOT", "which is being read: these files name each other"),
        ("from .broken import ROBOT", "which cannot be read: "),
        ("from .fine import ROBOT", "has no such name"),
        ("from .fine import X\nROBOT = Art(actuators=[X])", "fine.py: line 1: 'UNKNOWN' is no name of this file"),
        ("from .fine import Y\nROBOT = Art(actuators=[Y])", "fine.py: line 2: Cfg: stiffness: "),
    ],
)
def test_what_lies_outside_the_folder_or_is_not_understood_there_is_refused(tmp_path: Path, text: str, says: str):
    folder = write(tmp_path / "inner", r=text, round="from .square import ROBOT", square="from .round import ROBOT", broken="x = (")
    write(folder, fine="X = UNKNOWN\nY = Cfg(joint_names_expr=['knee'], stiffness=UNKNOWN, damping=1)")
    write(tmp_path, base=BASE + "BASE = ROBOT")
    (folder / "link.py").symlink_to(tmp_path / "base.py")
    with pytest.raises(GainroomError) as caught:
        read_gains(Path(f"{folder / 'r.py'}:ROBOT"))
    assert says in str(caught.value)


ROBOTS = """
A = Art(
    spawn=Usd(path="a"),
    init_state=Art.InitialStateCfg(pos=(0, 0, 1), joint_pos={"knee": 0.6, "head": 0.1}),
    actuators={"legs": Cfg(joint_names_expr=["knee"], stiffness=200.0, damping=5.0),
               "feet": Cfg(joint_names_expr=["toe"], stiffness=40.0, damping=2.0)},
)
B = A.copy()
B.spawn.path = "b"
C = A.copy()
C.actuators["feet"].stiffness = 20.0
D = A.replace(actuators={"all": Cfg(joint_names_expr=[".*"], stiffness=100.0, damping=3.0)})
E = A.replace(spawn=Usd(path="e"))
F = deepcopy(A)
F.init_state.pos = (0, 0, 2)
G = dataclasses.replace(A, spawn=None)
H = A.copy()
H.init_state.joint_pos = {"knee": 0.9}
I = A.copy()
I.actuators.pop("feet")
J = OTHER.copy()
MORE = {"small": A.copy(), "soft": C}
def get():
    return A.replace(actuators={"one": Cfg(joint_names_expr=["toe"], stiffness=7.0, damping=3.0)})
"""


@pytest.mark.parametrize(
    ("name", "kp", "knee"),
    [
        *((name, [200, 40], 0.6) for name in ("A", "B", "E", "F", "G", "MORE.small")),
        *((name, [200, 20], 0.6) for name in ("C", "MORE.soft")),
        ("D", [100, 100], 0.6),
        ("H", [200, 40], 0.9),
        ("I", [200, 0], 0.6),
        ("get", [0, 7], 0.6),
    ],
)
def test_every_robot_of_a_file_can_be_chosen(name: str, kp: list[float], knee: float):
    found = gains_of(read_actuator_configs(ROBOTS, "r.py", name), ("knee", "toe"))
    assert found.kp.tolist() == kp
    (angles,) = found.postures.values()
    assert angles == {"knee": knee}
    assert [note for note in found.notes if "no joint for 'head'; the other angles count" in note] or name == "H"


def test_without_a_name_robots_that_differ_are_asked_for_and_copies_are_not():
    """B, E and F are as A, as far as anything here depends on it; C and D have other gains, H another posture, I one actuator less."""
    with pytest.raises(GainroomError, match=r"the actuators of 5 robots; name one, r\.py:A \(A, C, D, H, I\)"):
        read_actuator_configs(ROBOTS, "r.py")
    head = ROBOTS[: ROBOTS.index("C = ")]
    assert gains_of(read_actuator_configs(head, "r.py"), ("knee", "toe")).kp.tolist() == [200, 40]
    more = "J = OTHER.copy()\nSPARE = Cfg(joint_names_expr='a', stiffness=1.0)\n"
    file = read_actuator_configs(head + more, "r.py")
    assert file.notes == (
        "r.py: line 11: SPARE is in no robot's actuators, so it does not count",
        "r.py: line 10: J is not looked at: 'OTHER' is no name of this file: write its actuators here, or lay that file beside",
    )


def test_a_posture_that_is_not_understood_is_no_posture_and_is_told():
    text = TWO + "ROBOT = Art(actuators=[A], init_state=Init(joint_pos={'knee': BENT}))"
    found = gains_of(read_actuator_configs(text, "r.py"), ("knee",))
    assert found.postures == {}
    assert dict(found.unread_postures) == {"init_state": "r.py: line 3: init_state: joint_pos: 'BENT' is no name of this file"}
