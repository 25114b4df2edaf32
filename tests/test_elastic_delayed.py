"""The actuator of trainers: vibration starts where gainroom predicts it; parts agree with closed forms and with fine integration."""

import math
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import solve_ivp

from elastic_actuators import EVERY, JOINTS, LEG, Held, first_speeds, onset, stiffest_step
from gainroom.errors import GainroomError
from gainroom.trainers.elastic_delayed import MOST_SUBSTEPS, ElasticDelayed, ElasticDelayedJoints, Library

RIGID = ElasticDelayed(motor_inertia=0.1, delay=0.0, period=1e-3)
SOFT = JOINTS["soft"].actuators["joint"]


def simulated(held: Held, step: float, duration: float, known: float | None = 1.0):
    """Run for elastic_actuators.onset in which links move as MuJoCo moves them, by semi-implicit Euler with held torques.

    known   times the links' own inertias: what the actuators are told; None: nothing
    """
    inverse, own = np.linalg.inv(held.inertia()), held.own_inertia()

    def run(factors: np.ndarray) -> np.ndarray:
        envs, record = len(factors), []
        motors = [
            ElasticDelayedJoints(each, step, envs, 1, None if known is None else [known * inertia])
            for each, inertia in zip(held.actuators.values(), own, strict=True)
        ]
        position, speed = np.zeros((envs, len(motors))), np.tile(first_speeds(held), (envs, 1))
        nothing, unlimited = np.zeros((envs, 1)), np.full((envs, 1), math.inf)
        gains = [(factors[:, None] * kp, factors[:, None] * kd) for kp, kd in zip(held.kp, held.kd, strict=True)]
        for _ in range(round(duration / step)):
            each = [
                motor.torque(position[:, [k]], speed[:, [k]], nothing, nothing, nothing, *gains[k], unlimited)
                for k, motor in enumerate(motors)
            ]
            torque = np.hstack(each)
            speed = speed + step * torque @ inverse
            position = position + step * speed
            record.append((torque**2).sum(1))
        return np.array(record)

    return run


@pytest.mark.parametrize("name", EVERY)
def test_vibration_starts_at_the_predicted_factor(name: str):
    """Within 0.5 %: the leg's step of 1 ms costs 0.35 %, and the fit of the growth hardly anything."""
    held = EVERY[name]
    assert onset(simulated(held, 1e-3, 1.0), held.limit()) == pytest.approx(held.limit(), rel=5e-3)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "longest"), [("stiff", 4e-3), ("rigid", 2e-3)])
def test_the_error_falls_with_the_square_of_the_step(name: str, longest: float):
    """Of links that are stepped explicitly: halved steps leave a quarter; from a third to a fifth counts, as other orders are there."""
    held = EVERY[name]
    errors = [abs(onset(simulated(held, longest / part, 2.0, None), held.limit()) / held.limit() - 1) for part in (1, 2, 4)]
    assert errors[0] < 0.01
    for coarse, fine in pairwise(errors):
        assert 1 / 5 < fine / coarse < 1 / 2.9


@pytest.mark.slow
@pytest.mark.parametrize("known", [0.7, 1.4])
@pytest.mark.parametrize("name", ["stiff", "link", "rigid"])
def test_a_link_inertia_that_is_off_costs_less_than_none(name: str, known: float):
    """At 4 ms: other postures and other joints change it. None costs 0.7 to 1.6 %."""
    held = EVERY[name]
    none, off = (abs(onset(simulated(held, 4e-3, 2.0, each), held.limit()) / held.limit() - 1) for each in (None, known))
    assert 2 * off < none


def test_a_load_is_held_at_the_springs_stiffness_whatever_the_step():
    """10 N m on a link that is light for its spring, Ω dt = 1.8: nothing of the corrections within a step is left at rest."""
    inertia, load = 0.05, 10.0
    step = 1.8 * math.sqrt(inertia / SOFT.gearbox_stiffness)
    numbers = replace(SOFT, motor_inertia=1e9, gearbox_damping=5.0, period=step)
    motor = ElasticDelayedJoints(numbers, step, 1, 1, [inertia])
    position, speed, nothing = np.zeros((1, 1)), np.zeros((1, 1)), np.zeros((1, 1))
    for _ in range(round(10 / step)):
        torque = motor.torque(position, speed, nothing, nothing, nothing, nothing, nothing, nothing)
        speed = speed + step / inertia * (torque - load)
        position = position + step * speed
    assert float(torque[0, 0]) == pytest.approx(load, rel=1e-6)
    assert float(position[0, 0]) == pytest.approx(-load / SOFT.gearbox_stiffness, rel=1e-4)  # the rotor of 1e9 kg m² gives way by 1e-6


TABLE = (Path(__file__).parents[1] / "docs" / "trainers.md").read_text("utf-8").partition("| predicted factor |")[2].partition("\n\n")[0]
ROWS = [[cell.strip() for cell in line.split("|")[1:-1]] for line in TABLE.splitlines()[2:]]


@pytest.mark.slow
@pytest.mark.parametrize("row", ROWS, ids=lambda row: row[0])
def test_the_table_of_the_documentation(row: list[str]):
    """Its digits; 0.02 % may be the processor's."""
    name, factor, share, *errors = row
    held = EVERY[name]
    assert held.limit() == pytest.approx(float(factor), rel=1e-3)
    assert stiffest_step(held, 1e-3) == pytest.approx(float(share), abs=0.006)
    for (step, known), error in zip(((1e-3, 1.0), (2e-3, 1.0), (4e-3, 1.0), (4e-3, None)), errors, strict=True):
        if error != "explodes":
            found = 100 * (onset(simulated(held, step, 2.0, known), held.limit()) / held.limit() - 1)
            assert found == pytest.approx(float(error.replace("−", "-").removesuffix("%")), abs=0.02)


def test_the_table_has_every_joint():
    assert [row[0] for row in ROWS] == [*EVERY]


def single(numbers: ElasticDelayed, step: float = 1e-3, library: Library | None = None, envs: int = 1) -> ElasticDelayedJoints:
    return ElasticDelayedJoints(numbers, step, envs, 1, None, library)


def torques(motor: ElasticDelayedJoints, efforts, position=0.0, speed=0.0, kp=0.0, kd=0.0, limit=math.inf) -> np.ndarray:
    """Torques (steps, envs) while the policy commands `efforts` (steps,), on links that stay where they are."""
    shape = motor._fresh.shape  # what the state is of

    def full(value):
        return np.full(shape, value, dtype=float)

    given = (full(position), full(speed), full(0.0), full(0.0))
    return np.array([motor.torque(*given, full(effort), full(kp), full(kd), full(limit))[:, 0] for effort in efforts])


def test_a_fraction_of_a_step_counts():
    """A command that arrives 0.35 of a step after its beginning acts for 0.65 of it; the mean over the step is exact."""
    found = torques(single(replace(RIGID, delay=2.35e-3)), [4.0] * 5)[:, 0]
    assert_allclose(found, [0.0, 0.0, 0.65 * 4, 4.0, 4.0], atol=1e-12)


def test_commands_are_held_until_the_next_comes():
    """Sampled every 3 ms and 0.5 ms late, of a command that rises by 1 each ms."""
    found = torques(single(replace(RIGID, delay=5e-4, period=3e-3)), range(1, 8))[:, 0]
    assert_allclose(found, [0.5, 1.0, 1.0, 2.5, 4.0, 4.0, 5.5], atol=1e-12)


def test_the_limit_is_the_motors():
    assert_allclose(torques(single(RIGID), [5.0, -5.0, 1.0], limit=2.0)[:, 0], [2.0, -2.0, 1.0])


def by_integration(numbers: ElasticDelayed, kp: float, kd: float, target: float, steps: int, step: float) -> np.ndarray:
    """Means of the spring's torque over each step, on a link that is locked at 0.

    By an integrator of ordinary differential equations, which stops at each sample, at each arrival and at the ends of the steps.
    """
    j, stiffness, damping, w = numbers.motor_inertia, numbers.gearbox_stiffness, numbers.gearbox_damping, numbers.bandwidth
    paths = [[numbers.delay, numbers.period, kp, kd]]
    if numbers.is_split:
        paths = [[numbers.delay, numbers.period, kp, 0.0], [numbers.kd_delay, numbers.kd_period, 0.0, kd]]
    end = steps * step
    samples = sorted({(round(k * path[1], 12), number) for number, path in enumerate(paths) for k in range(int(end / path[1]) + 1)})
    times = sorted(
        {round(t, 12) for t, _ in samples}
        | {round(t + paths[n][0], 12) for t, n in samples}
        | {round(k * step, 12) for k in range(steps + 1)}
    )
    state, last, sent, impulse = np.zeros(5), [0.0] * len(paths), [], [0.0]

    def flow(_, x, u):
        torque = u if math.isinf(w) else x[2]
        spring = stiffness * x[0] + damping * x[1]
        current = [0.0, 0.0] if math.isinf(w) else [x[3], w * w * (u - x[2]) - 1.8 * w * x[3]]
        return [x[1], (torque - spring - numbers.viscous * x[1]) / j, *current, spring]

    for now, later in pairwise(times):
        if now >= end - 1e-12:
            break
        for number, (delay, period, own_kp, own_kd) in enumerate(paths):
            if (now, number) in samples:
                sent.append((round(now + delay, 12), number, own_kp * (target - state[0]) - own_kd * (state[0] - last[number]) / period))
                last[number] = state[0]
        held = sum(next((u for t, n, u in reversed(sent) if n == number and t <= now + 1e-12), 0.0) for number in range(len(paths)))
        state = solve_ivp(flow, (now, later), state, args=(held,), rtol=1e-10, atol=1e-13).y[:, -1]
        if abs(later / step - round(later / step)) < 1e-6:
            impulse.append(state[4])
    return np.diff(impulse) / step


NUMBERS = {
    "plain": replace(SOFT, delay=1.7e-3),
    "viscous": replace(SOFT, viscous=0.7, delay=2.2e-3),
    "current loop": replace(SOFT, bandwidth=900.0, delay=1.1e-3),
    "split": replace(SOFT, period=2e-3, delay=3.1e-3, kd_period=5e-4, kd_delay=0.2e-3),
}


@pytest.mark.parametrize("name", NUMBERS)
def test_the_motor_moves_as_an_integrator_has_it(name: str):
    """Within 1e-3 of the largest: in the substep of an arrival the command is a line with its mean and first moment, which costs 1e-4."""
    numbers, step, steps = NUMBERS[name], 2e-3, 40
    motor = single(numbers, step)
    given = [np.zeros((1, 1)), np.zeros((1, 1)), np.full((1, 1), 0.1), np.zeros((1, 1)), np.zeros((1, 1))]
    gains = [np.full((1, 1), 200.0), np.full((1, 1), 4.0), np.full((1, 1), math.inf)]
    found = np.array([motor.torque(*given, *gains)[0, 0] for _ in range(steps)])
    expected = by_integration(numbers, 200.0, 4.0, 0.1, steps, step)
    assert_allclose(found, expected, atol=1e-3 * np.abs(expected).max())


def test_no_momentum_is_lost():
    """Without gains, friction and limits the sum of both momenta stays, to round-off, whatever the step of the simulator."""
    motor, inertia, step = single(replace(SOFT, gearbox_damping=2.0), 4e-3), 0.5, 4e-3
    position, speed, nothing = np.zeros((1, 1)), np.zeros((1, 1)), np.zeros((1, 1))
    motor.torque(position, speed, nothing, nothing, nothing, nothing, nothing, nothing)
    speed, total, motors = np.ones((1, 1)), [], []  # a blow on the link
    for _ in range(50):
        torque = motor.torque(position, speed, nothing, nothing, nothing, nothing, nothing, nothing)
        speed = speed + step * torque / inertia
        position = position + step * speed
        motors.append(float(motor._all[0, 0, 1]))
        total.append(inertia * speed[0, 0] + SOFT.motor_inertia * motors[-1])
    assert np.ptp(motors) > 0.5  # they do exchange it
    assert_allclose(total, inertia * 1.0, rtol=1e-12)


def test_friction_holds_the_motor_exactly_and_slows_it_by_its_torque():
    numbers = replace(SOFT, friction=3.0, delay=0.0)
    motor = single(numbers)
    torques(motor, [2.9] * 500)
    assert float(motor.motor_position[0, 0]) == pytest.approx(0.0, abs=1e-15)  # round-off: it sticks, and does not creep
    torques(motor, [10.0] * 4000)
    rest = float(motor.motor_position[0, 0])  # it stops where the spring's torque is within friction of the motor's
    assert abs(10.0 - numbers.gearbox_stiffness * rest) <= 3.0 + 1e-9
    torques(motor, [10.0] * 100)
    assert float(motor.motor_position[0, 0]) == pytest.approx(rest, rel=1e-12)
    free = single(replace(numbers, gearbox_stiffness=1e-9, gearbox_damping=0.0))
    torques(free, [5.0] * 100)  # 2 N m are left for 0.1 s: a closed form
    assert float(free.motor_position[0, 0]) == pytest.approx(0.5 * (5.0 - 3.0) / numbers.motor_inertia * 0.1**2, rel=1e-9)


def test_each_command_has_a_delay_of_its_own_from_the_range():
    """A single torque of one period, behind 1 ms and up to 0.8 ms more: its mean arrival and its spread are those of the range."""
    motor = single(replace(RIGID, delay=1e-3, jitter=8e-4), library=Library.numpy(3), envs=4000)
    found = torques(motor, [1.0, 1.0, 1.0])
    late = 1 - found[1]  # part of the second step in which the first command is not there yet
    assert late.min() >= 0
    assert late.max() <= 0.8
    assert late.mean() == pytest.approx(0.4, abs=4 * 0.8 / math.sqrt(12 * 4000))  # four standard deviations
    assert late.std() == pytest.approx(0.8 / math.sqrt(12), rel=0.05)


def test_what_a_later_command_overtook_is_dropped():
    """The first command would come after 2.9 ms, the second, sent a step later, after 1 ms: the first is never there."""
    draws = iter([0.9, 0.0, 0.0, 0.0, 0.0])
    library = Library(np, lambda values: np.asarray(values, dtype=float), lambda shape: np.full(shape, next(draws)))
    numbers = replace(RIGID, delay=1e-3, jitter=2e-3)
    found = torques(single(numbers, library=library), [100.0, 2.0, 3.0, 4.0])[:, 0]
    assert_allclose(found, [0.0, 0.0, 2.0, 3.0], atol=1e-12)


def test_jitter_is_repeated_with_its_seed():
    first, same, other = (torques(single(replace(RIGID, jitter=5e-4, seed=seed)), range(20)) for seed in (1, 1, 2))
    assert_allclose(first, same, atol=0)
    assert np.abs(first - other).max() > 0.01


def test_a_reset_is_of_its_environments_alone():
    """The rotor is then where the link is, and no command is under way; the others go on as if nothing was."""
    numbers = replace(SOFT, delay=2e-3)
    motor, beside = (single(numbers, envs=2) for _ in range(2))
    for each in (motor, beside):
        torques(each, [5.0] * 10)
    motor.reset(np.array([1]))
    found, expected = torques(motor, [0.0] * 3, position=0.2), torques(beside, [0.0] * 3, position=0.2)
    assert_allclose(found[:, 0], expected[:, 0], atol=0)
    assert_allclose(found[:, 1], 0.0, atol=1e-12)  # for as long as commands take
    assert float(motor.motor_position[1, 0]) == pytest.approx(0.2)


REFUSED = [
    ({"period": 0.7e-3 * math.pi}, "actuator: period 2.19911 ms and the physics step 1 ms must be multiples of one time, at least 1/100"),
    ({"period": 1e-3, "kd_period": 1e-3 / 101}, "must be multiples of one time"),
    ({"gearbox_damping": 1.0}, "gearbox_damping 1 N·m·s/rad acts on nothing where the gearbox is rigid"),
    ({"encoder": "torque"}, "encoder 'torque' must be one of motor, link"),
    ({"delay": -1e-3}, "delay"),
    ({"kd_period": 0.0}, "kd_period"),
    ({"gearbox_stiffness": 1e3, "motor_inertia": 0.0}, "motor_inertia"),
]


@pytest.mark.parametrize(("others", "said"), REFUSED, ids=lambda value: "" if isinstance(value, str) else "/".join(value))
def test_what_cannot_be_is_refused_in_one_line(others, said):
    with pytest.raises(GainroomError) as refused:
        single(replace(RIGID, **others))
    assert said in str(refused.value)
    assert "\n" not in str(refused.value)


def test_substeps_are_as_few_as_the_periods_allow():
    for period, step, count in ((1e-3, 5e-3, 5), (2e-3, 5e-3, 5), (2e-2, 5e-3, 1), (1 / 3000, 5e-3, 15), (5e-3, 2e-3, 2)):
        assert single(replace(RIGID, period=period), step).substeps == count
    assert single(replace(RIGID, period=1e-3 / MOST_SUBSTEPS), 1e-3).substeps == MOST_SUBSTEPS


def test_a_step_at_which_links_explode_is_refused():
    """Of links that are stepped explicitly at Ω dt = 2; with an inertia that is known to a factor 1.6 not there yet."""
    inverse = np.linalg.inv(LEG.inertia())
    ankle = LEG.actuators["ankle"]
    longest = 2 / math.sqrt(ankle.gearbox_stiffness * inverse[2, 2])
    ankle.require_step("ankle", 0.99 * longest, inverse[2, 2])
    with pytest.raises(GainroomError, match=r"ankle: gearbox_stiffness 2500 N·m/rad on a link of .* needs a physics step below"):
        ankle.require_step("ankle", 1.01 * longest, inverse[2, 2])
    RIGID.require_step("rigid", 1.0, 1e9)
    cases = ((0.95, None), (1.05, None), (1.05, 1.0), (1.05, 0.6), (1.05, 1.6))
    assert [grows(part * 2, known) for part, known in cases] == [False, True, False, False, False]


def grows(share: float, known: float | None) -> bool:
    """Motion of a link on a spring whose rotor is too heavy to move, at Ω dt = `share`: True if it explodes; `known` as in `simulated`."""
    link, position, speed, nothing = 0.2, np.full((1, 1), 1e-3), np.zeros((1, 1)), np.zeros((1, 1))
    step = share / math.sqrt(SOFT.gearbox_stiffness / link)
    numbers = replace(SOFT, motor_inertia=1e9, gearbox_damping=0.0, period=step)
    motor = ElasticDelayedJoints(numbers, step, 1, 1, None if known is None else [known * link])
    motor.torque(nothing, nothing, nothing, nothing, nothing, nothing, nothing, nothing)
    for _ in range(300):
        speed = speed + step / link * motor.torque(position, speed, nothing, nothing, nothing, nothing, nothing, nothing)
        position = position + step * speed
    return not abs(float(position[0, 0])) < 1.0
