"""Growing study of a robot: of the visible state first, then of all states."""

import math
from collections.abc import Iterator

from ..report.words import tone
from ..studies.analysis import analyzed, in_turn
from ..studies.progress import Progress
from ..studies.robot import NUMBERS, RobotStudy
from ..studies.state import State, limit_headroom
from ..system.system import System


class SoFar:
    """Cache of the latest study, for further views at the same gains."""

    def __init__(self) -> None:
        self._last: tuple[str, RobotStudy] | None = None

    def studies(self, key: str, system: System, shown: tuple[str, str], progress: Progress) -> Iterator[RobotStudy]:
        """Studies of the state `shown`, of all states so far whenever another is unstable, and finally of every state.

        `key` differs between different systems. The states with the least headroom before come first.
        """
        last = self._last
        if last is None or last[0] != key:
            progress(0, 1, "this state")
            before = {} if last is None else {_place(state): limit_headroom(state.limit) for state in last[1].states}
            order = sorted(system.source.states, key=lambda place: (place != shown, before.get(place, math.inf)))
            found: dict[tuple[str, str], State] = {}
            for state in in_turn(system, order, progress, NUMBERS):
                found[_place(state)] = state
                if len(found) < len(order) and state.moves and (len(found) == 1 or not state.limit.stable):
                    yield RobotStudy(system, tuple(found[place] for place in system.source.states if place in found))
            every = analyzed(system, (found[place] for place in system.source.states)).every
            last = self._last = key, RobotStudy(system, every)
        yield last[1]


def tone_so_far(study: RobotStudy) -> str:
    """Tone of the verdict on the page; "good" only after all states."""
    found = tone(study.verdict)
    return "wait" if study.examined and found == "good" else found


def _place(state: State) -> tuple[str, str]:
    return state.posture, state.contact
