"""A rule whose network is an ONNX file, as frameworks export it: an example of a rule from outside.

The network maps the (1, n) numbers of an observation to the (1, M + 1) scores of the actions. The metadata "features"
of the file has the names of its inputs, separated by spaces. The rule needs the package onnxruntime.

Run as a program, this module converts a file of weights of the protocol `policy` into such a file, by means of torch.
"""

from collections.abc import Iterator
from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Literal

import click
import numpy as np
from pydantic import field_validator

from desim.pursuit.team.agent import Agent
from desim.pursuit.team.observation import observation, observation_names
from protocols.policy import Policy
from protocols.rule import Rule


class OnnxRule(Rule):
    """The action of the greatest score, where the network of an ONNX file computes the scores."""

    kind: Literal["onnx"] = "onnx"
    model: str = "policy.onnx"
    """Path of the file."""

    @field_validator("model")
    @classmethod
    def _names_its_inputs(cls, model: str) -> str:
        features_of(session(model), model)
        return model

    def depends_on(self) -> tuple[str, ...]:
        """Return the file, so that its content is part of the identity of a run."""
        return (self.model,)

    def actions(self, me: Agent) -> Iterator[int]:
        """Yield the action of the greatest score, or 0, at each turn.

        Raises:
            ValueError: if the network has inputs that the game has not.
        """
        network = session(self.model)
        names = observation_names(me.team_size, me.evader_count)
        features = features_of(network, self.model)
        if absent := [name for name in features if name not in names]:
            raise ValueError(f"{self.model} has the input {absent[0]!r}, which the game has not")
        columns = list(map(names.index, features))
        (entry,) = network.get_inputs()
        while True:
            numbers = np.array(observation(me), dtype=np.float32)[columns]
            (scores,) = network.run(None, {entry.name: numbers[np.newaxis]})[0].tolist()
            yield max(me.options(), key=scores.__getitem__)


def session(path: str) -> Any:
    """Return the network of a file, which all pursuers share until the file changes.

    Raises:
        ValueError: if onnxruntime is not installed, or cannot read the file.
    """
    if find_spec("onnxruntime") is None:
        raise ValueError("onnxruntime is missing: pip install onnxruntime")
    try:
        status = Path(path).stat()
    except OSError as error:
        raise ValueError(f"{path} cannot be read: {error}") from error
    return _session(path, status.st_mtime_ns, status.st_size)


@lru_cache(maxsize=8)
def _session(path: str, _time: int, _size: int) -> Any:
    """Return the network of a file; by `_time` (of its last change, ns) and `_size` the cache notices a new content."""
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1  # runs are parallel already
    try:
        return onnxruntime.InferenceSession(path, options)
    except Exception as error:  # the errors of onnxruntime have no other class in common
        raise ValueError(f"{path} cannot be read: {error}") from error


def features_of(network: Any, path: str) -> list[str]:
    """Return the names of the inputs of a network; ValueError if its file does not have them."""
    metadata = network.get_modelmeta().custom_metadata_map
    if "features" not in metadata:
        raise ValueError(f'{path} does not name its inputs: its metadata should have "features"')
    return str(metadata["features"]).split()


def torch_network(policy: Policy) -> Any:
    """Return the network of a rule as a module of torch."""
    import torch

    parts: list[Any] = []
    for layer in policy.layers:
        linear = torch.nn.Linear(layer.inputs, len(layer.bias))
        with torch.no_grad():
            linear.weight.copy_(torch.tensor(layer.weights))
            linear.bias.copy_(torch.tensor(layer.bias))
        parts += [linear, torch.nn.Tanh() if policy.activation == "tanh" else torch.nn.ReLU()]
    return torch.nn.Sequential(*parts[:-1])  # no activation after the last layer


@click.command()
@click.argument("weights", type=click.Path(exists=True, path_type=Path))
@click.argument("model", type=click.Path(path_type=Path))
def main(weights: Path, model: Path) -> None:
    """Write the network of a file of WEIGHTS, as `Policy.write` writes it, to the ONNX file MODEL.

    It needs torch, onnx and onnxscript.
    """
    import onnx
    import torch

    policy = Policy(file=str(weights))
    inputs = torch.zeros(1, len(policy.features))
    torch.onnx.export(torch_network(policy), (inputs,), model, input_names=["observation"], external_data=False)
    content = onnx.load(model)
    onnx.helper.set_model_props(content, {"features": " ".join(policy.features)})
    onnx.save(content, model)


if __name__ == "__main__":
    main()
