"""The picture of scheduled_biped.py: error of both runs over time, and gains as they are scheduled. Plain SVG, no plotting library."""

import numpy as np
from walking_plan import Plan
from walking_run import error_of, phases

from gainroom.design.realtime.scheduler import ScheduledGains
from gainroom.simulation.robot_run import RobotRun

WIDTH, LEFT, RIGHT, TOP, PANEL, GAP = 820, 74, 150, 44, 190, 46
COLOURS = {"single set": "#D55E00", "scheduled": "#0072B2"}
SHOWN = {"right_knee": "#009E73", "right_hip_roll": "#CC79A7"}
INK, SOFT, SHADE = "#1b1b1b", "#5a5a5a", "#F2F2F2"
STRIDE = 20

Walk = tuple[Plan, RobotRun, list[ScheduledGains]]


def drawn(walks: dict[str, Walk]) -> str:
    """The whole picture; runs by name."""
    plan = next(iter(walks.values()))[0]
    end, errors = float(plan.time[-1]), {}
    for name, (_, run, _) in walks.items():
        errors[name] = run.time[::STRIDE], 1e3 * np.sqrt(np.mean(error_of(run, plan) ** 2, axis=1))[::STRIDE]
    most = np.ceil(1.2 * max(float(values.max()) for _, values in errors.values()))
    upper = _Panel(TOP, end, 0.0, most, [(value, f"{value:g}") for value in np.arange(0, most + 1)])
    lower = _Panel(
        TOP + PANEL + GAP, end, 3.0, 4.4, [(np.log10(value), f"{value:,}".replace(",", "\u202f")) for value in (1000, 3000, 10000)]
    )
    _, run, history = walks["scheduled"]
    shapes = [*upper.frame(plan), *lower.frame(plan), _text(LEFT, 16, "Two slow steps of the biped, friction in the motors", INK, 14)]
    shapes.append(_text(LEFT, TOP - 8, "error of the links, rms over the joints [mrad]", SOFT))
    for place, (name, (time, values)) in zip((0.85, 0.7), errors.items(), strict=True):
        shapes += [upper.line(time, values, COLOURS[name]), upper.label(end, place * most, name, COLOURS[name])]
    shapes.append(_text(LEFT, lower.top - 8, "scheduled kp [N·m/rad]", SOFT))
    for joint, colour in SHOWN.items():
        k = run.joint_names.index(joint)
        values = np.log10([one.kp[k] for one in history[::STRIDE]])
        shapes += [lower.line(run.time[::STRIDE], values, colour), lower.label(end, values[-1], joint.replace("_", " "), colour)]
    height = lower.top + PANEL + 44
    shapes.append(_text(LEFT, height - 8, "time [s]; above each part: the feet that stand", SOFT))
    head = f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {height}" font-family="sans-serif" font-size="12">'
    return "\n".join([head, f'<rect width="{WIDTH}" height="{height}" fill="white"/>', *shapes, "</svg>\n"])


class _Panel:
    """One pair of axes over the whole time."""

    def __init__(self, top: float, end: float, low: float, high: float, ticks: list[tuple[float, str]]):
        self.top, self._end, self._low, self._high, self._ticks = top, end, low, high, ticks

    def _x(self, time: np.ndarray | float) -> np.ndarray | float:
        return LEFT + (WIDTH - LEFT - RIGHT) * time / self._end

    def _y(self, value: np.ndarray | float) -> np.ndarray | float:
        return self.top + PANEL * (self._high - value) / (self._high - self._low)

    def frame(self, plan: Plan) -> list[str]:
        """Axes, and single support shaded."""
        found = []
        for name, rows in phases(plan, len(plan.time)):
            first, last = (self._x(float(plan.time[k])) for k in (rows.start, rows.stop - 1))
            if name != "double":
                found.append(f'<rect x="{first:.1f}" y="{self.top}" width="{last - first:.1f}" height="{PANEL}" fill="{SHADE}"/>')
            found.append(_text((first + last) / 2, self.top + 14, name, SOFT, anchor="middle"))
        for value, text in self._ticks:
            found.append(f'<line x1="{LEFT}" x2="{WIDTH - RIGHT}" y1="{self._y(value):.1f}" y2="{self._y(value):.1f}" stroke="#DDDDDD"/>')
            found.append(_text(LEFT - 8, self._y(value) + 4, text, SOFT, anchor="end"))
        for second in range(int(self._end) + 1):
            found.append(_text(self._x(second), self.top + PANEL + 16, str(second), SOFT, anchor="middle"))
        return found

    def line(self, time: np.ndarray, values: np.ndarray, colour: str) -> str:
        """A curve."""
        points = " ".join(f"{x:.1f},{y:.1f}" for x, y in zip(self._x(time), self._y(values), strict=True))
        return f'<polyline points="{points}" fill="none" stroke="{colour}" stroke-width="1.8"/>'

    def label(self, time: float, value: float, text: str, colour: str) -> str:
        """A curve's name, beside its end."""
        return _text(self._x(time) + 8, self._y(value) + 4, text, colour)


def _text(x: float, y: float, text: str, colour: str, size: int = 12, anchor: str = "start") -> str:
    return f'<text x="{x:.1f}" y="{y:.1f}" fill="{colour}" font-size="{size}" text-anchor="{anchor}">{text}</text>'
