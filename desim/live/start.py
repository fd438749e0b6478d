"""The start of the process of a pursuer: what it is told, also as a word for the command line of another host."""

from typing import NamedTuple, Self

from desim.config.arguments import value_text
from desim.scenario.scenario import Scenario
from desim.study.plan.config_hash import identify

Address = tuple[str, int]
"""A host and a UDP port."""


class PursuerStart(NamedTuple):
    """What the process of a pursuer is told at its start."""

    referee: Address
    token: str
    """A secret of the run, with which a process shows that it belongs to the run."""
    pursuer: int
    seed: int
    host: str
    """The host at which it listens for datagrams."""
    draws: bool = True
    """Whether losses and latencies are drawn."""
    namespace: str = ""
    """The network namespace in which it listens; empty: its own."""
    scenario: str = ""
    """The hash of the scenario, its code and its data files; "" if the referee has sent the scenario."""

    def invitation(self) -> str:
        """Return the start as a word for the command line of another host."""
        host, port = self.referee
        return f"{host}:{port}/{self.pursuer}/{self.seed}/{self.host}/{self.token}"

    @classmethod
    def invited(cls, invitation: str, scenario: Scenario) -> Self:
        """Return the start that an invitation stands for, with a scenario that was read from a file.

        Raises:
            ValueError: if it is not an invitation, or an object of the scenario has no stable hash.
        """
        try:
            referee, pursuer, seed, host, token = invitation.split("/")
            referee_host, _, port = referee.rpartition(":")
            if not 0 < int(port) < 1 << 16:
                raise ValueError
            start = cls((referee_host, int(port)), token, int(pursuer), int(seed), host)
        except ValueError:
            raise ValueError(
                f"should be the word that `desim live --hosts` prints (got {value_text(invitation)})"
            ) from None
        return start._replace(scenario=identify(scenario).key)
