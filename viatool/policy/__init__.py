"""The exported actor: ONNX reader, network, specification and the onnxruntime program."""

from __future__ import annotations

from viatool.channels import LidarSpecification
from viatool.policy.action_channels import ActionChannel, ActionMap
from viatool.policy.inspection import Inspection, Layer, describe
from viatool.policy.maps import Maps
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
from viatool.policy.policy import Policy, as_policy, load_policy
from viatool.policy.specification import ObservationChannel, PolicySpecification
from viatool.policy.specification_file import load_specification
from viatool.policy.writer import write_onnx

__all__ = [
    "ActionChannel",
    "ActionMap",
    "Activation",
    "Affine",
    "Cast",
    "Input",
    "Inspection",
    "Layer",
    "LidarSpecification",
    "Maps",
    "Maximum",
    "Minimum",
    "Network",
    "ObservationChannel",
    "Policy",
    "PolicySpecification",
    "Product",
    "as_policy",
    "describe",
    "load_policy",
    "load_specification",
    "write_onnx",
]
