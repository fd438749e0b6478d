"""Warnings about latencies that were probably given in milliseconds by mistake."""

from collections.abc import Collection, Iterator

from desim.kernel.models.graphs import as_model
from desim.kernel.models.latency import mean_latency
from desim.scenario.link_warnings import edge_attributes
from desim.scenario.scenario import Scenario

LONG_LATENCY = 0.1
"""The share of the horizon above which a mean latency gives a warning.

With a longer latency, a chain of messages, each sent on arrival of the one before, has fewer than ten messages in a
run, so the pursuers can hardly negotiate. Latencies in seconds are usually a far smaller share: in the files of
`scenarios`, outside of grids, at most 1.5 % of the horizon. Latencies given in milliseconds by mistake are a greater
share: even the 5 ms of a fast radio become 5 s, a sixth of the default horizon.
"""


def latency_warnings(scenarios: Collection[Scenario]) -> Iterator[tuple[str, str]]:
    """Yield the key and the text of a warning for each latency that was probably given in milliseconds by mistake.

    The scenarios are the configurations of a sweep, or a single scenario. A sweep may vary a latency from short to long
    on purpose. With several scenarios, a latency therefore gives a warning only if its mean is long (`LONG_LATENCY`) in
    all scenarios where it is positive, or reaches the horizon in one of them.
    """
    by_key: dict[str, list[tuple[float, float]]] = {}
    for scenario in scenarios:
        for key, mean in _mean_latencies(scenario):
            if mean > 0.0:
                by_key.setdefault(key, []).append((mean, scenario.horizon))
    for key, pairs in by_key.items():
        mean, horizon = max(pairs, key=lambda pair: pair[0] / pair[1])
        share = "not less than" if mean >= horizon else "more than a tenth of"
        if mean >= horizon or all(value > LONG_LATENCY * limit for value, limit in pairs):
            of_edge = " of an edge" if key == "network.graph" else ""
            yield (
                key,
                f"the mean latency{of_edge} of {mean:g} s is {share} the horizon of {horizon:g} s: times are in s, not"
                " ms",
            )


def _mean_latencies(scenario: Scenario) -> Iterator[tuple[str, float]]:
    """Yield the key and the mean (s) of each latency with a known mean in the network; of edges, the longest."""
    network = scenario.network
    models = {"network.latency": network.latency}
    models |= {f"network.link.{k}.latency": link.latency for k, link in enumerate(network.link) if link.latency}
    for key, model in models.items():
        if (mean := mean_latency(model)) is not None:
            yield key, mean
    edges = [edge for edge in edge_attributes(scenario) if "latency" in edge]
    means = [mean_latency(as_model("latency", edge["latency"])) for edge in edges]
    yield "network.graph", max((mean for mean in means if mean is not None), default=0.0)
    if (at_sender := mean_latency(network.processing.sender)) is not None:
        yield "network.processing", at_sender + network.processing.receiver
