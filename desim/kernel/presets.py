"""Named networks. Their values show the order of magnitude of a technology, and are not measurements of a product."""

from typing import Any

PRESETS: dict[str, dict[str, Any]] = {
    "wifi": {"latency": {"kind": "shifted_exponential", "offset": 0.001, "mean": 0.002}},
    "lte": {"latency": {"kind": "gamma", "offset": 0.020, "shape": 2.0, "scale": 0.010}},
    "5g": {"latency": {"kind": "gamma", "offset": 0.005, "shape": 2.0, "scale": 0.003}},
    "satellite": {"latency": {"kind": "constant", "value": 0.270}},
    "acoustic": {
        "latency": {"kind": "propagation", "speed": 1500.0},
        "medium": {"kind": "bitrate", "bitrate": 5000.0, "half_duplex": True},
    },
} | {
    f"lora_sf{sf}": {"medium": {"kind": "lora", "spreading_factor": sf, "shared": True, "queue_limit": 8}}
    for sf in range(7, 13)
}
"""Default parameters of a network by the name of its preset; a scenario may override each of them.

The presets are wifi (one hop of 802.11), lte and 5g (via the base station), satellite (geostationary), acoustic
(under water), lora_sf7 .. lora_sf12 (by spreading factor, 125 kHz).
"""
