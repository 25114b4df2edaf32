"""Short Python, each to find `k`: as Python itself has it, or refused with the line; the reader never has another value."""

from pathlib import Path
from typing import Any

import pytest

from gainroom.errors import GainroomError
from gainroom.files.gain_files import gains_of, read_gains
from gainroom.files.gain_formats.actuator_configs import read_actuator_configs
from python_cases import READ, REFUSED

ROBOT = "ROBOT = Art(actuators=[Cfg(joint_names_expr=['hip'], stiffness=k, damping=1.0)])\n"


def cases(text: str) -> list[str]:
    return text.strip("\n").split("\n---\n")


def kp_of(text: str) -> float:
    ((gain,),) = read_actuator_configs(f"{text}\n{ROBOT}", "r.py").matched(("hip",))
    return gain.kp


@pytest.mark.parametrize("text", cases(READ))
def test_k_is_pythons_own(text: str):
    space: dict[str, Any] = {"__name__": "robot"}
    exec(text, space)
    assert kp_of(text) == float(space["k"])


@pytest.mark.parametrize("text", cases(REFUSED))
def test_what_is_not_followed_is_refused_with_its_line(text: str):
    """Nearly all of it means something to Python; of the sets not even Python could say what, before it is run."""
    with pytest.raises(GainroomError, match=r"^r\.py: line \d+: "):
        kp_of(text)


@pytest.mark.parametrize("call", ["tensor", "as_tensor", "asarray"])
def test_single_precision_is_not_taken_for_double(call: str):
    """PyTorch keeps 0.1 as 0.10000000149, unless told; NumPy as Python does."""
    assert kp_of("import numpy as np\nk = np.asarray([0.1, 3.0])[0]") == 0.1
    with pytest.raises(GainroomError, match=rf"^r\.py: line 3: .*{call} comes with `import torch`"):
        kp_of(f"import torch\nk = torch.{call}([0.1, 3.0])[0]")


@pytest.mark.parametrize(
    "late",
    [
        "g = (x * n for x in (1.0, 2.0))",
        "g = map(lambda x: x * n, (1.0, 2.0))",
        "g = filter(lambda x: x > n, (1.0, 2.0, 9.0))",
        "g = zip((n,), (1.0,))",
        "g = enumerate(row)",
        "g = reversed(row)",
        "g = h = (x for x in row)",
        "g, h = (x for x in row), 1",
    ],
)
def test_what_is_gone_through_later_is_refused(late: str):
    """Python looks at n and row where the items are taken, one by one: after they were changed here, and after some were taken."""
    row = "n = 1.0\nrow = [1.0, 2.0]\n"
    after = "n = 5.0\nrow.append(3.0)\n"
    for use in ("k = sum(map(float, g))", "k = float(len(list(g)))", "for k in g: pass", "def f(k): return sum(k)\nk = f(g)"):
        with pytest.raises(GainroomError, match=r"is gone through later, which is not followed: write list|'for k in g' cannot be decided"):
            kp_of(row + late + "\n" + after + use)
    assert kp_of(row + "g = list(row)\n" + after + "k = sum(g)") == 3.0


def test_a_private_name_of_two_classes_is_refused():
    base = "class P:\n    def __init__(self): self.__k = 3.0\n    def get(self): return self.__k\n"
    assert kp_of(base + "k = P().get()") == 3.0
    with pytest.raises(GainroomError, match="'class C' has a private name that a class which it inherits from has"):
        kp_of(base + "class C(P):\n    def more(self): self.__k = 5.0\nc = C()\nc.more()\nk = c.get()")


CLASSES = """
@configclass
class BaseCfg(ArticulationCfg):
    actuators = {
        "legs": Cfg(joint_names_expr=["knee"], stiffness=10.0, damping=1.0),
        "feet": Cfg(joint_names_expr=["toe"], stiffness=20.0, damping=2.0),
    }
    def __post_init__(self):
        self.actuators["legs"].stiffness = 99.0
@configclass
class SoftCfg(BaseCfg):
    def __post_init__(self):
        super().__post_init__()
        self.actuators["feet"].stiffness /= 2
class PlainCfg(BaseCfg):
    scale = 3.0
@configclass
class SceneCfg(InteractiveSceneCfg):
    robot = SoftCfg()
    def __post_init__(self):
        self.robot.actuators["legs"].stiffness = 7.0
@configclass
class OpenCfg(BaseCfg):
    def __post_init__(self):
        self.actuators["legs"].stiffness = TUNED
@configclass
class LaterCfg(ArticulationCfg):
    def __post_init__(self):
        self.actuators = {"all": Cfg(joint_names_expr=[".*"], stiffness=5.0, damping=1.0)}
@register_robot("other")
@configclass
class NamedCfg(LaterCfg):
    pass
"""


@pytest.mark.parametrize(
    ("name", "kp"),
    [
        ("BaseCfg", [99, 20]),
        ("SoftCfg", [99, 10]),
        ("PlainCfg", [99, 20]),
        ("SceneCfg.robot", [7, 10]),
        ("LaterCfg", [5, 5]),
        ("NamedCfg", [5, 5]),
    ],
)
def test_a_class_is_what_an_object_of_it_is(name: str, kp: list[float]):
    """What __post_init__ changes counts (Isaac Lab's own manner to derive a robot), by hand: it runs after the fields are copied."""
    assert gains_of(read_actuator_configs(CLASSES, "r.py", name), ("knee", "toe")).kp.tolist() == kp


def test_a_class_whose_objects_are_not_known_is_refused():
    with pytest.raises(GainroomError, match=r"line 5: Cfg: stiffness: 'TUNED' is no name of this file \(line 25\)"):
        read_actuator_configs(CLASSES, "r.py", "OpenCfg")
    for decorator in ("@scaled", "@scaled(2)", "@other.scaled"):
        with pytest.raises(
            GainroomError, match=f"line 3: ROBOT: actuators: '{decorator.replace('(', '.').replace(')', '.')}' is not followed"
        ):
            read_actuator_configs(f"A = 1\n{decorator}\nclass ROBOT(Art):\n    pass\nROBOT = Art(actuators=ROBOT)", "r.py", "ROBOT")


TWICE = "x = 1.0\nfor _ in range(40): x = {}\n"


@pytest.mark.parametrize("held", ["[x, x]", "(x, x)", "{'a': x, 'b': x}"])
@pytest.mark.parametrize(
    "use",
    [
        "A.stiffness = x",
        "A.joint_names_expr = x",
        "A.stiffness = {'knee': x}",
        "ROBOT.actuators = x",
        "kps = [x]\nkds = [1]\ndel A, ROBOT",
        "del A, ROBOT\nclass C:\n    class control:\n        stiffness = {'knee': x}\n        damping = x",
    ],
)
def test_what_holds_itself_twice_at_every_depth_is_refused_at_once(held: str, use: str):
    """2^40 values, were each looked at."""
    text = "A = Cfg(joint_names_expr=['knee'], stiffness=10.0, damping=1.0)\nROBOT = Art(actuators=[A])\n"
    with pytest.raises(GainroomError) as caught:
        gains_of(read_actuator_configs(text + TWICE.format(held) + use, "r.py"), ("knee",))
    assert len(str(caught.value)) < 400


@pytest.mark.parametrize(
    "use",
    [
        "y = 1 if x == x else 2",
        "y = x in [1, 2, x]",
        "y = {x: 1}",
        "y = f'{x}'",
        "y = sorted([x, x])",
        "y = [x].count(x)",
        "y = {x, x}",
        "y = copy.deepcopy(x)",
        "y = x + x",
        "B = Art(actuators=[A], init_state=Init(joint_pos={'toe': x}))",
        "y = list(range(1, 5, 0)) + list(enumerate([1], foo=1)) + list(range(10**30))",
        "y = 1 << (1 << 40)\nz = 3\nfor _ in range(2000): z = z**3",
        "y = []\nfor _ in range(2000): y.append(copy.deepcopy([0] * 2000))",
        "y = [[0] * 2000 for _ in range(2000)]",
        "y = tuple([int] * 2000)\nfor _ in range(2000): isinstance('a', y)",
    ],
)
def test_much_beside_the_actuators_costs_little(use: str):
    text = "import copy\nA = Cfg(joint_names_expr=['knee'], stiffness=10.0, damping=1.0)\nROBOT = Art(actuators=[A])\n"
    text += TWICE.format("(x, x)")
    assert gains_of(read_actuator_configs(text + use, "r.py", "ROBOT"), ("knee",)).kp.tolist() == [10]


@pytest.mark.parametrize(
    ("base", "text", "kp"),
    [
        ("__all__ = ['_K']\n_K = 4.0", "from base import *\nk = _K", 4.0),
        ("class B:\n    k = 4.0\n    def twice(self): return 2 * self.k", "from base import B\nclass C(B): k = 5.0\nk = C().twice()", 10),
        ("K = {'hip': 1.0}\ndef get(n): return K[n]", "import base\nbase.K['hip'] = 9.0\nk = base.get('hip')", 9.0),
        ("K = 1.0\ndef get(): return K", "import base\nbase.K = 9.0\nk = base.get()", 9.0),
        ("K = 1.0\ndef get(): return K", "from base import K, get\nK = 9.0\nk = get()", 1.0),
    ],
)  # fmt: skip
def test_a_file_beside_is_one_file_for_all(tmp_path: Path, base: str, text: str, kp: float):
    (tmp_path / "base.py").write_text(base, "utf-8")
    (tmp_path / "r.py").write_text(f"{text}\n{ROBOT}", "utf-8")
    assert gains_of(read_gains(tmp_path / "r.py"), ("hip",)).kp.tolist() == [kp]
