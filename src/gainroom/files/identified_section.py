"""Section `identified` of a joint.yaml: the parameters that `gainroom identify joint` fitted, their covariance, and the log's name."""

from typing import Annotated, Literal

import numpy as np
from pydantic import BeforeValidator, Field

from ..identification.estimate import PARAMETERS
from ..io.validation import LARGEST, Flag, Name, Refusals, Section, refusal, relation
from ..io.yaml_text import shown
from ..system.linear.arrays import Floats

ROUND_OFF = 1e-6
"""Tolerance of a correlation: the written digits change its symmetry, and an eigenvalue of 0, by less than this."""


def _finite(value: object) -> float:
    """Number of any usable size: variances are squares, and may be far smaller than measured values."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise refusal(f"{shown(value)} is not a number")
    if not abs(value) <= LARGEST**2:
        raise refusal(f"{value} must be finite, and at most {LARGEST**2:g} in size")
    return float(value)


Signed = Annotated[float, BeforeValidator(_finite)]


class IdentifiedSection(Section):
    """Section `identified`: origin of the file's numbers. Units are SI on the joint side, the delay in s."""

    log: Name = Field(description="the log's name")
    date: Name = Field(description="when it was identified")
    gainroom: Name = Field(description="the version that identified it")
    model: Literal["rigid", "two-mass", "two-mass with friction"] = Field(description="the model that was fitted")
    adequate: Flag = Field(description="whether the residuals hold nothing that the torque explains")
    names: list[Name] = Field(description="the names of the parameters that were fitted", max_length=len(PARAMETERS))
    values: list[Signed] = Field(description="the values of the parameters, in SI", max_length=len(PARAMETERS))
    covariance: list[list[Signed]] = Field(description="the covariance of the parameters, in SI", max_length=len(PARAMETERS))

    @relation
    def _names_fit(self) -> Refusals:
        for index, name in enumerate(self.names):
            if name not in PARAMETERS or name in self.names[:index]:
                what = "is there twice" if name in PARAMETERS else f"must be one of {', '.join(PARAMETERS)}"
                yield refusal(f"{shown(name)} {what}", key=f"names[{index}]")

    @relation
    def _values_fit(self) -> Refusals:
        count = len(self.names)
        if len(self.values) != count:
            yield refusal(f"{len(self.values)} values must be {count}, one per name", key="values")

    @relation
    def _covariance_fits(self) -> Refusals:
        count = len(self.names)
        if len(self.covariance) != count or any(len(row) != count for row in self.covariance):
            yield refusal(f"must have {count} rows of {count} numbers, one per name", key="covariance")
        elif problem := problem_of(np.array(self.covariance).reshape(count, count)):
            yield refusal(problem, key="covariance")

    @property
    def coulomb(self) -> tuple[float, float]:
        """Coulomb friction of motor and link [N m]; 0 if the fit has none."""
        self.require_right()
        found = dict(zip(self.names, self.values, strict=True))
        return abs(found.get("coulomb", 0.0)), abs(found.get("link_coulomb", 0.0))


def problem_of(covariance: Floats) -> str:
    """Reason why a matrix (p, p) is not a covariance; "" if it is one."""
    variances = np.diag(covariance)
    if np.any(variances < 0):
        return f"variance {variances.min():g} must be >= 0"
    deviation = np.sqrt(np.outer(variances, variances))
    if np.any(np.abs(covariance) > deviation * (1 + ROUND_OFF)):
        return "must have no correlation beyond 1"
    correlation = np.divide(covariance, deviation, out=np.zeros_like(covariance), where=deviation > 0)
    if np.any(np.abs(correlation - correlation.T) > ROUND_OFF):
        return "must be symmetric"
    least = float(np.linalg.eigvalsh(correlation).min(initial=0.0))
    return f"must have no eigenvalue below 0 (of its correlations the least is {least:.3g})" if least < -ROUND_OFF else ""
