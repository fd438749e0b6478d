"""What desim is compared with: the same broadcasts delivered in other ways and by other simulators.

`workloads` says what is delivered. `desim_ways`, `simpy_ways` and `bare_heap` deliver it here, from the same stream of
latencies, and must end with the same tables; `elsewhere` has it delivered by programs that are built and run in an
environment of their own, and must deliver as many. `bare_loop` is the pursuit without messages.
"""
