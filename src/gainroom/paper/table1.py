"""Table I: the joint gains that control of the centre of mass amounts to, eqs. (9) and (10), largest over the motion of Fig. 12.

The paper prints the task's gains and the motion; posture, contact frame and what the controller's model holds are not printed. The rows
take the centre of mass alone, in the world's axes, on two flat rigid feet. Inferred, so that the table comes out: the start and the
lean of the pelvis (three numbers) and that the motors' inertia counts. A level pelvis cannot account for the hip yaw.
"""

from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from ..linear.arrays import Floats
from .biped import COM_KD, COM_KP, NAMES, biped, com_tasks, standing_so
from .motion import on_both_feet
from .picture import DotPicture, Dots
from .row import Row, compare

PRINTED = {
    "kp": ("41.80", "109.4", "421.6", "1228", "1234", "813.2", "43.70", "132.5", "488.9", "1199", "1270", "742.7"),
    "kv": ("2.26", "4.73", "19.1", "57.6", "16.8", "40.9", "2.40", "6.20", "22.5", "56.0", "22.5", "36.6"),
}
UNITS = {"kp": "N m/rad", "kv": "N m s/rad"}
MOVE = np.full(3, 0.06)  # [m] printed: 6.0 cm in x, y and z at once
START = np.array([-0.05, 0.0, 0.79])  # [m] inferred; from the ankles' line, the middle between the feet, the soles
TOLERANCE = 0.25  # of the paper's value; unsettled() is more
STEPS = 9  # samples of the motion; the largest gains stand at an end of it or change slowly


@dataclass(frozen=True)
class Account:
    """One set of assumptions.

    key           its name in row ids
    label         in pictures
    pitch         lean of the pelvis [rad], forward where positive
    rotors        the controller's model counts the motors' inertia
    pelvis_kp     K'p [1/s²] in x, y, z of control of the pelvis's orientation, counted with the rest; None: no such task
    pelvis_kd     K'v [1/s] likewise
    lower         how far below START the motion starts [m]
    """

    key: str
    label: str
    pitch: float
    rotors: bool = True
    pelvis_kp: tuple[float, float, float] | None = None
    pelvis_kd: tuple[float, float, float] | None = None
    lower: float = 0.0


LEAN = Account("leaning_pelvis", "pelvis leaning back (inferred)", -0.19)
LEVEL = Account("level_pelvis", "pelvis level", 0.0)
NO_ROTORS = replace(LEAN, key="without_rotors", rotors=False)
LOWER = replace(LEAN, key="5 mm lower", lower=0.005)
PELVIS_TASK = Account(
    "pelvis_task", "level, orientation task besides (inferred)", 0.0, pelvis_kp=(164.0, 166.0, 57.0), pelvis_kd=(7.8, 6.3, 3.1)
)


def rows() -> list[Row]:
    """The table, then how near other assumptions come."""
    result = []
    for gain, unit in UNITS.items():
        computed, other = gains(LEAN)[gain], ratios(PELVIS_TASK)[gain]
        for name, text, value, with_task in zip(NAMES, PRINTED[gain], computed, other, strict=True):
            side, _, joint = name.partition("_")
            printed = float(text)
            note = _note(value / printed, with_task)
            result.append(compare(f"table1.{side}.{joint}.{gain}", printed, value, unit, TOLERANCE * printed, note, text))
    return [*result, *map(_typical, (LEAN, NO_ROTORS, LEVEL, PELVIS_TASK))]


def pictures() -> list[DotPicture]:
    """The computed gains over the printed ones, joint by joint."""
    captions = {"kp": _yaw_caption(), "kv": _ratio_caption()}
    names = tuple(name.replace("_", " ") for name in NAMES)
    band = (1 - TOLERANCE, 1 + TOLERANCE)
    result = []
    for gain in UNITS:
        series = tuple(Dots(account.label, ratios(account)[gain]) for account in (LEAN, LEVEL, PELVIS_TASK))
        title = f"Table I, K{gain[1]}q: largest joint gains over the motion, computed over printed"
        result.append(DotPicture("table1", title, captions[gain], "computed / printed", (0.03, 3.0), names, series, band))
    return result


def gains(account: Account) -> dict[str, Floats]:
    """The largest diagonal entries of Kpq [N m/rad] and Kvq [N m s/rad] over the motion, (12,) each, as "kp" and "kv"."""
    shares = _shares(account)
    given = {"kp": (COM_KP, account.pelvis_kp), "kv": (COM_KD, account.pelvis_kd)}
    return {gain: (shares @ np.concatenate([com, pelvis or ()])).max(axis=0) for gain, (com, pelvis) in given.items()}


def ratios(account: Account) -> dict[str, Floats]:
    """gains() over the printed ones, (12,) each."""
    return {gain: values / np.array(PRINTED[gain], dtype=float) for gain, values in gains(account).items()}


def typical_factor(account: Account) -> float:
    """By what factor computed and printed differ: e to the root mean square of the 24 logarithms of their ratios."""
    logarithms = np.log(np.concatenate([*ratios(account).values()]))
    return float(np.exp(np.sqrt(np.mean(logarithms**2))))


@cache
def motion(pitch: float, lower: float = 0.0) -> tuple[Floats, ...]:
    """Postures along the motion. Fig. 12's spline sets their timing, which the largest gains do not depend on."""
    body, postures, near = biped().robot.body, [], None
    for share in np.linspace(0.0, 1.0, STEPS):
        near = on_both_feet(body, START - [0.0, 0.0, lower] + share * MOVE, pitch, near)
        postures.append(near)
    return tuple(postures)


@cache
def _shares(account: Account) -> Floats:
    """(STEPS, 12, m): what each task direction adds to the diagonal of the joint gains per unit of its own gain, diag(E Λ eᵢ eᵢᵀ Eᵀ)."""
    stacks = [com_tasks(standing_so(q), account.rotors, account.pelvis_kp is not None) for q in motion(account.pitch, account.lower)]
    return np.array([tasks.torque * tasks.jacobian.T for tasks in stacks])


def _note(share: float, with_task: float) -> str:
    """What there is to say about a row whose computed value is `share` of the printed one."""
    why = ""
    if abs(share - 1) > TOLERANCE:
        why = (
            "The task alone, in the inferred posture, does not give it; with the pelvis level and controlled besides it would be "
            f"{with_task:.2f}. "
        )
    return f"{share:.2f} of the paper's. {why}Posture and rotors inferred; tolerance a quarter."


def unsettled(account: Account) -> float:
    """By what share of itself the row that moves most moves when one assumption changes: why no row can be asked for more."""
    changed, main = gains(account), gains(LEAN)
    return max(float(np.abs(changed[gain] / main[gain] - 1).max()) for gain in UNITS)


def why_a_quarter() -> str:
    """The reason for the tolerance."""
    return (
        f"tolerance a quarter, as a start {1e3 * LOWER.lower:g} mm lower moves a row by up to {100 * unsettled(LOWER):.0f} %, and the "
        f"rotors by up to {100 * unsettled(NO_ROTORS):.0f} %"
    )


def _typical(account: Account) -> Row:
    """How far the whole table is off under one set of assumptions."""
    both = np.concatenate([*ratios(account).values()])
    hips = ratios(account)["kp"][[NAMES.index("left_hip_yaw"), NAMES.index("right_hip_yaw")]]
    said = {
        LEAN.key: f"Inferred: pelvis leaning back {-LEAN.pitch:g} rad, start {-START[0]:g} m behind the ankles and {START[2]:g} m above "
        f"the soles; the controller counts the rotors; {why_a_quarter()}.",
        NO_ROTORS.key: "The same posture without the rotors in the controller's model: knees and ankles come out too small.",
        LEVEL.key: f"The same motion with the pelvis level, nothing else: the hip yaw is {hips.max():.2f} of the paper's at most, as its "
        "axis is upright.",
        PELVIS_TASK.key: f"The pelvis level and its orientation controlled besides, six gains inferred: K'p {written(account.pelvis_kp)} "
        f"1/s², K'v {written(account.pelvis_kd)} 1/s in roll, pitch, yaw.",
    }[account.key]
    note = f"How far off all 24 are (root mean square of the logarithms); {both.min():.2f} to {both.max():.2f} of the printed ones. {said}"
    return compare(f"table1.{account.key}.typical_factor", 1.0, typical_factor(account), "×", 1 / (1 - TOLERANCE) - 1, note)


def _yaw_caption() -> str:
    found, level = ratios(LEAN)["kp"], ratios(LEVEL)["kp"]
    inside = sum(int(np.count_nonzero(np.abs(values - 1) <= TOLERANCE)) for values in ratios(LEAN).values())
    yaw = NAMES.index("left_hip_yaw")
    return (
        f"At 1 computed and printed agree; in the grey band, a quarter to either side, lie {inside} of the 24 gains of both pictures. "
        f"With the pelvis level the hip yaw comes out at {level[yaw]:.2f} of what is printed. With the pelvis leaning back "
        f"{-LEAN.pitch:g} rad its axis is no longer upright and the sideways motion turns it, most at the end where the legs are nearly "
        f"straight: {found[yaw]:.2f}."
    )


def _ratio_caption() -> str:
    printed = [float(PRINTED["kv"][k]) / float(PRINTED["kp"][k]) for k in (NAMES.index("left_hip_yaw"), NAMES.index("right_hip_yaw"))]
    return (
        "Orientation control of a level pelvis explains the table as well, with six gains that the paper does not print instead of the "
        f"lean. In favour of the lean: the printed Kvq/Kpq of the hip yaws, {printed[0]:.3f} and {printed[1]:.3f} s, is that of the task's "
        f"y direction, {COM_KD[1]:g}/{COM_KP[1]:g} = {COM_KD[1] / COM_KP[1]:.3f} s."
    )


def written(values: tuple[float, ...] | None) -> str:
    """Numbers in a sentence."""
    return ", ".join(f"{value:g}" for value in values or ())
