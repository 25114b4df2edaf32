"""State-space algebra, the exact hold against fine integration, transmission zeros."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import gainroom as gr
from gainroom.system.linear.state_space import StateSpace, factored, hold, realize, zeros_of
from gainroom.system.linear.transfer_function import Factored, polynomial_roots, ratio

S = np.array([0.2j, 3j, 50j, 1 + 4j, -0.5 + 700j])


def random_system(rng: np.random.Generator, states: int, inputs: int = 1, outputs: int = 1, direct: bool = True) -> StateSpace:
    """Time constants around a second."""
    d = rng.normal(size=(outputs, inputs)) if direct else np.zeros((outputs, inputs))
    return StateSpace(
        rng.normal(size=(states, states)) - np.eye(states), rng.normal(size=(states, inputs)), rng.normal(size=(outputs, states)), d
    )


def test_algebra_is_that_of_transfer_matrices():
    rng = np.random.default_rng(1)
    first, second, third = random_system(rng, 3, 2, 4), random_system(rng, 2, 4, 2), random_system(rng, 1, 2, 2)
    assert (second @ first).at(S) == pytest.approx(second.at(S) @ first.at(S), rel=1e-10)
    assert (second @ first + third).at(S) == pytest.approx(second.at(S) @ first.at(S) + third.at(S), rel=1e-10)
    beside = first.beside(third).at(S)
    assert beside[:, :4, :2] == pytest.approx(first.at(S), rel=1e-10)
    assert beside[:, 4:, 2:] == pytest.approx(third.at(S), rel=1e-10)
    assert not np.any(beside[:, :4, 2:])
    twice = third.repeated(2).at(S)
    assert twice[:, :2, :2] == pytest.approx(third.at(S), rel=1e-10)
    assert twice[:, 2:, 2:] == pytest.approx(third.at(S), rel=1e-10)
    assert StateSpace.gain(np.array([[2.0]])).at(S)[:, 0, 0].tolist() == [2.0] * len(S)


@pytest.mark.parametrize("first", [0, 3, 5])
def test_states_that_nothing_acts_on_are_solved_first(first):
    """Current loops before a plant: the same response as from the whole matrix, which a random change of basis leaves full."""
    rng = np.random.default_rng([3, first])
    system = random_system(rng, 8, 2, 2)
    system.a[:first, first:] = 0.0
    assert system.lead == first
    turn = np.linalg.qr(rng.normal(size=(8, 8)))[0]
    full = StateSpace(turn.T @ system.a @ turn, turn.T @ system.b, system.c @ turn, system.d)
    assert full.lead == 0
    assert system.at(S) == pytest.approx(full.at(S), rel=1e-10)
    held = hold(StateSpace(system.a, system.b, system.c, np.zeros((2, 2))), np.zeros(2), 0.1)
    assert held.lead == first
    steps = hold(StateSpace(full.a, full.b, full.c, np.zeros((2, 2))), np.zeros(2), 0.1)
    assert held.at(S) == pytest.approx(steps.at(S), rel=1e-9)


@pytest.mark.parametrize("seed", range(30))
def test_realize_is_the_ratio(seed):
    """Poles and zeros over four decades, pairs and reals, some at zero."""
    rng = np.random.default_rng([2, seed])

    def roots(pairs: int, reals: int) -> np.ndarray:
        size = 10.0 ** rng.uniform(-1, 3, pairs)
        pair = size * np.exp(1j * rng.uniform(np.pi / 2, np.pi, pairs))
        return np.concatenate([pair, pair.conj(), -(10.0 ** rng.uniform(-1, 3, reals)), np.zeros(int(rng.integers(0, 3)))]).astype(complex)

    poles = roots(int(rng.integers(1, 4)), int(rng.integers(0, 4)))
    zeros = roots(int(rng.integers(0, 3)), int(rng.integers(0, 3)))[: len(poles)]
    zeros = zeros if np.isclose(np.sum(zeros.imag), 0) else zeros[zeros.imag == 0]
    system = Factored(zeros, poles, 3.7)
    omega = np.array([0.02, 1.3, 40.0, 9000.0])
    expected = system.response(omega)
    # Away from the poles each section is well scaled; a section's own cancellation near a zero is at most its peak times 1e-16.
    assert realize(system).at(1j * omega)[:, 0, 0] == pytest.approx(expected, rel=1e-8)


def test_improper_is_refused():
    with pytest.raises(gr.GainroomError, match="2 zeros and 1 poles is improper"):
        realize(ratio([1.0, 1.0, 1.0], [1.0, 2.0]))


def stepped(system: StateSpace, delays: np.ndarray, sample_time: float, inputs: np.ndarray) -> np.ndarray:
    """Outputs (ticks, outputs) at the sampling instants, by integrating x' = A x + B u(t − T) piece by piece. inputs (ticks, inputs)."""
    ticks = len(inputs)

    def held(t: float) -> np.ndarray:
        late = np.floor((t - delays) / sample_time + 1e-9).astype(int)
        return np.array([inputs[k, i] if 0 <= k < ticks else 0.0 for i, k in enumerate(late)])

    switches = np.unique(np.round(np.concatenate([np.arange(ticks) * sample_time + d for d in (0.0, *delays)]), 12))
    switches = switches[switches <= (ticks - 1) * sample_time + 1e-12]
    state, outputs = np.zeros(len(system.a)), []
    for start, end in zip(switches, np.append(switches[1:], np.nan), strict=True):
        if abs(start / sample_time - round(start / sample_time)) < 1e-6:
            outputs.append(system.c @ state)
        if np.isfinite(end):
            u = held(0.5 * (start + end))
            solved = solve_ivp(lambda t, x, u=u: system.a @ x + system.b @ u, (start, end), state, method="DOP853", rtol=1e-12, atol=1e-14)
            state = solved.y[:, -1]
    return np.array(outputs)


@pytest.mark.parametrize(
    "ticks_late",
    [(0.0, 0.0), (1.0, 0.0), (0.3, 0.3), (0.3, 0.8), (2.0, 3.7), (0.999, 1.0), (4.0, 0.25)],
    ids=lambda late: f"{late[0]} and {late[1]}",
)
def test_hold_is_fine_integration(ticks_late):
    """Two inputs with their own delays; the sampled system must repeat what integration between the switches gives."""
    rng, sample_time = np.random.default_rng(3), 0.2
    system = random_system(rng, 3, 2, 2, direct=False)
    delays = np.array(ticks_late) * sample_time
    inputs = rng.normal(size=(14, 2))
    sampled = hold(system, delays, sample_time)
    state, outputs = np.zeros(len(sampled.a)), []
    for u in inputs:  # z x = x + T_s δ x
        outputs.append(sampled.c @ state + sampled.d @ u)
        state = state + sample_time * (sampled.a @ state + sampled.b @ u)
    # The integrator's 1e-12 per step, growing by less than 10 over fourteen unit time constants.
    assert np.array(outputs) == pytest.approx(stepped(system, delays, sample_time, inputs), abs=1e-10)


def test_whole_ticks_survive_rounding():
    """2.5 ms is five ticks of 0.5 ms, 0.3 ms three of 0.1 ms, although neither quotient need be whole in floating point."""
    system = random_system(np.random.default_rng(4), 2, direct=False)
    for ticks, sample_time in ((5, 5e-4), (3, 1e-4), (7, 1e-3 / 3), (6, 0.7e-3)):
        sampled = hold(system, np.array([ticks * sample_time]), sample_time)
        assert len(sampled.a) == 2 + ticks
    assert len(hold(system, np.array([0.3 - 0.2]), 0.1).a) == 3


def test_hold_of_a_fast_tick_tends_to_the_continuous_system():
    """Hold and fraction of a tick cost half a tick plus the delay in phase; magnitudes differ by (ωT_s)²/24."""
    system = random_system(np.random.default_rng(5), 3, direct=False)
    omega, step = np.array([0.1, 1.0, 5.0]), 1e-5
    v = np.expm1(1j * omega * step) / step
    found = hold(system, np.array([0.4 * step]), step).at(v)[:, 0, 0]
    assert found == pytest.approx(system.at(1j * omega)[:, 0, 0] * np.exp(-0.9j * omega * step), rel=1e-9)


@pytest.mark.parametrize("seed", range(20))
def test_zeros_and_gain_come_back(seed):
    """From a state space to zeros, poles, gain: the response is the same."""
    rng = np.random.default_rng([6, seed])
    system = random_system(rng, int(rng.integers(1, 7)), direct=seed % 2 == 0)
    poles = np.linalg.eigvals(system.a).astype(complex)
    found = factored(system, poles, None)
    assert found.at(S) == pytest.approx(system.at(S)[:, 0, 0], rel=1e-8)  # poles by eigenvalues: 1e-15 times a condition below 1e5
    for zero in zeros_of(system):
        assert abs(system.at(np.array([zero]))[0, 0, 0]) < 1e-8 * np.abs(system.c).max() * np.abs(system.b).max()


def test_zeros_of_a_known_system():
    a = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [-6.0, -11.0, -6.0]])
    system = StateSpace(a, np.array([[0.0], [0.0], [1.0]]), np.array([[5.0, 2.0, 1.0]]), np.zeros((1, 1)))
    assert sorted(zeros_of(system), key=lambda z: z.imag) == pytest.approx([-1 - 2j, -1 + 2j], rel=1e-13)


@pytest.mark.parametrize(
    ("polynomial", "roots"),
    [
        ([2.0, -6.0], [3.0]),
        ([1.0, 0.0, 0.0], [0.0, 0.0]),
        ([1.0, 3.0, 2.0, 0.0], [0.0, -1.0, -2.0]),
        ([1.0, 1e8, 1.0], [-1e8, -1e-8]),
        ([0.0, 1.0, 0.0, 4.0], [-2j, 2j]),
        ([5.0], []),
        ([1.0, 2.0, 1.0], [-1.0, -1.0]),
    ],
)
def test_polynomial_roots(polynomial, roots):
    found = polynomial_roots(polynomial)
    order = lambda z: (round(z.real, 6), round(z.imag, 6))  # noqa: E731
    assert sorted(found, key=order) == pytest.approx(sorted(np.array(roots, dtype=complex), key=order), rel=1e-15)


def test_badly_scaled_polynomial_keeps_its_digits():
    """Roots from 1e-3 to 1e9, as a slow integrator and a fast current loop give."""
    roots = np.array([-1e-3, -2.0, -30.0, -4e3, -1e9])
    assert np.sort(polynomial_roots(np.poly(roots)).real) == pytest.approx(np.sort(roots), rel=1e-9)


def test_zero_polynomial_has_no_roots():
    with pytest.raises(gr.GainroomError, match="zero polynomial"):
        polynomial_roots([0.0, 0.0])


@pytest.mark.parametrize(
    ("first", "size", "halves"), [(1, 10, False), (2, 10, False), (3, 10, True), (5, 10, True), (9, 10, False), (1, 3, True)]
)
def test_states_are_solved_apart_where_that_halves_the_work(first, size, halves):
    """Solving takes the cube of the states: k³ + (n − k)³ against n³, as 2³ + 8³ = 520 and 3³ + 7³ = 370 of 1000, 1 + 8 = 9 of 27."""
    system = random_system(np.random.default_rng([first, size]), size)
    system.a[:first, first:] = 0.0
    assert system.lead == (first if halves else 0)
