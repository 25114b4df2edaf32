"""Robot skeleton for a drawing: joints as points, and their tree."""

from dataclasses import dataclass

from ..system.linear.arrays import Floats, Integers


@dataclass(frozen=True)
class Bone:
    """One joint of the file for a drawing: `tip` (3,) [m] in its frame is the end of its links, None where other joints follow."""

    name: str
    parent: str | None
    tip: Floats | None


@dataclass(frozen=True)
class Skeleton:
    """Joint positions of a robot, as nodes of a tree.

    names       of the k nodes: "base", then every joint of the file, locked ones too, each chain closed by a tip
    positions   (k, 3) [m]; a floating base stands at the origin
    parents     (k,) index of the parent node; −1 for the base
    joints      (k,) index in joint_names of the joint at the node; −1 for base, locked joints and tips
    """

    names: tuple[str, ...]
    positions: Floats
    parents: Integers
    joints: Integers
