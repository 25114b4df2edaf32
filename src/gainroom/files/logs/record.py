"""Record of a log: channels in SI on the joint side, the origin of each, and the corrections of the rows."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise

import numpy as np

from ...errors import GainroomError, nearest
from ...identification.record import SHORTEST, SIGNALS, Record
from ...system.linear.arrays import Floats
from .channels import CHANNELS, ONE_JOINT
from .clock import Ticks, ticks_of


@dataclass(frozen=True)
class Origin:
    """Origin of a channel.

    channel, joint   of the log; the joint "" for time
    column           as the file calls it
    unit             that it was read in; "" for a bare factor
    factor           by which it was multiplied, to SI and the joint side
    column_from      "given" by the user, or the "name" said it
    unit_from        "given", the "file" or the column's "name" said it, its "values" did, "convention": the column is called as
                     this package calls it, which is in SI; or it was "assumed"; "unknown": the numbers are as the file has them
    """

    channel: str
    joint: str
    column: str
    unit: str
    factor: float
    column_from: str
    unit_from: str


@dataclass(frozen=True)
class Quality:
    """Corrections of the rows of a log, and evenness of their time stamps.

    rows             in the file, within the window asked for
    not_finite       rows cut since a number was missing or not finite; `missing`: how often by column
    duplicate        rows cut since their time stamp was there already
    backwards        rows cut since their time stamp was earlier than one before
    ahead            rows cut since their time stamp was far later than all that follow
    gaps             where ticks are without a row; `dropped` ticks are missing in them, the longest lasts `longest_gap` [s]
    jitter           standard deviation of the time between neighbouring rows [s], gaps apart
    off_ticks        root mean square distance of a stamp from its tick [ticks]
    sample_time      [s] mean time per tick; 0 where fewer than two rows are
    """

    rows: int = 0
    not_finite: int = 0
    duplicate: int = 0
    backwards: int = 0
    ahead: int = 0
    missing: Mapping[str, int] = field(default_factory=dict)
    gaps: int = 0
    dropped: int = 0
    longest_gap: float = 0.0
    jitter: float = 0.0
    sample_time: float = 0.0
    off_ticks: float = 0.0

    @property
    def cut(self) -> int:
        """Number of rows that were left out."""
        return self.not_finite + self.duplicate + self.backwards + self.ahead


@dataclass(frozen=True, eq=False)
class JointLog:
    """Rows of one joint.

    time          (m,) rising [s]
    channels      by name, one of SIGNALS, (m,) each; only those that the log has
    sample_time   [s] mean time per tick
    name          of the joint
    """

    time: Floats
    channels: Mapping[str, Floats]
    sample_time: float
    name: str = ONE_JOINT

    def even_parts(self, longest_gap: int = 3, least: int = 2) -> "list[JointLog]":
        """Parts without gaps, with rows exactly `sample_time` apart, as a Fourier transform and a shift by ticks need.

        longest_gap   so many ticks that are missing one after the other are filled in; a longer gap ends a part
        least         rows of the shortest part

        Rows keep their numbers at the ticks that their stamps tell, whatever these jitter (see clock.py), and where a tick is missing, or
        the stamps are of no even clock, it is interpolated: linearly what is measured, and what is commanded holds until the next one.
        """
        if len(self.time) < least:
            return []
        ticks = ticks_of(self.time, self.sample_time)
        edges = [0, *(np.flatnonzero(np.diff(ticks.numbers) > longest_gap + 1) + 1).tolist(), len(self.time)]
        return [self._even(ticks, first, last) for first, last in pairwise(edges) if last - first >= least]

    def _even(self, ticks: Ticks, first: int, last: int) -> "JointLog":
        stamps = self.time[first:last]
        places = (ticks.numbers[first:last] - ticks.numbers[first]).astype(float) if ticks.even else (stamps - stamps[0]) / self.sample_time
        count = np.arange(round(places[-1]) + 1, dtype=float)
        if len(count) == len(places) and np.max(np.abs(places - count)) < NEAR:
            places = count
        channels = {name: aligned(count, places, values[first:last], CHANNELS[name].commanded) for name, values in self.channels.items()}
        return replace(self, time=stamps[0] + self.sample_time * count, channels=channels)

    def record(self) -> Record:
        """Record for identification: the even parts on one grid of ticks, with gaps between. Raises GainroomError if too short."""
        parts = self.even_parts()
        if sum(len(part.time) for part in parts) < SHORTEST:
            raise GainroomError(f"{len(self.time)} rows are too few to identify anything; at least {SHORTEST} are needed")
        began = parts[0].time[0]
        # A part begins on the tick nearest to its own: up to half a tick of a gap's length is not known to the ticks around it.
        first = [round((part.time[0] - began) / self.sample_time) for part in parts]
        ticks = np.concatenate([start + np.arange(len(part.time)) for start, part in zip(first, parts, strict=True)])
        channels = {name: np.concatenate([part.channels[name] for part in parts]) for name in self.channels}
        return Record(began + self.sample_time * ticks, channels, self.sample_time)


NEAR = 0.25
"""Jitter [ticks] below which stamps belong to an even clock that was read a little late."""


def aligned(time: Floats, stamps: Floats, values: Floats, held: bool) -> Floats:
    """Values at `stamps` (k,) rising, resampled at `time` (m,): the last one before if `held`, else linearly interpolated."""
    if len(time) == len(stamps) and np.array_equal(time, stamps):
        return values
    if not held:
        return np.interp(time, stamps, values)
    places = np.searchsorted(stamps, time, side="right") - 1
    return values[np.maximum(places, 0)]


@dataclass(frozen=True, eq=False)
class Log:
    """Content of a log.

    time          (k,) rising [s]
    joints        by joint and channel (one of SIGNALS), (k,) each
    complete      False where the file ends in the middle of a record, as after a power cut
    origins       where time and each channel came from
    quality       what had to be done to the rows
    began         [s] what was taken off the file's time stamps: 0, or the first of them where they count from an epoch
    notes         what was left out, and why: texts
    """

    time: Floats
    joints: Mapping[str, Mapping[str, Floats]]
    complete: bool = True
    origins: Sequence[Origin] = ()
    quality: Quality = field(default_factory=Quality)
    began: float = 0.0
    notes: Sequence[str] = ()

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Joint names (n,) in the file's order."""
        return tuple(self.joints)

    @property
    def sample_time(self) -> float:
        """Mean time per tick [s]."""
        return self.quality.sample_time

    @cached_property
    def signals(self) -> Mapping[str, Floats]:
        """Signals (k, n) by channel, those that every joint has."""
        every = [name for name in SIGNALS if all(name in channels for channels in self.joints.values())]
        return {name: np.stack([channels[name] for channels in self.joints.values()], axis=1) for name in every}

    def joint(self, name: str | None = None) -> JointLog:
        """Joint of the log; None: the only one. Raises GainroomError for an unknown name, and for None if there are several."""
        if name is None and len(self.joints) > 1:
            raise GainroomError(f"the log holds {len(self.joints)} joints and one must be chosen{nearest('', self.joint_names, 'joint')}")
        if name is not None and name not in self.joints:
            raise GainroomError(f"the log has no joint {name!r}{nearest(name, self.joint_names, 'joint')}")
        chosen = next(iter(self.joints)) if name is None else name
        return JointLog(self.time, self.joints[chosen], self.sample_time, chosen)
