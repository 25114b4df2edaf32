"""A sweep as it is shown: keys of --json, lines of the terminal, page."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from .. import __version__
from ..io.as_typed import as_typed
from ..studies.sweep.store import Store
from ..studies.sweep.summary import SweepSummary
from ..studies.swept_margins import WorstStates, swept_verdict
from ..system.margin_units import to_db
from .columns import facts
from .number_format import model_facts
from .presentation import Grid, Part, Presentation, closing, warned_first
from .robot_columns import state_columns
from .sweep_text import advice, columns, looked_at, posture_facts, sample_facts, sentence, sureness, verdict, warnings


@dataclass(frozen=True)
class SweepPresentation(Presentation):
    """All that is shown of a sweep; `mended`: what was damaged and computed again."""

    found: SweepSummary
    at_worst: WorstStates
    store: Store
    mended: Sequence[str]

    def facts(self) -> dict[str, Any]:
        found, plan, at_worst, output = self.found, self.found.plan, self.at_worst, self.files.get("Results")
        return {
            "robot": plan.robot.name,
            "gainroom": __version__,
            **swept_verdict(found, at_worst).facts,
            "stable": found.stable,
            "gain_margin_met": found.margin_held if found.margin > 1 else None,
            "unmet": [*(["gain_margin"] if found.margin > 1 and not found.margin_held else []), *at_worst.unmet],
            "sentence": sentence(found),
            **model_facts(plan.system.control.sample_time),
            "margin_db": as_typed(to_db(found.margin)) if found.margin > 1 else None,
            "postures": plan.postures.kind,
            "count": plan.postures.count,
            "draws": len(plan.places) - 1,
            "limits": found.count,
            "unknown": found.unknown,
            "uncertified": found.uncertified,
            "worst": posture_facts(found, found.worst_posture),
            "searched": posture_facts(found, found.searched),
            "worst_states": [facts(state_columns(), state) for state in at_worst.states],
            "judged": sample_facts(found, at_worst),
            "scale": found.scale,
            "rarer_than": found.rarer_than,
            "contacts": [facts(columns(found), one) for one in found.contacts],
            "output": None if output is None else str(output),
            "warnings": [*warnings(found), *self.mended],
        }

    def screens(self, verbose: bool) -> Iterator[list[Part]]:
        found, at_worst = self.found, self.at_worst
        doubts, warned = warned_first(warnings(found), True)
        yield [
            *doubts,
            *verdict(found, at_worst),
            *filter(None, [advice(found, at_worst)]),
            Grid.of("", columns(found), found.contacts, ("highest", "10 %")),
            *sureness(found, found.searched),
            *filter(None, [looked_at(found, at_worst)]),
            *closing(self.files, [*warned, *self.mended]),
        ]

    def page(self, command: str) -> str:
        from .sweep import sweep_page  # loads the pictures

        return sweep_page(self.found, self.at_worst, self.store, command)
