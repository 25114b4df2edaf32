"""The biped of scheduled_biped.py in MuJoCo: its controller with scheduled gains, a run of the plan, and what is measured of it."""

from collections.abc import Mapping
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import yaml
from walking_plan import Plan, posture, two_steps

from gainroom.analysis.margin_record import Margins
from gainroom.analysis.margins import joint_margins
from gainroom.design.realtime.scheduler import GainScheduler, GainTable, ScheduledGains, Tracker
from gainroom.design.realtime.tracker import GainTracker
from gainroom.files.robot_yaml import load_robot, load_robot_system
from gainroom.robot.ground import Ground, Sole
from gainroom.robot.linearize import linearize
from gainroom.simulation.robot_run import RobotRun, RobotStepper
from gainroom.simulation.robot_setup import RobotSetup
from gainroom.simulation.run_record import joined
from gainroom.studies.oscillation import Oscillation, oscillation_in
from gainroom.system.controller import PD
from gainroom.system.loop import Loop
from gainroom.system.system import System

HERE = Path(__file__).parent
COULOMB, OF_ANKLES, VISCOUS = 4.5, 21.0, 10.0
"""Friction of the motors [N m], [N m s/rad], and of those of the ankle pitch: of `gainroom example biped-simulated`."""
BLOCK = 200
EVERY = 100
"""Ticks between two looks at the margins."""
EARLY_OR_LATE = 0.04
"""So much earlier or later than planned a foot may lift or land [s]: the margins of both contact states are looked at then."""


def loop(system: System, q: np.ndarray, contact: str, gains: np.ndarray, weight: bool = False) -> Loop:
    """The loop with gains (2, n) in posture `q`."""
    source = system.source
    return system.loop(linearize(source.body, source.actuators, q, source.contacts[contact], weight), PD(gains[0], gains[1]))


class Controller:
    """What runs at each tick, in place of the simulation's own controller: the plan, and torques with scheduled gains."""

    def __init__(self, system: System, plan: Plan, scheduler: GainScheduler):
        self.channels, self._body, self._plan, self._scheduler = system.source.joint_names, system.source.body, plan, scheduler
        # The encoders are in front of the gearboxes, which the load winds up.
        self._reference = plan.joints + plan.holding / system.source.actuators.stiffness
        self._tick, self._before, self._dt = 0, None, system.control.sample_time
        self.history: list[ScheduledGains] = []

    def tick(self, positions: np.ndarray, offset: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Torques, reference and measured value (n,) on the encoders' `positions` (n,); `offset` is not used."""
        k, plan = self._tick, self._plan
        error = self._reference[k] - positions
        rate = (error - (error if self._before is None else self._before)) / self._dt
        self.history.append(self._scheduler.update(posture(self._body, plan.base[k], positions), plan.contact[k], self._dt))
        self._tick, self._before = k + 1, error
        return self._scheduler.torque(error, rate, plan.holding[k]), self._reference[k], positions


def biped() -> System:
    """The robot at 2 kHz."""
    return load_robot_system(HERE / "scheduled_biped.yaml")


def tables() -> dict[str, GainTable]:
    """Gains: "scheduled" by contact state, "single" the same everywhere."""
    own = {name: (one["kp"], one["kd"]) for name, one in yaml.safe_load((HERE / "scheduled_gains.yaml").read_text("utf-8")).items()}
    safe = own.pop("everywhere")
    return {"single set": GainTable.of(dict.fromkeys(own, safe), safe), "scheduled": GainTable.of(own, safe)}


def plan_of(system: System, pace: float = 1.0) -> Plan:
    """The two steps from the file's posture."""
    model = system.source.linearize()
    return two_steps(model.body, model.q, system.control.sample_time or 0.0, pace)


def walked(
    system: System,
    plan: Plan,
    table: GainTable,
    *,
    friction: bool = True,
    trackers: Mapping[str, Tracker] | None = None,
    ticks: int | None = None,
    **options: float,
) -> tuple[RobotRun, list[ScheduledGains]]:
    """The run of the plan with the gains of a table, and the gains of each tick.

    trackers   other than a GainTracker of each contact state's gains
    options    of the scheduler
    """
    source = system.source
    body, own = source.body, source.actuators
    contacts = source.contacts["double"]
    setup = RobotSetup(
        body=body,
        actuators=replace(own, motor_viscous=own.motor_viscous + friction * VISCOUS),
        drives=system.drives,
        control=system.control,
        q=plan.posture(body, 0),
        contacts=contacts,
        coulomb=friction * np.where(["ankle_pitch" in name for name in body.joint_names], OF_ANKLES, COULOMB),
        ground=Ground(friction=0.8, soles={contact.frame: Sole(length=0.28, width=0.15) for contact in contacts}),
    )
    robot = load_robot(HERE / "scheduled_biped.yaml")
    trackers = trackers or {name: GainTracker(robot, PD(*gains), contacts=[name]) for name, gains in table.own.items()}
    stepper = RobotStepper(setup)
    controller = Controller(system, plan, GainScheduler(table, trackers, system.requirements, **options))
    stepper.control = controller  # type: ignore[assignment] - all that the stepper asks of it
    stepper.line.rest(plan.holding[0])
    stepper.data = stepper.robot.new_data(setup.q, plan.holding[0])
    parts: list[RobotRun] = []
    for first in range(0, ticks or len(plan.time), BLOCK):
        parts.append(stepper.part(plan.joints[first : first + BLOCK], first))
        if parts[-1].ending != "completed":
            break
    return joined(parts), controller.history


def error_of(run: RobotRun, plan: Plan) -> np.ndarray:
    """(k, n) planned less true positions of the links [rad]."""
    return plan.joints[: len(run.time)] - run.link_position


def phases(plan: Plan, ticks: int) -> list[tuple[str, slice]]:
    """Each phase of the plan, with its rows."""
    edges = [0, *(k for k in range(1, ticks) if plan.phase[k] != plan.phase[k - 1]), ticks]
    return [(plan.phase[first], slice(first, last)) for first, last in pairwise(edges)]


def vibrations(run: RobotRun, plan: Plan) -> list[tuple[str, Oscillation]]:
    """What `gainroom simulate` would report as a sustained vibration, phase by phase."""
    found = []
    for name, rows in phases(plan, len(run.time)):
        part = run.rows(rows)
        moving = (rows.stop - rows.start) * run.sample_time
        spec = SimpleNamespace(
            is_exact=False, is_linear=False, noise=0.0, encoder_step=0.0, sample_time=run.sample_time, moves_until=moving,
            at_rest=lambda part: slice(len(part.time), None),
        )  # fmt: skip
        one, _ = oscillation_in(spec, 1.0, part, None)  # type: ignore[arg-type]
        if one is not None and one.lasts:
            found.append((name, one))
    return found


def steps(run: RobotRun, plan: Plan) -> np.ndarray:
    """The largest change of a command from one tick to the next at each switch of contact and in the two ticks after it [N m]."""
    change = np.abs(np.diff(run.target_torque, axis=0)).max(axis=1)
    return np.array([change[k - 1 : k + 2].max() for k in range(1, len(change)) if plan.contact[k] != plan.contact[k - 1]])


def margins_in_use(system: System, plan: Plan, history: list[ScheduledGains]) -> list[tuple[float, bool, Margins]]:
    """(time, settled, margins) of the gains in use, weight included, in the planned posture and contact state."""
    found, late = [], round(EARLY_OR_LATE / (plan.time[1] - plan.time[0]))
    for k in range(0, len(history), EVERY):
        for contact in {plan.phase[max(k - late, 0)], plan.phase[min(k + late, len(plan.time) - 1)]}:
            gains = np.array([history[k].kp, history[k].kd])
            own = loop(system, plan.posture(system.source.body, k), contact, gains, weight=True)
            found.append((plan.time[k], history[k].settled, joint_margins(own)))
    return found


def rms(values: np.ndarray) -> float:
    """Root of the mean square over everything."""
    return float(np.sqrt(np.mean(values**2)))
