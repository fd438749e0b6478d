"""References for the speed of desim: the same broadcasts in other implementations and other simulators.

`workloads` defines the broadcasts. `desim_ways`, `simpy_ways` and `bare_heap` deliver them in this process with the
same stream of latencies, and must end with the same tables of received numbers; `ways` lists these implementations by
name. `elsewhere` runs a program for each of the other simulators, in a separate environment; a program must deliver all
messages that it sends. `simpy_contention` is a channel in SimPy for which nodes contend, `bare_loop` a pursuit without
messages or a simulator, and `bare_sockets` the datagrams of a live run without desim.
"""
