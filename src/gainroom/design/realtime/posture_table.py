"""Gains by posture and contact, looked up: limits on a grid of posture features, for controllers that compute nothing.

A feature is a set of joints that bend together: each stands at its base angle plus its weight times the feature's value. At every point
of the grid, in every contact state, the gain limit is computed, the common factor on all gains, with its certificate. A posture
lies in a cell of the grid; its factor is

    factor = min(highest, between · least of the cell's corners / gain margin)

Nothing is proved about postures between the points. `between` is what was found there: postures drawn at random, joints beside the
features up to `aside` included, are examined, and the lowest ratio of limit to the least of the corners bounds all factors, where it is
below 1. With n such postures a further one of the same kind lies below it with a probability of 1/(n + 1).

Outside the grid, and farther beside it, the lowest gains of the contact state come back with a status that says so, times `outside`: the
lowest ratio of limit to the table's least among random postures up to a grid's width beyond it and ASIDE beside it. Where no factor makes
the gains safe such a posture is left out, and counted in `never`. No gains are known to keep the margin there.
"""

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ...analysis.gain_limit import gain_limit
from ...errors import GainroomError, first_of_many, nearest, require_count, require_finite, require_positive
from ...io.atomic import write_text
from ...system.controller import PD
from ...system.linear.arrays import Floats
from .c_header import Constant, header_text, provenance
from .scheduler import GainTable

if TYPE_CHECKING:
    from ...robot.robot import Robot
    from ...system.system import System

MOST_FEATURES, MOST_POINTS = 4, 100_000
ASIDE = 0.3
"""[rad] that joints stand beside the features, at most, in postures outside the table that are looked at."""
FINE, OUTSIDE, NO_POSTURE, NO_CONTACT = range(4)
"""Status of a look-up: a posture in the table; one that is not, or joints farther beside the features than was examined; no numbers;
an unknown contact state."""


@dataclass(frozen=True)
class Feature:
    """Feature of a posture: joints that bend together, each by its weight in `joints` times the feature's value.

    The grid has `points` values from `low` to `high` [rad].
    """

    name: str
    joints: Mapping[str, float]
    low: float
    high: float
    points: int = 7


class TableGains(NamedTuple):
    """Gains for one posture.

    factor     on the contact state's own gains
    kp, kd     (n,) [N m/rad], [N m s/rad]
    certified  whether the limits at all corners of the cell are
    status     FINE; else the gains are the lowest of the contact state, or those for unknown ones: they may be too high, as no margin is
               known there, and a controller should go back into the table, or compute
    """

    factor: float
    kp: Floats
    kd: Floats
    certified: bool
    status: int


@dataclass(frozen=True)
class PostureTable:
    """Factors on gains over a grid of postures, by contact state; see the module's text. From `PostureTable.computed`.

    model      the name of the robot's file
    joints     names of n joints; `base` (n,) their angles where all features are 0 [rad]
    contacts   names of contact states; `own` (contacts, 2, n) kp and kd of each
    everywhere (2, n) the set for unknown contact states; `everywhere_factor` on it
    limits     (contacts, points, …) the factor on the own gains at which the loop loses stability
    certified  of the same shape
    margin, between, highest, aside    as in the module's text; looked_at: postures that `between` is the lowest of
    outside    as there, at most `between`, of looked_outside postures; never: of those where no factor makes the gains safe
    sample_time  of the control that the limits hold for [s]; 0: continuous
    """

    model: str
    joints: tuple[str, ...]
    base: Floats
    features: tuple[Feature, ...]
    contacts: tuple[str, ...]
    own: Floats
    everywhere: Floats
    everywhere_factor: float
    limits: Floats
    certified: np.ndarray
    margin: float
    between: float
    looked_at: int
    highest: float
    aside: float
    sample_time: float
    outside: float = 1.0
    looked_outside: int = 0
    never: int = 0

    @property
    def weights(self) -> Floats:
        """(features, n) of the joints in the features."""
        return _weights(self.features, self.joints)

    @classmethod
    def computed(
        cls,
        robot: "Robot",
        features: Sequence[Feature],
        gains: "GainTable | PD | None" = None,
        *,
        aside: float = 0.05,
        samples: int = 200,
        highest: float = 1.0,
        seed: int = 0,
    ) -> "PostureTable":
        """Limits of `robot`, as load_robot gives it, about its first posture, in its contact states or those of `gains`.

        gains    by contact state, or one PD for all; None: the robot's own. The gain margin is the robot's, 1 where it asks for none
        aside    how far joints may stand beside what the features say [rad]
        samples  random postures examined in each contact state, besides the grid

        Raises GainroomError for features that name unknown joints or share one, and where gains are not stable down to 0 in some posture.
        """
        system = getattr(robot, "system", None)
        if system is None:
            raise GainroomError("posture table: the robot has to come from load_robot, which reads drives and control")
        body, angles = robot.body, dict(next(iter(robot.postures.values())).angles)
        base = body.angles(body.configuration(angles))
        features = _checked(features, body.joint_names)
        require_count("posture table", "samples", samples, 1)
        aside = require_positive("posture table", "aside", aside, "rad", zero=True)
        highest = require_positive("posture table", "highest", highest)
        table = _table(robot, system, gains)
        names, limits_at = tuple(table.own), _PostureLimits(robot, system, features, base)
        grids = [np.linspace(one.low, one.high, one.points) for one in features]
        shape = tuple(one.points for one in features)
        limits, certified = np.empty((len(names), *shape)), np.empty((len(names), *shape), dtype=bool)
        for row, name in enumerate(names):
            for at in itertools.product(*map(range, shape)):
                limits[(row, *at)], certified[(row, *at)] = limits_at.limit(
                    name, table.own[name], [grid[k] for grid, k in zip(grids, at, strict=True)]
                )
        margin = system.requirements.gain_margin or 1.0
        own = np.array([table.own[name] for name in names])
        found = cls(
            Path(robot.name).name, robot.joint_names, base, features, names, own, table.everywhere, 0.0, limits, certified, margin,
            between=1.0, looked_at=0, highest=highest, aside=aside, sample_time=system.control.sample_time or 0.0,
        )  # fmt: skip
        rng = np.random.default_rng(seed)
        between, lowest, looked_at = 1.0, float(limits.min()) if np.ptp(found.own, axis=0).max() == 0 else math.inf, 0
        for row, name in enumerate(names):
            for _ in range(samples):
                values = [rng.uniform(one.low, one.high) for one in features]
                offset = rng.uniform(-aside, aside, len(base))
                cell = found._cell(_values(features, found.joints, base, limits_at.posture(values, offset)))
                if cell is None:  # the joints beside the features carry it over the edge
                    continue
                looked_at += 1
                between = min(between, limits_at.limit(name, table.own[name], values, offset)[0] / limits[row][cell].min())
                lowest = min(lowest, limits_at.limit(name, table.everywhere, values, offset)[0])
        outside, looked_outside, never = found._looked_outside(limits_at, samples, rng)
        outside = min(between, outside)
        factor = float(min(highest, outside * lowest / margin))
        about = {"outside": float(outside), "looked_outside": looked_outside, "never": never}
        return replace(found, between=float(between), looked_at=looked_at, everywhere_factor=factor, **about)

    def _looked_outside(self, limits_at: "_PostureLimits", samples: int, rng: np.random.Generator) -> tuple[float, int, int]:
        """Lowest ratio of limit to the table's least among random postures outside the grid; their number; and the number left out.

        Left out are postures in which no factor makes the gains safe.
        """
        lowest, count, never = math.inf, 0, 0
        for row, name in enumerate(self.contacts):
            for _ in range(samples):
                values = [rng.uniform(2 * one.low - one.high, 2 * one.high - one.low) for one in self.features]
                offset = rng.uniform(-1, 1, len(self.base)) * max(ASIDE, self.aside)
                angles = limits_at.posture(values, offset)
                if self._cell(_values(self.features, self.joints, self.base, angles), angles) is not None:
                    continue
                try:
                    lowest = min(lowest, limits_at.limit(name, self.own[row], values, offset)[0] / self.limits[row].min())
                    count += 1
                except GainroomError:
                    never += 1
        return lowest, count, never

    def lookup(self, angles: ArrayLike, contact: str) -> TableGains:
        """Gains in the posture of joint `angles` (n,) [rad] on `contact`: what the C header gives. Raises nothing."""
        if contact not in self.contacts:
            return _scaled(self.everywhere_factor, self.everywhere, False, NO_CONTACT)
        row = self.contacts.index(contact)
        try:
            joints = np.array(angles, dtype=float)
        except (TypeError, ValueError):
            joints = np.empty(0)
        if joints.shape != self.base.shape or not np.isfinite(joints).all():
            return self._gains(row, self.limits[row].min(), False, NO_POSTURE)
        cell = self._cell(_values(self.features, self.joints, self.base, joints), joints)
        if cell is None:
            return self._gains(row, self.limits[row].min(), False, OUTSIDE)
        return self._gains(row, self.limits[row][cell].min(), bool(self.certified[row][cell].all()), FINE)

    def to_header(self, path: str | Path, name: str = "gain_table", date: str | None = None) -> None:
        """Write the table as a plain C99 header with the look-up, names in it beginning with `name`; `date`: as it shall say, None: today.

        It needs no other header. Raises GainroomError where `name` is no identifier, or `path` cannot be written: the file is whole or
        not there.
        """
        sizes = {"JOINTS": len(self.joints), "FEATURES": len(self.features), "CONTACTS": len(self.contacts), "POINTS": self.limits[0].size}
        write_text(Path(path), header_text(name, sizes, self._constants(date)))

    def _constants(self, date: str | None) -> list[Constant]:
        rows, about = len(self.contacts), provenance(self.model, date)
        return [
            *(Constant("char *const", what, text) for what, text in zip(("model", "version", "date"), about, strict=True)),
            Constant("char *const", "joints", self.joints),
            Constant("char *const", "contacts", self.contacts),
            Constant("char *const", "features", [one.name for one in self.features]),
            Constant("double", "margin", self.margin, "limits over it are factors"),
            Constant("double", "between", self.between),
            Constant("long", "looked_at", self.looked_at),
            Constant("double", "outside", self.outside, "between, of postures that are not in the table"),
            Constant("long", "looked_outside", self.looked_outside),
            Constant("long", "never", self.never, "further ones there, where no factor makes the gains safe"),
            Constant("double", "highest", self.highest, "of the factors"),
            Constant("double", "aside", self.aside, "rad"),
            Constant("double", "sample_time", self.sample_time, "s: of the control that limits hold for; 0: continuous"),
            Constant("double", "base", self.base, "rad: where all features are 0"),
            Constant("double", "weights", self.weights, "of joints in features"),
            Constant("double", "low", [float(one.low) for one in self.features], "rad"),
            Constant("double", "high", [float(one.high) for one in self.features], "rad"),
            Constant("int", "points", [one.points for one in self.features]),
            Constant("double", "kp", self.own[:, 0], "N m/rad: own gains of contact states"),
            Constant("double", "kd", self.own[:, 1], "N m s/rad"),
            Constant("double", "everywhere_kp", self.everywhere[0], "for unknown contact states"),
            Constant("double", "everywhere_kd", self.everywhere[1]),
            Constant("double", "everywhere_factor", self.everywhere_factor),
            Constant("double", "limits", self.limits.reshape(rows, -1), "the last feature runs fastest"),
            Constant("unsigned char", "certified", self.certified.reshape(rows, -1)),
        ]

    def _gains(self, row: int, limit: float, certified: bool, status: int) -> TableGains:
        factor = min(self.highest, (self.between if status == FINE else self.outside) * limit / self.margin)
        return _scaled(factor, self.own[row], certified, status)

    def _cell(self, values: Sequence[float], joints: Floats | None = None) -> tuple[slice, ...] | None:
        """Cell of the grid around feature `values` [rad], a slice of two points per feature; None outside the grid.

        None also if `joints` (n,) [rad] are given and stand farther than `aside` from where the features put them.
        """
        cell = []
        for one, value in zip(self.features, values, strict=True):
            if not one.low <= value <= one.high:
                return None
            k = min(int((value - one.low) / ((one.high - one.low) / (one.points - 1))), one.points - 2)
            cell.append(slice(k, k + 2))
        if joints is not None:
            weights = self.weights
            for j in range(len(joints)):
                left = joints[j] - self.base[j]
                for f, value in enumerate(values):
                    left -= weights[f, j] * value
                if abs(left) > self.aside:
                    return None
        return tuple(cell)


def _scaled(factor: float, own: Floats, certified: bool, status: int) -> TableGains:
    return TableGains(factor, factor * own[0], factor * own[1], certified, status)


def _weights(features: Sequence[Feature], joints: Sequence[str]) -> Floats:
    return np.array([[float(one.joints.get(name, 0.0)) for name in joints] for one in features])


def _values(features: Sequence[Feature], names: Sequence[str], base: Floats, joints: Floats) -> list[float]:
    """Feature values [rad] of joint angles `joints` (n,) [rad]: weighted means, with the C header's order of operations."""
    found = []
    for row in _weights(features, names):
        above, below = 0.0, 0.0
        for j in range(len(names)):
            above += row[j] * (joints[j] - base[j])
            below += row[j] * row[j]
        found.append(above / below)
    return found


class _PostureLimits:
    """Gain limits of a robot's joint PD in postures given by feature values [rad] and offsets of joints [rad]."""

    def __init__(self, robot: "Robot", system: "System", features: Sequence[Feature], base: Floats):
        self._robot, self._system, self._base = robot, system, base
        self._weights = _weights(features, robot.joint_names)

    def posture(self, values: Sequence[float], offset: ArrayLike = 0.0) -> Floats:
        return self._base + np.asarray(values, dtype=float) @ self._weights + offset

    def limit(self, contact: str, gains: Floats, values: Sequence[float], offset: ArrayLike = 0.0) -> tuple[float, bool]:
        angles = dict(zip(self._robot.joint_names, self.posture(values, offset).tolist(), strict=True))
        standing = replace(self._robot, postures={"here": replace(next(iter(self._robot.postures.values())), angles=angles)})
        found = gain_limit(self._system.with_controller(PD(*gains)).loop(standing.linearize("here", contact)))
        if found.gain == 0 or found.lower_gain > 0:
            where = ", ".join(f"{value:.3g}" for value in values)
            raise GainroomError(f"posture table: contact {contact!r}, features at {where} rad: no factor below 1 makes these gains safe")
        return found.gain, found.certificate is not None and found.certificate.holds


def _checked(features: Sequence[Feature], names: Sequence[str]) -> tuple[Feature, ...]:
    if not 1 <= len(features) <= MOST_FEATURES:
        raise GainroomError(f"posture table: {len(features)} features; from 1 to {MOST_FEATURES} are possible")
    used: set[str] = set()
    for one in features:
        owner = f"posture table: feature {one.name!r}"
        low, high = (float(require_finite(owner, end, value)) for end, value in (("low", one.low), ("high", one.high)))
        if not low < high:
            raise GainroomError(f"{owner}: low {low:g} must be below high {high:g}")
        require_count(owner, "points", one.points, 2)
        if not one.joints:
            raise GainroomError(f"{owner}: it has to name joints; there are {first_of_many(tuple(names))}")
        for name, weight in one.joints.items():
            if name not in names:
                raise GainroomError(f"{owner}: joint {name!r} is not one of this robot's{nearest(name, tuple(names), 'joint')}")
            if float(require_finite(owner, f"weight of {name!r}", weight)) == 0:
                raise GainroomError(f"{owner}: weight of {name!r} must not be 0")
            if name in used:
                raise GainroomError(f"{owner}: joint {name!r} belongs to another feature already")
            used.add(name)
    if math.prod(one.points for one in features) > MOST_POINTS:
        raise GainroomError(f"posture table: {math.prod(one.points for one in features)} points; at most {MOST_POINTS} are possible")
    return tuple(features)


def _table(robot: "Robot", system: "System", gains: "GainTable | PD | None") -> GainTable:
    """One set of gains for each contact state."""
    if isinstance(gains, GainTable):
        unknown = [name for name in gains.own if name not in robot.contacts]
        if unknown:
            raise GainroomError(f"posture table: contact {unknown[0]!r} is not one of this robot's")
        if gains.everywhere.shape[1] != robot.body.size:
            raise GainroomError(f"posture table: gains of {gains.everywhere.shape[1]} joints; the robot has {robot.body.size}")
        return gains
    pd = system.control.controller if gains is None else gains
    if not isinstance(pd, PD) or any(pd.filters.values()) or max(np.ndim(pd.kp), np.ndim(pd.kd)) > 1:
        raise GainroomError("posture table: gains must be a PD with one kp and kd per joint, without filters")
    kp, kd = (np.broadcast_to(np.asarray(gain, dtype=float), robot.body.size) for gain in (pd.kp, pd.kd))
    return GainTable.of(dict.fromkeys(robot.contacts, (kp, kd)))
