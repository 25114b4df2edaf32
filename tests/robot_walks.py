"""Random smooth motion of a robot with contact switches, for the tracker: what it says is compared with gain_limit afterwards."""

from dataclasses import replace

import numpy as np

import gainroom as gr
from gainroom.design.realtime.tracker import WEAK
from gainroom.robot.linearize import linearize


class Walk:
    """Joints swing about the first posture by sums of sines of 0.1 to 0.8 Hz; contacts take turns every `stance` ticks of 1 ms."""

    def __init__(self, robot, sample_time=None, seed=0, symmetric=False, speed=1.0, stance=800, contacts=None, pd=None, tasks=False):
        self.robot, self.stance = robot, stance
        self.system = replace(robot.system, control=replace(robot.system.control, sample_time=sample_time))
        if pd is not None:
            self.system = self.system.with_controller(pd)
        if tasks:
            self.system = replace(self.system, control=replace(self.system.control, space="task", controller=None))
        self.tracker = gr.GainTracker(robot, self.system.control)
        self.contacts = contacts or self.tracker.contacts
        rng, size = np.random.default_rng([5, seed]), robot.body.size
        self.rates = rng.uniform(0.1, 0.8, (size, 3))
        self.phases = rng.uniform(0, 2 * np.pi, (size, 3))
        self.swing = rng.uniform(0.3, 1.0, (size, 1)) * speed / (2 * np.pi * self.rates) / 1.5
        if symmetric:  # the right leg does what the left one does: limbs with equal crossings
            for values in (self.rates, self.phases, self.swing):
                values[size // 2 :] = values[: size // 2]
        self.middle = robot.body.configuration(dict(next(iter(robot.postures.values())).angles))

    def posture(self, tick: int):
        q = self.middle.copy()
        moved = np.sum(self.swing * np.sin(2e-3 * np.pi * self.rates * tick + self.phases), axis=1)
        q[len(q) - len(moved) :] += np.clip(moved, -0.6, 0.6)
        return q

    def contact(self, tick: int) -> str:
        return self.contacts[tick // self.stance % len(self.contacts)]

    def loop(self, tick: int) -> gr.Loop:
        robot = self.robot
        return self.system.loop(linearize(robot.body, robot.actuators, self.posture(tick), robot.contacts[self.contact(tick)]))

    def truth(self, tick: int) -> float:
        """The limit; 0 where the loop is not stable from the least factors up to there, but for tasks' that are too weak to matter."""
        limit = gr.gain_limit(self.loop(tick))
        return limit.gain if limit.lower_gain < WEAK else 0.0

    def holds(self, tick: int, gain: float) -> bool:
        """Whether the loop is stable from the least factors that matter up to `gain`."""
        limit = gr.gain_limit(self.loop(tick).scaled(gain * (1 - 1e-6)))
        return limit.stable and limit.lower_gain * gain < WEAK

    def run(self, ticks: int, checks: int | None) -> tuple[float, float]:
        """The share of ticks that are certified, and by how much a certified gain is above the limit at most, relative.

        checks   how many certified ticks are looked at, or so; None: all
        """
        answers = [self.tracker.update(self.posture(tick), self.contact(tick)) for tick in range(ticks)]
        certified = [tick for tick, answer in enumerate(answers) if answer.certified]
        checked = certified[:: max(1, len(certified) // checks) if checks else 1]
        return len(certified) / ticks, max(answers[tick].gain / max(self.truth(tick), 1e-9) - 1 for tick in checked)
