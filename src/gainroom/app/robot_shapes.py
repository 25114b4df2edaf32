"""Shapes of a robot for the page, and the motion of its parts in a mode; meshes are sent as bare triangles, never as files."""

import contextlib
import math
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np

from ..errors import GainroomError
from ..io.guarded_child import Answer, GuardedChild, guarded_child
from ..robot.body import RigidBody
from ..robot.contact import free_motion
from ..robot.formats.xml_text import read_xml
from ..robot.model import RobotModel
from ..simulation.robot_run import RobotRun
from ..system.linear.arrays import Complexes, Floats
from .bench import rounded

MOST_BYTES = 30 << 20
"""Maximum size of a mesh file [bytes]."""
MOST_CORNERS, MOST_SHAPES = 60_000, 400
MOST_FILES = 50
"""Maximum number of files that an MJCF includes."""
MESHES = (".stl", ".obj", ".dae")
PACKAGE_DEPTH = 4
"""Number of folders above the model in which a package is searched."""
PICTURES = 150
"""Maximum number of pictures of a run."""
SMALL = 1e-4
"""Scale of the mode with which the robot is moved for its derivative."""


@dataclass(frozen=True)
class Shape:
    """Shape: one piece of a link.

    frame   of the body that it is fixed to, and `place` (4, 4) in it
    kind    box, sphere, cylinder, capsule or mesh; `size` its edges, radius, or radius and length along z [m]
    corners, faces   of a mesh: (k, 3), (m, 3)
    """

    frame: str
    kind: str
    place: Floats
    size: tuple[float, ...] = ()
    corners: Floats | None = None
    faces: Any = None

    def packed(self) -> bytes:
        """Packed counts, corners and faces, little-endian."""
        assert self.corners is not None
        head = struct.pack("<II", len(self.corners), len(self.faces))
        return head + np.ascontiguousarray(self.corners, "<f4").tobytes() + np.ascontiguousarray(self.faces, "<u4").tobytes()


def shapes_of(body: RigidBody) -> tuple[Shape, ...]:
    """Shapes of a URDF or MJCF; empty if it has none, or they cannot be read: then the page draws its own."""
    path = Path(body.source)
    with contextlib.suppress(GainroomError, OSError, ValueError, RuntimeError):
        root = read_xml(path)
        with guarded_child(path, "a robot with shapes", f"{__package__}.shape_files") as child:
            found = _of_urdf(root, path, child) if root.tag == "robot" else _of_mjcf(root, path, child)
        return tuple(shape for shape in found if shape.frame in body.frames)[:MOST_SHAPES]
    return ()


def _of_urdf(root: Element, path: Path, child: GuardedChild) -> list[Shape]:
    found, meshes = [], {}
    for link in root.findall("link"):
        for visual in link.findall("visual"):
            geometry, origin = visual.find("geometry"), visual.find("origin")
            if geometry is None or not len(geometry):
                continue
            form, place = geometry[0], _placed(origin)
            if form.tag == "mesh":
                scale = tuple(_numbers(form.get("scale", "1 1 1"), 3))
                key = form.get("filename", ""), scale
                if key not in meshes:
                    meshes[key] = _mesh(child, mesh_file(path, key[0]), scale)
                if meshes[key] is not None:
                    found.append(Shape(link.get("name", ""), "mesh", place, (), *meshes[key]))
            elif form.tag == "box":
                found.append(Shape(link.get("name", ""), "box", place, tuple(_numbers(form.get("size", ""), 3))))
            elif form.tag == "sphere":
                found.append(Shape(link.get("name", ""), "sphere", place, tuple(_numbers(form.get("radius", ""), 1))))
            elif form.tag in ("cylinder", "capsule"):
                found.append(
                    Shape(
                        link.get("name", ""), form.tag, place, (*_numbers(form.get("radius", ""), 1), *_numbers(form.get("length", ""), 1))
                    )
                )
    return found


def _numbers(text: str, count: int) -> list[float]:
    values = [float(word) for word in text.split()]
    if len(values) != count or not all(math.isfinite(value) and abs(value) < 1e3 for value in values):
        raise ValueError(text)
    return values


def _placed(origin: Element | None) -> Floats:
    """Placement (4, 4) of an <origin>: fixed axes x, y, z."""
    place = np.eye(4)
    if origin is not None:
        place[:3, 3] = _numbers(origin.get("xyz", "0 0 0"), 3)
        roll, pitch, yaw = _numbers(origin.get("rpy", "0 0 0"), 3)
        (ca, sa), (cb, sb), (cc, sc) = ((math.cos(each), math.sin(each)) for each in (yaw, pitch, roll))
        place[:3, :3] = [
            [ca * cb, ca * sb * sc - sa * cc, ca * sb * cc + sa * sc],
            [sa * cb, sa * sb * sc + ca * cc, sa * sb * cc - ca * sc],
            [-sb, cb * sc, cb * cc],
        ]
    return place


def mesh_file(path: Path, name: str) -> Path | None:
    """File of a mesh that the model at `path` names, in the model's folder or in the package around it; else None."""
    home = path.parent.resolve()
    if name.startswith("package://"):
        package, _, inner = name.removeprefix("package://").partition("/")
        roots = [folder for folder in [home, *home.parents][:PACKAGE_DEPTH] if folder.name == package and package not in ("", ".", "..")]
    else:
        inner, roots = name.removeprefix("file://"), [home]
    for root in roots:
        with contextlib.suppress(OSError, RuntimeError, ValueError):
            target = (root / inner).resolve()
            sound = target.is_relative_to(root) and target.suffix.lower() in MESHES and target.is_file()
            if sound and target.stat().st_size <= MOST_BYTES:
                return target
    return None


def _mesh(child: GuardedChild, file: Path | None, scale: tuple[float, ...]) -> tuple[Floats, Any] | None:
    """Corners and faces of a mesh; None if there is no such file, the child cannot read it, or it is too large."""
    if file is None:
        return None
    with contextlib.suppress(GainroomError):
        return _triangles(child.ask([str(file), *scale]))
    return None


def _triangles(answer: Answer) -> tuple[Floats, Any] | None:
    """Corners (k, 3) and faces (m, 3) that the child has sent; None of too many."""
    count, numbers = answer[0]["corners"], answer[1]
    if numbers is None or not 0 < count <= MOST_CORNERS or not np.all(np.isfinite(numbers)):
        return None
    return numbers[: 3 * count].reshape(-1, 3), numbers[3 * count :].reshape(-1, 3).astype(int)


def _is_all_inside(root: Element, path: Path) -> bool:
    """True if every file that an MJCF names, and those that it includes, lies in the model's folder after following links.

    Raises GainroomError where an included file cannot be read.
    """
    home, known, waiting = path.parent.resolve(), {path.resolve()}, [root]
    folders, names = {""}, set[str]()
    while waiting:
        for element in waiting.pop().iter():
            if element.tag in ("plugin", "attach", "model"):
                return False
            folders |= {element.get(key, "") for key in ("meshdir", "texturedir", "assetdir")}
            names |= {text for key, text in element.attrib.items() if key.startswith("file") or key == "content_type"}
            if element.tag == "include":
                further = (home / element.get("file", "")).resolve()
                if not further.is_relative_to(home) or len(known) > MOST_FILES:
                    return False
                if further not in known:
                    known.add(further)
                    waiting.append(read_xml(further))
    return all((home / folder / name).resolve().is_relative_to(home) for folder in folders for name in {"", *names})


def _of_mjcf(root: Element, path: Path, child: GuardedChild) -> list[Shape]:
    """Shapes of an MJCF compiled by MuJoCo; empty unless every file that it names lies in the model's folder."""
    if not _is_all_inside(root, path):
        return []
    found, meshes = [], {}
    for frame, kind, place, size in child.ask("shapes")[0]["shapes"]:
        if kind != "mesh":
            found.append(Shape(frame, kind, np.array(place), tuple(size)))
            continue
        if size not in meshes:
            meshes[size] = _triangles(child.ask(size))
        if meshes[size] is not None:
            found.append(Shape(frame, kind, np.array(place), (), *meshes[size]))
    return found


def described(shapes: tuple[Shape, ...]) -> list[dict[str, Any]]:
    """Shapes for the page; meshes are given by their index."""
    return [
        {"frame": shape.frame, "kind": shape.kind, "size": shape.size, "place": rounded(shape.place[:3].ravel().tolist(), 6)}
        for shape in shapes
    ]


def pose(model: RobotModel, shapes: tuple[Shape, ...], mode: Complexes | None) -> dict[str, Any]:
    """Positions of joints and frames, and their motion in the mode, position + Re(moves e^{jωt}); contacts carry all else along."""
    body, q = model.body, model.q
    frames = sorted({shape.frame for shape in shapes})
    skeleton = body.skeleton(q)
    rest = _snapshot(body, q, frames)
    part: dict[str, Any] = {
        "nodes": {"names": skeleton.names, "parents": skeleton.parents, "joints": skeleton.joints},
        "frames": frames,
        "drives": [_joint_of(body, frame) for frame in frames],
        "rest": [rounded(each.ravel().tolist()) for each in rest],
        "contacts": [
            {"name": one.frame, "kind": one.kind, "at": rounded(place.tolist()), "axes": rounded(axes.ravel().tolist())}
            for one in model.contacts
            for axes, place in [body.frame_placement(q, one.frame)]
        ],
        "fixed": body.base == "fixed",
    }
    if mode is None:
        return part
    held = model.contact_jacobian[model.rigid] if len(model.contact_jacobian) else model.contact_jacobian
    motion = free_motion(model.inertia, held)
    follow = motion @ np.linalg.pinv(motion[body.nv - body.size :])
    moves = {}
    for name, values in (("re", mode.real), ("im", mode.imag)):
        twist = follow @ values
        moved = _snapshot(body, body.integrate(q, SMALL * twist), frames)
        moves[name] = [rounded(((after - before) / SMALL).ravel().tolist()) for after, before in zip(moved, rest, strict=True)]
    return part | moves


def film(run: RobotRun, shapes: tuple[Shape, ...]) -> dict[str, Any]:
    """Positions of joints and frames at the start of a run, as `rest` of a pose, and their displacements at PICTURES moments of it.

    Displacements are separate so that small motions keep their digits and can be drawn enlarged.
    """
    frames = sorted({shape.frame for shape in shapes})
    rows = np.unique(np.linspace(0, len(run.time) - 1, PICTURES).astype(int)).tolist()
    start, *later = [_snapshot(run.setup.body, run.posture(row), frames) for row in rows]
    moved = [[rounded(there - here, 4) for there, here in zip(each, start, strict=True)] for each in (start, *later)]
    return {"ms": rounded(1e3 * run.time[rows]), "start": [rounded(each, 6) for each in start], "moved": moved}


def _joint_of(body: RigidBody, frame: str) -> int:
    """Index of the joint that moves a frame; −1 for the base's frames, and if that joint is locked."""
    name = body.model.names[body.model.frames[body.frame_index(frame)].parentJoint]
    return body.joint_names.index(name) if name in body.joint_names else -1


def _snapshot(body: RigidBody, q: Floats, frames: list[str]) -> list[Floats]:
    """Points of the skeleton (k, 3), then every frame (3, 4)."""
    positions = body.skeleton(q).positions
    return [positions, *(np.hstack([axes, place[:, None]]) for axes, place in body.frame_placements(q, frames))]
