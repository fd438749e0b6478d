"""A learned rule: a linear function or a small neural network of the observation of a pursuer, from a file of weights.

Paper: none. The network is a multilayer perceptron; a linear rule is one without hidden layers.
Parameters: schedule, and the file of weights, or the names of the features and the layers.
Assumes: nothing beyond the game in which the weights were learned.
Messages: announcements, see `announce` in the scenario.
Robust to loss: as far as the weights were learned with losses; the ages of the newest announcements are among the
    features.
"""

import json
from collections.abc import Callable, Iterator, Sequence
from functools import cache, cached_property, partial
from math import tanh
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple, Self

import numpy as np
from pydantic import Field, ValidationInfo, model_validator

from desim.config.errors import KeyedError, Problem
from desim.config.model import FirstError, Value
from desim.config.number_files import text_of_file
from desim.config.number_texts import counted
from desim.config.suggestion import did_you_mean
from desim.config.tables import object_once
from desim.config.trust import resolve_path
from desim.config.whole_files import write_whole
from desim.pursuit.team.agent import Agent
from desim.pursuit.team.observation import (
    OfEvader,
    OfPursuer,
    Own,
    evader_block,
    observation_names,
    own_block,
    pursuer_blocks,
)
from protocols.rule import Rule

MAX_WEIGHT = 1e12
"""Largest absolute value of a weight."""
Weight = Annotated[float, Field(ge=-MAX_WEIGHT, le=MAX_WEIGHT, allow_inf_nan=False, strict=True)]
RELATIVE = "evader"
"""The block of the evader whose chase is scored, in the names of features."""
CONTENT = ("features", "layers", "activation")
"""The keys of a file of weights."""
FORMS = "own.FIELD, evader.FIELD, evader_1.FIELD and pursuer_0.FIELD"
"""The forms of the names of features."""


class Layer(Value):
    """A layer of a network: its outputs are weights x + bias, before the activation."""

    weights: Annotated[tuple[Annotated[tuple[Weight, ...], FirstError()], ...], FirstError()]
    """(K, n) weights of the n inputs, a row for each of K outputs."""
    bias: Annotated[tuple[Weight, ...], FirstError()]
    """(K,) constants."""

    @model_validator(mode="after")
    def _has_a_shape(self) -> Self:
        if not self.weights or not self.weights[0]:
            raise ValueError("weights should have at least one row, and a row at least one number")
        for k, row in enumerate(self.weights):
            if len(row) != self.inputs:
                raise ValueError(f"weights should be a matrix: row {k} has {len(row)} numbers, row 0 has {self.inputs}")
        if len(self.bias) != len(self.weights):
            raise ValueError(
                f"bias should have a number for each of {counted(len(self.weights), 'row')}, has {len(self.bias)}"
            )
        return self

    @property
    def inputs(self) -> int:
        """Number of inputs, n."""
        return len(self.weights[0])


SHARP = 1e9
"""A weight so large that even a tiny lead or delay outweighs the constant 1."""
FIRST_AND_IN_TIME = (
    Layer(weights=((SHARP, 0.0), (0.0, SHARP)), bias=(0.0, 0.0)),
    Layer(weights=((-1.0, -1.0),), bias=(1.0,)),
)
"""The score 1 - SHARP max(lead, 0) - SHARP max(late, 0): positive for a pursuer that is first, and in time."""


class Policy(Rule):
    """The action of the greatest score, where a network computes the scores from an observation.

    A network with one output gives the score of chasing an evader, for each evader that the pursuer may chase; the
    score of inactivity is 0. The block "evader" in the names of its features stands for the evader in question. A
    network with M + 1 outputs gives the scores of all actions, 0 .. M. Ties go to the lowest action.

    The default weights give the rule of `local_min` where all hear each other: a pursuer chases if it would be in time,
    and no teammate that is known to chase would be earlier.
    """

    kind: Literal["policy"] = "policy"
    file: str | None = None
    """Path of a JSON file with `features`, `layers` and perhaps `activation`, relative to the scenario file. It is
    read once, when the scenario is created."""
    features: Annotated[tuple[str, ...], FirstError()] = ("evader.lead", "evader.late")
    """The names of the n inputs, as in "evader.lead", "own.time_left" or "pursuer_3.age"; see
    `desim.pursuit.team.observation`.

    They are in the file, if there is one."""
    layers: tuple[Layer, ...] = FIRST_AND_IN_TIME
    """The layers, from the input to the output; a linear rule has one.

    They are in the file, if there is one."""
    activation: Literal["tanh", "relu"] = "relu"
    """The function that is applied to the outputs of all layers but the last."""

    @model_validator(mode="before")
    @classmethod
    def _read(cls, fields: Any, info: ValidationInfo) -> Any:
        if not isinstance(fields, dict) or fields.get("file") is None:
            return fields
        written_out = [name for name in CONTENT if name in fields]
        if written_out:
            raise ValueError(f"should have a file or {written_out[0]}, not both")
        try:
            content = _content(resolve_path(fields["file"], info))
        except ValueError as error:
            raise KeyedError(Problem(str(error), "file")) from error
        return fields | {"file": None} | content

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        if not self.layers or not self.features or len({"features", "layers"} & self.model_fields_set) == 1:
            raise ValueError("should have features and layers, both of them or in a file")
        sizes = len(self.features), *(len(layer.bias) for layer in self.layers)
        for k, layer in enumerate(self.layers):
            if layer.inputs != sizes[k]:
                before = "features" if k == 0 else f"outputs of layer {k - 1}"
                raise ValueError(f"layer {k} has {layer.inputs} inputs, but there are {sizes[k]} {before}")
        for name in self.features:
            _check_name(name, several=self.outputs > 1)
        return self

    @property
    def outputs(self) -> int:
        """Number of outputs of the network: 1, or M + 1."""
        return len(self.layers[-1].bias)

    def check_game(self, pursuers: int, evaders: int) -> None:
        """Raise KeyedError if a game lacks one of the features, or the number of scores is neither 1 nor M + 1."""
        names = observation_names(pursuers, evaders)
        absent = [name for name in self.features if not name.startswith(f"{RELATIVE}.") and name not in names]
        if absent:
            problem = f"there is no {absent[0]!r} in this game (pursuers: {pursuers}, evaders: {evaders})"
            raise KeyedError(Problem(problem, "features"))
        if self.outputs not in {1, evaders + 1}:
            expected = f"1 output, or {evaders + 1}, one for each action"
            raise KeyedError(Problem(f"the last layer should have {expected} (it has {self.outputs})", "layers"))

    def given(self) -> dict[str, Any]:
        """Return the fields that differ from their defaults, see `Value.given`; of the layers only their sizes."""
        sizes = " x ".join(str(size) for size in (len(self.features), *(len(layer.bias) for layer in self.layers)))
        return super().given() | {"layers": sizes}

    def write(self, path: str | Path) -> Path:
        """Write the weights to a JSON file, for `file`, and return its path.

        Raises:
            OSError: if the file cannot be written.
        """
        content = {name: self.model_dump(mode="json")[name] for name in CONTENT}
        write_whole(Path(path), (json.dumps(content, indent=1) + "\n").encode())
        return Path(path)

    def actions(self, me: Agent) -> Iterator[int]:
        """Yield the action of the greatest score, or 0, at each turn."""
        scores_of = network(self.layers, self.activation)
        inputs = [_reader(name) for name in self.features]
        while True:
            options = me.options()
            scores = [0.0] * len(options)
            blocks = _Blocks(me)
            if self.outputs > 1:
                values = scores_of([read(blocks, 0) for read in inputs])  # 0: no name has an evader in question
                scores = [values[action] for action in options]
            else:
                for k, evader in enumerate(options[1:], start=1):
                    (scores[k],) = scores_of([read(blocks, evader) for read in inputs])
            yield options[scores.index(max(scores))]


def network(layers: Sequence[Layer], activation: Literal["tanh", "relu"]) -> Callable[[Sequence[float]], list[float]]:
    """Return the function that computes the outputs of a network from its inputs."""
    matrices = [(np.array(layer.weights), np.array(layer.bias)) for layer in layers]
    squash: Callable[[float], float] = tanh if activation == "tanh" else lambda value: max(value, 0.0)

    def outputs(inputs: Sequence[float]) -> list[float]:
        values = np.array(inputs, dtype=float)
        for k, (weights, bias) in enumerate(matrices):
            if k:
                values = np.array([squash(value) for value in values.tolist()])
            # Not `weights @ values`: the last digits of BLAS depend on the processor.
            values = (weights * values).sum(axis=1) + bias
        numbers: list[float] = values.tolist()
        return numbers

    return outputs


class _Blocks:
    """The blocks of the observation of a pursuer at one turn, each computed at its first use."""

    def __init__(self, me: Agent):
        self._me = me
        self.evader = cache(partial(evader_block, me))
        """Returns the block of an evader."""

    @cached_property
    def own(self) -> Own:
        """The block of the pursuer itself."""
        return own_block(self._me)

    @cached_property
    def pursuers(self) -> list[OfPursuer]:
        """The blocks of all pursuers."""
        return pursuer_blocks(self._me)


class _Feature(NamedTuple):
    """The parts of the name of a feature."""

    block: str
    """own, evader or pursuer."""
    number: int | None
    """The number of the evader or pursuer; None for `own` and for the evader whose chase is scored."""
    field: str


_FIELDS = {"own": Own._fields, "evader": OfEvader._fields, "pursuer": OfPursuer._fields}
_MAY_HAVE_NUMBER = {"own": (False,), "evader": (False, True), "pursuer": (True,)}
"""For each block, whether names may be without a number and with one."""


def _parts(name: str) -> _Feature:
    """Return the parts of the name of a feature."""
    block, _, field = name.partition(".")
    kind, _, number = block.partition("_")
    return _Feature(kind, int(number) if number.isdecimal() and number.isascii() else None, field)


def _check_name(name: str, *, several: bool) -> None:
    """Raise ValueError if no game has a feature with this name.

    Args:
        name: the name.
        several: whether the network gives the scores of all actions, so that there is no evader in question.
    """
    feature = _parts(name)
    has_number = feature.number is not None
    block = f"{feature.block}_{feature.number}" if has_number else feature.block
    # The name is put together again, because `_parts` drops a text that is no number, and leading zeros.
    if has_number not in _MAY_HAVE_NUMBER.get(feature.block, ()) or f"{block}.{feature.field}" != name:
        raise ValueError(f"there is no feature {name!r}: names are {FORMS}")
    fields = _FIELDS[feature.block]
    if feature.field not in fields:
        hint = did_you_mean(feature.field, fields) or f": its fields are {', '.join(fields)}"
        raise ValueError(f"there is no feature {name!r}{hint}")
    if several and feature.block == RELATIVE and not has_number:
        raise ValueError(f"{name!r} has no number, but the network gives the scores of all actions: write evader_1")


def _reader(name: str) -> Callable[[_Blocks, int], float]:
    """Return the function that reads a feature, given the blocks and the evader whose chase is scored.

    The block of that evader has no number in its name.
    """
    block, number, field = _parts(name)
    index = _FIELDS[block].index(field)
    if block == "own":
        return lambda blocks, _: blocks.own[index]
    if block == "pursuer":
        return lambda blocks, _: blocks.pursuers[number or 0][index]
    return lambda blocks, evader: blocks.evader(number or evader)[index]


def _content(path: Path) -> dict[str, Any]:
    """Return the content of a file of weights.

    Raises:
        ValueError: if the file cannot be read, is not JSON, or has no valid weights; the text begins with the file.
    """
    try:
        content = json.loads(text_of_file(path), parse_constant=_refuse_constant, object_pairs_hook=object_once)
    except (ValueError, RecursionError) as error:
        reason = str(error)  # that of `text_of_file` begins with the file already
        raise ValueError(reason if reason.startswith(str(path)) else f"{path} is not JSON: {reason}") from error
    if not isinstance(content, dict):
        raise ValueError(f"{path} should have an object with the keys {', '.join(CONTENT)}")
    if unknown := [key for key in content if key not in CONTENT]:
        raise ValueError(f"{path} has an unknown key {unknown[0]!r}{did_you_mean(unknown[0], CONTENT)}")
    if missing := [key for key in ("features", "layers") if key not in content]:
        raise ValueError(f"{path} has no {missing[0]}")
    try:
        policy = Policy(**content)
    except KeyedError as error:
        raise ValueError(f"{path}: {error.problems[0]._replace(where='')}") from error
    return {name: getattr(policy, name) for name in CONTENT}


def _refuse_constant(name: str) -> float:
    raise ValueError(f"{name} is no weight")
