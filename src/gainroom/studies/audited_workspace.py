"""Audit of gains in the whole workspace: gain margin and extra delay in every posture, other margins in a sample."""

from dataclasses import dataclass, replace

from ..system.requirements import Requirements
from .audit import Audit
from .progress import Progress, quiet
from .sweep.summary import SweepSummary
from .sweep.workspace import over_workspace
from .swept_margins import SampledRequirement, WorstStates, worst_states
from .verdict import Finding

EACH = 20
"""Number of sampled postures with the lowest gain limits, and as many at random, of each contact state."""


@dataclass(frozen=True)
class AuditedWorkspace:
    """Gain limits over a workspace, and the sample in which all other margins were computed.

    later      gain limits in the same postures with the required extra delay; None: none is required
    asked      requirements of the audit; other margins in the sample are judged by defaults, which decide nothing
    """

    summary: SweepSummary
    later: SweepSummary | None
    sample: WorstStates
    asked: Requirements

    @property
    def safe(self) -> bool:
        """True if every requirement is met in every posture in which it was judged."""
        return not self.unmet

    @property
    def findings(self) -> tuple[Finding, ...]:
        """Findings of requirements missed in some posture."""
        return tuple(Finding(name, "unsafe", state="workspace") for name in self.unmet)

    @property
    def unmet(self) -> tuple[str, ...]:
        """Names of the requirements missed in some posture."""
        missed = [] if self.summary.margin_held else ["gain_margin"]
        missed += [] if self.later is None or self.later.margin_held else ["delay_margin"]
        return tuple(dict.fromkeys([*missed, *(name for name in self.sample.unmet if name in self.asked.asked)]))

    @property
    def requirements(self) -> list[SampledRequirement]:
        """Requirements other than the gain margin, as judged in the sample."""
        return [one for one in self.sample.requirements if one.requirement.name in self.asked.asked]

    @property
    def tightest(self) -> SweepSummary:
        """Sweep with more unsafe postures: with the given delay, or with the extra one."""
        return max([self.summary, *([] if self.later is None else [self.later])], key=lambda one: one.unsafe)

    @property
    def scale(self) -> float:
        """Factor on all gains with which gain margin and extra delay hold in every posture; NaN: none is known."""
        if self.later is None:
            return self.summary.scale
        scale = min(self.summary.scale, self.later.scale)
        return scale if scale >= max(self.summary.lower * self.summary.margin, self.later.lower) else float("nan")


def audited_workspace(result: Audit, samples: int, progress: Progress = quiet) -> AuditedWorkspace:
    """Audit in `samples` postures within the joints' limits in every contact state. Raises as over_workspace.

    Gains that are unstable with the required extra delay miss the delay margin; that stable ones are stable with every shorter delay, too,
    is checked in the sample.
    """
    asked = result.required
    shapes = asked.only(*(name for name in asked.asked if name not in ("gain_margin", "delay_margin")))
    further = {**(shapes if shapes.asked else Requirements.usual().only("phase_margin", "peak_sensitivity")).needed}
    further |= asked.only("gain_margin", "delay_margin").needed
    system = replace(result.system, requirements=Requirements(**further))
    found, later = over_workspace(system, samples, result.margin, progress), None
    if result.delay_margin > 0:
        delays = [drive.delay + result.delay_margin for drive in system.drives]
        later = over_workspace(system.with_values(delay=delays), samples, 1.0, progress)
    return AuditedWorkspace(found, later, worst_states(found, EACH, progress), asked)
