"""Studies as a program holds them: the numbers of their command's --json, a card for a notebook, and the main picture of their page."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import singledispatch
from html import escape
from pathlib import Path
from typing import Any

from ..errors import GainroomError
from ..files.compare_section import assumption
from ..io.atomic import write_text
from ..io.strict_json import strict
from ..studies.audit import Audit
from ..studies.comparison import Comparison
from ..studies.joint import JointStudy
from ..studies.robot import RobotStudy
from . import style
from .audit import headroom
from .audit_text import AuditPresentation
from .comparison import bars
from .comparison_text import ComparisonPresentation
from .gain_map import gain_map
from .joint_tables import JointPresentation
from .page import Html, Lead, Section, page
from .presentation import Presentation
from .robot import decisive_picture
from .robot_tables import RobotPresentation
from .words import tone

COLORS = {"good": style.BLUE, "warn": style.ORANGE, "bare": style.ORANGE, "bad": style.VERMILION}
"""Colours of a card's edge by tone of the verdict: told apart by everybody, as on the pages."""


@dataclass(frozen=True)
class Picture:
    """Picture of a study as a self-contained page."""

    html: str

    def save(self, path: Path | str) -> None:
        """Write the page. Raises GainroomError if it cannot be written."""
        write_text(Path(path), self.html)

    def _repr_html_(self) -> str:
        return f'<iframe srcdoc="{escape(self.html)}" style="width:100%;height:620px;border:0"></iframe>'


@dataclass(frozen=True)
class Shown:
    """How a study is shown: its presentation, and its main figure."""

    presentation: Presentation
    figure: Callable[[], Html]


@singledispatch
def _shown(study: Any) -> Shown:
    raise GainroomError(f"a {type(study).__name__} has no page")


@_shown.register
def _joint(study: JointStudy) -> Shown:
    return Shown(JointPresentation(study), lambda: gain_map(study))


@_shown.register
def _audit(study: Audit) -> Shown:
    if study.of is None:
        raise GainroomError("this audit is of a system; gainroom.audit takes a model and its gains, and has numbers, card and picture")
    return Shown(AuditPresentation(study, study.of), lambda: headroom(study))


@_shown.register
def _comparison(study: Comparison) -> Shown:
    assumed = assumption(study.system, study.settings)
    shown = ComparisonPresentation(study, study.system, study.settings, assumed=assumed)
    return Shown(shown, lambda: bars(study))


@_shown.register
def _robot(study: RobotStudy) -> Shown:
    return Shown(RobotPresentation(study), lambda: decisive_picture(study))


def facts_of(study: Any) -> dict[str, Any]:
    """Numbers of the study as its command's --json has them."""
    return strict(_shown(study).presentation.facts())


def card_of(study: Any) -> str:
    """Card of the verdict as HTML: its sentence beside an edge in the verdict's colour."""
    facts = _shown(study).presentation.facts()
    color = COLORS[tone(study.verdict)] if hasattr(study, "verdict") else style.BLUE
    return (
        f'<div style="border-left:6px solid {color};padding:.4em 1em;max-width:60em;font-family:system-ui,sans-serif">'
        f"{escape(facts['sentence'])}</div>"
    )


def picture_of(study: Any) -> Picture:
    """Main picture of the study's page."""
    shown = _shown(study)
    sentence = shown.presentation.facts()["sentence"]
    return Picture(page("gainroom", Lead(sentence), [], [Section("", [shown.figure()])], ""))
