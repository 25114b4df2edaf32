"""Simulation of a loop or a testbed through a scenario: all at once, or block after block."""

from collections.abc import Iterator

from ..errors import GainroomError
from ..system.loop import Loop
from .run_record import Run, cut, joined
from .scenario import MOST_TICKS, Scenario, ScenarioInputs
from .stepping import LinearStepper
from .testbed import Testbed
from .testbed_stepping import TestbedStepper

BLOCK = 2000  # ticks


def simulate(system: Loop | Testbed, scenario: Scenario) -> Run:
    """Complete run of a sampled loop or a testbed through a scenario.

    system    a sampled loop of any number of joints, built with gainroom.build_loop: stepped exactly; or a Testbed. Where kd of one joint
              has a path of its own, its loop runs as a Testbed without effects

    Raises GainroomError where system and scenario do not go together, and for a run too long to be held in memory.
    """
    loop = _sampled(system)
    assert loop.sample_time is not None
    if scenario.duration / loop.sample_time * loop.size > MOST_TICKS:
        raise GainroomError(
            f"scenario: duration {scenario.duration:g} s must be at most {MOST_TICKS / loop.size * loop.sample_time:g} s, which are "
            f"{MOST_TICKS} ticks over all {loop.size} joints; stream() yields longer runs in parts"
        )
    return joined(stream(system, scenario))


def stream(system: Loop | Testbed, scenario: Scenario, block: int = BLOCK) -> Iterator[Run]:
    """Run in parts of `block` ticks, as they are computed; it ends early if it diverges, with the reason in the last part."""
    signals = ScenarioInputs(scenario, _sampled(system))
    if isinstance(system, Loop) and system.kd_path is not None and system.size == 1:
        system = Testbed(system)
    stepper = TestbedStepper(system, signals) if isinstance(system, Testbed) else LinearStepper(system, signals)
    first, total = 0, signals.ticks + 1  # both ends of the run are rows
    while first < total:
        count = min(block, total - first)
        part = cut(stepper.advance(signals.block(first, count), first), scenario.limit, first, count)
        yield part
        if part.diverged:
            return
        first += count


def _sampled(system: Loop | Testbed) -> Loop:
    loop = system.loop if isinstance(system, Testbed) else system
    if loop.parts is None or loop.sample_time is None:
        raise GainroomError("simulation needs a loop built with build_loop and a sample_time: the controller works tick by tick")
    return loop
