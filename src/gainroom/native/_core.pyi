"""Functions and classes of the C++ core, bound in bindings/.

Arrays that are read are copied unless they are contiguous and of doubles (integers: int64); those that are written have to be.
Shapes that do not fit raise ValueError. The headers include/gainroom/*.hpp document what the functions compute.
"""

from collections.abc import Callable
from typing import overload

from ..system.linear.arrays import Booleans, Complexes, Floats, Integers

FLOOR: float
LOWEST_FLOOR: float
DISK_TOLERANCE: float

def scan(
    zeros: Complexes, poles: Complexes, gain: float, delay: float, sample_time: float, with_peaks: bool
) -> tuple[Floats, Floats, Floats, float, bool]: ...
def quadratic_programme(
    bend: Floats, pull: Floats, slope: Floats, value: Floats, penalty: float, low: Floats, high: Floats
) -> tuple[Floats, float]:
    """Solution x (1, n) with low ≤ x ≤ high, and t ≥ 0, of the smallest ½ Σ bend x² + pull·x + penalty t + ½ t² with value + slope x ≤ t.

    slope (m, n); value (m,); the others (n,), bend > 0.
    """

def link_compliance(springs: Floats, joints: int, inner: Floats, omega: Floats, stiffness: Complexes, whole: bool) -> Complexes:
    """Compliance of link_compliance.hpp at s = jω (k,): its diagonal (k, n), or `whole` (k, n n).

    springs H (c, r), its first n = `joints` rows R; inner G (r, r); stiffness Y (k, c).
    """

def response(zeros: Complexes, poles: Complexes, gain: float, delay: float, sample_time: float, points: Complexes) -> Complexes:
    """Response at s = points (k,), of factors.hpp; sample_time 0: continuous."""

def response_and_slope(
    zeros: Complexes, poles: Complexes, gain: float, delay: float, sample_time: float, omega: Floats
) -> tuple[Complexes, Complexes]:
    """Response at s = jω (k,) and its derivative by ω."""

def sample(zeros: Complexes, poles: Complexes, gain: float, sample_time: float, fraction: float) -> tuple[Complexes, Complexes, float]:
    """Sampled system of sampling.hpp: zeros, poles and gain in δ; no poles if the numbers are too far apart in size."""

def delay_margin(
    zeros: Complexes,
    poles: Complexes,
    gain: float,
    delay: float,
    control_zeros: Complexes,
    control_poles: Complexes,
    control_gain: float,
    sample_time: float,
    unstable_poles: int,
    crossings: Floats,
) -> tuple[int, float, float]:
    """Delay margin of scalar_delay_margin.hpp: outcome (the number of its enum), extra delay [s] and ω [rad/s]; crossings (k, 2)."""

def split_delays(delays: Floats, sample_time: float) -> Floats:
    """Whole ticks and the rest as a fraction of a tick (k, 2) of delays (k,) [s]."""

def unstable_roots(gains: Floats, phases: Floats, half_turns: float, unstable_poles: int) -> float: ...
def half_encirclements(start_phase: float, outside: bool, ends_on_boundary: bool, last_phase: float, gains: Floats) -> float: ...
def assigned(cost: Floats) -> Integers:
    """Column (n,) assigned to each row at the least total of `cost` (n, n); ValueError if that is not finite."""

def paired(before: Complexes, after: Complexes) -> Integers:
    """Index (k, n) of the eigenvalue `after` (k, n) that continues each one `before`, as in locus_step.hpp; ValueError if not finite."""

class ModalLoop:
    """Loop of modal_loop.hpp; rigid (n, n), real unless `twofold`; shapes (m, n), poles (m,), partners (m,) or (0,)."""

    def __init__(
        self,
        rigid: Complexes,
        twofold: bool,
        shapes: Complexes,
        poles: Complexes,
        partners: Complexes,
        bandwidth: float,
        damping_ratio: float,
        fraction: float,
        step: float,
        inexact: float,
    ) -> None: ...
    def set_laws(self, zeros: Complexes, poles: Complexes, counts: Integers, gains: Floats, delays: Floats) -> None:
        """Sets the control laws: zeros, and poles, joint by joint; counts (n, 2) of them, gains and delays (n,)."""

    def responses(self, omega: Floats) -> tuple[Complexes, Complexes]:
        """Responses f₀ and f_k (k, 1 + m), and d (k, n), at omega (k,)."""

    def mobility(self, s: Complexes) -> Complexes:
        """Mobility P (k, n²) at s (k,), |Re s| < 1e-6 Im s; sampled: behind hold, current loop and the fraction of a tick."""

    def bends(self, omega: Floats) -> tuple[Floats, Floats]:
        """Bounds of the interpolation error of `responses` from each ω to the next: (k − 1, 1 + m), (k − 1, n)."""

    def limit(
        self,
        grid: Floats,
        start: float,
        stop: float,
        nudge: float,
        floor: float,
        passive: bool,
        counting: bool,
        bases: Complexes,
    ) -> tuple[bool, Floats, Complexes, Floats, tuple[float, float, float]]:
        """Limit of coupled_limit.hpp for factors from `start` to `stop`; bases (k − 1, n, n) or (0, n, n).

        Returns: proved or not; (k, 3) ω, gain and growth rate of crossings; their vectors (k, n); (k, 2) undecided intervals; turned, tail
        and end.
        """

    def searched(self, low: float, high: float, gain: float, passive: bool) -> Floats:
        """Parts (k, 2) of [low, high] rad/s in which factors up to `gain` may put a root on the boundary."""

    def excluded(
        self, low: float, high: float, start: float, gain: float, basis: Complexes, floor: float, most: int, counting: bool
    ) -> tuple[bool, float]:
        """Proof that no factor from `start` to `gain` puts a root in [low, high], in coordinates of `basis` (n, n), vectors in rows.

        Returns: proved or not, and the change of arg det F on the interval.
        """

class PostureLimits:
    """Limits of posture_limits.hpp: a loop's laws with the modes of one posture after the other."""

    def __init__(self, loop: ModalLoop, slow: float, fast: float, highest: list[float], passive: bool) -> None: ...
    def run(self, rigid: Floats, shapes: Floats, poles: Complexes, partners: Complexes, inexact: Floats) -> tuple[Integers, Floats]:
        """Limits of ModeStacks of k postures: (k, 1) 1 if proved; (k, 3) gain, ω and the index of the joint that moves most."""

class Body:
    """Joint of motion.hpp; positions, rates, entries (2, m)."""

    def __init__(
        self, system: Floats, positions: Floats, rates: Floats, entries: Floats, current: Floats, ideal: bool, coordinates: int
    ) -> None: ...
    @property
    def positions(self) -> Floats: ...
    @property
    def rates(self) -> Floats: ...
    @property
    def coordinates(self) -> int: ...

class Control:
    """Control law of testbed.hpp; velocity None: made from what `side` measures; torque (m,): the spring's, in the body's states."""

    def __init__(
        self, a: Floats, b: Floats, c: Floats, d: Floats, side: int, velocity: int | None = None, torque: Floats | None = None
    ) -> None: ...

class Hardware:
    """Hardware of testbed.hpp; laws (2, 5), gravity (2,), resolution (2,)."""

    def __init__(
        self, tick: float, cells: int, laws: Floats, gravity: Floats, torque_limit: float, resolution: Floats, position_limit: float
    ) -> None: ...

class SecondPath:
    """Part of the control law that samples `every` so many ticks, its commands `whole` ticks and a fraction of one late."""

    def __init__(self, control: Control, every: int, whole: int, fraction: float) -> None: ...

class Testbed:
    """Testbed of one joint at some tick, from `state` (m,). For one thread at a time.

    `control` samples `every` so many ticks; none of its commands takes more than `longest` whole ticks.
    """

    def __init__(
        self,
        body: Body,
        control: Control,
        hardware: Hardware,
        state: Floats,
        longest: int,
        every: int = 1,
        second: SecondPath | None = None,
    ) -> None: ...
    def advance(self, given: Floats, whole: Integers, fraction: Floats, torque_noise: Floats | None = None) -> Floats:
        """Rows (made, 7) of the next k samples of `control`, fewer if a position is out of bounds.

        given             (k, 7) reference, motion, feedforward, torques and noises of motor and link
        whole, fraction   (k,) delays of the commands [ticks]
        torque_noise      (k,) of the torque's reading [N m]; None: 0

        Columns of what comes out: positions and readings of motor and link, target, demand and actual torque.
        """

def substep(body: Body, hardware: Hardware, state: Floats, bent: Floats, width: float, torques: Floats) -> None:
    """Moves `state` (m,) and `bent` (2,) by one substep."""

def recur(transposed: Floats, forcing: Floats, states: Floats, limit: float) -> int:
    """Fills `states` (k + 1, m) from its first row."""

def recur_late(
    transposed: Floats, forcing: Floats, rows: Floats, before: Floats, after: Floats, whole: Integers, part: Floats, states: Floats
) -> int:
    """Recurrence as `recur`, less the outputs `rows` (n, m) of its states, which return `whole` + `part` (n,) steps late."""

def predict_torque(
    command: Floats,
    changes: Floats,
    torque: Floats,
    fresh: Booleans,
    tick: Floats,
    parts: Floats,
    noises: Floats,
    gain: float,
    offset: float,
    noise: float,
    unknown: float,
    error: Floats,
    variance: Floats,
) -> None:
    """Fills `error` and `variance` (m,)."""

def decode(
    target: Floats,
    torque: Floats,
    transition: Floats,
    full: Floats,
    part: Floats,
    gain: float,
    offset: float,
    noise: float,
    first: int,
    last: int,
    change_cost: float,
    age: Integers,
) -> None:
    """Fills `age` (m,)."""

def predict(
    a: Floats,
    b: Floats,
    c: Floats,
    gains: Floats,
    regime: Integers,
    inputs: Floats,
    outputs: Floats,
    state: Floats,
    errors: Floats,
) -> None:
    """Fills `errors` (m, o), and changes `state` (n,)."""

def link_inverse_inertia(mass: Floats, rows: Floats, joints: int) -> Floats:
    """Inverse inertia W (n, n) of the links, of link_inertia.hpp."""

class GainTracker:
    """Tracker of tracker.hpp; joints (n, 10) in the order of JointData, sample_time 0: continuous. For one thread at a time.

    Answers are gain, frequency, certified, age, safe gain and flag of a Limit. A negative contact is an unknown one.
    """

    @overload
    def __init__(
        self, joints: Floats, sample_time: float, velocities: int, rows: int, contacts: int, slices: float, urgent: float
    ) -> None: ...
    @overload
    def __init__(
        self,
        joints: Floats,
        sample_time: float,
        velocities: int,
        rows: int,
        contacts: int,
        sizes: list[int],
        gains: Floats,
        rotors: bool,
        movable: float,
    ) -> None:
        """Tracker with tasks of `sizes` directions each, with K'p and K'v `gains` (2, m); the gains of `joints` are ignored."""

    def update(
        self, mass: Floats, jacobians: list[Floats], contact: int, tasks: list[Floats] = ...
    ) -> tuple[float, float, bool, int, float, int]:
        """Limit at the next tick; `tasks`: their Jacobians, m rows in all."""

    def settle(self, mass: Floats, jacobians: list[Floats], contact: int, tasks: list[Floats], gain: float) -> tuple[bool, float]:
        """Decision if such ticks lead to the limit `gain`, and the limit that they lead to."""

    def set_body(self, tree: RigidTree, contacts: list[tuple[Floats, Floats]], switches: list[int], tasks: Floats) -> None:
        """Sets the robot for update_posture: frames (c, 13) and held (c, 6) of each contact state; those kept ready; tasks (k, 14)."""

    def update_posture(self, q: Floats, contact: int) -> tuple[float, float, bool, int, float, int]:
        """Limit at a posture (nq,), as update; other contact states are prepared in turn."""

    def replay(self, q: Floats, contacts: list[int]) -> Floats:
        """Answers (T, 7) of update_posture at each of q (T, nq) and contacts (T,), and its time [s]."""

    def prepare(self, jacobians: list[Floats], contact: int) -> None:
        """Prepares another contact state with the mass matrix of the last `update`."""

    def update_inverse(self, w: Floats, contact: int) -> tuple[float, float, bool, int, float, int]: ...
    def lost(self, flag: int, contact: int, limit: float) -> tuple[float, float, bool, int, float, int]:
        """Answer to a tick of which only the contact state is known, or not even that (negative); `limit`: one in another posture."""

    def crossings(self, contact: int) -> Floats: ...
    def counted_gain(self, contact: int) -> float: ...
    def alias_left(self, w: Floats, omega: float) -> float: ...
    @property
    def inverse(self) -> Floats: ...
    @property
    def passive_frequency(self) -> float: ...

def eigenvalues(matrices: Complexes) -> Complexes:
    """Eigenvalues (k, n) of matrices (k, n, n), as eigenvalues.hpp finds them; NaN if they do not converge."""

def symmetric_eigenvalues(matrices: Complexes, error: float) -> Complexes:
    """Eigenvalues of matrices that are symmetric in some units; NaN for others, or where they may be off by more than `error`."""

def inverses(matrices: Complexes) -> Complexes:
    """Inverses (k, n n) of matrices (k, n, n). Raises ValueError for a singular one."""

class DirectedLoop:
    """Loop of directed_loop.hpp without its gains. torque (n, m), jacobian (m, n), both (0, 0) if the directions are the joints.

    For one thread at a time. joints (5, n): motor inertia, stiffness, damping, viscous friction of motor and link; contacts (2, c):
    stiffness and damping; drives (3, n): bandwidth, damping ratio, delay.
    """

    def __init__(self, size: int, torque: Floats, jacobian: Floats, cascade: Integers, by_direction: bool = False) -> None: ...
    def set_plant(
        self,
        mobility: Floats,
        joints: Floats,
        root: Floats,
        gravity: Floats,
        hung: Floats,
        contacts: Floats,
        drives: Floats,
        motor_side: bool,
    ) -> None: ...
    def set_held(
        self,
        a: Floats,
        b: Floats,
        c: Floats,
        hessenberg: Floats,
        turned_b: Floats,
        turned_c: Floats,
        fast: float,
        delay: Floats,
        step: float,
    ) -> None: ...
    def set_modes(self, modes: ModalLoop) -> None:
        """Sets the modes over which responses are summed from now on if s is about jω."""

    def set_law(
        self,
        velocity_above: Floats,
        velocity_below: Floats,
        integral_above: Floats,
        integral_below: Floats,
        zeros: Complexes,
        poles: Complexes,
        gain: float,
    ) -> None: ...
    def set_matrix(self, gain: Floats, velocity: bool, integral: bool, slow: float) -> None:
        """One term of X from now on: gain (n, m) times the velocity, or the integrator, or both; slow [rad/s] as `slowest` of gains."""

    def set_boundary(self, grid: Floats, leaning: Floats, tilt: float, lean: float, unstable_poles: int, settles: float) -> None: ...
    def lag_about(self, gains: Floats, omega: float) -> tuple[float, float]:
        """Lag [rad] of the locus nearest to −1 at its crossing of the unit circle about ω, and that ω; NaN if it is lost."""

    def response(self, omega: Floats) -> Complexes:
        """Response E P C e^{−sT} X (k, m²) at ω (k,)."""

class Look:
    """Sampled loop of loop_samples.hpp and loop_curves.hpp; gains (3, m). Margins are columns (c, 1), with their derivatives (c, 2 m)."""

    def __init__(
        self, loop: DirectedLoop, gains: Floats, factor: float, phase: float, peak: float, between: bool, smooth: bool
    ) -> None: ...
    @property
    def followed(self) -> bool: ...
    @property
    def singular(self) -> bool: ...
    @property
    def unstable(self) -> int: ...
    @property
    def samples(self) -> int: ...
    def tell_apart(self, factor: float, phase: float) -> None:
        """Adds samples where loci that nearly meet may cross with a lesser factor > 1 on the gains, or phase [rad]."""

    def least(self, apart: bool = True) -> tuple[float, float, float, float, float, float]:
        """Least margins of loop_curves.hpp; `apart`: with more samples where loci that nearly meet may cross with less."""

    def peak(self, slope: float, offset: float) -> tuple[float, float]: ...
    def crossings(self, gains: Floats, locus: bool, axis: bool, reach: float, until: float = ...) -> tuple[Floats, Floats]:
        """Crossings (c, 2) of the loop with `gains`, margin and ω, and the margins' derivatives (c, 2 m); delays, peaks and ends likewise.

        `until`: only the first crossing with a smaller margin, without its derivatives. As in peaks, where it is the first that is higher.
        """

    def delays(self, gains: Floats, longest: float) -> tuple[Floats, Floats]: ...
    def delay_crossings(self, longest: float) -> Floats:
        """Crossings (c, 2): delays [s] and ω of each."""

    def one_loop(self) -> Floats:
        """Margins (n, 4) of one joint at a time: |ln g| up and down of its gains, a phase [rad], the largest |S_ii|."""

    def one_loop_crossings(self, which: int) -> Floats:
        """(c, 1) every ln g at which one loop's return ratio is seen to pass −1, by size; not each puts a root on the boundary."""

    def common_factors(self) -> Floats:
        """Nearest factors (2, 2) on all gains, above and below 1, that lose a stable loop: |ln g| and ω, 0 at rest; inf: none."""

    def passing_factors(self) -> Floats:
        """Factors (c, 2) on all gains at which a locus passes −1, as far as they are followed: ln g and ω."""

    def phases(self, locus: bool) -> Floats:
        """(c, 3) every crossing of the unit circle by loci, or by the loops' return ratios: which, the phase from −1 [rad], ω."""

    def sensitivities(self) -> Floats:
        """(c, 3) of every sample and every peak between samples: which loop, |S_ii|, ω."""

    def common_phase(self) -> tuple[float, float]:
        """Common phase [rad], > 0 for a lag, and its ω; inf if there is none."""

    def crossed(self, lag: float) -> int:
        """Number of roots that a `lag` [rad] in all loops moves across the boundary; < 0 a lead."""

    def one_loop_count(self, joint: int, change: float, gain: int) -> int:
        """Number of roots that a change of one joint's gains, of all (0) as a part of them, of kp (1) or kd (2), makes unstable.

        Hugely negative where they cannot be counted.
        """

    def growths(self, gain: int) -> Floats:
        """Factors (n, 1) by which kp (1) or kd (2) of each joint may grow, the others as they are; inf: by any; NaN: not known."""

    def peaks(self, gains: Floats, least: float, slope: float, offset: float, until: float = ...) -> tuple[Floats, Floats]: ...
    def ends(self, gains: Floats, locus: bool, reach: float) -> tuple[Floats, Floats]: ...

def balanced(matrices: Complexes) -> Floats:
    """Scaling x (k, n) of matrices (k, n, n), of structured_value.hpp."""

def improved(matrices: Complexes, start: Floats, tolerance: float) -> tuple[Floats, Floats]:
    """Scaling x (k, n) and σ_max (k, 1) of matrices (k, n, n), improved from `start` (k, n)."""

def from_below(matrix: Complexes, enough: float) -> tuple[float, Complexes]:
    """Largest |eigenvalue| found of M diag(q), and q (n, 1); the search ends at `enough`."""

def disk_peak(omega: Floats, samples: Complexes, response: Callable[[float], Complexes]) -> tuple[float, float, Floats]:
    """Peak of disk_peak.hpp, from samples (k, n, n) of S − T at rising omega (k,): σ_max, its ω, and x (n, 1)."""

class DiskModes:
    """Modes of disk_modes.hpp: poles (m,), into (m, n), out (m, n), delays and share (n,), step [s]."""

    def __init__(self, poles: Complexes, into: Complexes, out: Complexes, delays: Floats, share: Floats, step: float) -> None: ...
    def matrices(self, omega: Floats) -> Complexes:
        """Matrices X Y⁻¹ (k, n²) at omega (k,)."""

    def distances(self, low: Floats, high: Floats) -> Floats:
        """Least distances |v − p| (k, m) for ω in [low, high] (k,)."""

    def bounds(self, low: Floats, high: Floats, x: Floats, enough: float) -> tuple[Complexes, Floats]:
        """Bounds on intervals (k,) with x (k, n): M0, M1, M2 (k, 3 n²); upper bound of σ_max and the remainder (k, 2)."""

    def end(self, height: float) -> float: ...
    def search(self, omega: Floats, most: int) -> tuple[tuple[float, float, Floats], float]:
        """Peak (σ_max, ω, x (n, 1); none: x (0, 1)) from samples at omega (k,), rising from 0, and a bound of σ_max over all ω.

        The bound is infinite where `most` intervals are not enough for it.
        """

class RigidTree:
    """Rigid-body tree of rigid_tree.hpp. A pose is a rotation's rows, then the origin (12,).

    joints   (n, 17): parent link, place (12) on it, axis (3), kind: 0 a hinge, 1 prismatic, 2 continuous
    masses   (n + 1, 13): mass, centre and inertia about it (3, 3) of the base and of each joint's link
    """

    def __init__(self, floating: bool, root: Floats, joints: Floats, masses: Floats, gravity: Floats) -> None: ...
    def weight(self, q: Floats) -> Floats:
        """Weight g (N,) at posture q (nq,)."""

    def dynamics(self, q: Floats, frames: Floats, held: Floats, tasks: Floats) -> tuple[Floats, Floats, Floats]:
        """Mass matrix (N, N); the rows that frames (c, 13) hold, held (c, 6); those of tasks (k, 14), world axes."""

class PostureEstimate:
    """Posture estimate of posture_estimate.hpp: frames (c, 13) on a link, in a pose; held (c, 6) not 0 in directions that are held."""

    def __init__(self, tree: RigidTree, frames: Floats, held: Floats, start: Floats) -> None: ...
    def renew(self, back: Floats, counted: Floats | None) -> None: ...
    def update(self, joints: Floats) -> Floats:
        """Posture (nq,) of the encoders' joints (n,)."""

class TaskValues:
    """Task values of posture_estimate.hpp: tasks (k, 14): 0 centre of mass, 1 posture, 2 position, 3 orientation; then its frame (13)."""

    def __init__(self, tree: RigidTree, tasks: Floats, start: Floats) -> None: ...
    def read(self, q: Floats) -> Floats: ...

def exponential(matrix: Floats) -> Floats:
    """Matrix exponential e^A (n, n), of motion.hpp."""

def pseudo_inverse(matrix: Floats, share: float) -> Floats:
    """Pseudo-inverse A⁺ (n, m) of A (m, n), of row_space.hpp."""

def task_motion(
    inertia: Floats, held: Floats, tasks: Floats, sizes: list[int], joints: int, movable: float
) -> tuple[Floats, Floats, list[int], int]:
    """Task motion of task_motion.hpp: Y (N, n), X (n, m), directions of each task that can be moved, and motions that contacts leave.

    ValueError where a number is not finite, or the inertia not positive definite.
    """

MOST_ALIASES: int

class BoxLoop:
    """Loop of box_loop.hpp; values (7,): its five quantities, then friction of motor and link; columns (5,)."""

    def __init__(
        self,
        values: Floats,
        columns: Integers,
        motor_side: bool,
        current_poles: Complexes,
        current_gain: float,
        zeros: Complexes,
        poles: Complexes,
        gain: float,
        control_delay: float,
        sample_time: float,
        aliases: int,
        rest: float,
    ) -> None: ...
    def at(self, low: Floats, high: Floats, scaled: bool) -> tuple[Floats, Complexes, Floats]:
        """Sectors of boxes low to high (n, p): their four bounds (4, n), centres (1, n) and scores (n, p)."""
