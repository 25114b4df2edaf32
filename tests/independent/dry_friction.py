"""One elastic joint with dry friction on both sides, followed from event to event.

A side sticks (0) or slides (±1). Between two changes the equations are smooth and an eighth-order method follows them to 1e-12. A side that
slides stops where its velocity crosses zero, and stays where F_S can hold it; one that sticks breaks loose where more than F_S is needed.
"""

from dataclasses import dataclass

import numpy as np
from scipy.integrate import solve_ivp


@dataclass(frozen=True)
class DryJoint:
    """Inertias, gearbox, (F_C, F_S, v_s) of motor and link, and m g l of the link, which hangs at 0."""

    motor_inertia: float
    link_inertia: float
    stiffness: float
    damping: float
    motor: tuple[float, float, float] = (0.0, 0.0, 1.0)
    link: tuple[float, float, float] = (0.0, 0.0, 1.0)
    gravity: float = 0.0

    def driving(self, x: np.ndarray, torque: float) -> tuple[float, float]:
        """Torques on motor and link, friction apart."""
        spring = self.stiffness * (x[0] - x[1]) + self.damping * (x[2] - x[3])
        return torque - spring, spring - self.gravity * np.sin(x[1])

    def slope(self, x: np.ndarray, torque: float, modes: list[int]) -> np.ndarray:
        """d/dt of (θ, q, θ̇, q̇)."""
        driving, rates = self.driving(x, torque), []
        for side, (law, inertia) in enumerate(((self.motor, self.motor_inertia), (self.link, self.link_inertia))):
            free = law[1] == 0
            rates.append((driving[side] - modes[side] * dry(law, x[2 + side])) / inertia if free or modes[side] else 0.0)
        return np.array([x[2], x[3], *rates])

    def modes(self, x: np.ndarray, torque: float) -> list[int]:
        """Which side slides which way, where a velocity of zero sticks if it can."""
        found = []
        for side, law in enumerate((self.motor, self.link)):
            needed = self.driving(x, torque)[side]
            held = 0 if abs(needed) <= law[1] else int(np.sign(needed))
            found.append(0 if law[1] == 0 else int(np.sign(x[2 + side])) or held)
        return found


def dry(law: tuple[float, float, float], speed: float) -> float:
    """F(v)."""
    return law[0] + (law[1] - law[0]) * np.exp(-((speed / law[2]) ** 2))


def run(joint: DryJoint, torques: np.ndarray, tick: float, start: np.ndarray) -> np.ndarray:
    """(k + 1, 4) states at the ticks, with each of `torques` (k,), on the motor, held for one."""
    x = np.array(start, dtype=float)
    rows = [x.copy()]
    for torque in torques:
        now, modes = 0.0, joint.modes(x, torque)
        while now < tick:
            solved = solve_ivp(
                lambda _, y, torque=torque, modes=modes: joint.slope(y, torque, modes),
                (now, tick),
                x,
                method="DOP853",
                rtol=1e-12,
                atol=1e-15,
                events=[_event(joint, side, torque, modes) for side in (0, 1)],
            )
            now, x = solved.t[-1], solved.y[:, -1].copy()
            for side in (0, 1):
                if len(solved.t_events[side]):
                    x[2 + side] = 0.0
                    # One that has broken loose goes, whatever rounding makes of the torque that it needs.
                    gone = int(np.sign(joint.driving(x, torque)[side]))
                    new = gone if modes[side] == 0 else joint.modes(x, torque)[side]
                    modes = [new if k == side else modes[k] for k in (0, 1)]
        rows.append(x.copy())
    return np.array(rows)


def _event(joint: DryJoint, side: int, torque: float, modes: list[int]):
    """Zero where `side` changes its mode."""
    law = (joint.motor, joint.link)[side]

    def event(_: float, y: np.ndarray) -> float:
        if law[1] == 0:
            return 1.0
        return y[2 + side] if modes[side] else abs(joint.driving(y, torque)[side]) - law[1]

    event.terminal = True  # type: ignore[attr-defined]
    event.direction = -modes[side] if modes[side] else 1  # type: ignore[attr-defined]
    return event
