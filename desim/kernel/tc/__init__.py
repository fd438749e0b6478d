"""The language of Linux's `tc`: read `qdisc` commands as link models, and write link models as commands.

Only `desim netem` and `desim.live` need it.
"""
