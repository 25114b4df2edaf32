"""A verification as it is shown: keys of --json, lines of the terminal, page."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from ..studies.verification import Verification
from ..system.system import System
from .columns import facts
from .presentation import Grid, Part, Presentation, closing, do_this
from .verification_text import CASE, SHORT, sentence, what_to_do


@dataclass(frozen=True)
class VerificationPresentation(Presentation):
    """All that is shown of a verification; `call`: judges all margins."""

    system: System
    result: Verification

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
            *do_this(what_to_do(self.result, self.call)),
            "",
            Grid.of("Factor on all gains at which vibration starts, and its frequency", SHORT, self.result.cases, ("difference",)),
            *(f"Left out: {warning}" for warning in self.result.warnings),
            *closing(self.files),
        ]

    def page(self, command: str) -> str:
        from .verification import verification_page  # loads the pictures

        return verification_page(self.system, self.result, command, self.call)
