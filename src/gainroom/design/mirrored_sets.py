"""Recommended gains of contact states that mirror each other, as a left and a right leg do: one set in another order."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from ..analysis.margin_record import worst_of
from ..system.linear.arrays import Integers
from ..system.requirements import Requirements
from .gain_cases import SearchedState
from .gain_sets import GainSet
from .mirror import EXACT, mirror_of
from .starting_gains import Beginning


def mirrored(contacts: Sequence[str], states: Mapping[str, Sequence[SearchedState]], beginning: Beginning) -> list[list[str]]:
    """Groups of contact states that mirror each other: joints, directions and units of their gains are alike."""
    groups: list[list[str]] = []
    for contact in contacts:
        for group in groups:
            order = _order(states[group[0]], states[contact])
            if order is not None and all(
                np.allclose(each[..., order], each, rtol=EXACT, atol=0.0) for each in (beginning.gains, beginning.unit)
            ):
                group.append(contact)
                break
        else:
            groups.append([contact])
    return groups


def _order(states: Sequence[SearchedState], others: Sequence[SearchedState]) -> Integers | None:
    """Order (m,): for each direction of `others` the one of `states` that mirrors it; tasks' directions are themselves. None: no mirror."""
    order = mirror_of([(one.state, one.with_weight) for one in states], [(one.state, one.with_weight) for one in others])
    size = len(states[0].moves)
    return order if order is None or states[0].with_weight.joints else np.arange(size)


def mirror_image(
    found: GainSet | None, states: Sequence[SearchedState], others: Sequence[SearchedState], required: Requirements
) -> GainSet | None:
    """Set for `others` from that of the `states` that they mirror; None where there is none, or it breaks a requirement."""
    order = _order(states, others)
    if found is None or not found.moves or order is None:
        return None
    kp, kd, ki = found.kp[order], found.kd[order], None if found.ki is None else found.ki[order]
    gains = np.nan_to_num(np.array([kp, kd, np.zeros(len(order)) if ki is None else ki]))
    margins = [(one.without if found.without_weight else one.with_weight).all_margins(gains) for one in others]
    topples = [one.with_weight.title for one in others if found.without_weight and not one.with_weight.margins(gains).stable]
    if not all(required.met_by(one) for one in margins) or len(topples) != len(found.topples):
        return None
    titles = {one.with_weight.title: other.with_weight.title for one, other in zip(states, others, strict=True)}
    where = tuple(titles.get(found.case[j], "") for j in order)
    softest = int(np.flatnonzero(order == found.softest)[0])
    return replace(
        found,
        contact=others[0].contact,
        kp=kp,
        kd=kd,
        ki=ki,
        margins=worst_of(margins),
        binding=where[softest],
        compliance=found.compliance[order],
        margin=tuple(found.margin[j] for j in order),
        case=where,
        softest=softest,
        nearest=_of_mirrored(found.nearest, titles),
        topples=tuple(topples),
    )


def _of_mirrored(nearest: str, titles: Mapping[str, str]) -> str:
    """Text of `_nearest` with the titles of the mirrored states."""
    shortage, between, title = nearest.rpartition(" in ")
    return shortage + between + titles.get(title, title)
