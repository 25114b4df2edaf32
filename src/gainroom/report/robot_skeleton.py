"""Robot skeleton seen from its right and from the front, joints coloured by participation factors."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ..analysis.margin_record import GainLimit
from ..robot.model import RobotModel
from ..studies.state import State, limiting_joints
from ..system.linear.arrays import Floats, Integers
from . import style
from .number_format import digits

DEPTH = 0.5 * np.array([math.cos(math.pi / 6), math.sin(math.pi / 6)])  # cabinet projection: what is farther stands higher, at half scale
SAME_PLACE = 0.015  # relative to the robot's size: joints closer than this are drawn around one point
NEAR, FAR = "#7d7d7d", "#bdbdbd"  # links
GHOST = "#b9dcf2"  # links in another posture
SMALLEST_PART = 0.05  # participation factors below it get no angle
LINE = 17  # [px] a line of text is high
NAMES_BETWEEN = 0.72  # relative to the robot's size: a gap between the two views that holds names
Projection = Callable[[Floats], Floats]


@dataclass(frozen=True)
class DrawingView:
    """Side and front view in one plane, equal for every state. The front view is moved to the right by `shift`.

    low, high   (2,) corners of the whole drawing [m]
    """

    low: Floats
    high: Floats
    shift: float
    size: float

    def side(self, points: Floats) -> Floats:
        """Projection (k, 2) of points (k, 3) seen from the robot's right, forward to the right."""
        return points[:, [0, 2]] + points[:, [1]] * DEPTH

    def front(self, points: Floats) -> Floats:
        """Projection (k, 2) of points (k, 3) seen from the front, the robot's left on the right."""
        return points[:, [1, 2]] - points[:, [0]] * DEPTH + np.array([self.shift, 0.0])


def common_view(states: Sequence[State], gap: float = 0.3) -> DrawingView:
    """View that holds the robot in each of `states`, with `gap` of its size between the two projections."""
    return view_of([state.model for state in states], gap)


def view_of(models: Sequence[RobotModel], gap: float = 0.3) -> DrawingView:
    """View that holds each of `models`, with `gap` of the robot's size between the two projections."""
    nodes = np.vstack([_outline(model) for model in models])
    size = float(np.ptp(nodes, axis=0).max()) or 1.0
    bare = DrawingView(np.zeros(2), np.zeros(2), 0.0, size)
    side, front = bare.side(nodes), bare.front(nodes)
    shift = float(side[:, 0].max() - front[:, 0].min()) + gap * size
    both = np.vstack([side, front + np.array([shift, 0.0])])
    low, high = np.array([0.1, 0.18]), np.array([0.7 * gap - 0.1, 0.06])  # space for labels
    return DrawingView(both.min(axis=0) - low * size, both.max(axis=0) + high * size, shift, size)


def vibration(limit: GainLimit) -> Floats | None:
    """Participation factor (n,) of each joint in the vibration at the limit; None without one."""
    return np.abs(limit.mode) if math.isfinite(limit.frequency) else None


def participation_text(part: complex) -> str:
    """Participation factor of a joint, and its phase lag behind the strongest, as text."""
    angle = round(math.degrees(-np.angle(part))) % 360
    lag = f", {angle}°" if abs(part) >= SMALLEST_PART else ""
    return f"{100 * abs(part):.0f} %{lag}"


def _outline(model: RobotModel) -> Floats:
    """Points (k, 3) that must be in the picture."""
    body, q = model.body, model.q
    return np.vstack([body.skeleton(q).positions, body.com(q), *(body.frame_placement(q, one.frame)[1] for one in model.contacts)])


def drawn(model: RobotModel, limit: GainLimit, view: DrawingView, size: int) -> tuple[list[style.Trace], list[style.Annotation]]:
    """Traces and labels of links, contacts, joints, centre of mass and a scale."""
    points = model.body.skeleton(model.q).positions
    traces: list[style.Trace] = []
    for project, depth in ((view.side, points[:, 1]), (view.front, -points[:, 0])):
        traces += _contacts(model, view, project)
        traces += _links(model, project(points), depth, view)
        traces += _joints(model, limit, project(points), depth, size, view)
        traces.append(_centre(model, project))
    return [*traces, _scale(view)], _names(model, limit, view)


def _links(model: RobotModel, plane: Floats, depth: Floats, view: DrawingView) -> list[style.Trace]:
    """Lines from every node to its parent, the farther half first and lighter; a stand on a fixed base is dashed."""
    parents, held = model.body.skeleton(model.q).parents, [(k, 0) for k in stand(model)]
    ends = [(k, int(parent)) for k, parent in enumerate(parents) if parent >= 0 and (k, 0) not in held]
    middle = 0.5 * (depth.min() + depth.max())
    flat = np.ptp(depth) < 0.15 * view.size
    traces = [_between(plane, held, FAR, 2, "dash")] if held else []
    for color, far in ((FAR, True), (NEAR, False)):
        drawn = [(a, b) for a, b in ends if bool(not flat and depth[a] + depth[b] > 2 * middle + 1e-9) == far]
        if drawn:
            traces.append(_between(plane, drawn, color, 5))
    return traces


def stand(model: RobotModel) -> list[int]:
    """Indices of nodes held at a distance by a fixed base, as on a stand."""
    if model.body.base != "fixed":
        return []
    skeleton = model.body.skeleton(model.q)
    away = np.linalg.norm(skeleton.positions - skeleton.positions[0], axis=1) > SAME_PLACE * float(np.ptp(skeleton.positions, axis=0).max())
    return [k for k, parent in enumerate(skeleton.parents) if parent == 0 and away[k]]


def _between(plane: Floats, ends: Sequence[tuple[int, int]], color: str, width: float, dash: str = "solid") -> style.Trace:
    """Lines between pairs of nodes."""
    x, y = ([value for a, b in ends for value in (plane[a, axis], plane[b, axis], None)] for axis in (0, 1))
    return style.line(x, y, color, dash=dash, width=width)


def ghost(model: RobotModel, view: DrawingView) -> list[style.Trace]:
    """Links of another posture, faint, to be drawn first."""
    skeleton = model.body.skeleton(model.q)
    ends = [(k, int(parent)) for k, parent in enumerate(skeleton.parents) if parent >= 0]
    return [_between(project(skeleton.positions), ends, GHOST, 4) for project in (view.side, view.front)]


def path(points: Floats, view: DrawingView) -> list[style.Trace]:
    """Path of a point (k, 3) [m] in both views."""
    planes = (project(points) for project in (view.side, view.front))
    return [style.line(plane[:, 0], plane[:, 1], style.BLUE, width=2.5) for plane in planes]


def _joints(model: RobotModel, limit: GainLimit, plane: Floats, depth: Floats, size: int, view: DrawingView) -> list[style.Trace]:
    """Joints as discs, coincident ones as rings; base, locked joints and ends of chains are small and grey."""
    skeleton, parts, mode = model.body.skeleton(model.q), vibration(limit), limit.mode
    rings = _rings(skeleton.positions, skeleton.joints, view.size)
    order = sorted(range(len(plane)), key=lambda k: (-round(float(depth[k]) / view.size, 2), -rings[k], k))
    moving = [k for k in order if skeleton.joints[k] >= 0]
    immobile = [k for k in order if skeleton.joints[k] < 0]
    text = [style.shown(skeleton.names[k]) + ("" if parts is None else f": {participation_text(mode[skeleton.joints[k]])}") for k in moving]
    discs = style.markers(plane[moving, 0], plane[moving, 1], "circle", "white", hoverinfo="text", text=text, cliponaxis=False)
    discs["marker"] |= {
        "size": [size * (1 + 0.62 * rings[k]) for k in moving],
        "color": "white" if parts is None else [float(parts[skeleton.joints[k]]) for k in moving],
        "coloraxis": "coloraxis",
        "opacity": 1,
        "line": {"color": "#4a4a4a", "width": 1.2},
    }
    names = [style.shown(skeleton.names[k]) for k in immobile]
    held = style.markers(plane[immobile, 0], plane[immobile, 1], "circle", NEAR, hoverinfo="text", text=names, cliponaxis=False)
    held["marker"] |= {
        "size": [0.75 * size if k == 0 else 0.4 * size for k in immobile],
        "symbol": ["square" if k == 0 else "circle" for k in immobile],
        "opacity": 1,
        "line": {"width": 0},
    }
    return [held, discs]


def _rings(positions: Floats, joints: Integers, size: float) -> list[int]:
    """Number of joints further down the chain at the place of each joint."""
    moving = [k for k in range(len(positions)) if joints[k] >= 0]
    close = {k: [j for j in moving if np.linalg.norm(positions[j] - positions[k]) < SAME_PLACE * size] for k in moving}
    return [sum(j > k for j in close[k]) if k in close else 0 for k in range(len(positions))]


def _contacts(model: RobotModel, view: DrawingView, project: Projection) -> list[style.Trace]:
    """Patches under contacts: flat, line or point, not to scale; and one under a fixed base."""
    body, q = model.body, model.q
    half = 0.075 * view.size
    marks = []
    for contact in model.contacts:
        axes, place = body.frame_placement(q, contact.frame)
        long, across = {"flat": (half, 0.6 * half), "line": (0.12 * half, half), "point": (0.25 * half, 0.25 * half)}[contact.kind]
        kind = f"{contact.kind} contact" + ("" if contact.stiffness is None else ", on springs")
        marks.append((place, axes[:, 0] * long, axes[:, 1] * across, f"{style.shown(contact.frame)}: {kind}"))
    if body.base == "fixed":
        marks.append((body.skeleton(q).positions[0], np.array([half, 0, 0]), np.array([0, half, 0]), "fixed base"))
    traces = []
    for place, long, across, text in marks:
        corners = project(np.array([place + a * long + b * across for a, b in ((1, 1), (1, -1), (-1, -1), (-1, 1), (1, 1))]))
        patch = {"fill": "toself", "fillcolor": "#2b2b2b", "hoveron": "fills", "hoverinfo": "text", "text": text}
        traces.append(style.line(corners[:, 0], corners[:, 1], "#2b2b2b", width=3, **patch))
    return traces


def _centre(model: RobotModel, project: Projection) -> style.Trace:
    plane = project(model.body.com(model.q)[None])
    return style.markers(plane[:, 0], plane[:, 1], "circle-cross-open", style.BLUE, 13, hoverinfo="text", text="centre of mass")


def _scale(view: DrawingView) -> style.Trace:
    """Scale bar of a round length at the foot of the picture."""
    length = _round_length(0.35 * view.size)
    x, y = view.low[0] + 0.04 * view.size, view.low[1] + 0.05 * view.size
    bar = style.line([x, x + length], [y, y], style.SOFT, width=2, mode="lines+text", text=["", f"  {digits(length, 'm')}"])
    return bar | {"textposition": "middle right", "textfont": {"color": style.SOFT, "size": style.TEXT}}


def _round_length(length: float) -> float:
    decade = 10.0 ** math.floor(math.log10(length))
    return decade * max(step for step in (1, 2, 5) if step * decade <= length)


def _names(model: RobotModel, limit: GainLimit, view: DrawingView) -> list[style.Annotation]:
    """Labels of the two views, with a note if nothing touches the ground, or if the state is unstable."""
    middle = view.side(_outline(model))[:, 0], view.front(_outline(model))[:, 0]
    notes = []
    flies = not model.contacts and model.body.base == "floating"
    for across, name in zip(middle, ("from its right", "from the front" + ", no contact" * flies), strict=True):
        x = 0.5 * float(across.min() + across.max())
        notes.append(style.label(x, 1, name, style.SOFT, yref="y domain", yanchor="bottom", bgcolor="rgba(0,0,0,0)"))
    if not limit.stable:
        notes.append(style.stamp("UNSTABLE"))
    return notes


def labels(model: RobotModel, limit: GainLimit, view: DrawingView, scale: float) -> list[style.Annotation]:
    """Names of the limiting joints beside the front view, left ones to the right, without overlap. `scale` [px/m]."""
    skeleton = model.body.skeleton(model.q)
    plane = view.front(skeleton.positions)
    strong = set(limiting_joints(limit, model.joint_names)[:8])
    nodes = [k for k, joint in enumerate(skeleton.joints) if joint >= 0 and model.joint_names[joint] in strong]
    middle = 0.5 * float(plane[:, 0].min() + plane[:, 0].max())
    notes = []
    for right in (True, False):
        way = -1 if right else 1  # of joints at one height the outer one first: the others' lines would cross its disc
        own = sorted(
            (k for k in nodes if bool(plane[k, 0] >= middle) == right),
            key=lambda k: (-round(plane[k, 1] * scale / LINE), way * plane[k, 0]),
        )
        edge = (plane[:, 0].max() if right else plane[:, 0].min()) + (0.06 if right else -0.06) * view.size
        last = math.inf
        for k in own:
            last = min(float(plane[k, 1]), last - LINE / scale)
            side = {"xanchor": "left" if right else "right", "axref": "x", "ayref": "y", "showarrow": True, "name": "wide"}
            line = {"arrowhead": 0, "arrowwidth": 1, "arrowcolor": "#8a8a8a", "ax": edge, "ay": last}
            note = style.label(float(plane[k, 0]), float(plane[k, 1]), style.shown(skeleton.names[k]), style.INK, **side, **line)
            notes.append(note)
    return notes
