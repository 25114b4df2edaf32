"""A robot's model from its file, in whichever format."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from xml.etree.ElementTree import Element

from ...errors import GainroomError
from ..assemble import assemble
from ..body import Base, RigidBody
from .mjcf import Mjcf
from .model_format import ActuatorGains, ModelFormat, Stepping
from .model_names import locate
from .urdf import Urdf
from .xml_text import parse_xml, read_xml

FORMATS: dict[str, ModelFormat] = {"robot": Urdf(), "mujoco": Mjcf()}
"""By root element."""


def load_model(
    file: str | Path | Mapping[str, str],
    base: Base | None = None,
    locked: Sequence[str] = (),
    selected: Sequence[str] | None = None,
    posture_for_locked: Mapping[str, float] | None = None,
    locked_key: str = "",
    passive: Sequence[str] = (),
    driven: Sequence[str] = (),
    for_names: bool = False,
) -> RigidBody:
    """Links of a robot, read from its model file.

    file       a URDF or MJCF, recognised by its root element; {"package": …, "file": …} or "package:file" for one in an installed Python
               package, as in example-robot-data, or gainroom's own; or the name of a module of robot_descriptions, where that is installed
    base       "fixed", "floating", or None: fixed, except where the file has a free joint
    locked     patterns (regular expressions for whole names, or names) of joints to hold
    selected   patterns of the joints to use; None: all
    posture_for_locked   positions [rad; m if prismatic] of the locked joints, 0 where not named; other joints may stand in it too
    locked_key   what messages call the list `locked`, where it comes from another file
    passive    patterns of joints without a motor: what holds them, such as a closed loop, moves them. Joints of closed loops are, where the
               file has actuators and none on them, and joints without one that follow others that move. Locked ones are not
    driven     patterns of joints with a motor that the file does not tell of, where they would be passive: in closed loops, and following
               others, whose motor and theirs then move both
    for_names  True: joints that move no mass, or have more than one degree of freedom, may be among those that are to be locked later;
               assemble.require_movable refuses them

    Raises GainroomError, one line that names the file, where it is missing, malformed, out of bounds or makes no robot; where a pattern
    matches nothing; where Pinocchio, or for an MJCF MuJoCo, is not installed.
    """
    path = locate(file)
    if base not in ("fixed", "floating", None):
        raise GainroomError(f"{path}: base {base!r} must be fixed or floating")
    root = read_xml(path)
    description = _format(root, path).describe(root, path, base)
    return assemble(description, base, locked, selected, posture_for_locked, locked_key, passive, driven, for_names)


def has_base(path: Path) -> bool:
    """True if the file itself tells whether its base is fixed or floating. Raises GainroomError as load_model."""
    return _format(read_xml(path), path).has_base


def joint_order(path: Path) -> tuple[str, ...]:
    """See ModelFormat. Raises GainroomError as load_model."""
    root = read_xml(path)
    return _format(root, path).joint_order(root)


def keyframes(path: Path) -> Mapping[str, Mapping[str, float]]:
    """See ModelFormat. Raises GainroomError as load_model."""
    root = read_xml(path)
    return _format(root, path).keyframes(root, path)


def includes(path: Path, other: Path) -> bool:
    """True if an MJCF names the file `other` in an <include> of its own. Raises GainroomError as load_model."""
    named = [each.get("file", "") for each in read_xml(path).iter("include")]
    return any((path.parent / name).resolve() == other.resolve() for name in named if name)


def position_gains(path: Path, text: str = "") -> ActuatorGains:
    """See ModelFormat; `text` is read in the place of the file's, where it is given. Raises GainroomError as load_model."""
    root = parse_xml(text, str(path)) if text else read_xml(path)
    return _format(root, path).position_gains(root, path)


def stepping(path: Path) -> Stepping:
    """See ModelFormat. Raises GainroomError as load_model."""
    root = read_xml(path)
    return _format(root, path).stepping(root, path)


def _format(root: Element, path: Path) -> ModelFormat:
    if root.tag not in FORMATS:
        known = " or ".join(f"<{tag}> ({each.title})" for tag, each in FORMATS.items())
        raise GainroomError(f"{path}: root element <{root.tag[:40]}> must be {known}")
    return FORMATS[root.tag]
