"""The tracker's headers in C++ programs of their own: the control loop that is an example, ticks without memory, and hostile ones."""

from pathlib import Path

import numpy as np
import pytest

import gainroom as gr
from gainroom.native import _core
from native_programs import SANITIZED, compiled, output

TESTS = Path(__file__).parent
PERIOD = 5e-4


def example_joints():
    return np.array([[0.3 if i % 2 else 0.5, 0.2, 0, 8e3, 2.0, 4000.0, 0.9, 2e-3, 1800.0, 80.0 if i % 2 else 90.0] for i in range(4)])


@pytest.mark.slow
@pytest.mark.parametrize("options", [(), ("-O3", "-march=native")], ids=["Og", "O3"])
def test_control_loop(options):
    """Every tick of the example gives what Python gives for its matrices, and some of its limits are compared with gain_limit."""
    program = compiled(TESTS.parent / "examples" / "control_loop.cpp", *options)
    table = example_joints()
    tracker = _core.GainTracker(table, PERIOD, 7, 4, 4, 0.0, 0.0)
    drive, pd = gr.Drive(4000.0, 0.9, 2e-3), gr.PD(table[:, 8], table[:, 9])
    ticks = [line.split() for line in output(program, "trace").splitlines()]
    assert len(ticks) == 4000
    certified = 0
    for number, words in enumerate(ticks):
        contact, rows = int(words[0]), int(words[1])
        split = 2 + 49 + 7 * rows
        numbers = np.array([float.fromhex(word) for word in words[2:split]])
        gain, frequency, safe = (float.fromhex(words[split + k]) for k in (0, 1, 4))
        mass, held = numbers[:49].reshape(7, 7), numbers[49:].reshape(rows, 7)
        if number == 0:  # both feet; in this posture every contact state has been settled
            for state, kept in enumerate((held, held[:2], held[2:], held[:0])):
                assert any(tracker.update(mass, [kept], state)[2] for _ in range(20_000))
        found = tracker.update(mass, [held], contact)
        assert (found[0], found[1], found[4]) == pytest.approx((gain, frequency, safe), rel=1e-12, nan_ok=True)
        assert [found[2], found[3]] == [words[split + 2] == "1", int(words[split + 3])]
        certified += found[2]
        if found[2] and number % 400 == 399:
            motor, viscous, _, stiffness, damping = table[:, :5].T
            plant = gr.Plant(tracker.inverse, motor, stiffness, damping, viscous)
            assert gain == pytest.approx(gr.gain_limit(gr.build_loop(plant, drive, pd, "motor", PERIOD)).gain, rel=1e-8)
        other = np.array([float.fromhex(word) for word in words[split + 6 :]]).reshape(int(words[split + 5]), 7)
        if len(other):
            tracker.prepare([other], number // 4 % 3)
    assert certified > 0.99 * len(ticks)
    said = output(program).splitlines()
    assert "not certified" not in said[0]
    assert float(said[-2].split()[-1]) == pytest.approx(gain / 2, abs=1e-3)  # the factor on the gains has risen to what the margin allows


def words(values) -> str:
    return " ".join(float(value).hex() for value in np.ravel(values))


def ticks_text(table, sample_time, size, rows, contacts, ticks, gains=None, tasks=()) -> str:
    """`tasks`: their Jacobian at every tick, with `gains` (2, m)."""
    gains = np.zeros((2, 0)) if gains is None else gains
    head = f"{len(table)} {size} {rows} {contacts} {sample_time.hex()} {gains.shape[1]} {words(table)} {words(gains)}"
    tasks = tasks or [np.zeros(0)] * len(ticks)
    lines = (
        f"{contact} {len(held)} {words(mass)} {words(held)} {words(task)}" for (contact, mass, held), task in zip(ticks, tasks, strict=True)
    )
    return "\n".join([head, *lines])


def hostile_ticks(rng: np.random.Generator, count: int):
    """Matrices of every sort, most of them none that a robot has."""
    for k in range(count):
        root = rng.normal(size=(5, 5))
        mass, held = root @ root.T + np.eye(5), rng.normal(size=(int(rng.integers(0, 4)), 5))
        kind = k % 12
        if kind == 1:
            mass[rng.integers(5), rng.integers(5)] = rng.choice([np.nan, np.inf, -np.inf])
        elif kind == 2:
            mass *= 10.0 ** rng.uniform(-300, 300)
        elif kind == 3:
            mass -= 5 * np.eye(5)
        elif kind == 4:
            held = held * rng.choice([np.nan, 0.0, np.inf, 1e300, 1e-300])
        elif kind == 5:
            held = np.repeat(rng.normal(size=(1, 5)), 3, axis=0)
        yield (int(rng.integers(-2, 4)) if kind == 6 else int(rng.integers(0, 2))), mass, held


@pytest.mark.slow
@pytest.mark.parametrize("every", [False, pytest.param(True, marks=pytest.mark.population)], ids=["share", "all"])
def test_ticks_take_no_memory_and_hostile_ones_end(every: bool):
    """No tick takes memory; whatever comes in, an answer comes out, and none of it that is no number is called certified or safe.

    Joints that no robot has come in joint space, with a task of few directions or of many: in turn, or all with `every`.
    """
    program = compiled(TESTS / "native" / "ticks.cpp", *SANITIZED)
    rng = np.random.default_rng(3)
    good = np.array([[0.5, 0.1, 0.1, 8e3, 2.0, 4000.0, 0.9, 2e-3, 900.0, 45.0]] * 3)
    tables = [(good, 0.0), (good, PERIOD), (np.where(np.arange(10) == 3, np.inf, good), PERIOD)]
    for column in range(10):
        for odd in (0.0, np.nan, -1.0, 1e300):
            tables.append((np.where(np.arange(10) == column, odd, good), PERIOD if column % 2 else 0.0))
    for number, (table, sample_time) in enumerate(tables):
        ticks = list(hostile_ticks(rng, 60 if number < 3 else 12))
        texts = [ticks_text(table, sample_time, 5, 3, 2, ticks)]
        for size in (2, 5):  # of a task's directions: fewer than joints, and more
            gains = np.array([rng.uniform(0, 200, size), rng.uniform(0, 20, size)])
            tasks = [rng.normal(size=(size, 5)) for _ in ticks]
            tasks[3] = tasks[3] * rng.choice([np.nan, np.inf, 0.0, 1e300])
            tasks[5][1] = tasks[5][0]
            texts.append(ticks_text(table, sample_time, 5, 3 + size % 2, 2, ticks, gains, tasks))
        texts = texts if every or number < 3 else [texts[number % 3]]
        lines = [line for text in texts for line in output(program, given=text).splitlines()]
        assert len(lines) == len(texts) * len(ticks)
        for line in lines:
            gain, _, certified, _, safe, flag = line.split()
            gain, safe = float.fromhex(gain), float.fromhex(safe)
            assert safe >= 0, table
            assert not gain < safe, table
            assert certified == "0" or (flag == "0" and gain > 0)


def test_a_long_row_count_is_refused():
    tracker = _core.GainTracker(example_joints(), PERIOD, 7, 4, 4, 0.0, 0.0)
    for mass, rows in ((np.eye(6), np.zeros((0, 7))), (np.eye(7), np.zeros((5, 7))), (np.eye(7), np.zeros((1, 6)))):
        with pytest.raises(ValueError, match=r"shape|columns"):
            tracker.update(mass, [rows], 0)
    with pytest.raises(ValueError, match="at least as many"):
        _core.GainTracker(example_joints(), PERIOD, 3, 4, 4, 0.0, 0.0)
