"""The core's headers in a C++ program of their own: the same digits as through Python, and nothing that the sanitizers find."""

import subprocess
from fractions import Fraction
from pathlib import Path

import mpmath
import numpy as np
import pytest

import gainroom as gr
import native_programs
from draws import draw_setup
from gainroom.analysis.crossings import scan
from gainroom.native import include_dir
from gainroom.system.linear.transfer_function import Factored
from native_programs import SANITIZED, output
from test_crossings import KINDS

SOURCES = Path(__file__).with_name("native")


def compiled(name: str) -> Path:
    return native_programs.compiled(SOURCES / f"{name}.cpp", *SANITIZED)


@pytest.fixture(scope="module")
def program() -> Path:
    return compiled("scans")


@pytest.mark.slow
def test_limits_of_random_and_hostile_coupled_loops_end():
    """Loops of 0 to 60 joints; NaN, infinite, zero, huge and tiny values in every kind of place."""
    ordinary, _ = output(compiled("limits")).split()
    assert int(ordinary) > 10


@pytest.mark.slow
@pytest.mark.parametrize("option", ["-ffast-math", "-ffinite-math-only"])
def test_headers_refuse_to_take_all_numbers_for_finite(option: str):
    """Ticks without numbers would be certified, or spoil all that follow."""
    command = [native_programs.compiler(), "-std=c++17", option, f"-I{include_dir()}", "-fsyntax-only", "-x", "c++", "-"]
    done = subprocess.run(command, input='#include "gainroom/robot_tracker.hpp"', capture_output=True, text=True, check=False)
    assert done.returncode
    assert "compile it without" in done.stderr


@pytest.mark.slow
def test_looks_at_random_and_hostile_coupled_loops_end():
    """Joints and directions, gravity, soft contacts, sampled; NaN, infinite, zero, huge and tiny values everywhere; 20 joints."""
    ordinary, _ = output(compiled("looks")).split()
    assert int(ordinary) > 60


@pytest.mark.slow
def test_disk_margins_of_random_and_hostile_modes_end():
    """1 to 8 loops; none that is not finite is called bounded, all ordinary ones are."""
    ordinary, _ = output(compiled("disks")).split()
    assert int(ordinary) == 24


@pytest.mark.slow
def test_boxes_of_random_and_hostile_joints_end():
    """Rigid, locked and elastic joints, sampled or not: nothing that is not finite has a bounded phase, most that is narrow has."""
    ordinary, all_boxes, outside = output(compiled("boxes")).split()
    assert int(ordinary) > 0.9 * int(all_boxes)  # but for boxes at a resonance
    assert int(outside) == 0


@pytest.mark.slow
@pytest.mark.parametrize(
    "options", [SANITIZED, ["-O0"], ["-DGAINROOM_APART"], ["-DGAINROOM_PLAIN"]], ids=["sanitized", "O0", "apart", "plain"]
)
def test_four_frequencies_of_a_count_at_once_are_four_frequencies(options: list[str]):
    """Rigid and elastic joints, sampled or not, equal ones, up to 40; hostile numbers end. Pivots lose what digits they lose either way.

    A root that is passed much more closely than steps are long is seen, or the count does not come to an end. Without optimisation calls
    stay calls, so that caller and callee have to agree on where four numbers are. Product and sum are one instruction, or one each.
    """
    compared, phase, slope, ended, wrong = output(native_programs.compiled(SOURCES / "sweeps.cpp", *options)).split()
    assert int(compared) > 2000
    assert float.fromhex(phase) < 1e-9
    assert float.fromhex(slope) < 1e-9
    assert int(ended) > 15000
    assert int(wrong) == 0


def test_four_numbers_at_once_are_four_numbers():
    """The same digits with compilers that have no vectors."""
    one, plain = (output(native_programs.compiled(SOURCES / "fours.cpp", *SANITIZED, *more)) for more in ((), ("-DGAINROOM_PLAIN",)))
    values = 1 / (np.arange(8) + 3) - 0.2 * np.arange(8)
    a, b = values[:4], values[3:7]
    assert one == plain
    assert [float.fromhex(word) for word in one.split()] == (1 / (((a * b - 0.3 * a) + (b + a)) + 7.0)).tolist()


@pytest.mark.slow
def test_numbers_of_many_digits():
    """Against exact fractions, and mpmath's e^x; the same digits with compilers that have no product of 128 bits."""
    rng = np.random.default_rng(0)
    lines = (rng.normal(size=(200, 4)) * 2.0 ** rng.integers(-6, 3, (200, 4))).tolist()
    lines += [[1.0, 0.0, -1.0, 0.0], [0.0, 0.0, 2.0, 1.0], [1.0, -(2.0**-60), 1.0, 2.0**-60]]
    given = "\n".join(" ".join(value.hex() for value in line) for line in lines)
    found, plain = (
        output(native_programs.compiled(SOURCES / "extended.cpp", *SANITIZED, *more), given=given) for more in ((), ("-DGAINROOM_PLAIN",))
    )
    assert found == plain
    with mpmath.workprec(400):
        for line, answer in zip(lines, found.splitlines(), strict=True):
            x, y = (Fraction(one) + Fraction(small) / 2**90 for one, small in (line[:2], line[2:]))
            words = [Fraction(float.fromhex(word)) for word in answer.split()]
            product, total, difference, power = (sum(words[k : k + 6]) for k in range(0, 24, 6))
            # An operation is cut off behind the 320th bit, and six doubles hold 6 × 53 of them: 16 units of 2^−318 leave room.
            room = Fraction(1, 2**314)
            assert abs(product - x * y) <= room * abs(x * y)
            assert abs(total - x - y) <= room * max(abs(x), abs(y))
            assert abs(difference - x + y) <= room * max(abs(x), abs(y))
            exact = mpmath.exp(mpmath.mpf(x.numerator) / x.denominator)
            # Squared up to 20 times, each of which doubles what was cut off before.
            assert abs(mpmath.mpf(power.numerator) / power.denominator / exact - 1) <= mpmath.mpf(2) ** -290


def test_headers_can_be_used_together():
    """All of them in one file, in the order of their names: each includes what it needs, and no name is there twice."""
    names = sorted(header.name for header in (Path(include_dir()) / "gainroom").glob("*.hpp"))
    text = "".join(f'#include "gainroom/{name}"\n' for name in names)
    command = [native_programs.compiler(), *native_programs.STRICT, f"-I{include_dir()}", "-fsyntax-only", "-x", "c++", "-"]
    done = subprocess.run(command, input=text, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")


@pytest.fixture(scope="module")
def delays() -> Path:
    return compiled("delays")


def answers(program: Path, lines: list[list[float]]) -> list[list[float]]:
    """What the program says of each line of numbers; integers are counts."""
    words = [" ".join(str(value) if isinstance(value, int) else float(value).hex() for value in line) for line in lines]
    return [[float.fromhex(word) for word in line.split()] for line in output(program, given="\n".join(words)).splitlines()]


def parts(roots: np.ndarray) -> list[float]:
    return [part for root in roots for part in (root.real, root.imag)]


def scanned(program: Path, loops: list[Factored]) -> list[list[float]]:
    """Of each loop: certified, the numbers of crossings, half turns, crossings and peaks."""
    return answers(
        program,
        [
            [len(one.zeros), len(one.poles), one.gain, one.delay, one.sample_time or 0.0, *parts(one.zeros), *parts(one.poles)]
            for one in loops
        ],
    )


def delayed(program: Path, plant: list[Factored], control: list[Factored], crossings: list[np.ndarray]) -> list[list[float]]:
    """Of each sampled loop: what was found, the extra delay and its ω."""
    lines = []
    for one, law, starts in zip(plant, control, crossings, strict=True):
        counts = [len(one.zeros), len(one.poles), len(law.zeros), len(law.poles), len(starts), 0]
        sizes = [one.gain, one.delay, law.gain, law.sample_time or 0.0]
        places = [part for roots in (one.zeros, one.poles, law.zeros, law.poles) for part in parts(roots)]
        lines.append([*counts, *sizes, *places, *starts.ravel().tolist()])
    return answers(program, lines)


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_the_same_digits(program: Path, kind: str):
    loops = [KINDS[kind](np.random.default_rng([7, k])).reduced for k in range(25)]
    for loop, found in zip(loops, scanned(program, loops), strict=True):
        own = scan(loop)
        expected = [float(own.certified), len(own.gains), len(own.phases), own.half_turns, *own.gains.ravel(), *own.phases.ravel()]
        assert found == pytest.approx([*expected, *own.peaks.ravel()], rel=0, abs=0, nan_ok=True)


@pytest.mark.slow
def test_delay_margins_with_the_same_digits(delays: Path):
    loops = [loop for k in range(40) if gr.is_stable(loop := draw_setup(np.random.default_rng([9, k]), True).loop())]
    found = [gr.margins(loop) for loop in loops]
    crossings = [np.array(sorted((one.delay_margin, one.omega) for one in margins.gain_crossings)).reshape(-1, 2) for margins in found]
    plants = [loop.unsampled for loop in loops if loop.unsampled is not None]
    alone = delayed(delays, plants, [loop.control for loop in loops if loop.control is not None], crossings)
    assert sum(numbers[0] == 1 for numbers in alone) > 10  # confirmed on both sides
    for margins, (way, extra, _) in zip(found, alone, strict=True):
        assert not way or extra == margins.delay_margin


@pytest.mark.slow
def test_hostile_sampled_loops_end(delays: Path):
    """What is not finite, not strictly proper or vast fails or has no margin; equal poles are sampled."""
    none, one = np.zeros(0, complex), np.array([-1.0 + 0j])
    odd = [0.0, 1.0, 1e300, -1e300, np.inf, np.nan, 5e-324]
    law = Factored(none, none, 1.0, 0.0, 1e-3)
    plants = [Factored(none, np.array([complex(x, y), complex(x, -y)]), 1.0, 1e-3) for x in odd for y in odd]
    plants += (
        [Factored(none, one, gain, 1e-3) for gain in odd]
        + [Factored(none, one, 1.0, delay) for delay in odd]
        + [Factored(one, one, 1.0), Factored(none, none, 1.0)]
    )
    plants += [Factored(none, np.repeat(one, count), 2.0) for count in (2, 6, 61)]
    laws = (
        [law] * len(plants)
        + [Factored(one, none, 1.0, 0.0, step) for step in odd]
        + [Factored(none, none, gain, 0.0, 1e-3) for gain in odd]
    )
    plants += [Factored(none, one, 1.0)] * 2 * len(odd)
    for starts in (np.zeros((0, 2)), np.array([[np.nan, np.nan], [np.inf, 0.0], [-1.0, 5.0]]), np.array([[1e-3, 1e3]])):
        assert len(delayed(delays, plants, laws, [starts] * len(plants))) == len(plants)


@pytest.mark.slow
def test_hostile_loops_end(program: Path):
    """Numbers that are none, infinite, vast and minute, nothing at all, and hundreds of roots; none of it is called certified and wrong."""
    none, one = np.zeros(0, complex), np.array([-1.0 + 0j])
    odd = [0.0, 1e300, -1e300, np.inf, np.nan, 5e-324]
    rng = np.random.default_rng(8)
    loops = [Factored(none, none, gain, delay) for gain in odd for delay in (0.0, 1.0)]
    loops += [Factored(none, np.array([complex(x, y)]), 1.0, 0.1) for x in odd for y in odd]
    loops += [Factored(none, one, gain, abs(delay), 1e-3) for gain in odd for delay in odd]
    loops += [Factored(none, one, 1.0, 0.0, abs(step)) for step in odd]
    loops += [Factored(one, none, 1.0), Factored(np.repeat(one, 5), one, 1.0, 0.1)]
    many = -(10.0 ** rng.uniform(-3, 3, 500)).astype(complex)
    loops += [Factored(many[:-2], many, 1.0), Factored(none, np.repeat(1j * np.array([1.0, -1.0]), 50), 1.0, 0.1)]
    found = scanned(program, loops)
    assert len(found) == len(loops)
    for loop, numbers in zip(loops, found, strict=True):
        given = np.array([loop.gain, loop.delay, *loop.poles.real, *loop.poles.imag])
        if not np.all(np.isfinite(given)):
            assert numbers[0] == 0.0, loop


@pytest.mark.slow
@pytest.mark.parametrize("options", [SANITIZED, ("-O3", "-march=native")], ids=["sanitized", "O3"])
def test_trees_and_matrices_of_any_rank_end(options):
    """Joints of every kind, quaternions of any size, masses of 0; pseudo-inverses of any rank solve A A⁺ A = A; trackers of any posture."""
    ordinary, wrong = output(native_programs.compiled(SOURCES / "trees.cpp", *options)).split()
    assert (int(ordinary) > 1000, int(wrong)) == (True, 0)
