"""A whole workspace in words and in JSON, as a part of another command's answer."""

import math
from typing import Any

from ..studies.analysis import typed_factor
from ..studies.audited_workspace import AuditedWorkspace
from ..studies.sweep.summary import SweepSummary
from .sweep_text import judged_facts, looked_at, posture_facts, sentence, sureness, unmet_text, warnings


def workspace_text(swept: AuditedWorkspace) -> str:
    """What an audit says of it in the terminal."""
    found = swept.found
    said = [sentence(found), *sureness(found, None), *warnings(found), workspace_advice(found), unmet_there(swept), judged_there(swept)]
    return " ".join(["Workspace:", *filter(None, said)])


def unmet_there(swept: AuditedWorkspace) -> str:
    """What fails in the sample, besides the gain margin; "" where nothing does."""
    return unmet_text(swept.found, swept.sample, swept.required)


def judged_there(swept: AuditedWorkspace) -> str:
    """Where which requirement was judged."""
    return looked_at(swept.found, swept.sample) or "Judged there: the gain margin alone."


def audited_facts(swept: AuditedWorkspace) -> dict[str, Any]:
    """As workspace_facts, with the sample in which other requirements were judged."""
    found, sample = swept.found, swept.sample
    return workspace_facts(found) | {
        "safe": swept.safe,
        "unmet": [*([] if found.margin_held else ["gain_margin"]), *(sample.unmet if swept.required else ())],
        "judged": judged_facts(found, sample),
    }


def workspace_advice(found: SweepSummary) -> str:
    """Which common factor keeps the gain margin in the whole workspace; "" where these gains do."""
    if found.margin_held:
        return ""
    scale = found.scale
    if not math.isfinite(scale):
        return "No common factor is known to keep the gain margin in every posture swept."
    return f"All gains × {typed_factor(scale):.4g} keep the gain margin in every posture swept."


def workspace_facts(found: SweepSummary) -> dict[str, Any]:
    """A workspace in JSON, as a part of another command's answer."""
    return {
        "sentence": sentence(found),
        "count": found.plan.postures.count,
        "limits": found.count,
        "stable": found.stable,
        "gain_margin_met": found.margin_held,
        "safe_share": 1 - sum(one.unsafe for one in found.contacts) / found.count,
        "unstable_share": sum(one.unstable for one in found.contacts) / found.count,
        "below_margin_share": sum(one.short for one in found.contacts) / found.count,
        "unknown": found.unknown,
        "uncertified": found.uncertified,
        "rarer_than": found.rarer_than,
        "scale": found.scale,
        "worst": posture_facts(found, found.worst),
    }
