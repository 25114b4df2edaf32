"""Figs. 12 and 14: the biped in MuJoCo moves its centre of mass 6 cm in x, y and z at once in 1 s, under PD and under P/PI.

Posture and control are those of the rest: Table I's start, the example's pelvis task, its actuators and drives, at 2 kHz; soles are the
feet's boxes. The paper does not print friction. It is set here, three numbers for the three errors that PD leaves (Fig. 12); P/PI is then
run on the same robot with nothing touched (Fig. 14).
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from ..robot.ground import Ground, Sole
from ..robot.tasks import Task
from ..simulation.robot_run import RobotRun, run_robot
from ..simulation.robot_setup import RobotSetup
from ..simulation.trajectories import Spline
from ..system.linear.arrays import Floats
from .biped import COM_KD, COM_KP, MOVE, NAMES, START, biped, on_both_feet
from .joints import SAMPLE_TIME
from .picture import Curve, Panel, Picture
from .row import Row, compare, same

WAIT, MOTION, REST = 0.5, 1.0, 2.0  # [s] standing still before; printed; standing still after
STEADY = 0.1  # [s] the end of REST that steady-state errors are taken over
CASCADE_KP, CASCADE_KV, CASCADE_KI = np.array([40.0, 20, 100]), np.array([1.0, 5, 5]), np.array([1.0, 0.1, 1.0])  # printed
COULOMB, ANKLE_COULOMB, VISCOUS = 4.5, 21.0, 10.0  # [N m], [N m] in the ankles' pitch, [N m s/rad]: set so that PD's errors come out
SOLE = Sole(length=0.28, width=0.15, center=(-0.008, 0.0))  # the feet's boxes
GROUND = Ground(friction=0.8, soles={"left_sole": SOLE, "right_sole": SOLE})
DIRECTIONS = "xyz"
LAWS = {"pd": ("Fig. 12", "PD"), "ppi": ("Fig. 14", "P/PI")}
PRINTED = {"pd": ("14.0", "5.1", "13.0"), "ppi": ("5.6", "2.9", "1.0")}  # [mm]
TOLERANCE = 1.0  # [mm]
LINK_TICKS = 20  # between those at which the centre of mass is worked out from the links
EVERY = 10  # ticks between points that are drawn
WHY = {
    "x": "The integrator's time constant Kv/Ki is 1 s: the remaining error depends on the time.",
    "y": "Kp Kv is 100 against PD's 90 and Kv/Ki is 50 s, so the same friction leaves nearly the same error.",
    "z": "Kp Kv is 2.5 times PD's gain.",
}


@dataclass(frozen=True)
class ComMotion:
    """Run of the motion: time (k,) [s] from its start, and reference and positions of the centre of mass (k, 3) [m]."""

    run: RobotRun
    time: Floats

    @property
    def error(self) -> Floats:
        """Reference minus measured position (k, 3), from encoders on the motor side, as the controller has it."""
        return self.run.error[:, :3]

    @property
    def steady(self) -> Floats:
        """Tracking error (3,) [m] at the end of the run."""
        return self.run.steady_error(STEADY)[:3]

    @property
    def steady_of_links(self) -> Floats:
        """Error (3,) at the end, from the true positions of the links."""
        last = self.run.rows(slice(-round(STEADY / SAMPLE_TIME), None, LINK_TICKS))
        return (last.reference - last.actual)[:, :3].mean(axis=0)

    def after(self, duration: float) -> Floats:
        """Error (3,) `duration` [s] after the end of the motion."""
        return self.error[np.argmin(np.abs(self.time - MOTION - duration))]


def setup(controller: str) -> RobotSetup:
    """The robot with the gains of "pd" or "ppi"."""
    spec = biped()
    robot, control = spec.source, spec.control
    (pelvis,) = (task for task in robot.stack if task.name == "pelvis")
    kp, kd, ki = (COM_KP, COM_KD, None) if controller == "pd" else (CASCADE_KP, CASCADE_KV, CASCADE_KI)
    com = Task(name="com", kind="com", kp=kp, kd=kd, ki=ki)
    ankles = np.array([name.endswith("ankle_pitch") for name in NAMES])
    return RobotSetup(
        body=robot.body,
        actuators=replace(robot.actuators, motor_viscous=np.full(len(NAMES), VISCOUS)),
        drives=spec.drives,
        control=replace(control, space="task", controller=None, sample_time=SAMPLE_TIME),
        q=on_both_feet(robot.body, START, 0.0),
        contacts=robot.contacts["double"],
        stack=(com, pelvis),
        coulomb=np.where(ankles, ANKLE_COULOMB, COULOMB),
        ground=GROUND,
    )


@cache
def motion(controller: str) -> ComMotion:
    """The run under "pd" or "ppi"."""
    ticks = round((WAIT + MOTION + REST) / SAMPLE_TIME)
    time = SAMPLE_TIME * np.arange(ticks) - WAIT
    offsets = np.zeros((ticks, 6))
    offsets[:, :3] = Spline.move(MOVE, MOTION).position(time)
    run = run_robot(setup(controller), offsets)
    return ComMotion(run, time[: len(run.time)])


def pd_rows() -> Iterator[Row]:
    """Errors at rest beside the paper's."""
    friction = f"Friction set for it: {COULOMB:g} N·m, ankle pitch {ANKLE_COULOMB:g}, {VISCOUS:g} N·m·s/rad."
    links = _links_left("pd")
    for direction, text, error, link in zip(DIRECTIONS, PRINTED["pd"], _left("pd"), links, strict=True):
        note = f"{friction} By the motors' encoders; by the links {link:.1f} mm."
        yield compare(f"fig12.{direction}.steady_error_mm", float(text), error, "mm", TOLERANCE, note, text)


def ppi_rows() -> Iterator[Row]:
    """Errors at rest beside the paper's, and that they are smaller than PD's."""
    early = 1e3 * np.abs(motion("ppi").after(1.0))
    for direction, text, error, before, link in zip(DIRECTIONS, PRINTED["ppi"], _left("ppi"), early, _links_left("ppi"), strict=True):
        note = f"Predicted with PD's friction; {before:.1f} mm one second earlier, {link:.1f} mm by the links. {WHY[direction]}"
        yield compare(f"fig14.{direction}.steady_error_mm", float(text), error, "mm", TOLERANCE, note, text)
    for direction, pd, ppi in zip(DIRECTIONS, _left("pd"), _left("ppi"), strict=True):
        yield same(f"fig14.{direction}.below_pd", True, ppi < pd, "The error at rest is smaller under P/PI than under PD.")


def pictures(controller: str) -> Iterator[Picture]:
    """Errors of the centre of mass over time."""
    found = motion(controller)
    time, error = found.time[::EVERY], 1e3 * found.error[::EVERY]
    most = 1.15 * max(1.0, float(np.abs(error).max()))
    curves = tuple(Curve(name, time, error[:, k]) for k, name in enumerate(DIRECTIONS))
    left = ", ".join(f"{name} {value:.3g}" for name, value in zip(DIRECTIONS, _left(controller), strict=True))
    caption = (
        f"The motion begins at 0 and ends at {MOTION:g} s. Errors at the end: {left} mm; printed: {', '.join(PRINTED[controller])} mm. "
        + ("Friction, not printed, is set for these." if controller == "pd" else "The robot of Fig. 12 with the same friction.")
    )
    figure, law = LAWS[controller]
    panel = Panel("error [mm]", (-most, most), curves)
    yield Picture(f"{figure}. Error of the centre of mass under {law}, in MuJoCo", caption, "time [s]", (-WAIT, MOTION + REST), (panel,))


def _left(controller: str) -> list[float]:
    """Errors at rest in x, y, z [mm]."""
    return (1e3 * np.abs(motion(controller).steady)).tolist()


def _links_left(controller: str) -> list[float]:
    """Errors at rest in x, y, z [mm], by the true positions of the links."""
    return (1e3 * np.abs(motion(controller).steady_of_links)).tolist()
