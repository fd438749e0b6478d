"""What the mathematics of the pursuit game says of its profiles: utilities, equilibria and the law of a rule."""

import numpy as np

from desim.pursuit.game.game import equilibria, logit, profiles, relay_pursuer, welfare


def wonderful_life_utility(phi, actions, reward, i):
    """Return the marginal contribution of pursuer i to the global utility, s; only the term of its evader changes."""
    if not actions[i]:
        return 0.0
    times = np.asarray(phi, dtype=float).reshape(len(actions), -1)[:, actions[i] - 1]
    team = [action == actions[i] for action in actions]
    return welfare(times, team, reward) - welfare(times, [*team[:i], 0, *team[i + 1 :]], reward)


def is_equilibrium(phi, actions, reward, *options, **named):
    """Return whether no pursuer gains by changing its action alone."""
    return tuple(actions) in equilibria(phi, reward, *options, **named)


def relay_profile(phi, reward):
    """Return the profile in which only the relay pursuer is active; without a relay pursuer all are inactive."""
    relay = relay_pursuer(phi, reward)
    return tuple(i == relay for i in range(len(phi)))


def gibbs(phi, reward, tau):
    """Return the ((M + 1)^N,) stationary distribution of log-linear learning at the temperature tau, s.

    The profiles are in the order of `profiles`. P(profile) is proportional to exp(Phi(profile) / tau): Blume 1993, "The
    Statistical Mechanics of Strategic Interaction".
    """
    number, evaders = np.asarray(phi, dtype=float).reshape(len(phi), -1).shape
    return np.array(logit([welfare(phi, actions, reward) for actions in profiles(number, evaders)], 1.0 / tau))
