"""URDF through Pinocchio. Only links and joints matter: meshes are never opened.

The parser behind Pinocchio takes the first of two equal elements, passes over tags that it does not know, and says what it finds wrong on
the standard error of the whole process. So everything that bears on bodies and joints is read and checked here, and Pinocchio is given a
text that holds that and nothing else.
"""

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element, SubElement, tostring

import numpy as np

from ...errors import GainroomError, Together, all_of, first_of_many, nearest, one_line, refuse_all, typo_of
from ...system.linear.arrays import Floats
from ..assemble import FARTHEST, LARGEST, MASSLESS, Description, floats, require_at_most
from ..body import Base, library
from ..linkage import FollowingJoint
from ..plausible_links import Solid
from .model_format import ModelFormat
from .xml_text import WORDED

MAX_LINKS = 2000
"""Pinocchio walks down a chain of links by recursion, and the stack ends at about 4000."""
MOVING = ("revolute", "continuous", "prismatic")
TYPES = (*MOVING, "floating", "planar", "fixed")
MOMENTS = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
CHILDREN = {
    "robot": ("link", "joint"),
    "link": ("inertial",),
    "inertial": ("origin", "mass", "inertia"),
    "joint": ("parent", "child", "origin", "axis", "limit", "mimic", "dynamics"),
}
"""What matters in an element; others may stand beside it, but for those in <inertial>, and for what looks like a slip of the pen."""
ATTRIBUTES = {
    "link": ("name",),
    "joint": ("name", "type"),
    "origin": ("xyz", "rpy"),
    "mass": ("value",),
    "inertia": MOMENTS,
    "parent": ("link",),
    "child": ("link",),
    "axis": ("xyz",),
    "limit": ("lower", "upper"),
    "mimic": ("joint", "multiplier", "offset"),
    "dynamics": ("damping", "friction"),
}
CLOSED = ("inertial", "origin", "mass", "inertia", "parent", "child", "axis")
"""Elements that hold what is named above and nothing else: what stands there was meant to count."""
INSIDE = {child: parent for parent, children in CHILDREN.items() for child in children}
NEGLIGIBLE = 1e-6
"""Of the largest principal moment of inertia; files carry about six digits."""


class Urdf(ModelFormat):
    """URDF, the format of ROS; its base is fixed, unless the file itself has a floating joint."""

    title = "URDF"

    def joint_order(self, root: Element) -> tuple[str, ...]:  # Pinocchio sorts the joints of one link by name
        return tuple(joint.get("name", "") for joint in root.iterfind("joint"))

    def describe(self, root: Element, path: Path, base: Base | None) -> Description:
        pin, source = library("pinocchio", "Pinocchio"), str(path)
        found = _Reader(source)
        found.read(root)
        text = tostring(found.bare, "unicode")
        model = _parse(pin, text, source)
        if base == "floating" and not floats(model):
            # Pinocchio mixes two joints up that have one name.
            name = "root_joint" if "root_joint" not in found.joints else "floating base"
            model = _parse(pin, text, source, pin.JointModelFreeFlyer(), name)
        _put_rotors(model, found.rotors)
        return Description(
            source, model, found.held, found.notes(), friction=found.friction, linkages=tuple(found.ties), solids=tuple(found.solids)
        )


def _put_rotors(model: Any, rotors: Mapping[str, float]) -> None:
    """Sets the reflected rotor inertias [kg m²] by joint name, from the file's transmissions, in the model."""
    armature = np.array(model.armature)
    for name, inertia in rotors.items():
        joint = model.joints[model.getJointId(name)]
        armature[joint.idx_v : joint.idx_v + joint.nv] = inertia
    model.armature = armature


def _parse(pin: Any, text: str, source: str, *root_joint: Any) -> Any:
    """Pinocchio's model of a URDF text."""
    try:
        return pin.buildModelFromXML(text, *root_joint)
    except (ValueError, RuntimeError, LookupError, ArithmeticError) as error:
        raise GainroomError(f"{source}: not a valid URDF: {one_line(error)}") from error


@dataclass
class _Reader:
    """Reader of a URDF that copies links and joints alone, and collects names, following joints, friction and implausible inertias."""

    source: str
    bare: Element = field(default_factory=lambda: Element("robot", name="robot"))
    links: list[str] = field(default_factory=list)
    joints: list[str] = field(default_factory=list)
    held: dict[str, str] = field(default_factory=dict)
    friction: dict[str, float] = field(default_factory=dict)
    ties: list[FollowingJoint] = field(default_factory=list)
    rotors: dict[str, float] = field(default_factory=dict)
    geared: list[str] = field(default_factory=list)
    negative: dict[str, float] = field(default_factory=dict)
    solids: list[Solid] = field(default_factory=list)

    def read(self, root: Element) -> None:
        """Reads all elements of the file."""
        source = self.source
        xacro = next((element.tag for element in root.iter() if element.tag.startswith("xacro:")), None)
        if xacro:
            raise GainroomError(f"{source}: holds <{xacro}>: expand it first, xacro FILE > robot.urdf")
        links, joints = root.findall("link"), root.findall("joint")
        require_at_most(source, len(links), "links", MAX_LINKS)
        with Together() as together:
            step = together.step
            step(lambda: refuse_all([] if root.get("name") else [f"{source}: No name given: <robot> must have the attribute name"]))
            step(lambda: self._require_known(root, source))
            names = step(lambda: all_of([partial(self._names, links, "link"), partial(self._names, joints, "joint")]))
            self.links, self.joints = names()
            for link in links:
                step(partial(self._add_link, link))
            step(self._require_positive)
            parents = [step(partial(self._add_joint, joint)) for joint in joints]
            for transmission in root.findall("transmission"):
                step(partial(self._add_transmission, transmission))
            tree = dict(parent() for parent in parents)
            self._require_tree(tree, [joint.find("child").get("link", "") for joint in joints])  # type: ignore[union-attr]

    def notes(self) -> tuple[str, ...]:
        """Notes for the user on questionable values in the file."""
        notes = {
            "the inertia of these links is negative about some axis, taken as given": list(self.negative),
            "gear ratios of transmissions have no effect without the rotors' inertia: give rotor_inertia and gear_ratio": self.geared,
        }
        return tuple(f"{text}: {first_of_many(names)}" for text, names in notes.items() if names)

    def _names(self, elements: Sequence[Element], kind: str) -> list[str]:
        names = [element.get("name", "") for element in elements]
        counts = Counter(names)
        without = [f"{self.source}: a {kind} has no name"] * any(not name.strip() for name in counts)
        twice = (
            f"{self.source}: {kind} {name!r} is not unique: {count} {kind}s have this name"
            for name, count in counts.items()
            if count > 1 and name.strip()
        )
        refuse_all([*without, *twice])
        return names

    def _add_link(self, link: Element) -> None:
        name = link.get("name", "")
        owner = f"{self.source}: link {name!r}"
        self._require_known(link, owner)
        inertial = self._only(link, "inertial", owner)
        result = SubElement(self.bare, "link", name=name)
        if inertial is None:
            return
        parts = {tag: self._only(inertial, tag, f"{owner}: <inertial>") for tag in CHILDREN["inertial"]}
        with Together() as together:
            mass = together.step(lambda: self._mass(parts["mass"], owner))
            moments, principal = together.step(lambda: self._moments(parts["inertia"], owner))()
            mass = mass()
        if principal[0] < -max(NEGLIGIBLE * abs(principal[2]), MASSLESS):
            self.negative[name] = float(principal[0])
        inside = SubElement(result, "inertial")
        self._add_origin(inside, parts["origin"], owner)
        centre = self._numbers(parts["origin"], "origin", "xyz", 3, owner, absent=0.0)
        self.solids.append(Solid(name, mass, np.array(centre), principal))
        SubElement(inside, "mass", value=repr(mass))
        SubElement(inside, "inertia", dict(zip(MOMENTS, map(repr, moments), strict=True)))

    def _mass(self, element: Element | None, owner: str) -> float:
        mass = self._numbers(element, "mass", "value", 1, owner)[0]
        if not 0 <= mass <= LARGEST:
            raise GainroomError(f"{owner}: mass {mass:g} kg must be >= 0 and <= {LARGEST:g} kg")
        return mass

    def _moments(self, element: Element | None, owner: str) -> tuple[list[float], Floats]:
        """Moments of inertia [kg m²] in the order of MOMENTS, and the principal ones (3,), rising. Raises GainroomError out of bounds."""

        def moment(key: str) -> float:
            found = self._numbers(element, "inertia", key, 1, owner)[0]
            if abs(found) > LARGEST or (key in ("ixx", "iyy", "izz") and found < -MASSLESS):
                least = f"-{LARGEST:g}" if key in ("ixy", "ixz", "iyz") else "0"
                raise GainroomError(f"{owner}: inertia {key} {found:g} kg·m² must be >= {least} and <= {LARGEST:g} kg·m²")
            return found

        moments = all_of(partial(moment, key) for key in MOMENTS)
        xx, xy, xz, yy, yz, zz = moments
        return moments, np.linalg.eigvalsh([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])

    def _require_positive(self) -> None:
        """Raise GainroomError for a negative principal moment of inertia that counts beside the robot's largest."""
        largest = max((float(one.moments[2]) for one in self.solids), default=0.0)
        for name, least in self.negative.items():
            if least < -NEGLIGIBLE * largest:
                raise GainroomError(
                    f"{self.source}: link {name!r}: its least principal inertia {least:.4g} kg·m² must be >= 0: check ixy, ixz and iyz"
                )

    def _add_joint(self, joint: Element) -> tuple[str, str]:
        """Adds a joint; returns the names of its child and parent link."""
        name, kind = joint.get("name", ""), joint.get("type", "")
        owner = f"{self.source}: joint {name!r}"
        self._require_known(joint, owner)
        parts = {tag: self._only(joint, tag, owner) for tag in CHILDREN["joint"]}
        if kind not in TYPES:
            raise GainroomError(f"{owner}: has no known type [{kind[:40]}]; it must be {', '.join(TYPES[:-1])} or {TYPES[-1]}")
        result = SubElement(self.bare, "joint", name=name, type=kind)
        with Together() as together:
            step, axis, mimic = together.step, parts["axis"], parts["mimic"]
            parent, child = (step(partial(self._add_end, result, parts[side], side, owner)) for side in ("parent", "child"))
            step(lambda: self._add_origin(result, parts["origin"], owner))
            if kind != "fixed" and axis is not None:
                step(lambda: SubElement(result, "axis", xyz=" ".join(map(repr, self._axis(axis, owner)))))
            if kind in MOVING:
                step(lambda: self._add_limit(result, parts["limit"], owner))
                step(lambda: self._add_dynamics(result, parts["dynamics"], owner))
            if mimic is not None and kind != "fixed":
                step(lambda: self._add_follower(name, kind, mimic, owner))
            return child(), parent()

    def _add_end(self, result: Element, element: Element | None, side: str, owner: str) -> str:
        """Adds the <parent> or <child> (`side`) of a joint; returns the link's name."""
        link = "" if element is None else element.get("link", "")
        if link not in self.links:
            raise GainroomError(f"{owner}: {side} link {link!r} is not in the file{nearest(link, self.links, 'link')}")
        SubElement(result, side, link=link)
        return link

    def _add_follower(self, name: str, kind: str, mimic: Element, owner: str) -> None:
        leader = mimic.get("joint", "")
        self.held[name] = f"mimics {leader!r}"
        slope, offset = (self._numbers(mimic, "mimic", key, 1, owner, absent)[0] for key, absent in (("multiplier", 1.0), ("offset", 0.0)))
        if leader in self.joints and leader != name and kind in MOVING:
            self.ties.append(FollowingJoint(f"joint {name!r}", name, leader, (offset, slope)))

    def _add_transmission(self, transmission: Element) -> None:
        """Adds the reflected rotor inertia of a transmission (Drake's rotor_inertia and gear_ratio); ROS states the reduction alone."""
        joint, found = transmission.find("joint"), {}
        name = "" if joint is None else joint.get("name", "")
        if name not in self.joints:
            return
        owner = f"{self.source}: transmission of joint {name!r}"
        for element in transmission.iter():
            key = re.split("[}:]", element.tag)[-1]
            if key in ("rotor_inertia", "gear_ratio"):
                found[key] = self._numbers(element, key, "value", 1, owner)[0]
            elif key == WORDED and not re.fullmatch(r"[-+]?1(\.0*)?|", (element.text or "").strip()):
                self.geared.append(f"{name} {one_line((element.text or '').strip(), 12)}")
        if "rotor_inertia" in found:
            ratio = found.get("gear_ratio", 1.0)
            inertia = found["rotor_inertia"] * ratio * ratio  # a power would raise where it overflows
            if not 0 <= inertia <= LARGEST:
                raise GainroomError(f"{owner}: rotor inertia {inertia:g} kg·m² at the joint must be >= 0 and <= {LARGEST:g} kg·m²")
            self.rotors[name] = inertia
            self.geared = [each for each in self.geared if not each.startswith(f"{name} ")]

    def _axis(self, axis: Element, owner: str) -> list[float]:
        try:
            numbers = [float(word) for word in axis.get("xyz", "").split()]
        except ValueError:
            numbers = []
        if len(numbers) != 3 or not np.all(np.isfinite(numbers)) or not 1e-9 < np.abs(numbers).max() <= FARTHEST:
            raise GainroomError(f"{owner}: axis {axis.get('xyz', '')[:60]!r} must be three numbers, not all zero, up to {FARTHEST:g}")
        return numbers

    def _add_origin(self, result: Element, origin: Element | None, owner: str) -> None:
        """Adds an <origin>; parts that are missing are zeros."""
        if origin is None:
            return
        values = {key: self._numbers(origin, "origin", key, 3, owner, absent=0.0) for key in ATTRIBUTES["origin"]}
        for key, numbers in values.items():
            if np.abs(numbers).max() > FARTHEST:
                unit = "m" if key == "xyz" else "rad"
                raise GainroomError(f"{owner}: origin {key} {origin.get(key)!r} must be >= -{FARTHEST:g} and <= {FARTHEST:g} {unit}")
        SubElement(result, "origin", {key: " ".join(map(repr, numbers)) for key, numbers in values.items()})

    def _add_limit(self, result: Element, limit: Element | None, owner: str) -> None:
        if limit is None and result.get("type") != "continuous":
            raise GainroomError(f"{owner}: does not specify limits: <limit> must give lower and upper")
        # Effort and velocity are nobody's here; the parser behind Pinocchio wants them.
        values = {key: self._numbers(limit, "limit", key, 1, owner, absent=0.0)[0] for key in ATTRIBUTES["limit"]}
        SubElement(result, "limit", {"effort": "1", "velocity": "1"} | {key: repr(value) for key, value in values.items()})

    def _add_dynamics(self, result: Element, dynamics: Element | None, owner: str) -> None:
        values = {key: self._numbers(dynamics, "dynamics", key, 1, owner, absent=0.0)[0] for key in ATTRIBUTES["dynamics"]}
        SubElement(result, "dynamics", damping=repr(values["damping"]))
        if values["friction"]:
            self.friction[result.get("name", "")] = values["friction"]

    def _require_tree(self, parents: dict[str, str], children: Sequence[str]) -> None:
        """Raises GainroomError unless every link but one is the child of exactly one joint, without a cycle."""
        source = self.source
        for link, count in Counter(children).items():
            if count > 1:
                raise GainroomError(f"{source}: link {link!r} is the child of {count} joints and must be of one")
        roots = [link for link in self.links if link not in parents]
        if len(roots) > 1:
            raise GainroomError(f"{source}: Two root links: {roots[0]!r} and {roots[1]!r}; all but one must be the child of a joint")
        if not self.links:
            raise GainroomError(f"{source}: No link in the file")
        hanging = set(roots)
        for link in self.links:
            way = []
            while link not in hanging and link not in way:
                way.append(link)
                link = parents[link]
            if link not in hanging:
                raise GainroomError(f"{source}: link {way[0]!r} does not hang on the root link: its joints form a loop")
            hanging.update(way)

    def _only(self, element: Element, tag: str, owner: str) -> Element | None:
        """Child element with this tag; None if there is none. Raises GainroomError if there are several, and as `_require_known`."""
        found = element.findall(tag)
        if len(found) > 1:
            raise GainroomError(f"{owner}: holds <{tag}> {len(found)} times and must hold it once")
        if not found:
            return None
        self._require_known(found[0], owner)
        return found[0]

    def _require_known(self, element: Element, owner: str) -> None:
        """Raises GainroomError for an unknown child or attribute that is nearly a known name, belongs elsewhere, or is in one of CLOSED."""
        given = (
            ("<{}>", CHILDREN.get(element.tag, ()), {child.tag for child in element}),
            ("attribute {}", ATTRIBUTES.get(element.tag, ()), set(element.attrib)),
        )
        for form, known, names in given:
            for name in sorted(names - set(known)):
                meant = typo_of(name, known)
                misplaced = form == "<{}>" and name in INSIDE and name != "origin"  # some give a link one, where it means nothing
                if (meant or misplaced or element.tag in CLOSED) and ":" not in name:
                    hint = f"; did you mean {form.format(meant)}?" if meant else f"; it belongs in <{INSIDE[name]}>" if misplaced else ""
                    raise GainroomError(f"{owner}: <{element.tag}> holds {form.format(name[:40])}, which does not count there{hint}")

    def _numbers(self, element: Element | None, tag: str, key: str, count: int, owner: str, absent: float | None = None) -> list[float]:
        """Finite numbers (`count`) of attribute `key`; each `absent` if it is missing, which raises GainroomError if `absent` is None."""
        text = None if element is None else element.get(key)
        if text is None and absent is not None:
            return [absent] * count
        if text is None:
            raise GainroomError(f"{owner}: <{tag}> {key} is missing")
        try:
            numbers = [float(word) for word in text.split()] if "_" not in text else []
        except ValueError:
            numbers = []
        if len(numbers) != count or not np.all(np.isfinite(numbers)):
            wanted = "a finite number" if count == 1 else f"{count} finite numbers"
            raise GainroomError(f"{owner}: {tag} {key} {one_line(repr(text), 60)} must be {wanted}")
        return numbers
