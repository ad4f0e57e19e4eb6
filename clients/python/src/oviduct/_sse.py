"""Parser of server-sent events (WHATWG HTML, section 9.2.6)."""

from __future__ import annotations

import codecs
import json
from dataclasses import dataclass
from typing import Any

from .errors import UnexpectedAnswer


@dataclass(frozen=True)
class Message:
    """An event of a stream."""

    name: str
    data: str
    id: str | None
    """The last id that the stream has sent."""

    def json(self) -> Any:
        """Returns the parsed data; raises UnexpectedAnswer if the data is not JSON."""
        try:
            return json.loads(self.data)
        except ValueError as error:
            raise UnexpectedAnswer(f"the data of an event is not JSON: {error}") from None


class Parser:
    """Parses the bytes of a stream, in chunks of any size."""

    def __init__(self, last_id: str | None = None) -> None:
        self.last_id = last_id
        """The last id, even if no event followed it."""
        self._decode = codecs.getincrementaldecoder("utf-8-sig")("replace").decode
        self._line = ""
        self._after_cr = False
        self._name = ""
        self._data: list[str] = []
        self._id = last_id

    def feed(self, chunk: bytes) -> list[Message]:
        """Returns the events that these bytes complete."""
        messages = []
        text = self._decode(chunk)
        if self._after_cr and text:
            # The last chunk ended with CR, so an LF at the beginning of this chunk belongs to that
            # line end.
            text = text.removeprefix("\n")
            self._after_cr = False
        self._after_cr = self._after_cr or text.endswith("\r")
        lines = (self._line + text.replace("\r\n", "\n").replace("\r", "\n")).split("\n")
        self._line = lines.pop()
        for line in lines:
            message = self._take(line)
            if message is not None:
                messages.append(message)
        return messages

    def _take(self, line: str) -> Message | None:
        """Processes a line; returns the event that an empty line ends."""
        if not line:
            name, data = self._name or "message", self._data
            self._name, self._data, self.last_id = "", [], self._id
            return Message(name, "\n".join(data), self.last_id) if data else None
        field, _, value = line.partition(":")
        value = value.removeprefix(" ")
        if field == "event":
            self._name = value
        elif field == "data":
            self._data.append(value)
        elif field == "id" and "\0" not in value:
            self._id = value
        return None
