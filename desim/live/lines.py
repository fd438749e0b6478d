"""Lines of JSON between the referee and a pursuer."""

import asyncio
import json
from collections.abc import Callable
from typing import Any, cast

LONGEST = 1 << 26
"""Bytes of the longest line; a stranger who sends more without an end is cut off."""


class Lines(asyncio.Protocol):
    """One end of a connection. It is a protocol of asyncio, because a stream takes 1.5 times as long for each line.

    Args:
        hear: called with each line, a word and values.
        lost: called once, when the connection has ended.

    Attributes:
        hear, lost: see above; they may be replaced.
        ended: is done when the connection has ended.
    """

    def __init__(self, hear: Callable[..., object], lost: Callable[[], object] = lambda: None):
        self.hear, self.lost, self._rest = hear, lost, b""
        self._transport: asyncio.Transport | None = None
        self.ended: asyncio.Future[None] = asyncio.get_running_loop().create_future()

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Note the connection."""
        self._transport = cast("asyncio.Transport", transport)

    def data_received(self, data: bytes) -> None:
        """Hand on each complete line; close the connection of a stranger, who sends anything else."""
        *lines, self._rest = (self._rest + data).split(b"\n")
        for line in lines:
            try:
                word, *values = json.loads(line)
            except (ValueError, TypeError, RecursionError):  # brackets may nest without end
                self.close()
                return
            self.hear(word, *values)
        if len(self._rest) > LONGEST:
            self.close()

    def connection_lost(self, exc: Exception | None) -> None:
        """Tell that the connection has ended."""
        self.ended.set_result(None)
        self.lost()

    def tell(self, *words: Any) -> None:
        """Send a line."""
        self.write(encoded_line(*words))

    def write(self, line: bytes) -> None:
        """Send a line that is encoded already."""
        if self._transport is not None:
            self._transport.write(line)

    @property
    def unread(self) -> int:
        """The number of bytes that the other end has yet to read."""
        return 0 if self._transport is None else self._transport.get_write_buffer_size()

    def close(self) -> None:
        """Close the connection, once all has been sent."""
        if self._transport is not None:
            self._transport.close()


def encoded_line(*words: Any) -> bytes:
    """Return a line."""
    return json.dumps(words).encode() + b"\n"
