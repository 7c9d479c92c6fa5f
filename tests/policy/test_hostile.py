"""Hostile and broken files end in one clear error, soon and in little memory."""

from __future__ import annotations

import os
import resource
import time
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper

from tests.policy.models import model_of, node, save, two_layers, weights
from viatool.errors import PolicyError
from viatool.policy import load_policy

BIG = np.int64(2**40)


@pytest.fixture(autouse=True)
def bounded() -> Iterator[None]:
    """Every refusal comes within seconds and without allocating what the file asks for."""
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    start = time.process_time()
    yield
    assert time.process_time() - start < 10
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 600_000  # kB


def refused(path: Path, meaning: str) -> None:
    with pytest.raises(PolicyError, match=meaning) as refusal:
        load_policy(path)
    assert refusal.value.hint


def test_no_file(tmp_path: Path) -> None:
    refused(tmp_path / "none.onnx", "No such file")
    refused(tmp_path, "is not a file")
    refused(Path("/dev/zero"), "is not a file")


def test_a_pipe_is_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.onnx")
    refused(tmp_path / "pipe.onnx", "is not a file")


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"hello, I am a text file\n",
        b"\x00" * 100,
        b"\xff" * 100,
        b"\x08\x07",
        b"PK\x03\x04 a zip archive",
    ],
)
def test_no_model(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "policy.onnx"
    path.write_bytes(content)
    refused(path, "not an ONNX model")


def test_every_truncation_of_a_model(tmp_path: Path) -> None:
    content = two_layers().SerializeToString()
    path = tmp_path / "policy.onnx"
    for length in range(0, len(content), 7):
        path.write_bytes(content[:length])
        with pytest.raises(PolicyError):
            load_policy(path)


def test_a_cycle(tmp_path: Path) -> None:
    nodes = [node("Add", ["x", "b"], ["a"]), node("Relu", ["a"], ["b"]), node("Relu", ["b"], ["y"])]
    refused(save(model_of(nodes), tmp_path), "own output")


def test_a_deep_graph_is_no_recursion(tmp_path: Path) -> None:
    names = ["x", *(f"v{i}" for i in range(5000)), "y"]
    nodes = [node("Relu", [a], [b]) for a, b in pairwise(names)]
    assert load_policy(save(model_of(nodes[::-1]), tmp_path), self_check=False).output_size == 4


def test_names_given_twice(tmp_path: Path) -> None:
    twice = model_of([node("Relu", ["x"], ["y"]), node("Tanh", ["x"], ["y"])])
    refused(save(twice, tmp_path), "exists already")
    shadow = model_of([node("Relu", ["x"], ["x"]), node("Tanh", ["x"], ["y"])])
    refused(save(shadow, tmp_path), "exists already")
    model = two_layers()
    model.graph.initializer.append(model.graph.initializer[0])
    refused(save(model, tmp_path), "same name")


def test_a_missing_value(tmp_path: Path) -> None:
    refused(
        save(model_of([node("Add", ["x", "nowhere"], ["y"])]), tmp_path), "nothing makes the value 'nowhere'"
    )


@pytest.mark.parametrize("number", [np.nan, np.inf, -np.inf])
def test_weights_that_are_no_numbers(number: float, tmp_path: Path) -> None:
    weight = weights(1, 4, 2)
    weight[3, 1] = number
    refused(save(model_of([node("MatMul", ["x", "w"], ["y"])], {"w": weight}), tmp_path), "NaN or infinite")


def test_terabyte_initialisers(tmp_path: Path) -> None:
    tensor = TensorProto(name="w", data_type=TensorProto.FLOAT, dims=[2**20, 2**20])
    refused(
        save(model_of([node("MatMul", ["x", "w"], ["y"])], {"w": tensor}), tmp_path), "larger than any policy"
    )
    tensor = TensorProto(name="w", data_type=TensorProto.FLOAT, dims=[1000, 1000])
    refused(
        save(model_of([node("MatMul", ["x", "w"], ["y"])], {"w": tensor}), tmp_path), "needs 1000000 numbers"
    )
    tensor = TensorProto(name="w", data_type=TensorProto.FLOAT, dims=[-4, -2], raw_data=b"\0" * 32)
    refused(save(model_of([node("MatMul", ["x", "w"], ["y"])], {"w": tensor}), tmp_path), "impossible shape")


@pytest.mark.parametrize(
    ("nodes", "constants"),
    [
        ([node("ConstantOfShape", ["s"], ["c"])], {"s": np.array([BIG])}),
        ([node("Expand", ["one", "s"], ["c"])], {"s": np.array([BIG]), "one": np.float32(1)}),
        ([node("Tile", ["ones", "s"], ["c"])], {"s": np.array([BIG]), "ones": np.ones(1, np.float32)}),
        ([node("Range", ["zero", "n", "step"], ["c"])], {"zero": np.int64(0), "n": BIG, "step": np.int64(1)}),
        ([node("Range", ["zero", "n", "zero"], ["c"])], {"zero": np.float32(0), "n": np.float32(1)}),
        ([node("Pad", ["ones", "s"], ["c"])], {"s": np.array([BIG, 0]), "ones": np.ones(1, np.float32)}),
        (
            [node("OneHot", ["i", "n", "v"], ["c"])],
            {"i": np.array([1]), "n": BIG, "v": np.array([0.0, 1.0], np.float32)},
        ),
        (
            [node("MatMul", ["u", "v"], ["c"])],
            {"u": np.ones((50_000, 1), np.float32), "v": np.ones((1, 50_000), np.float32)},
        ),
        ([node("Expand", ["x", "s"], ["c"])], {"s": np.array([BIG, 1])}),
        ([node("Tile", ["x", "s"], ["c"])], {"s": np.array([BIG, 1])}),
        ([node("Pad", ["x", "s"], ["c"])], {"s": np.array([0, BIG, 0, 0])}),
        ([node("Add", ["x", "wide"], ["c"])], {"wide": np.ones((2**13, 2**11, 1), np.float32)}),
    ],
)  # fmt: skip
def test_operators_that_would_fill_the_memory(
    nodes: list[onnx.NodeProto], constants: dict[str, np.ndarray], tmp_path: Path
) -> None:
    tail = [] if nodes[-1].input[0] == "x" else [node("Add", ["x", "c"], ["sum"])]
    result = "sum" if tail else "c"
    model = model_of([*nodes, *tail, node("Relu", [result], ["y"])], constants)
    with pytest.raises(PolicyError):
        load_policy(save(model, tmp_path))


def test_absurd_convolutions(tmp_path: Path) -> None:
    for attributes in (
        {"pads": [2**40, 0]},
        {"dilations": [2**40]},
        {"strides": [0]},
        {"group": 0},
        {"group": -1},
    ):
        model = model_of(
            [node("Conv", ["x", "w"], ["y"], **attributes)], {"w": weights(1, 1, 1, 3)}, shape=(1, 1, 9)
        )
        with pytest.raises(PolicyError):
            load_policy(save(model, tmp_path))


def test_strings_and_other_types(tmp_path: Path) -> None:
    text = helper.make_tensor("w", TensorProto.STRING, [1], [b"hello"])
    refused(save(model_of([node("Add", ["x", "w"], ["y"])], {"w": text}), tmp_path), "STRING")
    small = TensorProto(name="w", data_type=TensorProto.FLOAT8E4M3FN, dims=[1], raw_data=b"\0")
    refused(save(model_of([node("Add", ["x", "w"], ["y"])], {"w": small}), tmp_path), "FLOAT8E4M3FN")
    odd = TensorProto(name="w", data_type=1234, dims=[1], raw_data=b"\0")
    refused(save(model_of([node("Add", ["x", "w"], ["y"])], {"w": odd}), tmp_path), "1234")
    refused(save(model_of([node("Relu", ["x"], ["y"])], dtype=TensorProto.INT64), tmp_path), "int64")
    refused(
        save(model_of([node("Relu", ["x"], ["y"])], dtype=TensorProto.STRING), tmp_path), "floating-point"
    )


def test_unknown_opsets(tmp_path: Path) -> None:
    for opset in (0, 5, 1000, -1):
        model = two_layers()
        model.opset_import[0].version = opset
        refused(save(model, tmp_path), f"opset {opset}")
    model = two_layers()
    model.opset_import[0].domain = "com.example"
    refused(save(model, tmp_path), "opset")


def test_attributes_of_the_wrong_kind(tmp_path: Path) -> None:
    calls = [
        node("LeakyRelu", ["x"], ["y"], alpha=1),
        node("LeakyRelu", ["x"], ["y"], alpha="steep"),
        node("LeakyRelu", ["x"], ["y"], alpha=float("nan")),
        node("Flatten", ["x"], ["y"], axis=2.5),
        node("Flatten", ["x"], ["y"], axis=99),
        node("Relu", ["x"], ["y"], surprise=1),
        node("Celu", ["x"], ["y"], alpha=0.0),
        node("Split", ["x"], ["y"], num_outputs=0),
        node("Transpose", ["x"], ["y"], perm=[0, 0]),
        node("Softmax", ["x"], ["y"], axis=7),
    ]
    for call in calls:
        with pytest.raises(PolicyError):
            load_policy(save(model_of([call], opset=18), tmp_path))


# --- external data -----------------------------------------------------------------------------------------


def with_external_weights(folder: Path, location: str, **entries: str) -> Path:
    tensor = TensorProto(
        name="w", data_type=TensorProto.FLOAT, dims=[4, 2], data_location=TensorProto.EXTERNAL
    )
    for key, value in {"location": location, **entries}.items():
        tensor.external_data.add(key=key, value=value)
    return save(model_of([node("MatMul", ["x", "w"], ["y"])], {"w": tensor}), folder)


def test_weights_in_a_file_beside_the_model(tmp_path: Path) -> None:
    stored = weights(1, 4, 2)
    (tmp_path / "data").mkdir()
    (tmp_path / "data" / "weights.bin").write_bytes(b"12345678" + stored.tobytes() + b"rest")
    policy = load_policy(with_external_weights(tmp_path, "data/weights.bin", offset="8", length="32"))
    np.testing.assert_array_equal(policy(np.eye(4)), stored.astype(np.float64))
    np.testing.assert_array_equal(policy.run(np.eye(4)), stored)


@pytest.mark.parametrize(
    "location",
    [
        "",
        "/etc/hostname",
        "../secret.bin",
        "a/../../secret.bin",
        "..\\secret.bin",
        "C:\\secret.bin",
        "C:secret.bin",
        "a\0b",
    ],
)
def test_nothing_outside_the_folder_is_read(location: str, tmp_path: Path) -> None:
    (tmp_path / "secret.bin").write_bytes(b"\0" * 32)
    (tmp_path / "inside").mkdir()
    refused(with_external_weights(tmp_path / "inside", location), "outside the model's folder")


def test_links_are_not_followed(tmp_path: Path) -> None:
    (tmp_path / "secret.bin").write_bytes(b"\0" * 32)
    inside = tmp_path / "inside"
    inside.mkdir()
    (inside / "link.bin").symlink_to(tmp_path / "secret.bin")
    (inside / "folder").symlink_to(tmp_path)
    refused(with_external_weights(inside, "link.bin"), "is a link")
    refused(with_external_weights(inside, "folder/secret.bin"), "is a link")


def test_broken_external_data(tmp_path: Path) -> None:
    (tmp_path / "w.bin").write_bytes(b"\0" * 31)
    os.mkfifo(tmp_path / "pipe.bin")
    refused(with_external_weights(tmp_path, "missing.bin"), "beside the model")
    refused(with_external_weights(tmp_path, "w.bin"), "ends before")
    refused(with_external_weights(tmp_path, "w.bin", offset="-8"), "from -8")
    refused(with_external_weights(tmp_path, "w.bin", offset="many"), "broken offset")
    refused(with_external_weights(tmp_path, "w.bin", offset=str(2**80)), "w.bin")
    refused(with_external_weights(tmp_path, "w.bin", length=str(2**40)), "needs 32 bytes")
    refused(with_external_weights(tmp_path, "pipe.bin"), "is not a file")
    refused(with_external_weights(tmp_path, "."), "is not a file")


def test_an_external_constant_inside_a_node_is_refused(tmp_path: Path) -> None:
    tensor = TensorProto(
        name="w", data_type=TensorProto.FLOAT, dims=[4, 2], data_location=TensorProto.EXTERNAL
    )
    tensor.external_data.add(key="location", value="w.bin")
    nodes = [node("Constant", [], ["w"], value=tensor), node("MatMul", ["x", "w"], ["y"])]
    refused(save(model_of(nodes), tmp_path), "outside")


def test_absurd_names_and_ranks_do_not_flood_the_message(tmp_path: Path) -> None:
    long = "n" * 100_000
    for model in (
        model_of([node("Sin", ["x"], ["y"], name=long)]),
        model_of([node(long, ["x"], ["y"])]),
        model_of([node("Add", ["x", long], ["y"])]),
        model_of(
            [node("Add", ["x", "w"], ["y"])],
            {"w": TensorProto(name="w", data_type=TensorProto.FLOAT, dims=[1] * 100_000)},
        ),
    ):
        with pytest.raises(PolicyError) as refusal:
            load_policy(save(model, tmp_path))
        assert len(str(refusal.value)) < 1000


def test_sparse_weights_are_refused_by_name(tmp_path: Path) -> None:
    model = two_layers()
    sparse = model.graph.sparse_initializer.add()
    sparse.values.name = "thin"
    refused(save(model, tmp_path), "thin")


def test_a_broken_specification_inside_the_model(tmp_path: Path) -> None:
    model = two_layers()
    for text in ("not json", "{}", '{"schema_version": 7}', "[" * 100_000):
        helper.set_model_props(model, {"viatool.spec": text})
        refused(save(model, tmp_path), "viatool.spec")


TWO_VALUES = node("Constant", [], ["c"], value_float=0.5)
TWO_VALUES.attribute.append(onnx.helper.make_attribute("value_int", 2))


@pytest.mark.parametrize(
    ("nodes", "opset", "reason"),
    [
        ([TWO_VALUES, node("Mul", ["x", "c"], ["y"])], 17, "several values: value_float, value_int"),
        (
            [node("Cast", ["x"], ["h"], to=TensorProto.FLOAT16, saturate=100), node("Cast", ["h"], ["y"], to=1)],
            19,
            "saturate = 100",
        ),
        ([node("ReverseSequence", ["x", "n"], ["y"], batch_axis=0, time_axis=-2)], 17, "batch_axis and time_axis"),
        ([node("Unsqueeze", ["x"], ["u"], axes=[2]), node("PRelu", ["u", "s"], ["y"])], 6, "slope for each channel"),
    ],
    ids=["Constant", "Cast", "ReverseSequence", "PRelu"],
)  # fmt: skip
def test_what_runtimes_take_in_another_sense_is_refused(
    nodes: list[onnx.NodeProto], opset: int, reason: str, tmp_path: Path
) -> None:
    constants = {"n": np.array([3]), "s": np.array([0.25, 0.1, -0.5, 2.0], np.float32)}
    refused(save(model_of(nodes, constants, opset=opset), tmp_path), reason)
