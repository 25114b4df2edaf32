"""Equality constraints of an MJCF: which parts of a robot they hold together, as MuJoCo compiles them."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from ...system.linear.arrays import Floats


class Placed(NamedTuple):
    """Frame on a body: index of the body, and in its axes the frame's origin (3,) [m] and quaternion (4,), w first."""

    body: int
    position: Floats
    quaternion: Floats


@dataclass(frozen=True)
class Join:
    """Constraint <connect> or <weld>: the origins of two frames coincide, or the whole frames."""

    name: str
    welded: bool
    first: Placed
    second: Placed


@dataclass(frozen=True)
class Tie:
    """Constraint <joint>: `follower` is Σ c_k x^k from its reference position, `leader` x from its own; leader "": the follower is held."""

    follower: str
    leader: str
    coefficients: tuple[float, ...]


@dataclass(frozen=True)
class Constraints:
    """Active equality constraints of a file; `ignored`: those of other kinds."""

    joins: tuple[Join, ...] = ()
    ties: tuple[Tie, ...] = ()
    ignored: int = 0

    def as_json(self) -> list[Any]:
        """Constraints as lists, numbers and texts, for `from_json`."""
        ends = lambda join: [[end.body, end.position.tolist(), end.quaternion.tolist()] for end in (join.first, join.second)]  # noqa: E731
        joins = [[join.name, join.welded, *ends(join)] for join in self.joins]
        return [joins, [[tie.follower, tie.leader, tie.coefficients] for tie in self.ties], self.ignored]

    @classmethod
    def from_json(cls, data: Sequence[Any]) -> "Constraints":
        """Constraints that `as_json` has written."""
        joins, ties, ignored = data
        placed = lambda end: Placed(end[0], np.array(end[1]), np.array(end[2]))  # noqa: E731
        return cls(
            tuple(Join(name, welded, placed(first), placed(second)) for name, welded, first, second in joins),
            tuple(Tie(follower, leader, tuple(coefficients)) for follower, leader, coefficients in ties),
            ignored,
        )


def take_constraints(mujoco: Any, spec: Any) -> Constraints:
    """Reads all equality constraints of `spec`, and deletes them there. Raises what MuJoCo's compiler raises."""
    kinds = mujoco.mjtEq
    active = [each for each in spec.equalities if each.active]
    ties = [Tie(each.name1, each.name2, tuple(map(float, each.data[:5]))) for each in active if each.type == kinds.mjEQ_JOINT]
    count = sum(each.type in (kinds.mjEQ_CONNECT, kinds.mjEQ_WELD) for each in active)
    joins = _joins(mujoco, spec.compile()) if count else ()  # where anchors are on the second body MuJoCo works out itself
    for each in list(spec.equalities):
        spec.delete(each)
    return Constraints(joins, tuple(ties), len(active) - len(ties) - count)


def _joins(mujoco: Any, model: Any) -> tuple[Join, ...]:
    found, kinds = [], (int(mujoco.mjtEq.mjEQ_CONNECT), int(mujoco.mjtEq.mjEQ_WELD))
    for index in range(model.neq):
        if not model.eq_active0[index] or int(model.eq_type[index]) not in kinds:
            continue
        welded, data = int(model.eq_type[index]) == kinds[1], np.array(model.eq_data[index])
        ends = int(model.eq_obj1id[index]), int(model.eq_obj2id[index])
        unturned = np.array([1.0, 0.0, 0.0, 0.0])
        if int(model.eq_objtype[index]) == int(mujoco.mjtObj.mjOBJ_SITE):
            first, second = (
                Placed(int(model.site_bodyid[end]), np.array(model.site_pos[end]), np.array(model.site_quat[end])) for end in ends
            )
        elif welded:  # the anchor on the second body, then where that body is seen from the first (engine_core_constraint.c)
            first, second = Placed(ends[0], data[3:6], data[6:10]), Placed(ends[1], data[:3], unturned)
        else:
            first, second = Placed(ends[0], data[:3], unturned), Placed(ends[1], data[3:6], unturned)
        name = model.equality(index).name or f"{'weld' if welded else 'connect'}#{index}"
        found.append(Join(name, welded, first, second))
    return tuple(found)
