"""With which gains the search for a robot's begins: stiffer ones are left out only where what is softer is known to vibrate."""

from typing import Any

import numpy as np
import pytest

import gainroom as gr
from gainroom.analysis.margin_record import GainLimit, Margins
from gainroom.design.gain_sets import GainSet, StateStiffness
from gainroom.design.robot_gains import _Searches
from gainroom.design.starting_gains import SHARES, WEIGHED, Beginning, stable_starts

BEGINNING = Beginning(np.array([[1.0], [1.0], [0.0]]), np.ones(1), [], np.zeros(1, dtype=bool), np.ones(1))


class Holds:
    """A case that is stable from a stiffness on, and perhaps known to vibrate where it is not."""

    def __init__(self, least: float, vibrating: bool) -> None:
        self.least, self.vibrating = least, vibrating
        self.asked: list[float] = []

    def stable(self, gains: Any) -> bool:
        self.asked.append(float(gains[0, 0]))
        return bool(gains[0, 0] >= self.least)

    def vibrates(self, gains: Any) -> bool:
        return self.vibrating

    def known(self, gains: Any) -> bool:
        return True


def test_stiff_beginnings_are_tried_where_it_is_not_known_that_soft_ones_vibrate():
    stiffest = SHARES[0] * max(WEIGHED)
    case: Any = Holds(0.9 * stiffest, vibrating=False)
    first = next(stable_starts([case], BEGINNING, True, lambda: None, None, False))
    assert first[0, 0] == pytest.approx(stiffest)


def test_what_vibrates_is_not_tried_stiffer_with_the_same_damping():
    case: Any = Holds(np.inf, vibrating=True)
    assert list(stable_starts([case], BEGINNING, True, lambda: None, None, False)) == []
    softer = [soft for k, soft in enumerate(WEIGHED) if soft < min(WEIGHED[:k], default=np.inf)]
    assert case.asked == pytest.approx([share * soft for share in SHARES for soft in softer])


@pytest.mark.parametrize("feedback", ["motor", "link"])
@pytest.mark.parametrize("sample_time", [None, 1e-3])
def test_loops_are_known_to_hold_up_the_weight_only_where_stiffness_tells(feedback, sample_time):
    """Two joints that both topple: sampled, their number is even, which is no verdict; at the links nothing tells."""
    plant = gr.Plant(np.eye(2), np.full(2, 0.1), np.full(2, 1e4), np.full(2, 10.0), gravity_stiffness=-50.0 * np.eye(2))
    soft, stiff = (gr.build_loop(plant, [gr.Drive(2000.0, 0.9, 1e-3)] * 2, gr.PD(kp, 5.0), feedback, sample_time) for kp in (10.0, 200.0))
    assert soft.topples == (feedback == "motor" and sample_time is None)
    assert not soft.stands
    assert stiff.stands == (feedback == "motor")


def gain_set(kp: float, without_weight: bool) -> GainSet:
    unknown = Margins.unknown(GainLimit.unknown(1))
    links = StateStiffness("there/here", "here", np.array([0.5 * kp]), np.ones(1), np.zeros(1, dtype=bool))
    return GainSet("", np.array([kp]), np.ones(1), None, unknown, "", 1, (links,), without_weight=without_weight)


class Weighed:
    def __init__(self, weighed: bool) -> None:
        self.weighed = weighed


@pytest.mark.parametrize("weighed", [True, False])
def test_a_set_is_behind_one_that_counts_the_weight_or_is_stiffer(weighed):
    """In the air no set counts a weight: there stiffness decides, although the set for all leaves out the weight of others."""
    states: Any = {"here": [Weighed(weighed)]}
    searches = _Searches(states, lambda state: state, None, "dynamic_stiffness", BEGINNING, (), {})  # pyright: ignore[reportArgumentType]
    soft, stiff, light = gain_set(1.0, False), gain_set(2.0, False), gain_set(2.0, True)
    assert searches._behind("here", None, soft)
    assert searches._behind("here", soft, stiff)
    assert not searches._behind("here", stiff, soft)
    assert searches._behind("here", soft, light) == (not weighed)
    assert searches._behind("here", light, soft) == weighed
