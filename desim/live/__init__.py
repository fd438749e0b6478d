"""Live runs: the protocol of a scenario in one process per pursuer, over UDP, in real time.

A process has a clock of SimPy of its own, which follows the wall clock, and a network whose link layer is a socket. The
protocol, its schedule, its dissemination and its transport are those of a simulation, unchanged. What cannot run live
is in `refusals`, the bytes of a datagram are in `wire`.
"""
