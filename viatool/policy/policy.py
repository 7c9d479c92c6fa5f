"""An exported policy: the network that is verified, the program that runs, and what its numbers mean."""

from __future__ import annotations

import hashlib
import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from viatool.errors import PolicyError
from viatool.policy.network import Network
from viatool.policy.specification import PolicySpecification, load_specification

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Policy:
    """A loaded policy.

    Parameters
    ----------
    path : Path
        Where it was read from.
    sha256 : str
        Of the file.
    network : Network
        The function that is verified, with the action map of the specification at its end.
    spec : PolicySpecification or None
        None for a foreign model without a sidecar.
    """

    path: Path
    sha256: str
    network: Network
    spec: PolicySpecification | None

    @property
    def input_size(self) -> int:
        """Return the length of the observation vector."""
        return self.network.input_size

    @property
    def output_size(self) -> int:
        """Return the number of actions."""
        return self.network.output_size

    def __call__(self, observations: ArrayLike) -> Floats:
        """Evaluate the network in float64: ``(B, input_size)`` to ``(B, output_size)``."""
        return self.network(np.asarray(observations, dtype=np.float64))

    def run(self, observations: ArrayLike) -> Floats:
        """Run the deployed program (onnxruntime): ``(B, input_size)`` to ``(B, output_size)``."""
        raise NotImplementedError


def load_policy(
    path: str | os.PathLike[str],
    spec: str | os.PathLike[str] | PolicySpecification | None = None,
    *,
    self_check: bool = True,
) -> Policy:
    """Read an ONNX policy.

    Parameters
    ----------
    path : path
        The ONNX file.
    spec : path or PolicySpecification, optional
        A sidecar; it replaces the specification inside the file.
    self_check : bool
        Compare the network with onnxruntime before anything is built on it.

    Raises
    ------
    PolicyError
        If the file cannot be read, is not supported, or contradicts its specification.
    SelfCheckError
        If the network and onnxruntime disagree.
    """
    path = Path(path)
    if isinstance(spec, (str, os.PathLike)):
        spec = load_specification(spec)
    try:
        content = path.read_bytes()
    except OSError as error:
        raise PolicyError(f"cannot read the policy {path}: {error.strerror}") from error
    hashlib.sha256(content).hexdigest()
    raise NotImplementedError
