"""Nothing of a pickle is run: what it would do has not happened, wherever it stands."""

from __future__ import annotations

import base64
import io
import json
import os
import pickle
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("torch")
pytest.importorskip("stable_baselines3")

import torch  # only where it is installed

from tests.importing.saved import rewritten, saved
from viatool.errors import PolicyError
from viatool.importing import ImportRequest, import_policy
from viatool.importing.inert import numbers_of, origin_of, read_inert
from viatool.importing.stable_baselines import read_model


class Touches:
    """Writes a file when it is unpickled."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple[Any, ...]:
        return os.mkdir, (str(self.path),)


def text_of(value: Any) -> dict[str, str]:
    return {":serialized:": base64.b64encode(pickle.dumps(value)).decode()}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    saved(tmp_path, "TD3", normalise=True, settings={"activation_fn": torch.nn.ELU})
    return tmp_path


def test_the_pickle_of_these_tests_does_harm_where_it_is_run(tmp_path: Path) -> None:
    pickle.loads(pickle.dumps(Touches(tmp_path / "touched")))
    assert (tmp_path / "touched").exists()


@pytest.mark.parametrize("field", ["policy_class", "policy_kwargs", "observation_space", "action_space"])
@pytest.mark.parametrize("protocol", [2, 4, 5])
def test_a_field_of_the_zip_is_not_run(field: str, protocol: int, folder: Path) -> None:
    touched = folder / "touched"
    hostile: Any = Touches(touched)
    if field == "policy_kwargs":
        hostile = {"activation_fn": hostile}
    text = base64.b64encode(pickle.dumps(hostile, protocol)).decode()
    path = rewritten(folder / "model.zip", **{field: {":serialized:": text}})
    with pytest.raises(PolicyError, match=field):
        import_policy(ImportRequest(path), folder / "policy.onnx")
    assert not touched.exists()
    assert not (folder / "policy.onnx").exists()


def test_fields_that_are_not_needed_are_not_read(folder: Path) -> None:
    touched = folder / "touched"
    path = rewritten(
        folder / "model.zip", lr_schedule=text_of(Touches(touched)), extra=text_of(Touches(touched))
    )
    import_policy(ImportRequest(path), folder / "policy.onnx")
    assert not touched.exists()


def test_weights_are_numbers_alone(folder: Path) -> None:
    touched = folder / "touched"
    stream = io.BytesIO()
    torch.save({"actor.mu.0.weight": Touches(touched)}, stream)
    path = rewritten(folder / "model.zip", member_policy_pth=stream.getvalue())
    with pytest.raises(PolicyError, match=r"policy.pth holds more than weights"):
        import_policy(ImportRequest(path), folder / "policy.onnx")
    assert not touched.exists()


@pytest.mark.parametrize("where", ["alone", "among the statistics"])
def test_a_normaliser_is_not_run(where: str, folder: Path) -> None:
    touched = folder / "touched"
    hostile: Any = Touches(touched)
    if where != "alone":
        with (folder / "vec_normalize.pkl").open("rb") as stream:
            normaliser = pickle.load(stream)
        normaliser.class_attributes = normaliser.returns = None  # which saving leaves out
        normaliser.obs_rms.count = Touches(touched)
        hostile = normaliser
    (folder / "hostile.pkl").write_bytes(pickle.dumps(hostile))
    with pytest.raises(
        PolicyError, match=r"hostile.pkl is a pickle that names '(posix|nt).mkdir'"
    ) as refusal:
        import_policy(ImportRequest(folder / "model.zip", folder / "hostile.pkl"), folder / "policy.onnx")
    assert "--trust" in refusal.value.hint
    assert not touched.exists()


@pytest.mark.parametrize(
    "content",
    [
        b"cos\nsystem\n(S'true'\ntR.",
        b"\x80\x04\x8c\x08builtins\x8c\x04eval\x93\x8c\x011\x85R.",
        b"\x80\x02ccopyreg\n_reconstructor\n(cos\nsystem\nc__builtin__\nobject\nNtR.",
        pickle.dumps(np.array([len], dtype=object)),
        pickle.dumps(np.array(["text"])),
        b"\x80\x04.",
        b"",
        b"\x80\x05\x95\xff\xff\xff\xff\xff\xff\xff\x7f",
        b"(" * 100_000,
    ],
)
def test_other_files_are_no_normaliser(content: bytes, folder: Path) -> None:
    (folder / "other.pkl").write_bytes(content)
    with pytest.raises(PolicyError, match=r"other.pkl"):
        import_policy(ImportRequest(folder / "model.zip", folder / "other.pkl"), folder / "policy.onnx")


def test_damaged_normalisers_are_refused_and_never_crash(folder: Path) -> None:
    content = (folder / "vec_normalize.pkl").read_bytes()
    rng = np.random.default_rng(0)
    for _ in range(300):
        damaged = bytearray(content)
        for place in rng.integers(0, len(content), rng.integers(1, 6)):
            damaged[place] = rng.integers(0, 256)
        try:
            read_inert(bytes(damaged), "damaged.pkl")
        except PolicyError as error:
            assert "damaged.pkl" in error.message  # noqa: PT017  # most are refused, some stay readable


def test_arrays_are_rebuilt_from_their_bytes() -> None:
    for array in (
        np.arange(6.0).reshape(2, 3),
        np.asfortranarray(np.arange(6.0).reshape(2, 3)),
        np.arange(4, dtype=">i2"),
        np.array([True, False]),
        np.float32(1.5),
        np.zeros((0, 2)),
    ):
        for protocol in (2, 4, 5):
            found = numbers_of(read_inert(pickle.dumps(array, protocol), "array"))
            assert found is not None
            np.testing.assert_array_equal(found, np.asarray(array, np.float64))


def test_classes_are_named_and_never_imported() -> None:
    for kind in (torch.nn.ReLU, Touches, dict):
        assert origin_of(read_inert(pickle.dumps(kind), "class")) == f"{kind.__module__}.{kind.__qualname__}"
    assert origin_of(3) == ""


def test_a_zip_of_absurd_size_is_refused(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("viatool.importing.stable_baselines._MAX_BYTES", 100)
    with pytest.raises(PolicyError, match="far more than a policy needs"):
        import_policy(ImportRequest(folder / "model.zip"), folder / "policy.onnx")


def test_trust_runs_what_is_said(folder: Path) -> None:
    touched = folder / "touched"
    path = rewritten(folder / "model.zip", policy_class=text_of(Touches(touched)))
    with pytest.raises(PolicyError, match="its policy cannot be built"):
        import_policy(ImportRequest(path, trust=True), folder / "policy.onnx")
    assert touched.exists()
    with zipfile.ZipFile(folder / "model.zip") as archive:
        assert "policy.pth" in archive.namelist()


def test_damaged_models_are_read_or_refused_and_never_crash(folder: Path) -> None:
    rng = np.random.default_rng(0)
    content = (folder / "model.zip").read_bytes()
    with zipfile.ZipFile(folder / "model.zip") as archive:
        fields = json.loads(archive.read("data"))
    for _ in range(60):
        field = str(rng.choice(["the zip", "observation_space", "action_space", "policy_kwargs"]))
        whole = field == "the zip"
        damaged = bytearray(content if whole else base64.b64decode(fields[field][":serialized:"]))
        for place in rng.integers(0, len(damaged), rng.integers(1, 6)):
            damaged[place] = rng.integers(0, 256)
        if whole:
            path = folder / "changed.zip"
            path.write_bytes(damaged)
        else:
            text = base64.b64encode(damaged).decode()
            path = rewritten(folder / "model.zip", **{field: {":serialized:": text}})
        try:
            read_model(path)
        except PolicyError as error:
            assert "changed.zip" in error.message  # noqa: PT017  # most are refused, some stay readable
