"""The common parts of all checks of models: the model that is checked, its errors, and runs that should be equal."""

import random
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from itertools import zip_longest
from math import sqrt
from pathlib import Path
from typing import Annotated, Any, NamedTuple, NoReturn

import cloudpickle
import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError, create_model

from desim.analysis.statistics import t_quantile
from desim.config.arguments import with_article
from desim.config.choice import OneOf
from desim.config.errors import WORDINGS, Problem
from desim.config.fresh import fresh_copy
from desim.config.model import Value
from desim.config.shared_state import StateWarning
from desim.config.traits import name_of
from desim.kernel.core.trace_file import line_of
from desim.scenario.scenario import Scenario
from desim.simulation.run import Result
from desim.simulation.watchdog import TimedOut, checked_limit, within
from desim.testing.pursuits import watched

CHANCE = 5.7e-7
"""The probability of a false alarm about a mean or a share: that a normal variable is 5 deviations off."""
DISTANCE = 2.7
"""Scaled Kolmogorov-Smirnov distance of two samples of one distribution: exceeded 1 time in a million by chance."""
SEED = 7
"""Seed of the runs; the check of an unchanged model always gives the same result."""


class ContractError(AssertionError):
    """A model breaks the contract of its kind; the text names the call, the input and what is expected."""


class Subject(NamedTuple):
    """A model that is being checked."""

    model: Any
    name: str

    def fail(self, text: str) -> NoReturn:
        """Raise the error that says what is wrong with the model."""
        raise ContractError(f"{self.name}: {text}")

    def require(self, truth: object, text: str) -> None:
        """Raise the error that says what is wrong with the model, unless a condition is true."""
        if not truth:
            self.fail(text)

    def blame(self, where: str, error: Exception) -> NoReturn:
        """Raise the error that says that a call raised an error, or broke an invariant; a ContractError stays."""
        if isinstance(error, ContractError):
            raise error
        if isinstance(error, StateWarning):
            raise ContractError(f"{self.name}: {where} cannot be repeated: {error}") from error
        notes = " ".join(["", *getattr(error, "__notes__", ())])
        complaint = "breaks an invariant" if isinstance(error, AssertionError) else f"raises {type(error).__name__}"
        raise ContractError(f"{self.name}: {where} {complaint}: {error}{notes}") from error

    @contextmanager
    def blaming(self, where: str) -> Iterator[None]:
        """Turn every error of a call of the model into one about the model."""
        try:
            yield
        except Exception as error:
            self.blame(where, error)

    @contextmanager
    def fresh(self) -> Iterator[Any]:
        """Yield the model as a run has it: with the state that it had before the check."""
        with fresh_copy(self.model) as model:
            yield model

    @contextmanager
    def judged(self, where: str, limit: float = 10.0) -> Iterator[None]:
        """Turn every error of a block into one about the model; it may not change the global random generators.

        Args:
            where: the call or the situation of the block.
            limit: the time that the block may take, s of wall time.
        """
        limit = checked_limit(limit)
        before = random.getstate(), _state_of_numpy()
        try:
            with warnings.catch_warnings(), within(limit):
                warnings.simplefilter("error", StateWarning)
                yield
        except TimedOut as error:
            raise ContractError(f"{self.name}: {where} does not end, or no simulated time passes: {error}") from error
        except Exception as error:
            self.blame(where, error)
        after = random.getstate(), _state_of_numpy()
        for module, first, second in zip(("random", "numpy.random"), before, after, strict=True):
            self.require(
                first == second, f"{where} draws from the global generator of {module}; draw from the one given"
            )


def _state_of_numpy() -> tuple[Any, ...]:
    state: Any = np.random.get_state()  # noqa: NPY002 - to see whether somebody else uses it
    return state[0], state[1].tobytes(), *state[2:]


def subject(model: Any, family: OneOf, noun: str) -> Subject:
    """Return the model that a user gives to a check, and its name.

    Args:
        model: an object, a class that needs no parameters, a table with a `kind`, a kind, or "module:name".
        family: the kinds of the family.
        noun: the noun of the family, for error messages.

    Raises:
        ContractError: if a scenario would refuse the model, or the model cannot be sent to another process.
    """
    name = model if isinstance(model, str) else model.__name__ if isinstance(model, type) else name_of(model)
    holder: Any = create_model("Given", __base__=Value, model=(Annotated[Any, family], ...))
    instance: Any = model  # for the messages if a class cannot be called
    try:
        instance = model() if isinstance(model, type) else model
        context = {"allow_import": True, "folder": Path.cwd()}
        checked: Any = holder.model_validate({"model": instance}, context=context)
        instance = checked.model
    except ValidationError as error:
        texts = (_problem(problem) for problem in WORDINGS["call"](error, holder, {"model": instance}))
        raise ContractError(f"{name} is not {with_article(noun)}: {'; '.join(texts)}") from error
    except TypeError as error:
        raise ContractError(f"{name} needs parameters, so give an object: {error}") from error
    try:
        cloudpickle.loads(cloudpickle.dumps(instance))
    except Exception as error:  # code of an object may raise anything
        raise ContractError(f"{name} cannot be pickled, which the workers of a sweep need: {error}") from error
    return Subject(instance, name)


def _problem(problem: Problem) -> str:
    """Return the text of a problem, without the key of the model itself."""
    key = problem.key.partition(".")[2]
    return f"{key}: {problem.reason}" if key not in {"", "kind"} else problem.reason


def twice(
    tested: Subject, where: str, scenario: Callable[[], Scenario], *, limit: float = 10.0, watchers: Sequence[Any] = ()
) -> Result:
    """Run a scenario twice with all invariants watched; return the second result.

    Args:
        tested: the model that the scenario contains.
        where: what the scenario is, for error messages.
        scenario: returns the scenario.
        limit: the time that each run may take, s of wall time.
        watchers: functions without arguments that each create a watcher of one run.

    Raises:
        ContractError: if a run raises an error, breaks an invariant or does not end, or if the second run differs.
    """
    results = []
    for _ in range(2):
        with tested.judged(where, limit):
            results.append(watched(scenario(), SEED, *(create() for create in watchers)))
    require_equal(
        tested,
        f"{where}: two runs of one scenario and seed differ",
        results,
        "every draw should be from the generator that it is given, and nothing from the clock of the computer, the"
        " order of a set, a global variable or a class",
    )
    return results[1]


def require_equal(tested: Subject, complaint: str, results: Sequence[Result], expected: str) -> None:
    """Require that two runs have one trace.

    Args:
        tested: the model that the runs contain.
        complaint: the sentence that is true if they differ.
        results: the two results.
        expected: what a model that is right does.
    """
    traces = (map(line_of, result.trace) for result in results)
    for first, second in zip_longest(*traces, fillvalue="the end of the trace"):
        if first != second:
            tested.fail(f"{complaint}, first {first.strip()} and then {second.strip()}: {expected}")


def are_apart(first: NDArray[Any], second: NDArray[Any]) -> bool:
    """Return whether two samples, (n,) and (m,), are of different distributions (Kolmogorov and Smirnov)."""
    values = np.sort(np.concatenate((first, second)))
    shares = [np.searchsorted(np.sort(sample), values, "right") / len(sample) for sample in (first, second)]
    # Equal values that are computed in two ways differ by rounding, which is no difference of distributions.
    if len(first) == len(second) and np.allclose(np.sort(first), np.sort(second)):
        return False
    scale = sqrt(len(first) * len(second) / (len(first) + len(second)))
    return bool(np.abs(shares[0] - shares[1]).max() * scale > DISTANCE)


def is_off(sample: NDArray[Any], mean: float, tolerance: float) -> bool:
    """Return whether the mean of a sample is off a value by more than 5 standard errors and a tolerance.

    For few draws, more standard errors are allowed, by Student's distribution.
    """
    standard_error = float(sample.std(ddof=1)) / sqrt(len(sample))
    most_errors = t_quantile(len(sample) - 1, 1.0 - CHANCE)
    return not abs(float(sample.mean()) - mean) <= most_errors * standard_error + tolerance


def are_more(first: NDArray[np.bool_], second: NDArray[np.bool_]) -> bool:
    """Return whether one of two samples of (n,) truth values, paired by index, is true more often than the other.

    The pairs are independent of each other. This is the exact test of McNemar 1947: without a difference, the first
    sample is true in half of the unequal pairs.
    """
    from scipy.special import bdtr

    differing = int((first != second).sum())
    fewer = min(int((first & ~second).sum()), int((second & ~first).sum()))
    return differing > 0 and 2.0 * float(bdtr(fewer, differing, 0.5)) < CHANCE
