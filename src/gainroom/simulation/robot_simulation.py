"""Simulation of a robot and its scenario in MuJoCo."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ..analysis.margin_record import Margins
from ..design.gain_cases import bounded_margins
from ..errors import GainroomError, named
from ..robot.ground import Footing, footings
from ..robot.held_followers import on_a_tree
from ..robot.model import RobotModel
from ..robot.name_patterns import select
from ..robot.robot import RobotScenario
from ..system.linear.arrays import Floats
from ..system.loop import Loop
from ..system.system import StateCase, System
from .robot_run import stream_robot
from .robot_setup import RobotSetup, channel_units, hold, robot_setup
from .run_record import LOGGED, REFERENCE_SIGNAL, Run
from .simulation_spec import NO_RATE, TORQUE_LIMIT, SimulationSpec, refuse_odd_run
from .trajectories import Spline

MOST_ROBOT_TICKS = 200_000
"""Most ticks of one run, which is held in memory: 100 s at 2 kHz."""
DEFAULT_MOVE = 0.01
"""Default displacement of a move [m, rad]."""


def require_sampled(system: System) -> None:
    """Raise GainroomError for a continuous controller, which has no ticks to simulate."""
    if system.control.sample_time is None:
        raise GainroomError(f"{system.source.name}: {NO_RATE}")


def scenario_effects(scenario: RobotScenario) -> tuple[str, ...]:
    """Names of the effects that a scenario adds to the linear loop."""
    there = {
        "friction": np.any(scenario.coulomb) or np.any(scenario.viscous),
        "encoder steps": scenario.resolution > 0,
        TORQUE_LIMIT: np.any(np.isfinite(scenario.torque_limit)),
        "the ground": scenario.ground is not None,
    }
    return tuple(name for name, given in there.items() if given)


@dataclass(frozen=True, kw_only=True)
class RobotSimulation(SimulationSpec):
    """Robot with its scenario.

    setup   robot in the scenario's state
    model   its linear plant in that state, with the scenario's viscous friction
    displacement   (m,) of each channel [rad, m]
    """

    setup: RobotSetup
    model: RobotModel
    displacement: Floats

    @classmethod
    def of(cls, system: System) -> "RobotSimulation":
        """Simulation of a system with a scenario. Raises GainroomError for continuous control, and where the scenario does not fit."""
        require_sampled(system)
        with named(system.source.name):
            return cls._of(on_a_tree(system))

    @classmethod
    def _of(cls, system: System) -> "RobotSimulation":
        scenario, setup = system.scenario, _setup(system)
        refuse_odd_run(scenario.duration, setup.sample_time, MOST_ROBOT_TICKS)
        displacement = _displacement(system, setup)
        effects = tuple(name for name in scenario_effects(scenario) if name != "friction" or np.any(setup.coulomb))  # viscous is linear
        return cls(
            kind="mujoco",
            duration=scenario.duration,
            sample_time=setup.sample_time,
            joint_names=setup.body.joint_names,
            signals=tuple(name for name in LOGGED if name != REFERENCE_SIGNAL or system.control.space == "joint"),
            moves_until=scenario.move_duration + system.control.command_delay if displacement.any() else 0.0,
            encoder_step=setup.encoder_step,
            torque_limit=setup.torque_limit,
            is_linear=not effects,
            effects=effects,
            contact_frames=tuple(contact.frame for contact in setup.contacts),
            warnings=system.warnings,
            system=system,
            setup=setup,
            model=replace(system.source, actuators=setup.actuators).linearize(scenario.posture, scenario.contact),
            displacement=displacement,
        )

    def stream(self, gain: float) -> Iterator[Run]:
        with named(self.system.source.name):
            time = self.sample_time * np.arange(len(hold(self.setup, self.duration)))
            move, delay = Spline.move(self.displacement, self.system.scenario.move_duration, order=5), self.system.control.command_delay
            for part in stream_robot(self.setup, move.position(time - delay), gain=gain):
                asked = move.position(part.time) - move.position(part.time - delay)  # the record has what was asked for, not what arrived
                yield part if delay == 0 else replace(part, reference=part.reference + asked)

    @property
    def place(self) -> tuple[str, str]:
        """Posture and contact state of the scenario, by default the file's first."""
        scenario, (posture, contact) = self.system.scenario, self.system.source.states[0]
        return scenario.posture or posture, scenario.contact or contact

    @property
    def adds_viscous_friction(self) -> bool:
        return bool(np.any(self.system.scenario.viscous))

    def loop(self, gain: float = 1.0) -> Loop:
        """Linear loop with all gains times `gain` and contacts fixed."""
        return self.system.loop(self.model).scaled(gain)

    def seen_margins(self, gain: float) -> Margins | None:
        if self.model.size == 1:
            return None
        scenario = self.system.scenario
        return bounded_margins(StateCase(scenario.posture, scenario.contact, "", self.system, self.model), gain)

    def at_rest(self, run: Run) -> slice:
        """Rows after the move has ended; the second half of a run that ended early."""
        first = round(self.moves_until / self.sample_time) if run.ending == "completed" else len(run.time) // 2
        return slice(first, len(run.time))

    @cached_property
    def footings(self) -> tuple[Footing, ...]:
        """Ground under each foot; empty for fixed contacts."""
        setup = self.setup
        return footings(setup.body, setup.q, setup.contacts) if setup.ground is not None and setup.gravity else ()

    @property
    def immovable(self) -> tuple[str, ...]:
        """Names of task directions that the scenario moves but the robot cannot, such as the centre of mass in flight."""
        if self.system.control.space == "joint":
            return ()
        tasks = self.system.source.tasks(self.model, self.system.control.rotors)
        return tuple(tasks.directions[k] for k in np.flatnonzero((self.displacement != 0) & ~tasks.movable).tolist())


def _setup(system: System) -> RobotSetup:
    """Robot setup in the state and with the effects of its scenario."""
    scenario = system.scenario
    setup = robot_setup(
        system,
        scenario.posture,
        scenario.contact,
        coulomb=scenario.coulomb,
        torque_limit=scenario.torque_limit,
        encoder_step=scenario.resolution,
        ground=scenario.ground,
    )
    viscous = setup.actuators.motor_viscous + scenario.viscous
    return replace(setup, actuators=replace(setup.actuators, motor_viscous=viscous))


def _displacement(system: System, setup: RobotSetup) -> Floats:
    """Displacement (m,) of each channel. Raises GainroomError if the scenario's `by` does not fit."""
    scenario, size = system.scenario, setup.body.size
    if system.control.space == "joint":
        places = list(range(size) if scenario.joint is None else select(scenario.joint, setup.body.joint_names, "scenario.move.joint"))
        usual = 0.0 if setup.contacts else DEFAULT_MOVE  # joints of legs in a closed chain cannot move independently
    else:
        counts = [len(task.directions(setup.body.joint_names)) for task in setup.stack]
        moved = 0 if scenario.task is None else [task.name for task in setup.stack].index(scenario.task)
        places = list(range(sum(counts[:moved]), sum(counts[: moved + 1])))
        usual = DEFAULT_MOVE if setup.stack[moved].kind == "posture" else (DEFAULT_MOVE, 0.0, 0.0)
    by = np.atleast_1d(usual if scenario.by is None else scenario.by)
    if len(by) not in (1, len(places)):
        raise GainroomError(f"scenario.move.by: {len(by)} numbers must be one, or {len(places)}")
    way = np.zeros(len(channel_units(setup)))
    way[places] = by
    return way
