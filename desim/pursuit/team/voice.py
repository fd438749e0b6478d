"""The voice of a team: the operations with which pursuers send messages; the network, or what replaces messages."""

from typing import Any, Protocol

from desim.kernel.core.records import Record
from desim.kernel.models.transport import Transport


class Voice(Protocol):
    """The operations with which a pursuer sends; the methods are those of `Network`."""

    def publish(self, src: int, body: Any, size: int | None = None, stamp: int | None = None) -> None:
        """Broadcast the state of a pursuer as a record."""
        ...

    def next_record(self, src: int, body: Any, stamp: int | None = None) -> Record:
        """Return a new record of a pursuer."""
        ...

    def send(
        self,
        src: int,
        dst: int | None,
        body: Any,
        *,
        port: str = "",
        size: int | None = None,
        transport: Transport | None = None,
    ) -> None:
        """Send a message to a pursuer, or to all neighbours."""
        ...
