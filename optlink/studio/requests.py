"""Messages of a page, of the server or of a notebook: form, size and rate are checked here before any is used."""

import json
import time
from typing import Any

MAX_MESSAGE = 1_000_000  # characters of a message
RATE, BURST = 200.0, 400.0  # messages per second, and at once
MAX_REFUSED = 2000  # refused messages after which no more are taken
MAX_REPORTED = 100  # refused messages that are answered one by one
REQUESTS = (
    *("open", "new", "drag", "set", "lock", "search", "stop", "undo", "redo"),
    *("draw", "choose", "save", "export", "link"),
)
"""Types of the requests that a page may send."""
QUOTA = "Too many requests. Send fewer than 200 a second"
MALFORMED = "The message is not a request. Send a JSON object with a known type and an id (a whole number), of at most 1 MB"
TOO_MANY = "too many malformed messages"


class Requests:
    """The requests of one page, and the count of those that are refused."""

    def __init__(self) -> None:
        self._left, self._last, self._refused = BURST, time.monotonic(), 0

    @property
    def closed(self) -> bool:
        """Whether so many messages were refused that the page gets no more answers."""
        return self._refused > MAX_REFUSED

    def take(self, text: object) -> tuple[dict[str, Any] | None, str | None]:
        """Return the request of a message, or none and the answer to a message that is refused.

        Not every refusal has an answer: a page that does not read its answers must not block the count.
        """
        now = time.monotonic()
        self._left, self._last = max(min(BURST, self._left + RATE * (now - self._last)) - 1.0, -BURST), now
        request = parsed(text)
        if request is not None and (self._left >= 0.0 or (request["type"] == "drag" and request.get("moving"))):
            return request, None
        self._refused += 1
        if self._refused > MAX_REPORTED and self._refused % MAX_REPORTED:
            return None, None
        words, ident = (MALFORMED, None) if request is None else (QUOTA, request["id"])
        return None, json.dumps({"type": "fault", "id": ident, "message": words})


def parsed(text: object) -> dict[str, Any] | None:
    """Return the request of a message; None if it is none."""
    if not isinstance(text, str) or len(text) > MAX_MESSAGE:
        return None
    try:
        request = json.loads(text, parse_constant=_refuse)
    except (ValueError, RecursionError):
        return None
    if not isinstance(request, dict) or not isinstance(request.get("type"), str) or request["type"] not in REQUESTS:
        return None
    ident = request.get("id")
    return request if isinstance(ident, int) and not isinstance(ident, bool) and 0 <= ident < 2**53 else None


def _refuse(text: str) -> None:
    raise ValueError(text)
