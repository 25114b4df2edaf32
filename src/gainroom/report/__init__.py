"""Results → pictures and pages."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ..studies.joint import JointStudy


def joint_page(study: "JointStudy", command: str, call: str = "gainroom joint FILE") -> str:
    """The report of one joint: a self-contained HTML page. `command` is what a reader types to get it again."""
    from .joint import joint_page

    return joint_page(study, command, call)
