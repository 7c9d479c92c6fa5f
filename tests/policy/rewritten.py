"""Models that onnxruntime rewrites at its default level into ones that compute something else."""

from __future__ import annotations

import numpy as np
import onnx

from tests.policy.models import model_of, node, weights


def gelu(x: str, y: str) -> list[onnx.NodeProto]:
    """Gelu as exporters write it, with the constants `root`, `one` and `half`."""
    return [
        node("Div", [x, "root"], [f"{y}_d"]),
        node("Erf", [f"{y}_d"], [f"{y}_e"]),
        node("Add", [f"{y}_e", "one"], [f"{y}_a"]),
        node("Mul", [x, f"{y}_a"], [f"{y}_m"]),
        node("Mul", [f"{y}_m", "half"], [y]),
    ]


def gelu_constants(half: float, root: float = 2.0**0.5) -> dict[str, np.float32]:
    return {"root": np.float32(root), "one": np.float32(1), "half": np.float32(half)}


def odd_gelu(half: float = 0.500004) -> onnx.ModelProto:
    """Gelu with a constant that is only near 0.5."""
    return model_of(gelu("x", "y"), gelu_constants(half), shape=(1, 1))


def normalisation(x: str, y: str, opset: int = 17) -> list[onnx.NodeProto]:
    """The pattern of a layer normalisation."""
    axes = {"axes": [-1]} if opset < 18 else {}
    return [
        node("ReduceMean", [x], [f"{y}_mean"], **axes),
        node("Sub", [x, f"{y}_mean"], [f"{y}_deviation"]),
        node("Pow", [f"{y}_deviation", "exponent"], [f"{y}_power"]),
        node("ReduceMean", [f"{y}_power"], [f"{y}_variance"], **axes),
        node("Add", [f"{y}_variance", "epsilon"], [f"{y}_positive"]),
        node("Sqrt", [f"{y}_positive"], [f"{y}_spread"]),
        node("Div", [f"{y}_deviation", f"{y}_spread"], [f"{y}_normal"]),
        node("Mul", [f"{y}_normal", "scale"], [f"{y}_scaled"]),
        node("Add", [f"{y}_scaled", "shift"], [y]),
    ]


def normalisation_constants(exponent: float) -> dict[str, np.ndarray]:
    return {
        "exponent": np.array(exponent, dtype=np.float32),
        "epsilon": np.array(1e-5, dtype=np.float32),
        "scale": weights(5, 4),
        "shift": weights(6, 4),
    }


def layer_norm(exponent: float, *, opset: int = 17) -> onnx.ModelProto:
    """The pattern of a layer normalisation, with a power in place of the square."""
    return model_of(normalisation("x", "y", opset), normalisation_constants(exponent), opset=opset)


def halves() -> onnx.ModelProto:
    """A factor that is a product of two float16 numbers, which onnxruntime folds in float32."""
    nodes = [
        node("Mul", ["a", "b"], ["c"]),
        node("Cast", ["c"], ["d"], to=onnx.TensorProto.FLOAT),
        node("Mul", ["x", "d"], ["y"]),
    ]
    return model_of(nodes, {name: weights(seed, 4).astype(np.float16) for seed, name in enumerate("ab")})


def integer_product() -> onnx.ModelProto:
    """Weights of 8 bits: onnxruntime rounds the observation to 8 bits as well."""
    nodes = [node("DequantizeLinear", ["w", "s"], ["d"]), node("MatMul", ["x", "d"], ["y"], name="product")]
    whole = np.arange(-6, 6, dtype=np.int8).reshape(4, 3)
    return model_of(nodes, {"w": whole, "s": np.float32(0.1)}, opset=19)


def shared_normalisation() -> onnx.ModelProto:
    """Two powers in place of squares; what another output takes from the first keeps that one from being joined."""
    nodes = [
        node("Tanh", ["x"], ["t"]),
        *normalisation("x", "g"),
        *normalisation("t", "h"),
        node("Sub", ["g", "h"], ["y"]),
        node("Neg", ["g_variance"], ["other"]),
    ]
    return model_of(nodes, normalisation_constants(4.0), outputs=("y", "other"))
