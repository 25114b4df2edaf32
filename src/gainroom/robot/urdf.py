"""URDF through Pinocchio. Only links and joints matter: meshes are never opened.

Pinocchio reads past some mistakes (a loop of joints, a joint that moves about no axis, an inertia that is no number): they are refused
here.
"""

import contextlib
import os
import re
import tempfile
from collections import Counter
from collections.abc import Iterator
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np

from ..errors import GainroomError
from ..messages import nearest, one_line
from .assemble import Description, floats
from .body import Base, library

MAX_LINKS = 2000
"""Pinocchio walks down a chain of links by recursion, and the stack ends at about 4000."""


def read_urdf(text: str, root: Element, source: str, base: Base | None = None) -> Description:
    """The robot that a URDF text with root element `root` describes; base None: fixed, unless the file itself has a floating joint.

    Raises GainroomError, one line that names the file.
    """
    pin = library("pinocchio", "Pinocchio")
    links = [link.get("name", "") for link in root.findall("link")]
    joints = root.findall("joint")
    _check(links, joints, root, source)
    model = _parse(pin, text, source)
    if base == "floating" and not floats(model):
        names = {joint.get("name") for joint in joints}
        # Pinocchio mixes two joints up that have one name.
        model = _parse(pin, text, source, pin.JointModelFreeFlyer(), "root_joint" if "root_joint" not in names else "floating base")
    _require_all(model, links, source, pin.FrameType.BODY)
    held = {joint.get("name", ""): f"mimics {mimic.get('joint')!r}" for joint in joints if (mimic := joint.find("mimic")) is not None}
    return Description(source, model, held)


def _check(links: list[str], joints: list[Element], root: Element, source: str) -> None:
    """Raise GainroomError on mistakes that Pinocchio reads past, or reports less well."""
    xacro = next((element.tag for element in root.iter() if element.tag.startswith("xacro:")), None)
    if xacro:
        raise GainroomError(f"{source}: holds <{xacro}>: expand it first, xacro FILE > robot.urdf")
    if len(links) > MAX_LINKS:
        raise GainroomError(f"{source}: has {len(links)} links and must have at most {MAX_LINKS}")
    children = Counter()
    for joint in joints:
        owner = f"{source}: joint {joint.get('name', '')!r}"
        for side in ("parent", "child"):
            element = joint.find(side)
            link = "" if element is None else element.get("link", "")
            if link not in links:
                raise GainroomError(f"{owner}: {side} link {link!r} is not in the file{nearest(link, links, 'link')}")
            children[link] += side == "child"
        axis = joint.find("axis")
        if joint.get("type") != "fixed" and axis is not None and not _is_direction(axis.get("xyz", "")):
            raise GainroomError(f"{owner}: axis {axis.get('xyz')!r} must be three numbers, not all zero")
    twice = [link for link, count in children.items() if count > 1]
    if twice:
        raise GainroomError(f"{source}: link {twice[0]!r} is the child of {children[twice[0]]} joints and must be of one")


def _is_direction(text: str) -> bool:
    try:
        numbers = [float(word) for word in text.split()]
    except ValueError:
        return False
    return len(numbers) == 3 and bool(np.all(np.isfinite(numbers))) and bool(np.linalg.norm(numbers) > 1e-9)


def _require_all(model: Any, links: list[str], source: str, body: Any) -> None:
    """Raise GainroomError where links were left out: joints in a loop hang on nothing."""
    read = {frame.name for frame in model.frames if frame.type == body}
    left = [link for link in links if link not in read]
    if left:
        raise GainroomError(f"{source}: link {left[0]!r} does not hang on the root link: its joints form a loop")


def _parse(pin: Any, text: str, source: str, *root_joint: Any) -> Any:
    """Pinocchio's model of a URDF text. What its parser finds wrong it says on standard error, and reads on where it can."""
    with _standard_error() as said:
        try:
            model = pin.buildModelFromXML(text, *root_joint)
            problem = ""
        except (ValueError, RuntimeError, LookupError, ArithmeticError) as error:
            model, problem = None, one_line(error)
    first = re.search(r"Error:\s*(.*)", said[0])
    if first or model is None:
        raise GainroomError(f"{source}: not a valid URDF: {one_line(first[1]) if first else problem}")
    return model


@contextlib.contextmanager
def _standard_error() -> Iterator[list[str]]:
    """Catch what compiled code writes to standard error; it is in the list at the end."""
    said = [""]
    with tempfile.TemporaryFile() as file:
        try:
            kept = os.dup(2)
        except OSError:  # closed, as in some services
            kept = None
        os.dup2(file.fileno(), 2)
        try:
            yield said
        finally:
            if kept is None:
                os.close(2)
            else:
                os.dup2(kept, 2)
                os.close(kept)
            file.seek(0)
            said[0] = file.read().decode("utf-8", "replace")
