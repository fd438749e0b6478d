"""From the start of a transmission to its arrival or loss: departure, draws of latency and loss, delivery.

Most of the time of a run is spent here, so it has fast paths. Each names the test that keeps it equal to the plain
path; run the benchmarks before and after a change.
"""
