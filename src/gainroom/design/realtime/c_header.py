"""The plain C99 header of a posture table: its data, and the look-up, with nothing but arithmetic.

Names that a robot's file gives (joints, contact states, features, the robot) appear in string constants alone, every byte but letters,
digits, `_`, `-`, `.` and blanks as an octal escape: no name ends a string, a line or a comment. Numbers have all their digits.
"""

import re
from collections.abc import Mapping, Sequence
from datetime import datetime, timezone
from typing import Any, NamedTuple

import numpy as np

from ...errors import GainroomError

LONGEST_NAME = 40
PLAIN = frozenset(b"abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789_-. ")

TEMPLATE = """\
/* Gains that joints may have, by contact state and posture: plain C99 (or C++11), no other header.

   NAME_lookup(angles, contact, &gains) fills kp [N m/rad] and kd [N m s/rad] of every joint, in the order of NAME_joints, for joint angles
   [rad] in the same order and the number of a contact state in NAME_contacts; NAME_contact("left") is that number, -1 where there is none.
   The limits are those of control that is sampled every NAME_sample_time [s], or continuous where that is 0.

   What is guaranteed. At the points of the grid, with all joints as the features say, the loop bears NAME_margin times these gains;
   where NAME_certified, that has been proved or counted from both sides. Between the points, and with joints up to NAME_aside [rad]
   beside the features, nothing is proved: the least of the cell's corners is taken, times NAME_between, the lowest ratio in
   NAME_looked_at random postures. In postures outside the table (status 1), for angles that are no numbers (2) and unknown
   contacts (3) the gains are the lowest of the contact state, or those for unknown ones, times NAME_outside, the lowest ratio in
   NAME_looked_outside random postures beyond the table; in NAME_never more no factor made the gains safe. They may be too high: a
   status that is not 0 says that no margin is known.

   It does not compile with -ffast-math, which believes that every number is one. */
#ifndef GUARD_H
#define GUARD_H

#if defined(__FAST_MATH__) || (defined(__FINITE_MATH_ONLY__) && __FINITE_MATH_ONLY__) || defined(_M_FP_FAST)
#error "angles that are no numbers have to be told: compile it without -ffast-math, -ffinite-math-only, /fp:fast"
#endif

#define GUARD_JOINTS JOINTS
#define GUARD_FEATURES FEATURES
#define GUARD_CONTACTS CONTACTS
#define GUARD_POINTS POINTS

DATA
typedef struct {
    double factor; /* on the contact state's own gains */
    double kp[GUARD_JOINTS], kd[GUARD_JOINTS];
    int certified; /* whether the limits at all corners of the cell are */
    int status;    /* 0: in the table; 1: outside; 2: angles are no numbers; 3: unknown contact; but for 0 no margin is known */
} NAME_gains;

static inline int NAME_contact(const char *name) {
    for (int c = 0; c < GUARD_CONTACTS; c++) {
        int k = 0;
        while (name[k] != 0 && name[k] == NAME_contacts[c][k]) k++;
        if (name[k] == NAME_contacts[c][k]) return c;
    }
    return -1;
}

/* The status. */
static inline int NAME_lookup(const double *angles, int contact, NAME_gains *gains) {
    double value[GUARD_FEATURES], least = 0.0;
    long first = 0, size = 1;
    int status = 0;
    gains->certified = 0;
    if (contact < 0 || contact >= GUARD_CONTACTS) {
        gains->status = 3;
        gains->factor = NAME_everywhere_factor;
        for (int j = 0; j < GUARD_JOINTS; j++) {
            gains->kp[j] = gains->factor * NAME_everywhere_kp[j];
            gains->kd[j] = gains->factor * NAME_everywhere_kd[j];
        }
        return 3;
    }
    for (int j = 0; j < GUARD_JOINTS; j++)
        if (!(angles[j] - angles[j] == 0.0)) status = 2;
    for (int f = GUARD_FEATURES - 1; f >= 0 && status == 0; f--) {
        double above = 0.0, below = 0.0;
        for (int j = 0; j < GUARD_JOINTS; j++) {
            above += NAME_weights[f][j] * (angles[j] - NAME_base[j]);
            below += NAME_weights[f][j] * NAME_weights[f][j];
        }
        value[f] = above / below;
        if (!(NAME_low[f] <= value[f] && value[f] <= NAME_high[f])) {
            status = 1;
        } else {
            long k = (long)((value[f] - NAME_low[f]) / ((NAME_high[f] - NAME_low[f]) / (NAME_points[f] - 1)));
            if (k > NAME_points[f] - 2) k = NAME_points[f] - 2;
            first += k * size;
            size *= NAME_points[f];
        }
    }
    for (int j = 0; j < GUARD_JOINTS && status == 0; j++) {
        double left = angles[j] - NAME_base[j];
        for (int f = 0; f < GUARD_FEATURES; f++) left -= NAME_weights[f][j] * value[f];
        if (!(left <= NAME_aside && -left <= NAME_aside)) status = 1;
    }
    if (status == 0) {
        gains->certified = 1;
        for (int corner = 0; corner < (1 << GUARD_FEATURES); corner++) {
            long at = first, step = 1;
            for (int f = GUARD_FEATURES - 1; f >= 0; f--) {
                if (corner >> f & 1) at += step;
                step *= NAME_points[f];
            }
            if (corner == 0 || NAME_limits[contact][at] < least) least = NAME_limits[contact][at];
            if (!NAME_certified[contact][at]) gains->certified = 0;
        }
    } else {
        least = NAME_limits[contact][0];
        for (long at = 1; at < GUARD_POINTS; at++)
            if (NAME_limits[contact][at] < least) least = NAME_limits[contact][at];
    }
    gains->factor = (status == 0 ? NAME_between : NAME_outside) * least / NAME_margin;
    if (!(gains->factor < NAME_highest)) gains->factor = NAME_highest;
    for (int j = 0; j < GUARD_JOINTS; j++) {
        gains->kp[j] = gains->factor * NAME_kp[contact][j];
        gains->kd[j] = gains->factor * NAME_kd[contact][j];
    }
    gains->status = status;
    return status;
}

#endif
"""


class Constant(NamedTuple):
    """A name with what it holds: a text, a number, or arrays of them, of the C type that `kind` names."""

    kind: str
    name: str
    value: Any
    note: str = ""


def header_text(name: str, sizes: Mapping[str, int], constants: Sequence[Constant]) -> str:
    """The header with `sizes` (JOINTS, FEATURES, CONTACTS, POINTS) and `constants`, all names beginning with `name`.

    Raises GainroomError where `name` is no identifier of C.
    """
    require_identifier("C header", name)
    text = re.sub(rf"(?<![A-Z_])({'|'.join(sizes)})(?![A-Z_])", lambda found: str(sizes[found[0]]), TEMPLATE)
    text = text.replace("GUARD", name.upper()).replace("NAME", name)
    return text.replace("DATA\n", "".join(_definition(name, one) for one in constants))  # last: names in it are not looked at


def provenance(model: str, date: str | None) -> tuple[str, str, str]:
    """Origin of a header: the model's file, gainroom's version, and the date (None: today)."""
    from ... import __version__

    return model, __version__, datetime.now(timezone.utc).strftime("%Y-%m-%d") if date is None else str(date)


def require_identifier(owner: str, name: object) -> None:
    """Raise GainroomError, which begins with `owner`, where a name is no identifier of C, or begins with _."""
    if not isinstance(name, str) or len(name) > LONGEST_NAME or not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", name):
        raise GainroomError(f"{owner}: name {name!r} must be a letter, then up to {LONGEST_NAME - 1} letters, digits and _")


def string(text: str) -> str:
    """A C string constant. An escape has three digits, so that a digit after it is not part of it."""
    body = "".join(chr(byte) if byte in PLAIN else f"\\{byte:03o}" for byte in text.encode("utf-8", "replace"))
    return f'"{body}"'


def _definition(prefix: str, one: Constant) -> str:
    shape = "".join(f"[{size}]" for size in np.shape(one.value))
    note = f" /* {one.note} */" if one.note else ""
    return f"static const {one.kind} {prefix}_{one.name}{shape} = {_value(one.value)};{note}\n"


def _value(value: Any) -> str:
    if isinstance(value, str):
        return string(value)
    if isinstance(value, int | np.integer | np.bool_):
        return str(int(value))
    if np.ndim(value) == 0:  # C has no name for infinity without a header: what is larger than any gain does as well
        return repr(min(float(value), 1e300))
    return "{" + (",\n     " if np.ndim(value) > 1 else ", ").join(_value(row) for row in value) + "}"
