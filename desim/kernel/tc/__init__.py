"""The language of Linux's `tc`: read `qdisc` commands as link models, and write link models as commands.

Nothing but `desim netem` needs it.
"""
