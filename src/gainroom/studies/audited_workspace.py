"""Gains of an audit in the whole workspace: the gain margin everywhere, what else is asked of them in a sample."""

from dataclasses import dataclass, replace

from ..system.requirements import Requirements
from .audit import Audit
from .state import Progress
from .sweep.summary import SweepSummary
from .sweep.workspace import over_workspace
from .swept_margins import WorstStates, worst_states

EACH = 20
"""Postures with the lowest gain limits, and as many at random, of each contact state."""


@dataclass(frozen=True)
class AuditedWorkspace:
    """Gain limits of a workspace, and the sample in which phase margin and Ms were judged.

    required   whether the audit asks for these; otherwise they are held against what is usual, and decide nothing
    """

    found: SweepSummary
    sample: WorstStates
    required: bool

    @property
    def safe(self) -> bool:
        """All that is asked for holds, wherever it was judged."""
        return self.found.margin_held and not (self.required and self.sample.unmet)


def audited_workspace(result: Audit, samples: int, progress: Progress | None = None) -> AuditedWorkspace:
    """`samples` postures within the joints' limits in every contact state. Raises as over_workspace does."""
    asked = result.required.only("phase_margin", "peak_sensitivity")
    system = replace(result.system, requirements=asked if asked.asked else Requirements.usual())
    found = over_workspace(system, samples, result.margin, progress)
    return AuditedWorkspace(found, worst_states(found, EACH, progress), bool(asked.asked))
