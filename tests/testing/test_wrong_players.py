"""Wrong bodies and strategies of evaders: each is told what is wrong with it."""

import random
from cmath import phase, rect
from contextlib import nullcontext
from typing import ClassVar

import numpy as np
import pytest

from desim.pursuit.evaders.evasion import PureEvasion
from desim.pursuit.motion.dynamics import DYNAMICS, Acceleration, Course, Piece, Simple, TurnRate
from desim.testing import ContractError, bodies, check_body, check_evader
from desim.testing.bodies import _Body
from desim.testing.judging import subject


def body(base=Acceleration, **methods):
    """Return a user's body: another one with some methods replaced."""
    return type("Mine", (base,), {"__module__": "mine", **methods})()


def elsewhere(self, position, course, command):
    return Piece(0j, Course(command, course.heading))


def at_once(self, position, course, command):
    return Piece(position, Course(command, course.heading))


def twice_as_fast(self, position, course, command):
    return Piece(position, Course(2.0 * command, course.heading))


def in_place(self, position, course, command):
    return position


def for_a_second(self, position, course, command):
    """Accelerate for a second, however much is missing."""
    return Piece(position, course, 1.0, command - course.velocity)


def never_ends(self, position, course, command):
    return Piece(position, course)


def creeps(self, position, course, command):
    return Piece(position, Course(command or 0.1 + 0j, course.heading))


def brakes_when_fast(self, position, course, command):
    """Stop at once, unless it is faster than 1.5 m/s."""
    if command or abs(course.velocity) < 1.5:
        return Piece(position, Course(command, course.heading))
    return Piece(position, course, 1.0, -course.velocity)


def both(self, position, course, command):
    return Piece(position, course, 1.0, 0.1 + 0j, 0.5)


def carried(self, position, course, command):
    return Piece(position, Course(command, course.heading), drift=0.1 + 0j)


def backwards(self, position, course, command):
    return Piece(position, course, -1.0)


def forgets(self, position, course, command):
    """Turn by 1 rad, and then go where it heads."""
    return Piece(position, Course(abs(command) * course.heading, course.heading), 0.5, turn_rate=2.0)


def sharp(self, position, course, command):
    """Turn at 3 rad/s."""
    if not command:
        return Piece(position, Course(0j, course.heading))
    angle = phase(command / course.heading)
    begun = Course(abs(command) * course.heading, course.heading)
    return Piece(position, begun, abs(angle) / 3.0, turn_rate=3.0 if angle > 0.0 else -3.0)


class Bent(Piece):
    """A piece whose positions are not the integral of its velocities."""

    def at(self, t):
        return super().at(t) + 0.3 * t


def bent(self, position, course, command):
    return Bent(position, Course(command, course.heading))


class Curved(Piece):
    """A piece that circles, and says that it is straight."""

    def at(self, t):
        return self.position + self.course.velocity * (rect(1.0, t) - 1.0) / 1j

    def course_at(self, t):
        turned = rect(1.0, t)
        return Course(self.course.velocity * turned, self.course.heading * turned)


def circles(self, position, course, command):
    return Curved(position, Course(command, course.heading))


def loose(call, **methods):
    """Return a user's body that names no limit."""

    class Mine:
        is_simple: ClassVar[bool] = False
        __call__ = call

        def headings(self, rng, count):
            return [1.0 + 0j] * count

        def steered(self, command, course, aim, radius):
            return command

        def capture_times(self, offsets, courses, speeds, evader_speed, radius):
            return Simple().capture_times(offsets, courses, speeds, evader_speed, radius)

    for name, method in methods.items():
        setattr(Mine, name, method)
    return Mine()


def overwritten(self, offsets, *given):
    times = Simple().capture_times(offsets.copy(), *given)
    offsets[:] = 1.0
    return times


BODIES = {
    "elsewhere": (loose(elsewhere), r"begins at 0.*, expected the position of the call"),
    "too fast": (loose(twice_as_fast), r"the speed is 4 m/s, expected at most 2 m/s: the greater"),
    "no piece": (loose(in_place), r"returns \(.*j\), expected a Piece"),
    "an error": (loose(lambda *_: 1 / 0), r"body\(.*\) raises ZeroDivisionError"),
    "for a second": (loose(for_a_second), r"if the command is given again after 0\.3 s, the position 0\.1 s later is"),
    "never stops": (loose(never_ends), r"goes on at .* m/s for ever, expected to come to rest"),
    "creeps": (loose(creeps), r"expected at most 0 m/s"),
    "coasts when fast": (loose(brakes_when_fast), r"expected to stop at once as from 1 m/s|is given again"),
    "both curves": (loose(both), r"has a turn rate and an acceleration; a curve has one of them"),
    "a flow of its own": (loose(carried), r"has a drift of .*; the flow of the scenario is added"),
    "a negative duration": (loose(backwards), r"curved is -1\.0, expected a duration >= 0 s"),
    "forgets its command": (loose(forgets), r"given again after 0\.3 s|goes on"),
    "an acceleration at once": (
        body(__call__=at_once),
        r"the velocity begins with .*, expected the velocity of the course",
    ),
    "a sharp turn": (
        body(TurnRate, __call__=sharp),
        r"turns by 3 rad/s, expected the heading of the course and at most the limit, 1 rad/s",
    ),
    "bent": (loose(bent), r"the position moves at .* m/s, and velocity_at says"),
    "curved": (loose(circles), r"expected at most its curvature 0 m/s\^2, on which the search for contacts relies"),
    "headings of length 2": (
        loose(at_once, headings=lambda self, rng, count: [2.0] * count),
        r"headings\(rng, 5\) returns \[2\.0",
    ),
    "other headings": (
        loose(at_once, headings=lambda self, rng, count: np.exp(1j * np.random.default_rng().random(count))),
        r"headings\(rng, 5\) returns others for an equal rng",
    ),
    "fast steering": (
        loose(at_once, steered=lambda self, command, *_: 2.0 * command),
        r"steered\(.*, expected a velocity of at most 2 m/s",
    ),
    "steering that raises": (
        loose(at_once, steered=lambda *_: 1 // 0),
        r"steered\(.*\) raises ZeroDivisionError",
    ),
    "no times": (
        loose(at_once, capture_times=lambda *_: None),
        r"capture_times\(.* of 8 pursuers returns None, expected as many times",
    ),
    "too early": (
        loose(
            at_once,
            capture_times=lambda self, offsets, courses, speeds, evader_speed, radius: np.abs(offsets) // speeds,
        ),
        r"of .* m/s at .* m is .* s, expected at least .* s: so long takes a body that is at full speed at once",
    ),
    "too late": (
        loose(at_once, capture_times=lambda self, *given: 1.5 * Simple().capture_times(*given)),
        r"at 5 m is 6\.68\d s, and its motion takes 4\.455 s",
    ),
    "together": (
        loose(at_once, capture_times=lambda self, *given: len(given[0]) * Simple().capture_times(*given)),
        r"among 8, and .* s alone: expected equal times",
    ),
    "late within reach": (
        loose(at_once, capture_times=lambda self, *given: np.maximum(Simple().capture_times(*given), 0.01)),
        r"of a pursuer of 2\.0 m/s at 0\.05 m is 0\.01 s, expected 0 within the capture radius",
    ),
    "overwrites": (
        loose(at_once, capture_times=overwritten),
        r"changes one of its arrays; copy it",
    ),
    "lacks methods": (
        lambda position, course, command: Piece(position, course),
        r"is not a body: should have is_simple, headings",
    ),
}
"""Wrong bodies, and what each is told."""


class Alternating:
    """A strategy whose class remembers which way it went."""

    side = 1

    def __call__(self, state, rng):
        type(self).side = -type(self).side
        return 1j * self.side


class Eavesdropping:
    """A strategy that listens without saying so."""

    def __call__(self, state, rng):
        return 1j if state.handover else 1.0 + 0j


def overwriting(state, rng):
    state.pursuers[:] = 0.0
    return 1j


EVADERS = {
    "a vector": (
        lambda state, rng: np.array([1.0, 0.0]),
        r"returns array\(\[1\., 0\.\]\), expected a heading: a finite complex number",
    ),
    "nothing": (lambda state, rng: None, r"returns None, expected a heading"),
    "truth": (lambda state, rng: True, r"returns True, expected a heading"),
    "a velocity": (
        lambda state, rng: 1.001j,
        r"returns 1\.001j of length 1\.001, expected at most 1: the velocity is the heading times the speed",
    ),
    "nan": (
        lambda state, rng: complex(np.nan, 0.0),
        r"with 0 pursuers .* returns \(nan\+0j\), expected a heading: a finite complex number",
    ),
    "away without pursuers": (
        lambda state, rng: complex(state.offsets[state.nearest]) / 99,
        r"with 0 pursuers in sight .* raises IndexError",
    ),
    "away from its own place": (
        lambda state, rng: (
            0j if state.nearest < 0 else complex(state.offsets[state.nearest]) / state.distances.min().item()
        ),
        r"one at its own position and heading .* raises ZeroDivisionError",
    ),
    "a class that remembers": (Alternating(), r"for an equal state and rng, .*the heading before is state\.heading"),
    "a generator of its own": (lambda state, rng: rect(1.0, np.random.default_rng().random()), "draw from rng only"),
    "random": (lambda state, rng: random.random() and 1j, "draws from the global generator of random"),
    "handover": (Eavesdropping(), r"depends on state\.handover: .* unless the strategy has listens = True"),
    "overwrites": (overwriting, r"with 1 pursuers .* changes state\.pursuers from \[.*\] to \[0\.\+0\.j\]; copy it"),
    "endless": (lambda state, rng: [None for _ in iter(int, 1)], r"does not end"),
    "a class": (
        type("Fast", (PureEvasion,), {"__call__": lambda self, state: 1j}),
        r"Fast is not a strategy of an evader: should accept a call",
    ),
}
"""Wrong strategies, and what each is told."""


@pytest.mark.slow_cases(
    "headings of length 2", "no times", "other headings", "overwrites", "together", "too early", "too late"
)
@pytest.mark.parametrize("name", BODIES)
def test_a_wrong_body_is_told_what_is_wrong_with_it(name):
    model, what = BODIES[name]
    with pytest.raises(ContractError, match=what):
        check_body(model)


def scaled(factor, part=1.0):
    """Return capture times in proportion to the right ones; of several pursuers at once, in proportion to `part`."""
    return lambda self, *given: Simple().capture_times(*given) * (factor if len(given[0]) == 1 else part * factor)


NEARLY = {
    "capture 0.5 % late": ("check_capture_times", loose(at_once, capture_times=scaled(1.005)), True),
    "capture 1.5 % late": ("check_capture_times", loose(at_once, capture_times=scaled(1.015)), False),
    "capture a little early": ("check_capture_times", loose(at_once, capture_times=scaled(1.0 - 5e-7)), True),
    "capture early": ("check_capture_times", loose(at_once, capture_times=scaled(1.0 - 2e-6)), False),
    "a little later together": ("check_capture_times", loose(at_once, capture_times=scaled(1.0, 1.0 + 5e-7)), True),
    "later together": ("check_capture_times", loose(at_once, capture_times=scaled(1.0, 1.0 + 2e-6)), False),
    "a heading a little long": ("check_headings", loose(at_once, headings=lambda *_: [1.0 + 5e-6] * 5), True),
    "a heading too long": ("check_headings", loose(at_once, headings=lambda *_: [1.0 + 5e-5] * 5), False),
    "a little drift": ("check_rest", loose(lambda self, place, *_: Piece(place, Course(5e-7 + 0j, 1.0 + 0j))), True),
    "drift": ("check_rest", loose(lambda self, place, *_: Piece(place, Course(2e-6 + 0j, 1.0 + 0j))), False),
}
"""Methods that are right up to rounding, and those that are just beyond it; each with the part that checks it."""


@pytest.mark.parametrize("name", NEARLY)
def test_a_check_of_a_body_tolerates_errors_of_rounding_and_no_more(name):
    part, model, passes = NEARLY[name]
    checked = _Body(subject(model, DYNAMICS, "body"), model)
    with nullcontext() if passes else pytest.raises(ContractError):
        getattr(checked, part)()


LATE = {
    "headings of length 2": "check_headings",
    "other headings": "check_headings",
    "too early": "check_capture_times",
    "too late": "check_capture_times",
    "no times": "check_capture_times",
    "together": "check_capture_times",
    "late within reach": "check_capture_times",
    "overwrites": "check_capture_times",
}
"""Methods that are checked late, each with the part that checks them."""


@pytest.mark.parametrize("name", LATE)
def test_each_part_of_the_check_of_a_body_tells_what_is_wrong(name):
    model, what = BODIES[name]
    tested = subject(model, DYNAMICS, "body")
    with pytest.raises(ContractError, match=what):
        getattr(_Body(tested, model), LATE[name])()


@pytest.mark.parametrize("part", ["check_rest", "check_headings", "check_capture_times"])
@pytest.mark.parametrize("kind", DYNAMICS.choices())
def test_each_built_in_body_passes_each_part_of_the_check(kind, part):
    tested = subject(kind, DYNAMICS, "body")
    getattr(_Body(tested, tested.model), part)()


def test_a_body_at_rest_stays_there():
    with pytest.raises(ContractError, match=r"moves by 0\.1 m in 1 s: expected to stay at rest"):
        _Body(subject(BODIES["creeps"][0], DYNAMICS, "body"), BODIES["creeps"][0]).check_rest()


def test_the_search_for_contacts_is_compared_with_positions(monkeypatch):
    """A search that finds nothing and one that finds a contact 1 s too early are told, and the built-in one passes."""
    tested = subject("acceleration", DYNAMICS, "body")
    checked = _Body(tested, tested.model)
    calls = list(bodies._calls())[4:7]
    monkeypatch.setattr(bodies, "_calls", lambda: calls)
    checked.check_contacts()
    found = bodies.first_contact_of_pieces
    for wrong in (lambda *given: None, lambda *given: found(*given) - 1.0, lambda *given: found(*given) + 0.1):
        monkeypatch.setattr(bodies, "first_contact_of_pieces", wrong)
        with pytest.raises(ContractError, match=r"come within .* m at .* s, and the search finds"):
            checked.check_contacts()


def test_dynamics_that_say_so_take_a_command_at_once():
    class Slow(Simple):
        def __call__(self, position, course, command):
            return Piece(position, Course(command / 2.0, course.heading))

        is_simple: ClassVar[bool] = True

    with pytest.raises(ContractError, match="is_simple is True, so that no piece is asked for, but"):
        check_body(Slow())


@pytest.mark.slow_cases("endless", "random")
@pytest.mark.parametrize("name", EVADERS)
def test_a_wrong_strategy_is_told_what_is_wrong_with_it(name):
    model, what = EVADERS[name]
    with pytest.raises(ContractError, match=what):
        check_evader(model, limit=0.5 if name == "endless" else 10.0)


@pytest.mark.whole
def test_the_checks_accept_the_right_models_from_which_the_wrong_ones_differ():
    check_body(loose(at_once))
    check_evader(lambda state, rng: 1j)
    check_evader(lambda state, rng: rect(1.0, rng.random()))
