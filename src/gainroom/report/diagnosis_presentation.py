"""A diagnosis as it is shown: keys of --json, lines of the terminal, page."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from ..studies.diagnosis import AT_LIMIT, Diagnosis
from .diagnosis_advice import advice
from .diagnosis_text import evidence_lines, evidence_text, sentence, warnings
from .log_text import logged_facts, logged_remarks
from .presentation import Part, Presentation, closing

if TYPE_CHECKING:
    from ..files.logs import LoggedJoint

SCALED = (*AT_LIMIT, "quantisation")
"""Causes that a factor on all gains ends, by the model."""


@dataclass(frozen=True)
class DiagnosisPresentation(Presentation):
    """All that is shown of a diagnosis; `log`: as it is called."""

    found: Diagnosis
    logged: "LoggedJoint"
    log: str

    def facts(self) -> dict[str, Any]:
        found, seen, predicted = self.found, self.found.oscillation, self.found.predicted
        return {
            **found.verdict.facts,
            "sentence": sentence(found),
            "vibrates": found.vibrates,
            "ran_away": found.ran_away,
            "vibration": None
            if seen is None or found.toggles
            else {
                "frequency_rad_s": seen.vibration.frequency,
                "growth_rate": seen.vibration.growth_rate,
                "state": seen.state,
                "amplitude": seen.vibration.amplitude,
                "channel": seen.side,
                "encoder_step": seen.step,
                "clipped": seen.clipped,
                "standing": seen.standing,
                "odd_harmonics": seen.odd,
                "even_harmonics": seen.even,
                "irregular": seen.irregular,
                "from": float(found.record.time[seen.rows][0]),
                "to": float(found.record.time[seen.rows][-1]),
            },
            "excitation_rad_s": None if found.search.excited is None else list(found.search.excited),
            "cause": None if found.cause is None else found.cause.name,
            "causes": [
                {
                    "cause": one.name,
                    "likelihood": one.likelihood,
                    "evidence": [vars(each) | {"text": evidence_text(each)} for each in one.evidence],
                }
                for one in found.causes
            ],
            "predicted": None
            if predicted is None
            else {
                "stable": predicted.limit.stable,
                "gain_limit": predicted.limit.gain,
                "frequency_rad_s": predicted.frequency,
                "growth_rate": predicted.growth,
            },
            "gain_factor": found.factor if found.vibrates and found.cause is not None and found.cause.name in SCALED else None,
            "advice": advice(found),
            "warnings": [*warnings(found), *logged_remarks(self.logged)],
            "log": logged_facts(self.logged),
        }

    def screens(self, verbose: bool) -> Iterator[list[Part]]:
        evidence = evidence_lines(self.found, everything=verbose)
        yield [
            sentence(self.found),
            *(f"→ {text}" for text in advice(self.found)),
            *(["", *evidence] if evidence else []),
            *([""] if self.files.get("Report") else []),
            *closing(self.files, warnings(self.found), notes=logged_remarks(self.logged)),
        ]

    def page(self, command: str) -> str:
        from .diagnosis import diagnosis_page  # loads the pictures

        return diagnosis_page(self.found, self.log, command)
