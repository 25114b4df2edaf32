"""Shapes in an MJCF and triangles in mesh files, read by MuJoCo and Assimp in a guarded child that robot_shapes starts.

A request is "shapes", answered by all that the MJCF draws (of a mesh its number); the number of such a mesh; or [file, scale x, y, z] of a
mesh file. Meshes are answered by the number of their corners, and corners and faces one behind the other.
"""

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import GainroomError
from ..io.guarded_child import Answer, Array, Handler
from ..robot.formats.mjcf_compiler import loaded
from ..robot.formats.mujoco_messages import mujoco_warnings

KINDS = {2: "sphere", 3: "capsule", 4: "sphere", 5: "cylinder", 6: "box", 7: "mesh"}
"""By MuJoCo's mjtGeom."""
MOST_GROUP = 2
"""Of MuJoCo's groups of geoms, those that its viewer shows at first."""


@contextlib.contextmanager
def opened(path: Path) -> Iterator[tuple[dict[str, Any], Handler]]:
    """Answers to the requests above. Raises GainroomError where MuJoCo or Assimp is not installed."""
    models: list[Any] = []

    def answer(request: Any) -> Answer:
        if isinstance(request, list):
            return _packed(*_mesh_in(request[0], request[1:]))
        if request != "shapes":
            return _packed(*_mesh_of(models[0], request))
        mujoco = loaded()
        with mujoco_warnings(mujoco):
            models.append(mujoco.MjModel.from_xml_path(str(path)))
        return {"shapes": _shapes(models[0])}, None

    yield {}, answer


def _packed(corners: Array, faces: Array) -> Answer:
    return {"corners": len(corners)}, np.concatenate([corners.ravel(), faces.ravel()]).astype(float)


def _shapes(model: Any) -> list[list[Any]]:
    """[frame, kind, placement (4, 4), size; of a mesh its number] of each geom drawn: those without contact where there are such."""
    pictures = [k for k in range(model.ngeom) if not model.geom_contype[k] and not model.geom_conaffinity[k]]
    found = []
    for k in pictures or range(model.ngeom):
        kind = KINDS.get(int(model.geom_type[k]))
        if not model.geom_bodyid[k] or model.geom_group[k] > MOST_GROUP or kind is None:
            continue
        place = np.eye(4)
        w, x, y, z = model.geom_quat[k]
        place[:3, :3] = [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
        place[:3, 3] = model.geom_pos[k]
        a, b, c = model.geom_size[k].tolist()
        size = {"sphere": (a,), "box": (2 * a, 2 * b, 2 * c), "mesh": int(model.geom_dataid[k])}.get(kind, (a, 2 * b))
        found.append([model.body(int(model.geom_bodyid[k])).name, kind, place.tolist(), size])
    return found


def _mesh_of(model: Any, number: int) -> tuple[Array, Array]:
    corner, face = model.mesh_vertadr[number], model.mesh_faceadr[number]
    return (
        np.asarray(model.mesh_vert[corner : corner + model.mesh_vertnum[number]]),
        np.asarray(model.mesh_face[face : face + model.mesh_facenum[number]]),
    )


def _mesh_in(file: str, scale: list[float]) -> tuple[Array, Array]:
    """Corners and faces of a mesh file; none where it is no mesh. Raises GainroomError."""
    try:
        import coal  # pyright: ignore[reportMissingImports] - of Pinocchio, with Assimp
    except ImportError as error:
        raise GainroomError(f"{file}: meshes need Pinocchio's coal: {error}") from error
    try:
        mesh = coal.MeshLoader().load(file, np.array(scale))
    except (ValueError, RuntimeError):  # this one is not drawn, and others are
        return np.zeros((0, 3)), np.zeros((0, 3))
    order = range(3) if np.prod(scale) > 0 else (2, 1, 0)  # mirrored, a triangle is seen from behind
    faces = np.array([[triangle[k] for k in order] for triangle in (mesh.tri_indices(k) for k in range(mesh.num_tris))])
    return np.asarray(mesh.vertices()), faces
