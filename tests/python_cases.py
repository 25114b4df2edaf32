"""Short Python, each to find `k`, for test_python_values: what the reader follows, and what it refuses."""

READ = """
def twice(f):
    def g(*a): return 2 * f(*a)
    return g
@twice
def k(x): return x
k = k(3.0)
---
from enum import Enum
class M(Enum):
    HIP = 100.0
    KNEE = 50.0
k = M.HIP.value
---
from enum import Enum
class M(Enum):
    HIP = 100.0
k = 5.0 if M.HIP == 100.0 else 7.0
---
from enum import IntEnum
class M(IntEnum):
    HIP = 100
k = M.HIP * 2
---
class P:
    k = 1.0
class Q(P): pass
class R(P):
    k = 2.0
class S(Q, R): pass
k = S.k
---
class P:
    def k(self): return 1.0
class Q(P): pass
class R(P):
    def k(self): return 2.0
class S(Q, R): pass
k = S().k()
---
class P:
    def __init__(self): self.k = 1.0
class Q(P):
    def __init__(self):
        super().__init__()
        self.k *= 3
class R(P):
    def __init__(self):
        super().__init__()
        self.k += 1
class S(Q, R):
    def __init__(self):
        super().__init__()
k = S().k
---
def twice(c):
    c.k *= 2
    return c
@twice
class Q:
    k = 1.0
k = Q.k
---
import numpy as np
k = np.float64(1.5) * np.sqrt(4.0)
---
import numpy as np
k = np.array([10.0]) + [5.0]
k = float(k[0])
---
import numpy as np
k = [5.0] + np.array([10.0])
k = float(k[0])
---
import math
k = math.log(8, 2) + math.log(math.e)
---
L = [[1.0]] * 2
L[0].append(5.0)
k = L[1][-1]
---
fs = [lambda: k for k in (1.0, 2.0)]
k = fs[0]()
---
def f(x, acc=[]):
    acc.append(x)
    return sum(acc)
f(1.0)
k = f(2.0)
---
from types import SimpleNamespace
m = SimpleNamespace(kp=3.0)
m.kp *= 2
k = m.kp
---
k = 1.0
while k < 10: k *= 2
---
k = 1.0
def s():
    global k
    k = 5.0
s()
---
fs = [lambda k=k: k for k in (1.0, 2.0)]
k = fs[0]()
---
k = True * 3.0 + (2 > 1)
---
k = (1 << 3) | 1
---
k = float((10**17 + 1) % 10)
---
import numpy as np
a = np.array([1.0,2.0,3.0])
k = float((a[:2] * 2)[1])
---
class M:
    k = [1.0]
m = M()
M.k.append(5.0)
k = m.k[-1]
---
from dataclasses import dataclass
@dataclass
class M:
    k: float = 1.0
m = M()
M.k = 5.0
k = m.k
---
from dataclasses import dataclass
from typing import ClassVar
@dataclass
class M:
    a: ClassVar[float] = 9.0
    k: float = 1.0
k = M(5.0).k
---
from dataclasses import dataclass, field, KW_ONLY
@dataclass
class M:
    k: float = 1.0
    _: KW_ONLY
    z: float = 2.0
k = M(5.0, z=3.0).z
---
from dataclasses import dataclass, field
@dataclass
class M:
    a: float = field(init=False, default=2.0)
    k: float = 1.0
k = M(5.0).k
---
from dataclasses import dataclass
@dataclass
class P:
    p: float = 1.0
@dataclass
class Q:
    q: float = 2.0
@dataclass
class R(P, Q):
    r: float = 3.0
k = R(7.0).q
---
from dataclasses import dataclass
@dataclass
class P:
    a: float = 1.0
    b: float = 2.0
@dataclass
class Q(P):
    b: float = 5.0
    c: float = 6.0
    a: float = 7.0
k = Q(1.5).a + Q(1.5).b
---
class M:
    @property
    def k(self): return 3.0
m = M()
k = m.k
---
class M:
    __slots__ = ('k',)
    def __init__(self): self.k = 2.0
k = M().k
---
class P:
    def __init__(self, k=1.0, **kw): self.k = k
class Q(P):
    def __init__(self, **kw): super().__init__(k=kw.pop('stiff', 2.0), **kw)
k = Q(stiff=8.0).k
---
class P:
    @classmethod
    def make(cls): return 2.0
class Q(P):
    @classmethod
    def make(cls): return super().make() + 1
k = Q.make()
---
class P:
    def f(self): return 2.0
class Q(P):
    def f(self): return P.f(self) + 1
k = Q().f()
---
class P:
    k = 1.0
class Mix:
    k = 4.0
class Q(Mix, P): pass
k = Q.k
---
class P:
    class control:
        k = 1.0
        d = 2.0
class Q(P):
    class control(P.control):
        k = 5.0
k = Q.control.k + Q.control.d
---
class P:
    k = 3.0
class Q(P):
    k = None
k = 5.0 if Q.k is None else 6.0
---
class P:
    k = 3.0
    del k
    k = 4.0
k = P.k
---
class P:
    ks = [i * 1.0 for i in range(3)]
    k = ks[-1]
k = P.k
---
class P:
    if True:
        k = 3.0
    else:
        k = 4.0
k = P.k
---
from enum import Enum
class M(Enum):
    A = 1.0
    B = 2.0
m = M.B
k = 5.0 if m == M.B else 6.0
---
from enum import Enum
class M(Enum):
    A = 1.0
    B = 2.0
k = {M.A: 3.0, M.B: 4.0}[M.B]
---
from enum import IntEnum
class M(IntEnum):
    A = 0
    B = 1
k = [3.0, 4.0][M.B]
---
from enum import Enum
class M(Enum):
    A = 1.0
    B = 2.0
k = sum(m.value for m in M)
---
k = 1.0
assert k == 1.0
---
def f(n):
    if n == 'x': return 1.0
    raise KeyError(n)
k = f('x')
---
k = float(int('12345678901234567890') % 97)
---
k = 5.0 if isinstance(3, float) else 1.0
---
k = max(0.0, -0.0) + abs(-3)
---
k = sorted([1.0, 3.0, 2.0], reverse=True)[0]
---
d = {'a': 1.0}
d['b'] = 2.0
d['a'] = 5.0
k = list(d.values())[0]
---
d = {'a': 1.0, 'b': 2.0}
v = d.pop('a')
d['a'] = v
k = list(d.values())[0]
---
d = {1: 2.0, True: 3.0}
k = d[1]
---
d = {}
d.setdefault('a', []).append(4.0)
k = d['a'][0]
---
(a, (b, *c)), d = (1.0, (2.0, 3.0, 4.0)), 5.0
k = c[-1]
---
a = b = [1.0]
a.append(3.0)
k = b[-1]
---
class M: k = 1.0
m = M()
m.k += 2
k = m.k + M.k
---
f = lambda *, a=1.0, **kw: a + kw.get('b', 2.0)
k = f(b=5.0)
---
def f(a, *b, c=1.0): return a + sum(b) * c
k = f(1.0, 2.0, 3.0, c=2.0)
---
def f(n): return 1.0 if n == 0 else n * f(n - 1)
k = f(5)
---
def mk():
    n = 0
    def inc():
        nonlocal n
        n += 1
        return n
    return inc
i = mk()
i()
k = float(i())
---
a = [1.0]
def f(): a.append(9.0)
f()
k = a[-1]
---
m = 'b'
k = 1.0 if m == 'a' else 2.0 if m == 'b' else 3.0
---
for x in [1, 2]:
    if x == 5: break
else:
    k = 7.0
---
n = 0
while True:
    n += 1
    if n == 4: break
k = float(n)
---
x = 5.0
y = [x for x in (1.0, 2.0)]
k = x
---
p = r'hi\\w'
k = 5.0 if p == 'hi\\\\w' else 1.0
---
d = dict(zip(('a', 'b'), (1.0, 2.0)))
k = d['b']
---
k = [i * v for i, v in enumerate([2.0, 3.0], start=1)][-1]
---
a = [1.0]
b = a[:]
b.append(2.0)
k = float(len(a))
---
F = float
k = F('2.5')
---
a = [y := 2.0, y * 3]
k = a[1]
---
a = [last := x for x in (1.0, 4.0)]
k = last
---
k = 3.0
j = k
del k
k = j * 2
---
import numpy as np
k = float((np.array([2, 3]) ** 2)[1])
---
import numpy as np
k = np.array([1, 2.5]).tolist()[0] / 2
---
import numpy as np
k = float(np.array([1.0])[0] / 4)
---
import numpy as np
k = float((5 - np.array([1.0]))[0])
---
import numpy as np
k = 3.0 if 1.0 in np.array([1.0, 2.0]) else 4.0
---
k = float(round(-2.5)) + 10
---
k = -7.5 % 2
---
k = 3.0 if 1 < 2 < 3 else 4.0
---
a = 0
k = 3.0 if a is not None else 4.0
---
k = 3.0 if 'a' not in {'b': 1} else 4.0
"""
REFUSED = """
class P:
    def __getattribute__(self, n): return 7.0
class Q(P):
    k = 1.0
k = Q().k
---
class Meta(type):
    def __getattribute__(cls, n): return 7.0
class Q(metaclass=Meta):
    k = 1.0
k = Q.k
---
class P:
    def __init_subclass__(cls): cls.k = 9.0
class Q(P):
    k = 1.0
k = Q.k
---
class D:
    def __get__(self, o, c): return 9.0
class Q:
    k = D()
k = Q.k
---
import numpy as np
k = np.array([10, 20])
k[0] = 1.5
k = float(k[0])
---
import numpy as np
k = np.array([1.5, 2.7], dtype=int)
k = float(k[0])
---
import numpy as np
k = np.float32(0.1)
k = float(k)
---
import numpy as np
k = np.array([[1.0, 2.0],[3.0, 4.0]])
k = float((k * 2)[1][0])
---
import numpy as np
k = np.array([1.0, 2.0]).mean()
---
import numpy as np
k = np.array([10, 21])
k //= 2
k = float(k[1])
---
import numpy as np
k = np.array([10.0, 21.0])
m = k[:1]
m[0] = 5.0
k = float(k[0])
---
import numpy as np
k = np.array([10.0, 21.0])
m = k
m *= 2
k = float(k[0])
---
import numpy as np
k = 3.0 if (np.array([1.0]) == 1.0) else 4.0
---
import numpy as np
k = 3.0 if np.array([0.0]) else 4.0
---
import numpy as np
k = np.maximum(3.0, 4.0) + np.clip(9.0, 0.0, 5.0) + np.abs(-1.0) + np.min([1.0, 2.0])
---
import math
k = math.fsum([1.0, 2.0]) + math.hypot(3.0, 4.0) + math.prod([2, 3]) + math.atan2(1.0, 1.0)
---
try:
    import nothere
    FAST = True
except ImportError:
    FAST = False
k = 1.0 if FAST else 2.0
---
try:
    k = KP['x']
except NameError:
    k = 4.0
---
mode = 'soft'
match mode:
    case 'soft': k = 1.0
    case _: k = 2.0
---
import sys
if sys.version_info >= (3, 9):
    k = 1.0
else:
    k = 2.0
---
from dataclasses import dataclass, InitVar
@dataclass
class M:
    f: InitVar[float]
    kp: float = 0.0
    def __post_init__(self, f): self.kp = f * 2
k = M(3.0).kp
---
from functools import reduce
k = reduce(lambda a, b: a + b, [1.0, 2.0])
---
from fractions import Fraction
k = float(Fraction(3, 2))
---
class M:
    def __init__(self, k): self.k = k
    def __mul__(self, o): return M(self.k * o)
k = (M(2.0) * 3).k
---
class M:
    def __call__(self, k): return k * 2
k = M()(3.0)
---
class M:
    def __getitem__(self, k): return 4.0
k = M()['x']
---
class M(dict):
    def __missing__(self, k): return 4.0
k = M()['x']
---
k = round(2.5) + round(2.675, 2) + divmod(7, 2)[0]
---
k = abs(3 + 4j)
---
import numpy as np
a = np.array([1.0,2.0])
m = a[:1]
m[0] = 5.0
k = float(a[0])
---
import numpy as np
a = np.array([1.0,2.0])
m = a[:1]
a[0] = 5.0
k = float(m[0])
---
import numpy as np
a = np.array([[1.0,2.0],[3.0,4.0]])
k = (a[0] * 2)[1]
---
import numpy as np
a = np.array([1.0,2.0])
a.fill(4.0)
k = float(a[0])
---
import numpy as np
a = np.array([1.0])
a += [2.0]
k = float(a[0])
---
import numpy as np
a = np.array([1.0])
np.multiply(a, 2.0, out=a)
k = float(a[0])
---
import random
a = [1.0, 2.0, 3.0]
random.shuffle(a)
k = a[0]
---
import heapq
a = [3.0, 1.0]
heapq.heapify(a)
k = a[0]
---
class M:
    k = 1.0
m = M()
M.k = 5.0
k = m.k
---
class M:
    k = 1.0
class N(M): pass
m = N()
M.k = 5.0
k = m.k
---
class M:
    k = 1.0
m = M()
setattr(M, 'k', 5.0)
k = m.k
---
class M:
    def __init__(self): self._k = 1.0
    @property
    def k(self): return self._k
    @k.setter
    def k(self, v): self._k = v * 2
m = M()
m.k = 4.0
k = m.k
---
class M:
    def __new__(cls):
        o = super().__new__(cls)
        o.k = 7.0
        return o
    k = 1.0
k = M().k
---
class P:
    @property
    def k(self): return 2.0
class Q(P):
    @property
    def k(self): return super().k * 2
k = Q().k
---
class P:
    def f(self): return 2.0
class Q(P):
    def f(self): return super(Q, self).f() + 1
k = Q().f()
---
from enum import Enum
class M(Enum):
    A = 1.0
    B = 1.0
k = 5.0 if M.A is M.B else 6.0
---
from enum import Enum
class M(Enum):
    A = 1.0
    def kp(self): return self.value * 3
k = M.A.kp()
---
from enum import Enum
class M(Enum):
    A = 1.0
k = M['A'].value + M(1.0).value
---
from enum import Enum
class M(str, Enum):
    A = 'a'
k = 5.0 if M.A == 'a' else 6.0
---
from enum import IntEnum
class M(IntEnum):
    A = 0
    B = 1
k = float(len(M))
---
from enum import IntEnum
class M(IntEnum):
    A = 7
k = M.A.value
---
from enum import Flag
class M(Flag):
    A = 1
    B = 2
k = 5.0 if (M.A | M.B) == 3 else 6.0
---
FAST = False
try:
    import nothere
    FAST = True
except ImportError:
    pass
k = 1.0 if FAST else 2.0
---
try:
    from math import pi
except ImportError:
    pi = 3
k = pi
---
try:
    from nothere import K
except ImportError:
    from math import pi as K
k = K
---
try:
    import nothere as m
except ImportError:
    import math as m
k = m.pi
---
k = 1.0
try:
    k = 2.0
finally:
    k += 1
---
from contextlib import suppress
k = 1.0
with suppress(KeyError):
    k = {}['x']
    k = 5.0
---
from contextlib import suppress
k = 1.0
with suppress(KeyError):
    x = {}['x']
    k = 5.0
---
k = (2**60 + 1) / 3
---
k = min([3.0, -4.0], key=abs)
---
k = max([], default=2.0)
---
a = [3.0, 1.0]
a.sort()
k = a[0]
---
d = dict.fromkeys(['a', 'b'], 4.0)
k = d['b']
---
k = float(f'{3.14159:.2f}') + float('{:.1f}'.format(2.25))
---
k = float('%.2f' % 3.14159)
---
k = float('7'.zfill(3))
---
k = 2.0 if '12'.isdigit() else 1.0
---
k = float('a=4'.partition('=')[2])
---
k = next(iter([4.0, 5.0]))
---
k = next((x for x in [1.0, 6.0] if x > 5), None)
---
import math
k = min(math.inf, 4.0)
---
import numpy as np
k = float(np.array([1.0, 2.0]) @ np.array([3.0, 4.0]))
---
import numpy as np
k = float(np.dot([1.0, 2.0], [3.0, 4.0]))
---
import numpy as np
k = float((np.ones(3) * 4.0)[0])
---
import numpy as np
k = np.full(3, 4.0).tolist()[0]
---
import numpy as np
k = float(np.deg2rad(np.array([90.0]))[0])
---
import numpy as np
k = float(np.linspace(0, 4, 5)[2])
---
import numpy as np
k = float((np.array([2000000000, 1], dtype=np.int32) * 2)[0])
---
import numpy as np
k = float((np.array([2**62, 1]) * 4 + 5)[0])
---
import numpy as np
k = float(np.array([True, False]).tolist()[0])
---
import numpy as np
k = float(np.round(2.567, 1))
---
k = float(pow(3, 4, 5))
---
a = ...
k = 3.0 if a is ... else 4.0
---
k = float(len(b'abc'))
"""
