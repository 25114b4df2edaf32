"""Robots put together in many ways: the actuators that Python itself ends up with, or refused with the line; never some of them."""

import copy
import re
import sys
import types
from typing import Any

import pytest

from gainroom.errors import GainroomError
from gainroom.files.gain_formats.actuator_configs import read_actuator_configs

BEFORE = """\
from isaaclab.actuators import ImplicitActuatorCfg as Cfg
from isaaclab.assets import ArticulationCfg as Art
A = Cfg(joint_names_expr=['hip'], stiffness=10.0, damping=1.0)
B = Cfg(joint_names_expr=['knee'], stiffness={'.*': 20.0}, damping=2.0)
C = Cfg(joint_names_expr=['toe'], stiffness=30.0, damping=3.0)
"""
READ = """
ROBOT = Art(actuators=(A,) + (B,))
---
acts = (A,)
acts += (B,)
ROBOT = Art(actuators=acts)
---
ROBOT = Art(actuators=(A,))
ROBOT.actuators += (B,)
---
ROBOT = Art(actuators={'a': A})
ROBOT.actuators |= {'b': B}
---
ROBOT = Art(actuators={'a': A})
ROBOT.actuators.update(b=B, c=C)
---
ROBOT = Art(actuators={**{'a': A, 'b': B}, 'a': C})
---
acts = [A]
ROBOT = Art(actuators=acts)
acts.append(B)
---
acts = [A]
ROBOT = Art(actuators=tuple(acts))
acts.append(B)
---
ROBOT = Art(actuators=list({'a': A, 'b': B}.values()))
---
ROBOT = Art(actuators=list(map(lambda n: Cfg(joint_names_expr=[n], stiffness=5.0, damping=1.0), ['hip', 'toe'])))
---
ROBOT = Art(actuators=list(filter(None, [A, None, B])))
---
ROBOT = Art(actuators=list(filter(lambda a: a.stiffness == 10.0, [A, C])))
---
ROBOT = Art(actuators=sorted([C, A], key=lambda a: a.stiffness))
---
ROBOT = Art(actuators=sum(((A,), (B,)), ()))
---
from itertools import chain
ROBOT = Art(actuators=tuple(chain([A], (B,), [C])))
---
from itertools import chain
ROBOT = Art(actuators=tuple(chain.from_iterable([[A], (B,)])))
---
ROBOT = Art(actuators=dict(zip('ab', (A, B))))
---
ROBOT = Art(actuators=tuple(a for a in (A, B)))
---
ROBOT = Art(actuators=[*(a for a in (A, B)), C])
---
USE = False
ROBOT = Art(actuators=[A, *([B] if USE else []), C])
---
USE = False
ROBOT = Art(actuators=[A] + ([B] if USE else [C]))
---
def legs(names, k=5.0): return [Cfg(joint_names_expr=[n], stiffness=k, damping=1.0) for n in names]
ROBOT = Art(actuators=[*legs(['hip', 'knee']), *legs(['toe'], k=7.0)])
---
def add(d, **kw): d.update(kw)
acts = {'a': A}
add(acts, b=B)
ROBOT = Art(actuators=acts)
---
def stiffen(r, f):
    for a in r.actuators.values(): a.stiffness = a.stiffness * f
ROBOT = Art(actuators={'a': A, 'c': C})
stiffen(ROBOT, 2)
---
ROBOT = Art(actuators={'a': A, 'c': C})
(lambda r: setattr(r.actuators['a'], 'stiffness', 50.0))(ROBOT)
---
ROBOT = Art(actuators={'a': A, 'c': C})
[setattr(a, 'damping', 9.0) for a in ROBOT.actuators.values()]
---
from copy import deepcopy
R = [deepcopy(A) for _ in range(2)]
R[1].joint_names_expr = ['ankle']
ROBOT = Art(actuators=R)
---
import copy
D = copy.copy(B)
D.joint_names_expr = ['ankle']
D.stiffness['.*'] = 77.0
ROBOT = Art(actuators=[B, D])
---
D = B.replace(joint_names_expr=['ankle'])
D.stiffness['.*'] = 77.0
ROBOT = Art(actuators=[B, D])
---
K = {'.*': 4.0}
X = Cfg(joint_names_expr=['hip'], stiffness=K, damping=1.0)
K['.*'] = 8.0
ROBOT = Art(actuators=[X])
---
N = ['hip']
X = Cfg(joint_names_expr=N, stiffness=4.0, damping=1.0)
X.joint_names_expr.append('toe')
ROBOT = Art(actuators=[X])
---
R = Art(actuators={'a': A})
ROBOT = R.copy()
R.actuators['a'].stiffness = 99.0
---
R = Art(actuators={'a': A})
ROBOT = R
R.actuators['a'].stiffness = 99.0
---
R = Art(actuators={'a': A, 'b': B})
ROBOT = R.replace(actuators={**R.actuators, 'b': C})
---
R = Art(actuators={'a': A})
ROBOT = R.replace(spawn=1)
R.actuators['a'].stiffness = 99.0
---
RS = {n: Art(actuators={'a': A.replace(stiffness=k)}) for n, k in (('x', 1.0), ('y', 2.0))}
ROBOT = RS['y']
---
class ROBOT(Art):
    actuators = {'a': A, 'b': B}
---
class P(Art):
    actuators = {'a': A, 'b': B}
class ROBOT(P):
    actuators = {**P.actuators, 'b': C}
---
class ROBOT(Art):
    actuators: dict = {'a': A}
---
class Leg(Cfg):
    stiffness = 5.0
    damping = 1.0
ROBOT = Art(actuators=[Leg(joint_names_expr=['hip']), Leg(joint_names_expr=['toe'], stiffness=6.0)])
---
class Leg(Cfg):
    def __post_init__(self): self.damping = self.stiffness / 10
ROBOT = Art(actuators=[Leg(joint_names_expr=['hip'], stiffness=6.0)])
---
acts = {}
for n in ('hip', 'knee', 'toe'):
    if n == 'knee': continue
    acts[n] = Cfg(joint_names_expr=[n], stiffness=1.0, damping=1.0)
ROBOT = Art(actuators=acts)
---
acts = []
for n in ('hip', 'knee', 'toe'):
    acts.append(Cfg(joint_names_expr=[n], stiffness=1.0, damping=1.0))
    if n == 'knee': break
ROBOT = Art(actuators=acts)
---
import contextlib
acts = [A]
with contextlib.nullcontext(): acts.append(B)
ROBOT = Art(actuators=acts)
---
globals()['A'] = C
ROBOT = Art(actuators=[A])
---
ROBOT = Art(actuators=[getattr(Art(x=B), 'x')])
---
A.__dict__['stiffness'] = 4.0
ROBOT = Art(actuators=[A])
---
vars(A).update(stiffness=4.0)
ROBOT = Art(actuators=[A])
---
acts = [A]
add = acts.append
add(B)
ROBOT = Art(actuators=acts)
---
acts = [A]
list(map(acts.append, [B, C]))
ROBOT = Art(actuators=acts)
---
acts = [A]
any(acts.append(x) for x in [B, C])
ROBOT = Art(actuators=acts)
---
acts = [A]
True or acts.append(B)
False or acts.append(C)
ROBOT = Art(actuators=acts)
---
acts = [A]
acts.append(B) if False else acts.append(C)
ROBOT = Art(actuators=acts)
---
ROBOT = Art(actuators=[(x := A), x.replace(joint_names_expr=['toe'])])
---
acts = [A]
def f(x=acts.append(B)): pass
ROBOT = Art(actuators=acts)
---
acts = [A]
def reg(f):
    acts.append(f())
    return f
@reg
def leg(): return C
ROBOT = Art(actuators=acts)
---
acts = [A]
class X:
    acts.append(B)
ROBOT = Art(actuators=acts)
---
acts = [A]
class X:
    def __init__(self): acts.append(B)
X()
ROBOT = Art(actuators=acts)
---
acts = [A]
class X:
    @property
    def go(self): acts.append(B)
X().go
ROBOT = Art(actuators=acts)
---
acts = [A]
assert acts.append(B) is None
ROBOT = Art(actuators=acts)
---
acts = [A]
f = lambda x=acts.append(B): x
ROBOT = Art(actuators=acts)
---
acts = [A]
[1, 2][acts.append(B) or 0]
ROBOT = Art(actuators=acts)
---
acts = [A]
reg = lambda c: acts.append(c) or c
reg(B)
ROBOT = Art(actuators=acts)
---
from functools import partial
acts = [A]
reg = partial(acts.append, B)
reg()
ROBOT = Art(actuators=acts)
---
acts = [A]
sorted([1], key=lambda x: acts.append(B) or x)
ROBOT = Art(actuators=acts)
---
acts = [A]
(acts.append, print)[0](B)
ROBOT = Art(actuators=acts)
---
acts = [A]
ops = {'add': acts.append}
ops['add'](B)
ROBOT = Art(actuators=acts)
---
acts = [A]
getattr(acts, 'append')(B)
ROBOT = Art(actuators=acts)
---
acts = [A]
acts[1:] = [B, C]
ROBOT = Art(actuators=acts)
---
acts = [A, B, C]
del acts[1:2]
ROBOT = Art(actuators=acts)
---
acts = [A, B]
acts[-1] = C
ROBOT = Art(actuators=acts)
---
A, C = C, A
A.stiffness = 5.0
ROBOT = Art(actuators=[A])
---
first, *rest = [A, B, C]
ROBOT = Art(actuators=rest)
---
class X: pass
x = X()
for x.k in (1.0, 6.0): pass
A.stiffness = x.k
ROBOT = Art(actuators=[A])
---
d = {}
for d['k'] in (1.0, 6.0): pass
A.stiffness = d['k']
ROBOT = Art(actuators=[A])
---
k = 1.0
class X:
    global k
    k = 5.0
A.stiffness = k
ROBOT = Art(actuators=[A])
---
if __name__ == '__main__': A.stiffness = 9.0
ROBOT = Art(actuators=[A])
---
from typing import TYPE_CHECKING
if TYPE_CHECKING: A = B
ROBOT = Art(actuators=[A])
---
import typing as t
if t.TYPE_CHECKING: A = B
else: A.stiffness = 3.0
ROBOT = Art(actuators=[A])
---
TYPE_CHECKING = True
if TYPE_CHECKING: A = B
ROBOT = Art(actuators=[A])
"""
REFUSED = """
class Leg(Cfg):
    stiffness = 5.0
    @property
    def damping(self): return self.stiffness / 10
ROBOT = Art(actuators=[Leg(joint_names_expr=['hip'])])
---
import os
acts = [A]
for n in os.environ.get('X', 'knee').split(','): acts.append(B)
ROBOT = Art(actuators=acts)
---
import os
acts = [A]
if os.environ.get('X') is None: acts.append(B)
ROBOT = Art(actuators=acts)
---
import os
if os.environ.get('X') is None: A.stiffness = 4.0
ROBOT = Art(actuators=[A])
---
acts = [A]
try:
    acts.append(B)
except Exception: pass
ROBOT = Art(actuators=acts)
---
import json
acts = [A]
for x in json.loads('[1]'): acts.append(B)
ROBOT = Art(actuators=acts)
---
exec('A.stiffness = 4.0')
ROBOT = Art(actuators=[A])
---
ROBOT = Art(actuators=[A, eval('B')])
---
ROBOT = Art(actuators=[locals()['B']])
---
object.__setattr__(A, 'stiffness', 4.0)
ROBOT = Art(actuators=[A])
---
import operator
d = {'a': A}
operator.setitem(d, 'b', B)
ROBOT = Art(actuators=d)
---
acts = [A]
class X:
    def __init_subclass__(cls): acts.append(B)
class Y(X): pass
ROBOT = Art(actuators=acts)
---
acts = [A]
class X:
    def __enter__(self): acts.append(B)
    def __exit__(self, *a): acts.append(C)
with X(): pass
ROBOT = Art(actuators=acts)
---
acts = [A]
class X:
    def __iter__(self):
        acts.append(B)
        return iter([])
for _ in X(): pass
ROBOT = Art(actuators=acts)
---
acts = [A]
class X:
    def __eq__(self, o): acts.append(B); return True
X() == 1
ROBOT = Art(actuators=acts)
---
acts = [A]
class X:
    def __contains__(self, o): acts.append(B); return True
1 in X()
ROBOT = Art(actuators=acts)
---
acts = [A]
class X:
    def __format__(self, o): acts.append(B); return ''
f'{X()}'
ROBOT = Art(actuators=acts)
---
acts = [A]
class X:
    def __str__(self): acts.append(B); return ''
str(X())
ROBOT = Art(actuators=acts)
---
acts = [A]
class X:
    def __bool__(self): acts.append(B); return True
if X(): pass
ROBOT = Art(actuators=acts)
---
acts = [A]
class X:
    def __call__(self): acts.append(B)
x = X()
x()
ROBOT = Art(actuators=acts)
---
class X(list):
    pass
acts = X([A])
acts.append(B)
ROBOT = Art(actuators=acts)
---
acts = [A]
class X:
    def __len__(self): acts.append(B); return 1
len(X())
ROBOT = Art(actuators=acts)
---
acts = [A]
x: acts.append(B) = 1
ROBOT = Art(actuators=acts)
---
acts = [A]
def f():
    acts.append(B)
    raise ValueError
try: f()
except ValueError: acts.append(C)
ROBOT = Art(actuators=acts)
---
acts = [A]
min([1], key=lambda x: acts.append(B) or x)
ROBOT = Art(actuators=acts)
---
from functools import reduce
acts = [A]
reduce(lambda a, x: acts.append(x), [B, C], None)
ROBOT = Art(actuators=acts)
---
from collections import deque
acts = deque([A])
acts.append(B)
ROBOT = Art(actuators=acts)
---
acts = [A]
list.append(acts, B)
ROBOT = Art(actuators=acts)
---
acts = {'a': A}
dict.update(acts, b=B)
ROBOT = Art(actuators=acts)
---
from operator import methodcaller
acts = [A]
methodcaller('append', B)(acts)
ROBOT = Art(actuators=acts)
---
import contextlib
with contextlib.nullcontext(5.0) as k: pass
A.stiffness = k
ROBOT = Art(actuators=[A])
---
import os
n = os.path.basename('/x/hip.py')[:-3]
ROBOT = Art(actuators=[Cfg(joint_names_expr=[n], stiffness=1.0, damping=1.0)])
"""
JOINTS = ("hip", "knee", "ankle", "toe")


class Stub:
    """A configuration as Isaac Lab makes them: with copies of what it is given."""

    def __init__(self, **fields: Any) -> None:
        for name, value in fields.items():
            setattr(self, name, copy.deepcopy(value))
        if hasattr(self, "__post_init__"):
            self.__post_init__()

    def copy(self) -> "Stub":
        return copy.deepcopy(self)

    def replace(self, **changes: Any) -> "Stub":
        return type(self)(**{**self.__dict__, **changes})


def run(text: str, monkeypatch: pytest.MonkeyPatch) -> list[tuple[float, float]]:
    """kp and kd of each joint of ROBOT, by Python, which runs the text."""
    for name, kind in (("isaaclab", ""), ("isaaclab.actuators", "ImplicitActuatorCfg"), ("isaaclab.assets", "ArticulationCfg")):
        module = types.ModuleType(name)
        if kind:
            setattr(module, kind, type(kind, (Stub,), {}))
        monkeypatch.setitem(sys.modules, name, module)
    space: dict[str, Any] = {"__name__": "robot"}
    exec(text, space)
    robot = space["ROBOT"]() if isinstance(space["ROBOT"], type) else space["ROBOT"]
    found = dict.fromkeys(JOINTS, (0.0, 0.0))
    for each in robot.actuators.values() if isinstance(robot.actuators, dict) else robot.actuators:
        for joint in JOINTS:
            if each is not None and any(re.fullmatch(pattern, joint) for pattern in each.joint_names_expr):
                found[joint] = tuple(value[".*"] if isinstance(value, dict) else value for value in (each.stiffness, each.damping))
    return list(found.values())


def read(text: str) -> list[tuple[float, float]]:
    gains = read_actuator_configs(text, "r.py", "ROBOT").matched(JOINTS)
    return [(each[-1].kp, each[-1].kd) if each else (0.0, 0.0) for each in gains]


def cases(text: str) -> list[str]:
    return text.strip("\n").split("\n---\n")


@pytest.mark.parametrize("text", cases(READ))
def test_the_actuators_are_pythons_own(text: str, monkeypatch: pytest.MonkeyPatch):
    assert read(BEFORE + text) == run(BEFORE + text, monkeypatch)


@pytest.mark.parametrize("text", cases(REFUSED))
def test_what_is_not_followed_leaves_no_actuator_out(text: str):
    with pytest.raises(GainroomError, match=r"^r\.py: line \d+: "):
        read(BEFORE + text)
