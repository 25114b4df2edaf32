"""Record that a program or a notebook holds: a study with the numbers of its command, a card and a picture."""

from importlib import import_module
from typing import Any


class StudyRecord:
    """Study whose command has --json and --report; both come from `report`, which knows every study and loads where it is asked."""

    def to_dict(self) -> dict[str, Any]:
        """What the command's --json has: numbers in the units of its keys; what is not finite is None."""
        return _report().facts_of(self)

    def plot(self) -> Any:
        """Main picture of the command's page; a notebook shows it, `save(path)` writes a page."""
        return _report().picture_of(self)

    def __str__(self) -> str:
        return self.to_dict().get("sentence") or repr(self)

    def _repr_html_(self) -> str:
        """Card of the verdict, for a notebook."""
        return _report().card_of(self)


def _report() -> Any:
    """Module report.study_records, by name: no study imports what shows it."""
    return import_module("gainroom.report.study_records")
