"""Channel and joint of a column by its name: all of its words count, and words without a meaning of their own name the joint.

A name is a path of parts (`low_state/motor_state[3].tau_est`). The last part that has a word for a quantity says which; words for commands,
for what is measured, and for a side of the gearbox stand beside it, or in the path. A word that no list has is the joint's name, unless
it stands where none can. What a name leaves open is a doubt: such a column is not used, and the user is asked.
"""

import re
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cache, lru_cache

from ...simulation.run_record import REFERENCE_SIGNAL
from .channels import CHANNELS
from .units import known_unit
from .vocabulary import (
    BARE_COMMAND,
    BARE_POSITION,
    COMMANDING,
    CONTAINERS,
    DEMAND,
    ELSEWHERE,
    FEEDFORWARD,
    FILLERS,
    LINK,
    LOCALLY_COMMANDING,
    MEASURING,
    MOTOR,
    NEUTRAL,
    OTHER,
    OUTPUT,
    PLURALS,
    QUALIFIERS,
    QUANTITIES,
    SENSOR,
    SIDES,
    TIME_BESIDE,
)

COMMAND_OF = {"motor_position": REFERENCE_SIGNAL, "motor_velocity": "reference_velocity", "actual_torque": "target_torque"}
"""Command channel by measured channel: next to a word for commands a name means the command, as `/joint_commands` has an `effort`."""
LESS_SURE = 100
"""Rank added to a name whose meaning is inferred rather than stated."""
BARE, LOCAL, QUALIFIED = 20, 10, 40
"""Rank added to a name without side or role, to a command by a weak word, and to a processed signal."""
WORD = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|[0-9]+")
BRACKETED = re.compile(r"[\s_]*[\[(<{]([^\])>}]*)[\])>}]\s*$")
DIMENSIONS = {"time": "time", "position": "angle", "velocity": "speed", "torque": "torque", "current": "current"}
SAYING = COMMANDING | MEASURING | FEEDFORWARD | OTHER | FILLERS | LOCALLY_COMMANDING
LETTERS = {"p": "position", "v": "velocity", "t": "torque"}
"""Quantities of the letters in motor protocols: `p_des`, `v_fb`."""
MOST_LETTERS = 300
"""Maximum length of a name; longer texts are no names."""
MOST_KEPT = 1 << 14
"""Maximum number of cached parts of names."""
COORDINATES = frozenset(("q", "theta", "encoder", "enc", "angle"))
"""Words for a coordinate beside another quantity: `theta_vel`, `q_torque`."""
FEED_FORWARD_DOUBT = "a feed-forward torque, which is all of the command only where the drive's own kp and kd are 0"
GAINS = frozenset(("kp", "kd"))
COMMAND_DOUBT = "a command, but of torque or of position is not said"
METRES_DOUBT = "in metres, or the motor's: the name may mean either"
INPUT_DOUBT = "a controller's input, or the gearbox's: the name may mean either, beside an output"
ENCODERS = frozenset(("encoder", "enc"))
ROLE_DOUBT = "a command or a measurement: the name says both"


@dataclass(frozen=True)
class Guess:
    """Meaning of a column's name.

    channel   one of CHANNELS
    joint     "" where it names none
    unit      "" where it names none
    rank      0 is the package's own name; the larger, the less sure
    side      "motor", "joint", "output" or "link" where the name says it
    doubt     what it leaves open; "" where nothing is
    """

    channel: str
    joint: str
    unit: str
    rank: int
    side: str = ""
    doubt: str = ""


@dataclass(frozen=True)
class Naming:
    """Conventions that the names of a file follow together.

    sided      `theta_m` stands beside `theta_l`: the motor's and the link's, not a left joint's
    lettered   `p_des` stands beside `v_des`, and no column says position in full
    dataset    a LeRobot data set: `observation.state` is where the joints are, `action` where they shall be
    geared     `input_torque` stands beside `output_torque`: a gearbox's sides, or a controller's
    gains      what holds a drive's own kp and kd beside its set-points: `motor_cmd[3]`
    """

    sided: bool = False
    lettered: bool = False
    dataset: bool = False
    gains: frozenset[str] = frozenset()
    geared: bool = False

    @classmethod
    def of(cls, names: Iterable[str]) -> "Naming":
        texts = [text for text in names if len(text) <= MOST_LETTERS]
        beside: dict[tuple[str, ...], set[str]] = {}
        gains = set()
        roles = COMMANDING | MEASURING | FEEDFORWARD
        letters, spelled, lower = set(), False, {text.lower() for text in texts}
        for text in texts:
            found = [word[0].lower() for word in WORD.finditer(text) if not word[0].isdigit()]
            if len(found) > 1:
                beside.setdefault(("", *found[:-1]), set()).add(found[-1])
                beside.setdefault((*found[1:], ""), set()).add(found[0])
                letters |= {word for word in found if word in LETTERS} if roles.intersection(found) else set()
            spelled |= any(_plain(word) in QUANTITIES["position"] for word in found)
            *parts, last = re.split(r"[/.]", text.strip("/"))
            if parts and GAINS.intersection(word[0].lower() for word in WORD.finditer(last)):
                gains.add("/".join(parts))
        sided = any({"m", "l"} <= letters and "r" not in letters for letters in beside.values())
        dataset = any(_dataset_part(text) == "state" for text in texts)
        geared = any("input" in text.lower() and re.sub("input", "output", text.lower()) in lower for text in texts)
        return cls(sided, "p" in letters and len(letters) > 1 and not spelled, dataset, frozenset(gains), geared)


def _dataset_part(text: str) -> str:
    found = re.fullmatch(r"observation\.(state)(\[[0-9]+\])?|(action)(\[[0-9]+\])?", text)
    return (found[1] or found[3] or "") if found else ""


def _plain(word: str) -> str:
    return PLURALS.get(word, word)


@cache
def _spellings() -> dict[tuple[str, ...], tuple[str, int]]:
    """Quantity and rank of each spelling."""
    return {tuple(text.split("_")): (quantity, place) for quantity, texts in QUANTITIES.items() for place, text in enumerate(texts)}


def channel_of(text: str, whole: bool = False, commanded: bool = False, naming: Naming = Naming()) -> Guess | None:
    """Channel, joint and unit in a column's name `text`; None if it names no channel.

    whole       the joint is known otherwise: what stands before the channel's name is no joint's, and nothing may stand behind it
    commanded   it stands among commands
    """
    if len(text) > MOST_LETTERS:
        return None
    if naming.dataset and (part := _dataset_part(text)):
        return Guess("motor_position" if part == "state" else REFERENCE_SIGNAL, text.partition("[")[2].rstrip("]"), "", BARE)
    own = None if whole else _own(text)
    if own is not None:
        return own
    text, unit = _without_unit(text)
    if whole:
        above, _, text = text.rpartition("/")
        commanded = is_commanding(above, commanded)
    guesses = (_Parse(stem, stem_unit, bool(unit), naming, whole).guess(commanded) for stem, stem_unit in _stems(text, unit))
    guess = next((guess for guess in guesses if guess is not None), None)
    is_own = guess is not None and re.split(r"[/.]", text)[-1] == guess.channel  # as this package writes it, in a topic of its own
    return replace(guess, rank=0) if guess is not None and is_own else guess


def is_commanding(path: str, otherwise: bool = False) -> bool:
    """True if a path, such as a topic, holds commands: the last of its parts with a known word decides."""
    for part in reversed(re.split(r"[/.]", path[-MOST_LETTERS:])):
        plain_words = {_plain(word[0].lower()) for word in WORD.finditer(part)}
        if plain_words & COMMANDING:
            return True
        if plain_words & MEASURING:
            return False
    return otherwise


def _own(text: str) -> Guess | None:
    """Guess for a column as logs of this package name it, for any joint name."""
    for name in sorted(CHANNELS, key=len, reverse=True):
        rest = text[len(name) + 1 :]
        if text == name or (name != "time" and rest and text.startswith(f"{name}_")):
            plain_words = [_plain(word[0].lower()) for word in WORD.finditer(rest) if not word[0].isdigit()]
            if any((word,) in _spellings() for word in plain_words) or (
                plain_words and (plain_words[-1] in COMMANDING or SAYING.issuperset(plain_words))
            ):
                return None  # `reference_torque`, `motor_position_knee_target`, `link_position_error`, `joint_torque_measured[0]`
            unit = rest if len(rest) > 1 and known_unit(rest, CHANNELS[name].dimension) else ""
            return Guess(name, "" if unit else rest, unit, 0)
    return None


def _without_unit(text: str) -> tuple[str, str]:
    """Name and unit of `torque [Nm]`. An index, `q[3]`, stays in the name."""
    found = BRACKETED.search(text)
    if found and not found[1].strip().isdigit() and any(known_unit(found[1], channel.dimension) for channel in CHANNELS.values()):
        return text[: found.start()], found[1]
    return text, ""


def _stems(text: str, unit: str) -> list[tuple[str, str]]:
    """Possible names and units of a text whose last one or two words may be a unit (`pos_deg`, `vel_rad_s`, `tau_N_m`)."""
    if unit:
        return [(text, unit), (text, "")]
    found = [*WORD.finditer(text)]
    stems = [(text, "")]
    if len(found) > 1:
        stems.insert(0, (text[: found[-1].start()], found[-1][0]))
    if len(found) > 2:
        stem = text[: found[-2].start()]
        stems[:0] = [(stem, f"{found[-2][0]}{sign}{found[-1][0]}") for sign in ("/", "")]
    inner = [word for word in found[1:-1] if len(word[0]) > 1]
    stems[:0] = [(text[: word.start()].rstrip("_ ") + text[word.end() :], word[0]) for word in inner]  # `angle_deg_ref`
    return [each for each in stems if not each[1] or any(known_unit(each[1], channel.dimension) for channel in CHANNELS.values())]


@dataclass(frozen=True)
class _Word:
    """Word of a part: as written, in lower case and the singular, its positions, and the piece of the name that it belongs to."""

    text: str
    plain: str
    start: int
    end: int
    piece: int


@lru_cache(MOST_KEPT)
def _words(part: str) -> list[_Word]:
    found, piece, end = [], 0, 0
    for word in WORD.finditer(part):
        start = word.start()
        piece += bool(re.search(r"[^A-Za-z0-9]", part[end:start]))
        end = word.end()
        for text in _pieces(word[0]):
            found.append(_Word(text, _plain(text.lower()), start, start + len(text), piece))
            start += len(text)
    return found


@lru_cache(MOST_KEPT)
def _pieces(word: str) -> tuple[str, ...]:
    """Pieces of a word: itself, or two words written as one: `poscmd`, `qdes`, `motorpos`."""
    plain = word.lower()
    if _plain(plain) in ONE_WORD:
        return (word,)
    for k in range(1, len(word)):
        one, other = plain[:k], plain[k:]
        if (one in MEASURABLE and other in BESIDE and len(other) > 2) or (one in BESIDE and other in MEASURABLE and k > 2):
            return word[:k], word[k:]
    return (word,)


class _Parse:
    """Name of a column without its unit `unit`, to be understood; bracketed: the unit is certain."""

    def __init__(self, text: str, unit: str, bracketed: bool, naming: Naming, whole: bool) -> None:
        self._parts = re.split(r"[/.]", text.strip("_ ./-"))
        self._unit, self._bracketed, self._naming, self._whole = unit, bracketed, naming, whole
        self._words: list[_Word] = []
        self._used: set[int] = set()

    def guess(self, commanded: bool) -> Guess | None:
        """Guess of channel and joint; None if the name is that of no channel.

        commanded   True: the column stands among commands, so that its values are targets
        """
        for place in range(len(self._parts) - 1, -1, -1):
            self._words, self._used = _words(self._parts[place]), set()
            found = self._quantity()
            if found is not None:
                return self._of(place, *found, commanded)
            if {word.plain for word in self._words if not word.text.isdigit()} - FILLERS - COMMANDING - MEASURING:
                break
        return self._bare()

    def _quantity(self) -> tuple[str, int, int, int] | None:
        """Quantity, its rank, and the positions (first, last) of its words; None if there is none, or two."""
        words = self._words
        matches, end = [], 0
        for k in range(len(words)):
            for count in (3, 2, 1):
                known = _spellings().get(tuple(word.plain for word in words[k : k + count]))
                if k >= end and known is not None and len(words[k : k + count]) == count:
                    matches.append((*known, k, k + count))
                    end = k + count
        roles = {word.plain for word in words} & (COMMANDING | MEASURING | FEEDFORWARD)
        if self._naming.lettered and roles and {each[0] for each in matches} <= {"time"}:
            matches = [(LETTERS[word.plain], 0, k, k + 1) for k, word in enumerate(words) if word.plain in LETTERS]
        if len(matches) > 1:
            matches = [each for each in matches if not self._names_a_joint(*each[2:])] or matches
        self._used = {k for each in matches for k in range(*each[2:])}
        if len({each[0] for each in matches}) > 1:
            matches = [each for each in matches if words[each[2]].plain not in COORDINATES]
        kinds = {each[0] for each in matches}
        if kinds in ({"current", "position"}, {"current", "velocity"}):
            matches = [each for each in matches if each[0] != "current"]  # the current position is that of now
        elif len(kinds) != 1:
            return None
        return min(matches, key=lambda each: each[1])

    def _names_a_joint(self, first: int, last: int) -> bool:
        """True if the words are part of a joint's name, such as `q3` in `q3_tau`."""
        words = self._words
        behind = words[last] if last + 1 < len(words) else None
        return first == 0 and behind is not None and behind.text.isdigit() and behind.piece == words[0].piece

    def _of(self, place: int, quantity: str, rank: int, first: int, last: int, commanded: bool) -> Guess | None:
        words = self._words
        if self._unit and known_unit(self._unit, DIMENSIONS[quantity]) is None:
            return None
        spelled, metres = words[first].plain, self._unit == "m" and not self._bracketed
        if spelled == "q" and not self._unit and words[-1].text in ("A", "V"):
            return None  # of the q axis: a current, or a voltage
        if metres and (self._naming.sided or spelled in COORDINATES):
            return None  # an angle's, of the motor
        above = self._parts[:place]
        plain_words = {word.plain for k, word in enumerate(words) if k not in self._used}
        if quantity == "time":
            return self._time(plain_words, above, rank)
        if plain_words & OTHER or _elsewhere(above):
            return None
        below = {word.plain for part in self._parts[place + 1 :] for word in _words(part)}
        side, letter = self._side(spelled, first, last, above)
        self._used |= {k for k, word in enumerate(words) if word.plain in ROLES}
        roles = plain_words & ROLES | below
        command = _is_command(quantity, roles, letter or (side == "output" and spelled == "effort"))
        if roles & FEEDFORWARD and quantity != "torque":
            return None
        path = command is None and is_commanding("/".join(above), commanded)
        channel, side = _channel(quantity, path or bool(command), side, spelled, roles)
        name, strange = self._joint(first, above, next((word for word in below if word.isdigit()), ""))
        if not channel or (self._whole and name):
            return None
        rank += 1 + BARE * (not roles and not side and not self._unit) + LOCAL * (command is True and not roles & COMMANDING)
        rank += QUALIFIED * bool(roles & QUALIFIERS) + LESS_SURE * path
        doubts = {
            FEED_FORWARD_DOUBT: bool(roles & FEEDFORWARD) or (channel == "target_torque" and "/".join(above) in self._naming.gains),
            ROLE_DOUBT: self._is_both(command, roles, above),
            INPUT_DOUBT: self._naming.geared and "input" in roles,
            METRES_DOUBT: metres,
            f"what {strange!r} says of it is not known": bool(strange),
        }
        return Guess(channel, name, self._unit, rank, side, next((text for text, holds in doubts.items() if holds), ""))

    def _is_both(self, command: bool | None, roles: set[str], above: list[str]) -> bool:
        """True if words name both command and measurement: in one part (`reference_encoder`), or possibly, as in `servo_control.torque`."""
        if command is None:
            return bool(above) and [word.plain for word in _words(above[-1])][-1:] == ["control"]
        measured = bool(roles & MEASURING - {"state"}) or bool({word.plain for word in self._words} & ENCODERS)
        return command and measured and bool(roles & COMMANDING)

    def _side(self, spelled: str, first: int, last: int, above: list[str]) -> tuple[str, bool]:
        """Side of the gearbox by the words beside the quantity or the part above it; and True if a `d` after it means desired."""
        words, side, letter = self._words, "", False
        for places in (range(last, len(words)), range(first - 1, -1, -1)):
            for k in places:
                plain = words[k].plain
                if k in self._used or plain in ROLES - OUTPUT:
                    continue
                behind = k >= last
                if behind and plain == "d":
                    letter = True
                elif plain in ("m", "l") and (self._naming.sided or (behind and plain == "m" and spelled in TURNING)):
                    side = {"m": "motor", "l": "link"}[plain]
                elif plain in SIDE_OF:
                    side = SIDE_OF[plain] if side in ("", "joint", "dof") else side
                else:
                    break
                self._used.add(k)
        over = {_plain(word.plain) for word in _words(above[-1])} - ROLES if above else set()
        if not side and len(over) == 1 and over <= {*SIDE_OF}:
            side = SIDE_OF[over.pop()]
        if spelled in ("encoder", "enc") and side == "output":
            side = "link"
        return side or {"theta": "theta", "dtheta": "theta", "q": "q", "dq": "q", "qd": "q", "qdot": "q"}.get(spelled, ""), letter

    def _joint(self, first: int, above: list[str], below: str = "") -> tuple[str, str]:
        """Name of the joint: the remaining words of the part, else of the path above it; and the words after the quantity.

        below   an index behind the part: `effort/commands[2]`
        """
        named = [k for k, word in enumerate(self._words) if k not in self._used and word.plain not in CONTAINERS]
        left, right = [k for k in named if k < first], [k for k in named if k >= first]
        before, behind = self._text(left), self._text(right)
        index = behind if behind.isdigit() else below
        if before and behind and not behind.isdigit():
            known = all(self._words[k].plain in SIDES or self._words[k].text.isdigit() for k in right)
            return (f"{before}_{behind}", "") if known else (before, behind)
        own = before or ("" if behind.isdigit() else behind)
        upper = own or ("" if self._whole else joint_in("/".join(above)))
        if re.fullmatch(r"q[0-9]+", upper):
            upper = upper[1:]
        return (f"{upper}[{index}]" if upper and index else upper or index), ""

    def _text(self, places: list[int]) -> str:
        """Text of the remaining words; words of one piece are joined as written."""
        pieces: dict[int, str] = {}
        for k in places:
            pieces[self._words[k].piece] = pieces.get(self._words[k].piece, "") + self._words[k].text
        return "_".join(pieces.values())

    def _time(self, plain_words: set[str], above: list[str], rank: int) -> Guess | None:
        if plain_words - TIME_BESIDE or (plain_words and self._words[0].plain == "t") or self._whole:
            return None
        return Guess("time", joint_in("/".join(above)), self._unit, rank + 1 + len(plain_words))

    def _bare(self) -> Guess | None:
        """Guess for a command without a quantity: its unit decides, and set-points are positions."""
        words = self._words = _words(self._parts[-1])
        plain_words = {word.plain for word in words}
        self._used = {k for k, word in enumerate(words) if word.plain in ROLES | BARE_COMMAND | BARE_POSITION}
        if (
            not plain_words & (BARE_COMMAND | BARE_POSITION)
            or plain_words & (OTHER | MEASURING)
            or _elsewhere(self._parts[:-1])
            or self._matched()
        ):
            return None
        name, strange = self._joint(len(words), self._parts[:-1])
        by_unit = {"angle": REFERENCE_SIGNAL, "speed": "reference_velocity", "torque": "target_torque"}
        channel = next((channel for dimension, channel in by_unit.items() if self._unit and known_unit(self._unit, dimension)), "")
        if (
            strange
            or (self._whole and name)
            or (self._unit and not channel)
            or (name and plain_words & {"u", "action"} and not name.isdigit())
        ):
            return None
        if channel or plain_words & BARE_POSITION:
            return Guess(channel or REFERENCE_SIGNAL, name, self._unit, BARE)
        return Guess("target_torque", name, "", BARE, doubt=COMMAND_DOUBT)

    def _matched(self) -> bool:
        """True if the part has words for two or more quantities; a single one would have been used."""
        return any((word.plain,) in _spellings() for word in self._words)


SIDE_OF = {
    **dict.fromkeys(MOTOR, "motor"),
    **dict.fromkeys(LINK, "link"),
    **dict.fromkeys(OUTPUT, "output"),
    **dict.fromkeys(NEUTRAL, "dof"),
    **dict.fromkeys(("joint", "j"), "joint"),
    **dict.fromkeys(SENSOR, "link"),
}
ROLES = COMMANDING | LOCALLY_COMMANDING | MEASURING | FEEDFORWARD | FILLERS
TURNING = COORDINATES | {"tau", "dq", "qd", "omega", "dtheta", "qdot"}
"""Words after which an `m` stands for the motor."""

BESIDE = ROLES | {*SIDE_OF}
MEASURABLE = frozenset(word for quantity, words in QUANTITIES.items() for word in words if quantity != "time")
ONE_WORD = MEASURABLE | BESIDE | OTHER | CONTAINERS


def _is_command(quantity: str, roles: set[str], letter: bool) -> bool | None:
    """True if the words beside a quantity make it a command, False for a measurement, None if undecided."""
    if letter or roles & FEEDFORWARD or roles & (COMMANDING if quantity == "torque" else COMMANDING - {"computed"}):
        return True
    if roles & MEASURING:
        return False
    return True if roles & LOCALLY_COMMANDING else None


def _channel(quantity: str, commanded: bool, side: str, spelled: str, roles: set[str]) -> tuple[str, str]:
    """Channel, "" for none, and the side that is still to be named."""
    if quantity == "current":
        return ("" if commanded else "current"), side
    if quantity == "torque":
        if commanded:
            return ("demand_torque" if roles & DEMAND and not roles & COMMANDING - DEMAND else "target_torque"), ""
        through = side == "link" or (side == "joint" and spelled in ("torque", "tau") and "applied" not in roles)
        return ("joint_torque" if through else "actual_torque"), side
    if commanded:
        return (REFERENCE_SIGNAL if quantity == "position" else "reference_velocity"), ""
    return f"{'link' if side == 'link' else 'motor'}_{quantity}", side


def _elsewhere(above: Iterable[str]) -> bool:
    """True if a path belongs to something other than a joint, such as an inertial sensor."""
    plain_words = [{word.plain for word in _words(part)} for part in above]
    return any(words & ELSEWHERE and not words & (COMMANDING | MEASURING) for words in plain_words)


def joint_in(path: str) -> str:
    """Joint name in the rest of a column's name, or in a topic: the last part of a path that names one."""
    path = path[-MOST_LETTERS:]
    parts = (_joint_part(part) for part in re.split(r"[/.]", path.strip("_ ./-[](){}<>:")))
    return ([part for part in parts if part] or [""])[-1]


def _joint_part(part: str) -> str:
    """Part without the words for commands and states: `l_knee_cmd` → l_knee, `motorState[2]` → motor[2], `joint_states` → ""."""
    name, bracket, index = part.partition("[")
    if name.lower() in CONTAINERS:
        name = ""
    pieces = [_joint_piece(piece) for piece in re.split(r"[_\s-]+", name)]
    left = [piece for piece in pieces if piece]
    plain = {_plain(piece.lower()) for piece in left}
    name = "" if plain <= CONTAINERS | NEUTRAL or (len(plain) == 1 and plain <= {*SIDE_OF} and not bracket) else "_".join(left)
    return f"{name}[{index.rstrip(']')}]" if name and bracket else name or index.rstrip("]")


def _joint_piece(piece: str) -> str:
    words = [*WORD.finditer(piece)]
    gone = [word for word in words if _plain(word[0].lower()) in NO_JOINT]
    return "".join(word[0] for word in words if word not in gone) if gone else piece


NO_JOINT = COMMANDING | MEASURING | CONTAINERS | frozenset(word for words in QUANTITIES.values() for word in words if len(word) > 2)
