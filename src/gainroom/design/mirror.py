"""States of a robot that mirror each other, as a biped's on its left and on its right foot: one set of gains, in another order of joints.

W' = Q W Qᵀ with Q a permutation of the joints with signs, likewise what gravity adds; motors, gearboxes and drives in that order. Gains
then do in one state what they do, in that order, in the other.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from ..analysis.margin_record import worst_of
from ..system.linear.arrays import Floats, Integers
from ..system.plant import Plant
from ..system.requirements import Requirements
from ..system.system import StateCase
from .gain_cases import SearchedState
from .gain_sets import GainSet, StateStiffness
from .margin_slopes import GainCase
from .set_search import AT_JOINT, ON_BOUNDS
from .starting_gains import Beginning

EXACT = 1e-9
"""Difference of entries, in a matrix whose diagonal is 1, below which it is round-off."""
COUPLED = 1e-6
"""Least entry, in such a matrix, whose sign says which joints turn the other way."""
PARTS = ("motor_inertia", "stiffness", "damping", "motor_viscous", "link_viscous")


def mirrored(
    contacts: Sequence[str], states: Mapping[str, Sequence[SearchedState]], beginning: Beginning, images: Sequence[Sequence[int]]
) -> list[list[str]]:
    """Groups of contact states that mirror each other: joints, directions, units and bounds of their gains, and equal ones, are alike."""
    together = {frozenset(image) for image in images}
    groups: list[list[str]] = []
    for contact in contacts:
        for group in groups:
            order = _order_of_directions(states[group[0]], states[contact])
            if order is None or {frozenset(order[list(image)].tolist()) for image in images} != together:
                continue
            if all(
                np.allclose(each[..., order], each, rtol=EXACT, atol=0.0)
                for each in (beginning.gains, beginning.unit, *beginning.bounds.box(len(order)))
            ):
                group.append(contact)
                break
        else:
            groups.append([contact])
    return groups


def _order_of_directions(states: Sequence[SearchedState], others: Sequence[SearchedState]) -> Integers | None:
    """Order (m,): for each direction of `others` the one of `states` that mirrors it; tasks' directions are themselves. None: no mirror."""
    order = mirror_of([(one.state, one.with_weight) for one in states], [(one.state, one.with_weight) for one in others])
    size = len(states[0].moves)
    return order if order is None or states[0].with_weight.joints else np.arange(size)


def mirror_image(
    found: GainSet | None, states: Sequence[SearchedState], others: Sequence[SearchedState], required: Requirements
) -> GainSet | None:
    """Set for `others` from that of the `states` that they mirror; None where there is none, or it breaks a requirement."""
    order = _order_of_directions(states, others)
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
        links=tuple(_turned_links(one, order, others[0].contact) for one in found.links),
        margin=tuple(found.margin[j] for j in order),
        case=where,
        of_sway=tuple(found.of_sway[j] for j in order),
        softest=softest,
        nearest=_of_mirrored(found.nearest, titles),
        topples=tuple(topples),
    )


def _turned_links(one: StateStiffness, order: Integers, contact: str) -> StateStiffness:
    """Link stiffness of the mirrored state in `contact`: each joint has the value of its image, by `order` (m,)."""
    title = one.title.removesuffix(one.contact) + contact
    return StateStiffness(title, contact, one.stiffness[order], one.omega[order], one.gear_limited[order], one.damping)


def _of_mirrored(nearest: str, titles: Mapping[str, str]) -> str:
    """Text `nearest` (set_search.py) with states replaced by their mirror images, without what names joints: others do."""
    shortage, between, title = nearest.partition(ON_BOUNDS)[0].partition(AT_JOINT)[0].rpartition(" in ")
    return shortage + between + titles.get(title, title)


def mirror_of(states: Sequence[tuple[StateCase, GainCase]], others: Sequence[tuple[StateCase, GainCase]]) -> Integers | None:
    """Order (n,): for each joint of `others` the joint of `states` that mirrors it, in all states; None where the loops do not mirror.

    Where the directions of a case are those of tasks, each has to be itself in the other case.
    """
    if len(states) != len(others) or any(one.model.compliance is not None for one, _ in (*states, *others)):
        return None
    order = _order([one.model for one, _ in states], [one.model for one, _ in others])
    if order is None:
        return None
    pairs = list(zip(states, others, strict=True))
    forms = [(one.model, other.model) for (one, _), (other, _) in pairs]
    turned = _turned([(_scaled(a)[np.ix_(order, order)], _scaled(b)) for a, b in forms])
    for ((one, case), (other, twin)), (a, b) in zip(pairs, forms, strict=True):
        if any(one.system.drives[j] != other.system.drives[k] for k, j in enumerate(order.tolist())):
            return None
        if not all(np.allclose(getattr(a, name)[order], getattr(b, name), rtol=EXACT, atol=0.0) for name in PARTS):
            return None
        if not _same(_scaled(a)[np.ix_(order, order)] * np.outer(turned, turned), _scaled(b)):
            return None
        if not _same(_weight(a)[np.ix_(order, order)] * np.outer(turned, turned), _weight(b)):
            return None
        if not _tasks_alike(case, twin, order, turned):
            return None
    return order


def _scaled(model: Plant) -> Floats:
    """Inverse inertia W in units in which its diagonal is 1."""
    own = np.sqrt(np.maximum(np.diagonal(model.link_inverse_inertia), 1e-300))
    return model.link_inverse_inertia / np.outer(own, own)


def _weight(model: Plant) -> Floats:
    """Gravity stiffness (n, n); zeros where there is none."""
    return np.zeros((model.size, model.size)) if model.gravity_stiffness is None else model.gravity_stiffness


def _same(one: Floats, other: Floats) -> bool:
    return bool(np.abs(one - other).max() <= EXACT * max(np.abs(one).max(), np.abs(other).max()))


def _order(models: Sequence[Plant], others: Sequence[Plant]) -> Integers | None:
    """Order (n,): for each joint of `others` the joint of `models` with the same own data and coupling in all states, or None."""

    def marks(each: Sequence[Plant]) -> Floats:
        rows = [getattr(model, name) for model in each for name in PARTS]
        rows += [np.diagonal(model.link_inverse_inertia) for model in each]
        rows += [(_scaled(model) ** 2).sum(axis=1) for model in each]
        return np.array(rows).T

    free, found = marks(models), []
    for mark in marks(others):
        alike = [j for j in range(len(free)) if j not in found and np.allclose(free[j], mark, rtol=1e-6, atol=0.0)]
        if not alike:
            return None
        found.append(alike[0])
    return np.array(found)


def _turned(forms: Sequence[tuple[Floats, Floats]]) -> Floats:
    """Signs (n,): −1 for joints that turn the other way, from the signs of their coupling."""
    size = len(forms[0][0])
    turned, open_ = np.zeros(size), []
    for first in range(size):
        if turned[first]:
            continue
        turned[first], open_ = 1.0, [first]
        while open_:
            i = open_.pop()
            for one, other in forms:
                for j in np.flatnonzero((np.abs(one[i]) > COUPLED) & (turned == 0)).tolist():
                    turned[j] = turned[i] * (1.0 if one[i, j] * other[i, j] > 0 else -1.0)
                    open_.append(j)
    return turned


def _tasks_alike(case: GainCase, twin: GainCase, order: Integers, turned: Floats) -> bool:
    """True if each task direction measures and drives, up to its sign, the mirrored joints in both cases."""
    if case.torque.shape != twin.torque.shape or not np.array_equal(case.cascade, twin.cascade):
        return False
    if case.joints:
        return twin.joints
    seen, moved = case.jacobian[:, order] * turned, case.torque[order] * turned[:, None]
    ways = np.sign((seen * twin.jacobian).sum(axis=1))
    return _same(seen * ways[:, None], twin.jacobian) and _same(moved * ways, twin.torque)
