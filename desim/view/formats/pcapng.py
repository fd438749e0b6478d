"""The messages of a run as a capture file in the pcapng format, which Wireshark and tshark open without a plug-in.

The format is that of the IETF draft "PCAP Next Generation (pcapng) Capture File Format": a section header block, the
description of one interface with times in ns, and an enhanced packet block for each message; a broadcast is one packet
for each receiver. The time of a packet is the start of the transmission; the run begins at the Unix epoch. An
acknowledged message (`csma_ca`) is one packet at the end of the attempt that succeeded, as in the trace.

A packet is UDP over IPv4 (LINKTYPE_RAW). Node i has the address 10.0.0.0 + i, the UDP payload has the size of the
message, and the identification of the IP header is the number of the transmission modulo 65,536. The payload is zeros;
the content of the message is in the comment of the packet, as JSON. The file has all messages whose transmission began,
even if they were lost, but not acknowledged messages of which no attempt succeeded.
"""

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import ClassVar, Literal

from desim.analysis.trace_index import NO_MESSAGES
from desim.config.model import Value
from desim.kernel.core.events import MESSAGES, Broadcast, MessageCounts, Sent
from desim.kernel.core.portable_math import portable_sum
from desim.kernel.core.trace_file import body_json
from desim.results.run_folder import StreamedResult
from desim.simulation.run import Result

SECTION_HEADER, INTERFACE, PACKET = 0x0A0D0D0A, 1, 6
"""Types of blocks."""
END, COMMENT, RESOLUTION, APPLICATION = 0, 1, 9, 4
"""Codes of options; the last two are those of the interface and of the section header."""
MAX_OPTION = 0xFFFF
"""Size of the longest option, bytes; a longer content is split into several comments."""
LINKTYPE_RAW = 101
"""The link type of packets that begin with an IP header."""
NETWORK = 10 << 24
"""The address 10.0.0.0 of node 0."""
PORT = 49152
"""The UDP port of all nodes, the first of the range that no protocol is assigned to."""
HEADERS = 28
"""Size of the headers of IPv4 and UDP, bytes."""
MAX_PAYLOAD = 65_535 - HEADERS
"""Size of the largest payload, bytes; a longer one is captured in part, and its headers have the length 0."""


class Pcapng(Value):
    """A capture file for Wireshark: one packet per message."""

    kind: Literal["pcapng"] = "pcapng"

    suffix: ClassVar[str] = ".pcapng"
    items: ClassVar[str] = "packets"
    streams: ClassVar[bool] = True

    def __call__(self, result: Result | StreamedResult, file: Path) -> int:
        """Write the capture, and return the number of packets.

        Raises:
            ValueError: if messages were sent and none was recorded.
        """
        count, are_recorded = 0, False
        with file.open("wb") as stream:
            stream.write(_file_header())
            for event in result.trace:
                are_recorded = are_recorded or isinstance(event, MESSAGES)
                if isinstance(event, Broadcast | Sent):
                    for packet in _packets(event):
                        stream.write(packet)
                        count += 1
                elif isinstance(event, MessageCounts) and event.sent and not are_recorded:
                    raise ValueError(NO_MESSAGES)
        return count


def _file_header() -> bytes:
    """Return the blocks at the beginning of a file."""
    version = struct.pack("<IHHq", 0x1A2B3C4D, 1, 0, -1)  # byte order, version 1.0, a section of unknown length
    nanoseconds = _option(RESOLUTION, bytes([9]))  # 10^-9 s
    interface = struct.pack("<HHI", LINKTYPE_RAW, 0, 0) + nanoseconds + _option(END, b"")
    section = version + _option(APPLICATION, b"desim") + _option(END, b"")
    return _block(SECTION_HEADER, section) + _block(INTERFACE, interface)


def _packets(event: Broadcast | Sent) -> Iterator[bytes]:
    """Yield a packet block for each receiver of a transmission."""
    body = body_json(event.body).encode()
    parts = [body[start : start + MAX_OPTION] for start in range(0, len(body), MAX_OPTION)]
    comments = b"".join(_option(COMMENT, part) for part in parts) + _option(END, b"")
    payload = bytes(min(event.size, MAX_PAYLOAD))
    for dst, _ in event.fates():
        data = _packet_headers(event, dst) + payload
        lengths = len(data), HEADERS + event.size
        fields = struct.pack("<IIIII", 0, event.t >> 32, event.t & 0xFFFF_FFFF, *lengths)
        yield _block(PACKET, fields + _padded(data) + comments)


def _packet_headers(event: Broadcast | Sent, dst: int) -> bytes:
    """Return the headers of IPv4 and UDP of the packet to one receiver; the checksum 0 of UDP means none."""
    fits = event.size <= MAX_PAYLOAD
    total, datagram = (HEADERS + event.size, 8 + event.size) if fits else (0, 0)
    addresses = NETWORK + event.src, NETWORK + dst
    # Version 4 with 5 words, no type of service, length, identification, no fragments, time to live 1, UDP.
    start = struct.pack(">BBHHHBB", 0x45, 0, total, event.transmission & 0xFFFF, 0, 1, 17)
    words = struct.unpack(">10H", start + struct.pack(">HII", 0, *addresses))
    # The complement of the sum of the words in ones' complement: the sum modulo 0xFFFF, but never 0 (RFC 1071).
    checksum = 0xFFFF - (portable_sum(words) % 0xFFFF or 0xFFFF)
    return start + struct.pack(">HII", checksum, *addresses) + struct.pack(">HHHH", PORT, PORT, datagram, 0)


def _block(kind: int, body: bytes) -> bytes:
    size = struct.pack("<I", 12 + len(body))
    return struct.pack("<I", kind) + size + body + size


def _option(code: int, value: bytes) -> bytes:
    return struct.pack("<HH", code, len(value)) + _padded(value)


def _padded(data: bytes) -> bytes:
    """Return bytes with zeros appended, so that their length is a multiple of 4."""
    return data + bytes(-len(data) % 4)
