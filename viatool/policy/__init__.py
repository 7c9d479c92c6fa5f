"""The exported actor: ONNX reader, network, specification and the onnxruntime program."""

from __future__ import annotations

from viatool.policy.network import (
    Activation,
    Affine,
    Cast,
    Input,
    Maximum,
    Minimum,
    Network,
    Product,
)
from viatool.policy.policy import Policy, load_policy
from viatool.policy.specification import (
    ActionChannel,
    ActionMap,
    LidarSpecification,
    ObservationChannel,
    PolicySpecification,
    load_specification,
)

__all__ = [
    "ActionChannel",
    "ActionMap",
    "Activation",
    "Affine",
    "Cast",
    "Input",
    "LidarSpecification",
    "Maximum",
    "Minimum",
    "Network",
    "ObservationChannel",
    "Policy",
    "PolicySpecification",
    "Product",
    "load_policy",
    "load_specification",
]
