"""The outcome of a verification in a sentence."""

import math

from ..errors import apart
from ..studies.verification import Case, Verification
from .number_format import digits


def sentence(result: Verification) -> str:
    """The answer in one sentence."""
    cases, what = result.cases, "the robot" if result.of_robot else "the joint"
    wrong = sorted((case for case in cases if not case.agrees), key=lambda case: -_furthest(case) / case.tolerance)
    worst = max(cases, key=lambda case: (_size(case.gain_difference), 0 < case.predicted_gain < math.inf))
    if wrong:
        names = ", ".join(f"{case.what} ({case.witness}), {_differences(case)}" for case in wrong[:3])
        names += " and others" if len(wrong) > 3 else ""
        return (
            f"Simulation and prediction differ by more than the tolerance in {len(wrong)} of {len(cases)} cases: {names}; "
            f"{_where_to_look(cases, wrong)}."
        )
    if not 0 < worst.predicted_gain < math.inf:
        reason = f"no common factor on these gains makes {what} vibrate" if worst.predicted_gain else "no lower gains are stable"
        return f"Simulation agrees with the prediction: {reason}."
    return (
        f"Simulation agrees with the prediction: vibration begins at {worst.simulated_gain:.5g} times these gains, predicted "
        f"{worst.predicted_gain:.5g}, {percent(worst.gain_difference)} apart"
        + (f" in the worst of {len(cases)} cases" if len(cases) > 1 else "")
        + f"; both without the scenario's friction{', torque limit and ground' if result.of_robot else ' and torque limit'}."
    )


def _furthest(case: Case) -> float:
    """The larger of both differences."""
    return max(_size(case.gain_difference), _size(case.frequency_difference))


def _differences(case: Case) -> str:
    """What of it is off, and by how much."""
    parts = []
    for what, difference in (("gain", case.gain_difference), ("frequency", case.frequency_difference)):
        if not abs(difference) <= case.tolerance:
            parts.append(f"no {what} found" if math.isnan(difference) else f"{what} {percent(difference, case.tolerance)} apart")
    return ", ".join(parts) + f" with {100 * case.tolerance:g} % allowed"


def _where_to_look(cases: tuple[Case, ...], wrong: list[Case]) -> str:
    """Which of model and simulation is to be doubted."""
    if any(case.witness == "linear" for case in wrong):
        return "the prediction itself is in doubt: report the input"
    if any(case.witness == "linear" for case in cases):
        return "the linear simulation agrees, so look at what MuJoCo steps or holds differently: stiff gearboxes on light links, contacts"
    return "look at stiff gearboxes on light links, and at contacts"


def percent(difference: float, tolerance: float = 0.0) -> str:
    """A relative difference, in digits enough to tell it from `tolerance`; below a thousandth of a percent none are worth it."""
    if math.isnan(difference):
        return "–"
    if abs(difference) < 1e-5:
        return "< 0.001 %"
    return f"{100 * abs(difference):.{apart(abs(difference), tolerance, 2)}g} %"


def gain_cells(case: Case) -> tuple[str, ...]:
    """Predicted and simulated factor on the gains, and how far they are apart."""
    gains = (digits(gain, "", 6) for gain in (case.predicted_gain, case.simulated_gain))
    return *gains, percent(case.gain_difference, case.tolerance)


def frequency_cells(case: Case) -> tuple[str, ...]:
    """The same of the frequency [rad/s]."""
    frequencies = (digits(omega, "", 5) for omega in (case.predicted_frequency, case.simulated_frequency))
    return *frequencies, percent(case.frequency_difference, case.tolerance)


def _size(value: float) -> float:
    return math.inf if math.isnan(value) else abs(value)
