"""References for the speed of desim: the same broadcasts in other implementations and other simulators.

`workloads` defines the broadcasts. `desim_ways`, `simpy_ways` and `bare_heap` deliver them in this process with the
same stream of latencies, and must end with the same tables. `elsewhere` runs programs of other simulators, each in a
separate environment; they must deliver the same number of messages. `bare_loop` is the pursuit without messages.
"""
