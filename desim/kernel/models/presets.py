"""Named networks, with the source of each of their values; values without a source are guesses.

The latencies show the order of magnitude of a technology, and are not measurements of a product.
"""

from typing import Any

# IEEE 802.11g, frames without protection at 6 Mbit/s, the rate of broadcasts.
_WIFI: dict[str, Any] = {
    # A guess: the times that the operating systems of sender and receiver take, 1 ms in all. That of the sender comes
    # before its queue, so frames of one instant, as in rounds, do not start at the same nanosecond.
    "processing": {"sender": {"kind": "shifted_exponential", "offset": 0.00025, "mean": 0.00025}},
    "latency": {"kind": "shifted_exponential", "offset": 0.00025, "mean": 0.00025},
    "medium": {
        "kind": "bitrate",
        "bitrate": 6e6,
        # 64 bytes of headers: MAC with checksum 28, LLC and SNAP 8, IPv4 20, UDP 8. Preamble and signal field (20 us),
        # signal extension (6 us), service and tail (22 bits) take as long as 22 bytes (IEEE 802.11-2016, clauses 17 and
        # 18).
        "header": 86,
        "queue_limit": 100,  # a guess
        "access": {
            "kind": "csma_ca",
            "slot": 9e-6,  # short slot; slot, SIFS and window: IEEE 802.11-2016, clause 18
            "sifs": 10e-6,
            "difs": 28e-6,  # SIFS + 2 slots
            "window": 16,
            "doublings": 6,  # up to 1023 slots
            "retries": 7,  # default of dot11ShortRetryLimit
            "ack": 50e-6,  # 14 bytes at 6 Mbit/s
            "ack_timeout": 69e-6,  # SIFS, acknowledgement and a slot
            "eifs": 88e-6,  # SIFS, acknowledgement at the lowest rate and DIFS
            "sensing_delay": 4e-6,  # limit of the time of a clear channel assessment, clause 17
        },
        # A guess: the ratio at which a receiver gets the stronger of two frames depends on the radio.
        "reception": {"kind": "capture", "threshold": 10.0, "exponent": 3.0, "lock": True},
    },
}


def _lora(spreading_factor: int) -> dict[str, Any]:
    """Return LoRa in the European band at 868 MHz, whose nodes transmit at any time, as in LoRaWAN class A.

    The spreading factor changes airtimes, and not the range. The 13 bytes of LoRaWAN headers are not counted.
    """
    return {
        "medium": {
            "kind": "lora",  # 125 kHz, coding rate 4/5, 8 preamble symbols: the defaults of LoRaWAN in Europe
            "spreading_factor": spreading_factor,
            "queue_limit": 1,  # a guess: an announcement supersedes the one before
            "duty_cycle": 0.01,  # ETSI EN 300 220-2, 868.0 .. 868.6 MHz
            "access": {"kind": "aloha"},
            # Threshold and critical section of Bor, Roedig, Voigt & Alonso 2016, and their measured path loss exponent.
            "reception": {"kind": "lora", "threshold": 6.0, "exponent": 2.08},
        }
    }


PRESETS: dict[str, dict[str, Any]] = {
    "wifi": _WIFI,
    # Guesses of the one-way latency via a base station, including the scheduling of radio resources.
    "lte": {"latency": {"kind": "gamma", "offset": 0.020, "shape": 2.0, "scale": 0.010}},
    "5g": {"latency": {"kind": "gamma", "offset": 0.005, "shape": 2.0, "scale": 0.003}},
    # A geostationary satellite at 35 786 km: 2 x 119.4 ms at least, and a guess of 30 ms for processing.
    "satellite": {"latency": {"kind": "constant", "value": 0.270}},
    # Under water: the speed of sound; a guess of the bit rate. Contention is not modelled, as models of interference
    # neglect the propagation delay, which may be longer than a frame here.
    "acoustic": {
        "latency": {"kind": "propagation", "speed": 1500.0},
        "medium": {"kind": "bitrate", "bitrate": 5000.0, "half_duplex": True},
    },
} | {f"lora_sf{sf}": _lora(sf) for sf in range(7, 13)}
"""Default parameters of a network by the name of its preset; a scenario may override each of them."""
