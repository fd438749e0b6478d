"""References for the speed of desim: the same broadcasts in other implementations and other simulators.

`workloads` defines the broadcasts. `desim_ways`, `simpy_ways` and `bare_heap` deliver them in this process with the
same stream of latencies, and must end with the same tables of received numbers. `elsewhere` runs programs for other
simulators, each in a separate environment; each must deliver all messages sent. `bare_loop` is a pursuit without
messages or a simulator.
"""
