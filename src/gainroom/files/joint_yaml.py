"""Reader of joint.yaml: one joint, its drive, its controller and requirements, validated and turned into a System.

Everything is SI and radians except where a key's name carries another unit (delay_ms, sample_rate_hz, gain_margin_db).
"""

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import Field, SerializeAsAny, ValidatorFunctionWrapHandler, WrapValidator

from ..errors import GainroomError, Together, UnjudgedError, named
from ..io.validation import (
    LARGEST,
    NotNegative,
    Positive,
    PositiveOrInfinite,
    Refusals,
    made_when_read,
    number,
    partly,
    refusal,
    relation,
)
from ..io.yaml_text import read_text
from ..system.controller import CONTROLLERS, DisturbanceObserver, GainKey
from ..system.elastic_joint import ElasticJoint
from ..system.feedback import SENSORS, Feedback, feedback_of
from ..system.gain_bounds import GainBounds
from ..system.linear.state_space import split_delay
from ..system.requirements import NOISE_SHARE, Requirements
from ..system.system import System
from ..system.uncertainty import Uncertainty
from .actuator_facts import published_notes
from .file_types import parse_as
from .law_section import LawSection
from .system_sections import (
    ControlSection,
    GainBoundsSection,
    GearboxSection,
    PositiveInterval,
    Stiffness,
    SystemFile,
    UncertaintySection,
    control_section,
    rad_per_s,
    refuse_long_delay,
    refuse_two_paths,
)

if TYPE_CHECKING:
    from ..simulation.simulation_spec import JointSimulation
    from ..studies.comparison import ComparisonSettings
    from .compare_section import CompareSection
    from .identified_section import IdentifiedSection
    from .joint_scenario import ScenarioSection

STIFFNESS = "the stiffness of the gearbox [N·m/rad], a number > 0, or rigid where it does not give way"
"""Meaning of joint.stiffness, for messages."""
MOTOR = ("motor_inertia", "rotor_inertia", "gear_ratio")
"""Keys of `joint` for the inertia of its motor."""
LAW = "lti"
"""Type of a law in plain numbers."""
Signed = Annotated[float, number(least=-LARGEST)]
MOST_DAMPED = 1e4
"""Damping ratio of motor and spring above which the spring has no effect."""


def load_joint(path: Path, two_paths: bool = False, may_ask: bool = False) -> System:
    """System of the joint that a joint.yaml describes; `two_paths`: kd may have a path of its own; `may_ask`: gains may be left out.

    Raises GainroomError, one line that names the file, the key, the value and what is allowed.
    """
    return parse_joint(read_text(path), str(path), two_paths, may_ask)


def parse_joint(text: str, source: str, two_paths: bool = False, may_ask: bool = False) -> System:
    """System in the text of a joint.yaml, which messages call `source`; otherwise as load_joint."""
    with named(source), Together() as together:
        return _file(text, source, two_paths, together, may_ask).spec()


def load_simulation(path: Path, feedforward: Path | None = None, two_paths: bool = False) -> "JointSimulation":
    """Joint with its scenario, or with the default scenario if the file has none; otherwise as load_joint.

    feedforward   a log: the joint is held at 0 under its target_torque, for as long as that lasts
    """
    return parse_simulation(read_text(path), str(path), feedforward, two_paths)


def parse_simulation(text: str, source: str, feedforward: Path | None = None, two_paths: bool = False) -> "JointSimulation":
    """Joint and scenario in the text of a joint.yaml, which messages call `source`; otherwise as load_simulation."""
    from ..simulation.simulation_spec import NO_RATE

    with named(source), Together() as together:
        file = _file(text, source, two_paths, together)
        if together.step(lambda: file.control.sample_rate_hz is None)():  # else a delay in ticks would ask for another remedy
            raise GainroomError(NO_RATE)
        system = together.step(file.spec)
        scenario = file.scenario or _scenario_section().model_validate({})
        scenario = scenario if feedforward is None else scenario.under(feedforward)
        simulation = scenario.spec(system(), Path(source).parent)
        return simulation if file.identified is None else replace(simulation, identified=file.identified.coulomb)


def load_comparison(path: Path) -> "tuple[System, ComparisonSettings]":
    """Joint of a joint.yaml, whose gains may be left out, and what is compared on it; otherwise as load_joint."""
    return parse_comparison(read_text(path), str(path))


def parse_comparison(text: str, source: str) -> "tuple[System, ComparisonSettings]":
    """Joint and comparison in the text of a joint.yaml, which messages call `source`; otherwise as load_comparison."""
    from ..design.comparison.compared_joint import require_comparable

    with named(source), Together() as together:
        file = _file(text, source, two_paths=True, together=together, may_ask=True)
        system = together.step(file.spec)
        section = file.compare or _compare_section().model_validate({})
        require_comparable(system())
        return system(), section.settings(system())


def _file(text: str, source: str, two_paths: bool, together: Together, may_ask: bool = False) -> "JointFile":
    """Joint file as far as it is valid; the problems are added to `together`."""
    file = partly(JointFile, parse_as("joint", text, source, "testbed", together), source, together)
    together.step(lambda: refuse_two_paths(file.control, two_paths))
    if not may_ask:
        together.step(lambda: _refuse_to_ask(file.control))
    return file


def _refuse_to_ask(control: "JointControlSection") -> None:
    """Raise GainroomError for a file without gains, where they are needed."""
    if control.asks:
        missing = [f"control.{key.name} is missing: {control.described(key)}" for key in CONTROLLERS[control.type].gain_keys()]
        raise GainroomError(*(f"{one}; `gainroom joint FILE` tells which gains may be used" for one in missing))


def _identified_section() -> "type[IdentifiedSection]":
    """Section `identified`, imported only here, because its module loads identification."""
    from .identified_section import IdentifiedSection

    return IdentifiedSection


def _compare_section() -> "type[CompareSection]":
    """Section `compare`, imported only here, because its module loads the search for structures."""
    from .compare_section import CompareSection

    return CompareSection


def _scenario_section() -> "type[ScenarioSection]":
    """Section `scenario`, imported only here, because its module loads the simulation."""
    from .joint_scenario import ScenarioSection

    return ScenarioSection


class JointSection(GearboxSection):
    """Section `joint`: two inertias and the gearbox between them."""

    link_inertia: PositiveOrInfinite = Field(description="the load's inertia [kg·m²], a number > 0, or .inf where it is locked")
    stiffness: Stiffness | None = Field(None, description=STIFFNESS)

    @relation
    def _stiffness_is_known(self) -> Refusals:
        if not self.is_given("stiffness") and self.entry().stiffness is None:
            published = "" if self.facts is None else f"; of {self.facts.title} none is published"
            yield refusal(f"is missing: {STIFFNESS}{published}", key="stiffness")

    def inertia(self) -> float:
        """Inertia of the motor on the joint side [kg m²]. Raises GainroomError if it is not described, or in two ways."""
        inertia = self.entry(MOTOR).reflected("joint")
        if inertia is None:
            raise GainroomError(
                "joint.motor_inertia is missing: the motor's on the joint side [kg·m²], a number > 0; or give rotor_inertia with gear_ratio"
            )
        return inertia

    def joint(self) -> ElasticJoint:
        """Joint in SI, on the joint side. Raises GainroomError as `inertia`."""
        spring = self.spring("stiffness"), self.spring("damping")
        return ElasticJoint(self.inertia(), self.link_inertia, *spring, self.motor_viscous, self.link_viscous)

    def spring(self, name: str) -> float:
        """Stiffness [N m/rad] or damping [N m s/rad] of the gearbox: given, else published. Raises UnjudgedError for no stiffness."""
        if self.is_given(name) and name in self.model_fields_set:
            return getattr(self, name)
        value = getattr(self.entry(), name)
        if value is None and name == "stiffness":
            raise UnjudgedError(name)
        return value or 0.0


def _one_side_or_more(value: object, handler: ValidatorFunctionWrapHandler) -> Any:
    return value if isinstance(value, dict) else handler(value)  # a mapping is judged with the type, whose gains it names


class JointControlSection(ControlSection):
    """Section `control` of one joint."""

    ONE_JOINT = True

    feedback: Annotated[Literal["motor", "link"], WrapValidator(_one_side_or_more)] = Field(
        description="the side of the gearbox that the encoder is on, motor or link; or a side per gain, such as {kp: link, kd: motor}"
    )
    motor: LawSection | None = None
    link: LawSection | None = None
    torque: LawSection | None = None
    bandwidth_hz: Positive | None = None

    @classmethod
    def prepared(cls, data: dict[str, Any]) -> dict[str, Any]:
        """Data of which a law in plain numbers has no feedback: it names its sensors."""
        return {"feedback": {}, **data} if data.get("type") == LAW else data

    @relation
    def _laws_of_the_type(self) -> Refusals:
        given = [sensor for sensor in SENSORS if self.is_given(sensor)]
        if self.type != LAW:
            yield from (refusal(f"is a law in plain numbers, for type {LAW}, not for type {self.type}", key=sensor) for sensor in given)
            return
        if not given:
            yield refusal(
                "is missing: the law of the motor's position, {zeros, poles, gain} in z; or give link, torque or several", key="motor"
            )
        if self.sample_rate_hz is None:
            yield refusal("is missing: the rate of the law [Hz], which is in z", key="sample_rate_hz")
        if self.feedback != {}:
            yield refusal(f"has no meaning for type {LAW}, whose laws name their sensors: motor, link, torque", key="feedback")

    @relation
    def _sampled_observer(self) -> Refusals:
        if CONTROLLERS[self.type] is not DisturbanceObserver:
            if self.is_given("bandwidth_hz"):
                yield refusal(f"has no meaning for type {self.type}", key="bandwidth_hz")
            return
        if self.is_given("bandwidth") == self.is_given("bandwidth_hz"):
            yield refusal("give either bandwidth [rad/s] of the disturbance observer or bandwidth_hz")
        if self.sample_rate_hz is None:
            yield refusal(f"is missing: type {self.type} is a difference equation with whole ticks of delay [Hz]", key="sample_rate_hz")

    @relation
    def _sides_of_the_gains(self) -> Refusals:
        if self.type == LAW:
            return
        if not isinstance(self.feedback, dict) and not CONTROLLERS[self.type].torque_name:
            return
        try:
            both = feedback_of(self.feedback, CONTROLLERS[self.type]).mixed
        except GainroomError as error:
            for problem in error.problems:
                place, message = re.split(r": | (?=is missing)", problem, maxsplit=1)
                yield refusal(message, key=place)
            return
        if both and self.kd_path is not None:
            yield refusal("is not for gains that measure both sides, or a torque: give feedback: motor or link", key="kd_path")

    @property
    def encoders(self) -> Feedback:
        """What each gain measures. Raises UnjudgedError where the section is wrong."""
        self.require_right()
        if self.type == LAW:
            return Feedback.of_law([sensor for sensor in SENSORS if self.is_given(sensor)])
        return feedback_of(self.feedback, CONTROLLERS[self.type])

    @property
    def asks(self) -> bool:
        """True if no gain is given, of a type whose gains can all be recommended."""
        return not any(map(self.is_given, self.known_gains())) and CONTROLLERS[self.type].can_be_asked_for()

    @classmethod
    def gain_type(cls, keys: Sequence[GainKey]) -> Any:
        if any(key.signed for key in keys):
            return Signed
        return Positive if all(key.positive for key in keys) else NotNegative

    def values(self, delay: float) -> dict[str, Any]:
        """Values of the type's gains in SI, some of those not given from the drive's `delay` [s]; 1 where gains are asked for."""
        self.require_right()
        if self.asks:
            return dict.fromkeys(self.gain_names, 1.0)
        found = {name: value for name in self.gain_names if (value := getattr(self, name)) is not None}
        step = None if self.sample_rate_hz is None else 1 / self.sample_rate_hz
        if CONTROLLERS[self.type] is DisturbanceObserver and step is not None:
            found.setdefault("bandwidth", rad_per_s(None, self.bandwidth_hz))
            found.setdefault("delay_ticks", float(split_delay(delay, step)[0]) + 1)  # and one tick for the hold
        if self.type == LAW and step is not None:
            found |= {sensor: section.law(step) for sensor in SENSORS if (section := getattr(self, sensor)) is not None}
        return found


class JointUncertaintySection(UncertaintySection):
    """Section `uncertainty` with the range of the load's inertia."""

    link_inertia: PositiveInterval | None = None


JointControl = Annotated[SerializeAsAny[JointControlSection], made_when_read(lambda: control_section(JointControlSection), optional=False)]


class JointFile(SystemFile[JointControl, JointUncertaintySection]):
    """File joint.yaml as it is written."""

    joint: JointSection = Field(
        description="the section of inertias and gearbox, such as {motor_inertia: 1, link_inertia: 16, stiffness: 1.0e4, damping: 1}"
    )
    gain_bounds: GainBoundsSection | None = None
    scenario: Annotated[Any, made_when_read(_scenario_section, optional=False)] = None
    identified: Annotated[Any, made_when_read(_identified_section)] = None
    compare: Annotated[Any, made_when_read(_compare_section)] = None

    def spec(self) -> System:
        """System in SI. Raises GainroomError where sections contradict each other."""
        with Together() as together:
            step = together.step
            tick, inertia, joint = step(self.tick), step(lambda: self.joint.inertia()), step(lambda: self.joint.joint())
            delay, drive = step(lambda: self.drive.delay(tick())), step(lambda: self.drive.drive(tick()))
            sample_time = step(lambda: self.sample_time())
            step(lambda: refuse_long_delay(delay(), sample_time(), self.drive.delay_key))
            step(lambda: _refuse_seized_gearbox(joint()))
            nominal: dict[str, float] = {}
            step(lambda: nominal.update(delay=delay()))
            step(lambda: nominal.update(motor_inertia=inertia()))
            for name in ("stiffness", "damping"):
                step(lambda name=name: nominal.update({name: self.joint.spring(name)}))
            step(lambda: nominal.update(link_inertia=self.joint.link_inertia))
            uncertainty = step(lambda: self._ranges(nominal, tick))
            controller = step(lambda: self.control.controller(self.control.values(delay())))
            path = step(lambda: self.control.gain_path())
            self.require_right()
            found = System.of_joint(
                joint=joint(),
                drive=replace(drive(), resolution=self._resolution, torque_noise=self._torque_noise),
                controller=controller(),
                feedback=self.control.encoders,
                sample_time=sample_time(),
                requirements=self._requirements(),
                uncertainty=uncertainty(),
                objective=self.objective,
                bounds=GainBounds() if self.gain_bounds is None else GainBounds(**self.gain_bounds.given),
                asks=self.control.asks,
                entered=self.joint.model_dump(include={"rotor_inertia", "gear_ratio"}, exclude_none=True),
                assumptions=tuple(published_notes([self.joint.entry()], ["joint"])),
            )
            paths = {"kd_path": path(), "command_delay": 1e-3 * self.drive.command_delay_ms}
            clock = {"sampling_in_delay": self.drive.delay_includes_sampling, "continuous": self.drive.clock == "continuous"}
            return replace(found, control=replace(found.control, **clock, **paths))

    def _ranges(self, nominal: Mapping[str, float], tick: Callable[[], float | None]) -> Uncertainty:
        """Uncertainty of the file, with the ranges in which the figures of the joint's actuator differ where the file has none."""
        given, published = self.uncertainty.uncertainty(nominal, tick), self.joint.entry().ranges
        return replace(given, **{name: pair for name, pair in published.items() if not self.uncertainty.is_given(name)})

    @property
    def _resolution(self) -> float:
        """Step of the encoder that the loop is closed with [rad]: the drive's, else the scenario's; 0: not known, or two that differ."""
        if self.drive.encoder_resolution or self.scenario is None:
            return self.drive.encoder_resolution
        steps = {getattr(self.scenario, f"{side}_resolution") for side in self.control.encoders.sides}
        return steps.pop() if len(steps) == 1 else 0.0

    @property
    def _torque_noise(self) -> float | None:
        """Standard deviation of the torque sensor's noise [N m]: the drive's, else the scenario's; None: not known."""
        if self.drive.torque_noise is not None or self.scenario is None:
            return self.drive.torque_noise
        return self.scenario.torque_noise or None

    def _requirements(self) -> Requirements:
        """Requirements of the file; without limits also on torque noise, where resolution, rate and peak torque are known."""
        found = self.requirements()
        peak = math.inf if self.scenario is None else self.scenario.torque_limit
        sampled = self.control.sample_rate_hz is not None and self.control.kd_path is None
        if self.limits is not None or not (sampled and self._resolution > 0 and math.isfinite(peak)):
            return found
        return Requirements(**{**found.needed, "torque_noise": NOISE_SHARE * peak})


def _refuse_seized_gearbox(joint: ElasticJoint) -> None:
    """Raise GainroomError if a gearbox's damping locks motor and link together at every relevant frequency."""
    most = 2 * MOST_DAMPED * math.sqrt(joint.stiffness * joint.motor_inertia) if math.isfinite(joint.stiffness) else math.inf
    if joint.damping > most > 0:
        raise GainroomError(
            f"joint.damping: {joint.damping:g} must be <= {most:g} ({MOST_DAMPED:g} times the critical damping of motor and spring); look "
            "for a wrong unit, or give stiffness .inf for a rigid gearbox"
        )
