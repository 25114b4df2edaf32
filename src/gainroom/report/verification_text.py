"""Verification as sentences and columns, and its presentation."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

from ..errors import apart, at_frequency, listed
from ..studies.verification import Verification, VerifiedLimit
from ..system.requirements import Requirements
from ..system.system import System
from .columns import Column, facts, yes
from .margin_columns import short_text
from .number_format import digits
from .page import Advice
from .presentation import Part, Presentation, TextTable, closing, do_this
from .words import NOT_SAFE, UNSTABLE


def sentence(result: Verification) -> str:
    """Answer in one or two sentences: a limit too near for the required gain margin comes first."""
    least = result.least
    if result.agrees and least.predicted_gain <= 1:
        return f"{UNSTABLE}. {_compared_text(result)}"
    if not result.agrees or least.enough is not False:
        return _compared_text(result)
    asked = Requirements(gain_margin=least.required)
    where = f" in {least.what}" if result.of_robot else ""
    short = short_text(asked, {"gain_margin": least.predicted_gain})
    fails = f"{NOT_SAFE}: stable, but a requirement fails{at_nominal(result)}: {short}{at_frequency(least.predicted_frequency)}{where}"
    return f"{fails}; phase margin and Ms are not judged here. {_compared_text(result)}"


def at_nominal(result: Verification) -> str:
    """Clause that a limit is at nominal values, if the file has ranges; "" otherwise."""
    return ", at nominal values" if result.uncertain else ""


def _compared_text(result: Verification) -> str:
    """Sentence on the agreement of simulation and prediction."""
    cases, what = result.cases, "the robot" if result.of_robot else "the joint"
    wrong = sorted((case for case in cases if not case.agrees), key=lambda case: -furthest(case) / case.tolerance)
    if wrong:
        names = "; ".join(f"{case.what} ({case.witness}): {_differences(case)}" for case in wrong[:3])
        names += "; and others" if len(wrong) > 3 else ""
        return f"Simulation and prediction disagree in {len(wrong)} of {len(cases)} cases. {names}. {_where_to_look(cases, wrong)}."
    least, worst = min(cases, key=lambda case: case.predicted_gain), max(size(case.gain_difference) for case in cases)
    several = len({case.what for case in cases}) > 1
    where = f" in {least.what}" if several else ""
    if not 0 < least.predicted_gain < math.inf:
        reason = (
            f"no lower gains are stable{where}" if least.predicted_gain == 0 else f"{what} does not vibrate at any factor on these gains"
        )
        return f"Simulation and prediction agree: {reason}."
    difference = f"the largest difference in {len(cases)} cases is" if len(cases) > 1 else "a difference of"
    return (
        f"Simulation and prediction agree: vibration starts at {least.simulated_gain:.5g} × these gains in simulation{where}, predicted "
        f"{least.predicted_gain:.5g} ×{';' if len(cases) > 1 else ','} {difference} {percent(worst)}. Both {left_out(result)}."
    )


def left_out(result: Verification) -> str:
    """Predicate on the scope of the limits: "are for small motions, without …"."""
    effects = listed([effect.removeprefix("the ") for effect in result.effects], most=9)
    return "are for small motions" + (f", without the scenario's {effects}" if effects else "")


def furthest(case: VerifiedLimit) -> float:
    """Larger of both differences."""
    return max(size(case.gain_difference), size(case.frequency_difference))


def _differences(case: VerifiedLimit) -> str:
    """Differences beyond the tolerance, as text."""
    parts = []
    for what, difference in (("gain", case.gain_difference), ("frequency", case.frequency_difference)):
        if not abs(difference) <= case.tolerance:
            parts.append(f"no {what} found" if math.isnan(difference) else f"{what} differs by {percent(difference, case.tolerance)}")
    return ", ".join(parts) + f", {100 * case.tolerance:g} % allowed"


def _where_to_look(cases: tuple[VerifiedLimit, ...], wrong: list[VerifiedLimit]) -> str:
    """Likely cause of a disagreement, as text."""
    if any(case.witness == "linear" for case in wrong):
        return "The prediction itself is in doubt: please report the input"
    if any(case.witness == "linear" for case in cases):
        return "The linear simulation agrees, so check what MuJoCo computes differently: stiff gearboxes on light links, contacts"
    return "Check stiff gearboxes on light links, and contacts"


def percent(difference: float, tolerance: float = 0.0) -> str:
    """Relative difference with enough digits to distinguish it from `tolerance`; "< 0.001 %" below that."""
    if math.isnan(difference):
        return "–"
    if abs(difference) < 1e-5:
        return "< 0.001 %"
    return f"{100 * abs(difference):.{apart(abs(difference), tolerance, 2)}g} %"


def _compared(quantity: str, key: str, unit: str, significant: int, scale: float = 1.0) -> list[Column]:
    """Columns of a quantity predicted and simulated, and its relative difference; displayed is the JSON value times `scale`."""

    def column(how: str) -> Column:
        def value(case: VerifiedLimit) -> float:
            return getattr(case, f"{how}_{quantity}")

        shown = f"{how} [{unit}]"
        return Column(shown, f"{how}_{key}", value, shown=lambda case: digits(scale * value(case), significant=significant))

    def difference(case: VerifiedLimit) -> float:
        return getattr(case, f"{quantity}_difference")

    shown = Column("difference", f"{quantity}_difference", difference, shown=lambda case: percent(difference(case), case.tolerance))
    return [column("predicted"), column("simulated"), shown]


WITNESSES = {"linear": "linear simulation", "mujoco": "MuJoCo"}
"""Names of the witnesses, by Case.witness."""
NAMED = [Column("case", "what", lambda case: case.what), Column("method", "witness", lambda case: case.witness)]
GAIN = _compared("gain", "gain", "×", 6)
FREQUENCY = _compared("frequency", "frequency_rad_s", "Hz", 5, 0.5 / math.pi)
ALLOWED = Column("allowed", "tolerance", lambda case: case.tolerance, shown=lambda case: f"{digits(100 * case.tolerance)} %")
AGREES = Column("agrees", "agrees", lambda case: case.agrees, shown=lambda case: yes(case.agrees))
CASE = [*NAMED, *GAIN, *FREQUENCY, ALLOWED, AGREES]
"""Columns of a case."""
SHORT = [
    *NAMED,
    *(replace(column, title=column.title.removesuffix(" [×]")) for column in GAIN),
    replace(FREQUENCY[1], title="at [Hz]"),
    AGREES,
]
"""Columns of a case on a terminal."""


def size(value: float) -> float:
    """Magnitude of a difference; inf if there is none to compare."""
    return math.inf if math.isnan(value) else abs(value)


@dataclass(frozen=True)
class VerificationPresentation(Presentation):
    """Presentation of a verification; `call`: the command that judges all margins."""

    system: System
    result: Verification

    @property
    def advice(self) -> Advice | None:
        """Advice from a confirmed prediction: the limit may be relied on; None if the two disagree."""
        if not self.result.agrees:
            return None
        least, ranges = self.result.least, ", in the file's ranges too" if self.result.uncertain else ""
        if not least.predicted_gain < math.inf:
            return Advice("The prediction may be relied on: no factor on these gains makes it vibrate.")
        if not least.predicted_gain > 1:
            return Advice(
                "These gains are UNSTABLE, beyond a limit that may be relied on. Find gains that meet every requirement:", [self.call]
            )
        if least.enough is False:
            return Advice("Find gains that meet every requirement:", [self.call])
        return Advice(f"The limit may be relied on. It is one margin of several; judge all{ranges}:", [self.call])

    def facts(self) -> dict[str, Any]:
        return {
            "agrees": self.result.agrees,
            "sentence": sentence(self.result),
            "cases": [facts(CASE, case) for case in self.result.cases],
            "warnings": list(self.result.warnings),
        }

    def screens(self, verbose: bool) -> Iterator[list[Part]]:
        yield [
            sentence(self.result),
            *do_this(self.advice),
            "",
            TextTable.of("Factor on all gains at which vibration starts, and its frequency", SHORT, self.result.cases, ("difference",)),
            *(f"Left out: {warning}" for warning in self.result.warnings),
            *closing(self.files),
        ]
