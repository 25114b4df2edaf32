"""Options of `gainroom audit` for the simulator that trains a policy, completed from the model's file."""

from collections.abc import Iterator
from dataclasses import dataclass, fields
from functools import partial
from typing import Any, get_args

from ..errors import GainroomError, all_of, refuse_all
from ..io.validation import checked, number, require_one_of
from ..io.yaml_text import shown
from ..robot.body import library
from ..robot.formats.model_files import stepping
from ..robot.formats.model_format import INTEGRATORS
from ..robot.formats.model_names import locate
from ..simulation.simulated_gains import ArmatureOf, Pd, Simulator

TIMESTEP = number(above=0, most=0.1, unit="s")
MOST_STEPS = 100
"""Maximum number of simulation steps for which a torque is held."""
OF_FILE = "the gains act as MuJoCo's own actuators, as in the file: or give --pd"
OF_PROGRAM = "a program computes the torques from kp and kd: or give --pd"


@dataclass(frozen=True)
class SimulatorOptions:
    """Simulator options as typed; None: not given. timestep [s]."""

    simulator: str | None = None
    timestep: float | None = None
    integrator: str | None = None
    pd: Pd | Any = None
    decimation: int | None = None
    armature: ArmatureOf | Any = None

    def __post_init__(self) -> None:
        allowed = {"simulator": ("mujoco",), "integrator": INTEGRATORS, "pd": get_args(Pd), "armature": get_args(ArmatureOf)}
        checks = [partial(require_one_of, f"--{name} {shown(getattr(self, name))}", getattr(self, name), allowed[name]) for name in allowed]
        tick = [] if self.timestep is None else [partial(checked, "--timestep", self.timestep, TIMESTEP)]
        all_of([lambda: refuse_all(self._contradictions()), *checks, *tick])

    def _contradictions(self) -> Iterator[str]:
        given = [each.name for each in fields(self) if getattr(self, each.name) is not None]
        if given and "simulator" not in given:
            yield f"--{given[0]}: goes with --simulator mujoco"
        if self.decimation is not None and not 1 <= self.decimation <= MOST_STEPS:
            yield f"--decimation {self.decimation}: must be 1 to {MOST_STEPS} steps"


def simulator_of(options: SimulatorOptions, model: str, own_gains: bool, damping_in_kd: bool = False) -> tuple[Simulator, tuple[str, ...]]:
    """Simulator, and the assumptions made where nothing was given, each with the option that replaces it.

    model       as `audited` takes it
    own_gains   whether the gains are those of the model's own actuators
    damping_in_kd   as Simulator has it

    Raises GainroomError, one line that names the option, the value and what is allowed; where MuJoCo is not installed.
    """
    library("mujoco", "MuJoCo")
    file = stepping(locate(model))
    pd: Pd = options.pd or ("implicit" if own_gains else "explicit")
    if options.decimation is not None and pd != "explicit":
        raise GainroomError(f"--decimation {options.decimation}: goes with --pd explicit; MuJoCo's own actuators act at every step")
    simulator = Simulator(
        timestep=checked(f"{model}: option timestep", file.timestep, TIMESTEP) if options.timestep is None else options.timestep,
        integrator=options.integrator or file.integrator,
        pd=pd,
        decimation=options.decimation or 1,
        armature=options.armature or ("file" if file.armature else "motor"),
        damping_in_kd=damping_in_kd,
        flags=file.disabled,
    )
    notes = []
    if missing := [name for name in file.unnamed if getattr(options, name) is None]:
        notes.append(f"the file names no {' and no '.join(missing)}, so it is MuJoCo's default: or give --{' and --'.join(missing)}")
    if options.pd is None:
        notes.append(OF_FILE if own_gains else OF_PROGRAM)
    if pd == "explicit" and options.decimation is None:
        notes.append("torques are computed anew at every step: or give --decimation")
    if options.armature is None and not file.armature:
        notes.append("the joints' armature is the motors' inertia, as the file names none")
    return simulator, tuple(notes)
