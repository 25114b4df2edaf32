"""Messages that the page may send, each with its bounds: they come from outside."""

import json
from typing import Annotated, Literal

from pydantic import AfterValidator, Field

from ..errors import GainroomError, listed
from ..files.export_forms import FORMS
from ..io.validation import LARGEST, Flag, Name, NotNegative, Positive, Section, number, refusal, validate

LONGEST = 32_768
"""Maximum length of a message [bytes]."""
Key = Annotated[int, Field(strict=True, ge=0, le=2**53)]
Rate = Annotated[float, number(least=0, most=1e6, unit="Hz")]
Signed = Annotated[float, number(least=-LARGEST)]
Coordinate = Annotated[float, number(least=-1e6, most=1e6)]


def _known(form: str) -> str:
    """Name of a form that can be copied, which the registers have when the message comes."""
    able = [name for name, each in FORMS.items() if each.text_to_paste is not None]
    if form not in able:
        raise refusal(f"must be one of {listed(able, most=99)}")
    return form


Form = Annotated[str, Field(strict=True, max_length=64), AfterValidator(_known)]


class View(Section):
    """Selection and edits that the page shows; None: as in the file.

    gains        of a joint by name, those of filters as biquads.0.zero_damping; of a robot as name of joint → {kp, kd}, or what its
                 controller has
    point        of the plane of the gain map, of the joint that it shows; it goes before gains
    delay_ms     of the drives
    stiffness    of the gearbox [N m/rad]; of a robot a factor on all of them
    link_inertia of a joint [kg m²]
    sample_rate_hz   0: continuous
    structure    of a joint's controller, as named by structures.TITLES
    payload      of a robot [kg], in all, at the origin of the frame payload_at
    posture, contact, joint   of a robot
    angles       of a robot's joints that stand otherwise than in its posture [rad, m]
    """

    gains: dict[Name, Signed | dict[Name, NotNegative]] = Field(default_factory=dict, max_length=200)
    point: tuple[NotNegative, NotNegative] | None = None
    delay_ms: NotNegative | None = None
    stiffness: Positive | None = None
    link_inertia: Positive | None = None
    sample_rate_hz: Rate | None = None
    structure: Name | None = None
    payload: NotNegative | None = None
    payload_at: Name | None = None
    posture: Name | None = None
    contact: Name | None = None
    joint: Name | None = None
    angles: dict[Name, Coordinate] = Field(default_factory=dict, max_length=200)


class Ask(Section):
    """Message of the page.

    ask     look: numbers of a view; find: recommended gains; copy, save: gains as text; shake: a simulated run; page: the report; cancel:
            end the search or the run, `of` which
    key     comes back with every answer
    final   look: not in the middle of a gesture, so everything that is certified is wanted
    window  look: draw the map anew, up to these gains (kp, kd)
    form    copy: of the text
    of      cancel: find or shake
    digest  save: of the difference that was seen
    """

    ask: Literal["look", "find", "copy", "save", "shake", "page", "cancel"]
    key: Key
    view: View = Field(default_factory=View)
    final: Flag = True
    window: tuple[Positive, Positive] | None = None
    form: Form = "yaml"
    of: Literal["find", "shake"] = "shake"
    digest: Annotated[str, Field(strict=True, max_length=64)] = ""


def read_message(text: str) -> Ask:
    """Validated message. Raises GainroomError, one line, for any other text."""
    if len(text.encode("utf-8", "surrogatepass")) > LONGEST:
        raise GainroomError(f"message: must be at most {LONGEST} bytes long")
    try:
        data = json.loads(text)
    except (ValueError, RecursionError):
        raise GainroomError("message: is no JSON") from None
    if not isinstance(data, dict):
        raise GainroomError("message: must be an object")
    return validate(Ask, data, "message")
