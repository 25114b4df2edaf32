"""A robot for a drawing: its joints as points, and what hangs on what."""

from dataclasses import dataclass

from ..system.linear.arrays import Floats, Integers


@dataclass(frozen=True)
class Bone:
    """One joint of the file for a drawing: `tip` (3,) [m] in its frame is where its links end, None where other joints follow."""

    name: str
    parent: str | None
    tip: Floats | None


@dataclass(frozen=True)
class Skeleton:
    """Where the joints are.

    names       of the k nodes: "base", then every joint of the file, locked ones too, each chain closed by a tip
    positions   (k, 3) [m]; a floating base stands at the origin
    parents     (k,) index of the node that this one hangs on; −1 for the base
    joints      (k,) index in joint_names of the joint at the node; −1 for base, locked joints and tips
    """

    names: tuple[str, ...]
    positions: Floats
    parents: Integers
    joints: Integers
