"""Session of an open page: its messages go to the lanes, and results return in order."""

import asyncio
import contextlib
import json
import traceback
from collections.abc import Iterator, Sequence
from typing import Any

from starlette.websockets import WebSocket, WebSocketDisconnect

from ..errors import GainroomError
from ..io.strict_json import strict
from .bench import Bench, Cancelled, Part, digest_of
from .lanes import Lane, Stale
from .messages import Ask, read_message

MOST_WAITING = 400
"""Maximum number of answers that a page has not taken: a page that takes none is closed."""
LANES = {"look": "quick", "copy": "text", "save": "text", "find": "search", "shake": "run", "page": "page"}


class Session:
    """Session of a page; see the module. `examples`: their names.

    lanes   "quick" and "curves" for what follows a gesture, "full" for what is certified, "text" for copies, "long" for the rest
    """

    def __init__(self, socket: WebSocket, bench: Bench, lanes: dict[str, Lane], examples: Sequence[str] = ()) -> None:
        self._examples = list(examples)
        self._socket, self._bench, self._lanes = socket, bench, lanes
        self._loop = asyncio.get_running_loop()
        self._answers: asyncio.Queue[str | None] = asyncio.Queue()
        self._known = {"quick": "", "curves": ""}
        self._sought = ""  # the plant for which gains are searched

    async def run(self) -> None:
        """Runs until the page is closed."""
        await self._socket.accept()
        sender = asyncio.create_task(self._send())
        self._post("opening", 0, self._bench.opening() | {"examples": self._examples})
        try:
            while True:
                message = await self._socket.receive()
                if message["type"] == "websocket.disconnect":
                    break
                try:
                    if message.get("text") is None:
                        raise GainroomError("message: must be text")
                    self._take(read_message(message["text"]))
                except GainroomError as error:
                    self._post("refused", 0, {"message": str(error)})
        except WebSocketDisconnect:
            pass
        finally:
            for kind in (*LANES.values(), "curves", "full"):
                self._drop(kind)
            self._answers.put_nowait(None)
            with contextlib.suppress(Exception):
                await asyncio.wait_for(sender, 1)

    async def _send(self) -> None:
        while (text := await self._answers.get()) is not None:
            await self._socket.send_text(text)

    def _lane(self, kind: str) -> Lane:
        return self._lanes["long" if kind in ("search", "run", "page") else kind]

    def _drop(self, kind: str) -> None:
        self._lane(kind).drop((id(self), kind))

    def _take(self, ask: Ask) -> None:
        if ask.ask == "cancel":
            self._drop(LANES[ask.of])
            self._sought = "" if ask.of == "find" else self._sought
            self._post("ended", ask.key, {"lane": LANES[ask.of]})
            return
        kind = LANES[ask.ask]
        if ask.ask == "look":
            self._drop("full")  # of gains that nobody looks at any more
            if self._sought and self._sought != self._bench.plant(ask.view):  # what would be found is of another robot
                self._drop("search")
                self._sought = ""
                self._post("ended", ask.key, {"lane": "search", "message": "the search has ended, as other values than gains have changed"})
        elif ask.ask == "find":
            self._sought = self._bench.plant(ask.view)
        self._lane(kind).put((id(self), kind), lambda stale: self._job(ask, kind, stale))
        if ask.ask == "look":
            self._lane("curves").put((id(self), "curves"), lambda stale: self._job(ask, "curves", stale), patient=not ask.final)
        if ask.ask == "look" and ask.final:
            self._lane("full").put((id(self), "full"), lambda stale: self._job(ask, "full", stale))

    def _job(self, ask: Ask, kind: str, stale: Stale) -> None:
        """Runs a job in a lane's thread."""
        try:
            for name, part in self._parts(ask, kind, stale):
                late = stale()
                if late and (kind != "curves" or name == "map"):
                    return
                self._later(name, ask.key, part | {"lane": kind})
                if late:  # a curve of a moment ago: in a quick drag every one would be, and none would follow
                    return
            if kind == "search" and not stale():
                self._sought = ""
            self._later("done", ask.key, {"lane": kind})
        except Cancelled:
            self._later("ended", ask.key, {"lane": kind})
        except GainroomError as error:
            self._later("refused", ask.key, {"lane": kind, "message": str(error)})
        except Exception:  # noqa: BLE001 - a fault of the program: reported in full where it runs, and the page goes on
            traceback.print_exc()
            self._later("refused", ask.key, {"lane": kind, "message": "an internal error; see the terminal"})

    def _parts(self, ask: Ask, kind: str, stale: Stale) -> Iterator[Part]:
        def progress(done: int, total: int, what: str) -> None:
            """Raises Cancelled if nobody waits for the answer any more."""
            if stale():
                raise Cancelled
            if kind != "curves":  # which come one after the other
                self._later("progress", ask.key, {"lane": kind, "done": done, "total": total, "what": what})

        if kind in self._known:
            asked = ask.view, ask.window, self._known[kind] if ask.window is None else ""
            for name, part in self._bench.quick(*asked) if kind == "quick" else self._bench.curves(*asked, ask.final, progress):
                yield name, part
                if name == "map":
                    self._known[kind] = part["plant"] if kind == "quick" or part.get("last") else ""
        elif kind == "full":
            yield from self._bench.full(ask.view, ask.window, progress)
        elif ask.ask == "find":
            yield from self._bench.recommended(ask.view, progress)
        elif ask.ask == "shake":
            yield from self._bench.shaken(ask.view, progress)
        elif ask.ask == "page":
            progress(0, 1, "the report")
            yield "page", {"text": self._bench.page(ask.view)}
        elif ask.ask == "copy":
            yield "copied", {"text": self._bench.copied(ask.view, ask.form), "form": ask.form}
        else:
            text = self._bench.text(ask.view)
            difference = self._bench.opened.difference(text)
            if ask.digest:
                self._bench.opened.save(text, ask.digest)
            yield "saved" if ask.digest else "difference", {"text": difference, "digest": digest_of(text)}

    def _later(self, name: str, key: int, part: dict[str, Any]) -> None:
        text = _text(name, key, part)  # in this thread: the event loop has others to serve
        with contextlib.suppress(RuntimeError):  # the loop has ended
            self._loop.call_soon_threadsafe(self._put, text)

    def _post(self, name: str, key: int, part: dict[str, Any]) -> None:
        self._put(_text(name, key, part))

    def _put(self, text: str) -> None:
        if self._answers.qsize() > MOST_WAITING:
            self._answers.put_nowait(None)
            return
        self._answers.put_nowait(text)


def _text(name: str, key: int, part: dict[str, Any]) -> str:
    whole = {"part": name, "key": key, **part}
    try:
        return json.dumps(whole, allow_nan=False, separators=(",", ":"), default=strict)
    except ValueError:  # a number that is none
        return json.dumps(strict(whole), allow_nan=False, separators=(",", ":"))
