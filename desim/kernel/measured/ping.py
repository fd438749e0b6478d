"""The output of ping, as Linux, macOS, BusyBox and Windows (in English) print it, as a table of round trips.

    64 bytes from 10.0.0.2: icmp_seq=1 ttl=64 time=12.3 ms
    Reply from 10.0.0.2: bytes=32 time=12ms TTL=64

A probe is lost if no reply has its sequence number. Windows prints no sequence numbers, but a line for each lost probe.
"""

import re
from typing import NamedTuple

import numpy as np

REPLY = re.compile(
    r"(?:\[(\d+(?:\.\d+)?)\] )?(?:\d+ bytes from .*?\b(?:icmp_)?seq=(\d+)\b.*?|Reply from \S+: (?:bytes=\d+ )?)"
    r"time[=<](\d+(?:[.,]\d+)?) ?ms\b.*",
    re.ASCII,
)
"""Matches the line of a reply; Windows prints no bytes for IPv6."""
FAILURE = re.compile(
    r"Request timed out\.|(?:Reply from \S+: )?(?:Destination|TTL expired).*|(?:PING: .* )?General failure\.?"
)
"""Matches the line of Windows for a lost probe."""
NO_REPLY = re.compile(r".*\b(?:icmp_)?seq[= ](\d+)\b.*", re.ASCII)
"""Matches a line of Linux, macOS or BusyBox that names a probe without a reply, or with a late one."""
TOTAL = re.compile(r"(\d+) packets transmitted, .*?(?:, time (\d+) ?ms)?", re.ASCII)
"""Matches the line with the number of probes and, on Linux, the time that they took."""
RECEIVED = re.compile(
    r"\d+ packets transmitted, (\d+) (?:packets )?received.*|.*Sent = \d+, Received = (\d+),.*", re.ASCII
)
"""Matches the line with the number of replies."""
START = re.compile(r"(?:PING |PING6?\(\d+=|Pinging ).*")
"""Matches the first line."""
FROM_0 = re.compile(r"PING .*: \d+ data bytes.*|PING6?\(\d+=.*")
"""Matches the first line of macOS, BSD and BusyBox, which number probes from 0; Linux numbers them from 1."""
INTERVAL = 1.0
"""Time between probes, s, if the output has no times."""
MAX_PROBES = 10**7
MAX_SHOWN = 100
"""The greatest number of characters of a line that a refusal shows."""
WRAP = 2**16
"""The modulus of sequence numbers, which have 16 bits: 0 follows 65535."""


class Probe(NamedTuple):
    """A probe."""

    sent: float
    """When it was sent, s; with `ping -D` since 1970, else since the first probe."""
    rtt: float | None
    """Round-trip time, s; None if the probe was lost."""


def ping_table(text: str, name: str) -> str | None:
    """Return the output of ping as CSV text with a row per probe; None if the text is anything else.

    The columns are t, when the probe was sent, s; rtt_ms, the round-trip time, ms, empty if the probe was lost; and
    lost, 0 or 1.

    Raises:
        ValueError: as `probes_of`; the message begins with `name`.
    """
    rows = [
        f"{probe.sent:.6f},,1" if probe.rtt is None else f"{probe.sent:.6f},{1e3 * probe.rtt:.9g},0"
        for probe in probes_of(text, name)
    ]
    return "\n".join(["t,rtt_ms,lost", *rows, ""]) if rows else None


def probes_of(text: str, name: str = "the text") -> list[Probe]:
    """Return the probes in the output of ping, in order of their sequence numbers; none if the text is anything else.

    With `ping -D`, the times of replies are known, and those of lost probes are interpolated. Without -D, the interval
    between probes is constant: on Linux it follows from the summary, elsewhere it is 1 s.

    Raises:
        ValueError: if the text is the output of several pings, a summary only, or of more than `MAX_PROBES` probes, or
            if the time of a reply is not in ms.
    """
    if "time=" not in text and "time<" not in text and "PING" not in text and "Pinging " not in text:
        return []
    lines = [line.strip() for line in text.split("\n")]
    starts = sum(bool(START.fullmatch(line)) for line in lines)
    if not any(map(REPLY.fullmatch, lines)):
        received = [int(match[1] or match[2]) for line in lines if (match := RECEIVED.fullmatch(line))]
        if not starts or not received:
            return []
        if any(received):
            raise ValueError(
                f"{name} has the summary of ping only; without the option -q, it prints a line for each reply"
            )
    if starts > 1:
        raise ValueError(f"{name} has the output of several pings; a file should have that of one")
    replies: dict[int, tuple[float | None, float]] = {}
    lost: set[int] = set()
    last: int | None = None
    count, duration = 0, None
    for line in lines:
        if reply := REPLY.fullmatch(line):
            stamp, number, rtt = reply.groups()
            last = _unwrapped(int(number), last) if number else len(replies) + len(lost)
            seconds = float(rtt.replace(",", ".")) / 1e3  # the decimal sign is that of the locale
            replies.setdefault(last, (float(stamp) - seconds if stamp else None, seconds))  # the first, of duplicates
        elif FAILURE.fullmatch(line):
            lost.add(len(replies) + len(lost))
        elif "time=" in line or "time<" in line:
            raise ValueError(f"{name} has a reply that cannot be read: {line[:MAX_SHOWN]!r}; its time should be in ms")
        elif no_reply := NO_REPLY.fullmatch(line):
            last = _unwrapped(int(no_reply[1]), last)
            lost.add(last)
        elif total := TOTAL.fullmatch(line):
            count, duration = int(total[1]), float(total[2]) / 1e3 if total[2] else None
    numbers = {*replies, *lost}
    first = min(numbers, default=1)
    if starts:  # the first probes may be lost; a log without its start may begin with any number
        first = min(first, 0 if any(map(FROM_0.fullmatch, lines)) else 1)
    end = max(numbers | {first + count - 1})
    if end - first >= MAX_PROBES:
        raise ValueError(f"{name} has more than {MAX_PROBES:,} probes")
    stamps = {seq: stamp for seq, (stamp, _) in replies.items() if stamp is not None}
    interval = _interval(stamps, count, duration)
    earliest, latest = min(stamps, default=first), max(stamps, default=first)
    stamps |= {  # the first and the last probe by extrapolation, so that the times of all others can be interpolated
        first: stamps.get(earliest, 0.0) - interval * (earliest - first),
        end: stamps.get(latest, 0.0) + interval * (end - latest),
    }
    stamped = sorted(stamps)
    sent = np.interp(range(first, end + 1), stamped, [stamps[seq] for seq in stamped]).tolist()
    return [Probe(time, replies[seq][1] if seq in replies else None) for seq, time in enumerate(sent, first)]


def _interval(stamps: dict[int, float], count: int, duration: float | None) -> float:
    """Return the time between probes, s, from the times of some, or from the number of all and their duration, s."""
    if len(stamps) > 1:
        return (max(stamps.values()) - min(stamps.values())) / (max(stamps) - min(stamps))
    return duration / (count - 1) if duration and count > 1 else INTERVAL


def _unwrapped(seq: int, last: int | None) -> int:
    """Return the number nearest to the last one that equals `seq` modulo 2^16."""
    return seq if last is None else last + (seq - last + WRAP // 2) % WRAP - WRAP // 2
