"""PyTorch's files without PyTorch: tensors as they are, and nothing else of a file is run."""

from __future__ import annotations

import io
import os
import pickle
import pickletools
import sys
import types
import zipfile
from collections import OrderedDict
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from didim.errors import RecordingError
from didim.log.data_file import open_data_file
from didim.log.torch_file import TorchFile

KINDS = {"f8": "DoubleStorage", "f4": "FloatStorage", "i8": "LongStorage"}


class Tensor:
    """A tensor as PyTorch pickles it: storage, offset, shape and strides."""

    def __init__(self, values: np.ndarray, transposed: bool = False) -> None:
        self.values = np.ascontiguousarray(values.T if transposed else values)
        self.transposed = transposed


@pytest.fixture
def torch_names(monkeypatch: pytest.MonkeyPatch) -> types.ModuleType:
    """Modules with PyTorch's names, so that pickles can be written that name them."""
    torch, utils = types.ModuleType("torch"), types.ModuleType("torch._utils")

    def _rebuild_tensor_v2() -> None:
        """Stand for PyTorch's function."""

    _rebuild_tensor_v2.__module__ = "torch._utils"
    _rebuild_tensor_v2.__qualname__ = "_rebuild_tensor_v2"
    utils._rebuild_tensor_v2 = _rebuild_tensor_v2  # type: ignore[attr-defined]
    for name in KINDS.values():
        setattr(torch, name, type(name, (), {"__module__": "torch", "__qualname__": name}))
    monkeypatch.setitem(sys.modules, "torch", torch)
    monkeypatch.setitem(sys.modules, "torch._utils", utils)
    return torch


def saved(content: Any, torch: types.ModuleType, *, compress: bool = False) -> bytes:
    """What ``torch.save`` writes."""
    storages: list[np.ndarray] = []
    rebuild = sys.modules["torch._utils"]._rebuild_tensor_v2

    class Pickler(pickle.Pickler):
        def persistent_id(self, item: Any) -> Any:
            if isinstance(item, np.ndarray):
                storages.append(item)
                kind = getattr(torch, KINDS[item.dtype.str[1:]])
                return ("storage", kind, str(len(storages) - 1), "cpu", item.size)
            return None

        def reducer_override(self, item: Any) -> Any:
            if isinstance(item, Tensor):
                rows, columns = (
                    (*item.values.shape, 1)[:2] if item.values.ndim == 2 else (item.values.size, None)
                )
                if columns is None:
                    shape: tuple[int, ...] = (rows,)
                    stride: tuple[int, ...] = (1,)
                else:
                    shape, stride = (rows, columns), (columns, 1)
                    if item.transposed:
                        shape, stride = shape[::-1], stride[::-1]
                return rebuild, (item.values.reshape(-1), 0, shape, stride, False, OrderedDict())
            return NotImplemented

    text = io.BytesIO()
    Pickler(text, protocol=2).dump(content)
    return archive(text.getvalue(), storages, compress=compress)


def archive(text: bytes, storages: list[np.ndarray], *, compress: bool = False) -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED if compress else zipfile.ZIP_STORED) as file:
        file.writestr("run/data.pkl", text)
        file.writestr("run/byteorder", "little")
        for number, values in enumerate(storages):
            file.writestr(f"run/data/{number}", values.tobytes())
    return out.getvalue()


def test_tensors_come_back_by_name(torch_names: types.ModuleType) -> None:
    rng = np.random.default_rng(0)
    time, q = np.arange(5.0), rng.standard_normal((5, 3)).astype(np.float32)
    raw = saved(
        {"time": Tensor(time), "run": {"q": Tensor(q), "qt": Tensor(q, transposed=True)}, "rate": 200},
        torch_names,
    )
    file = TorchFile(raw, "log.pt")
    assert file.names == ["time", "run/q", "run/qt"]
    np.testing.assert_array_equal(file.get(None, "run/q", 3), q)
    np.testing.assert_array_equal(file.get([3, 1], "run/qt", 2), q[:, [2, 0]])
    np.testing.assert_array_equal(file.get(["time"], None, 1)[:, 0], time)


def test_nothing_of_a_file_is_run(tmp_path: Path) -> None:
    class Attack:
        def __reduce__(self) -> Any:
            return os.mkdir, (str(tmp_path / "made"),)

    text = pickle.dumps({"q": Attack()}, protocol=2)
    assert any(op.name == "REDUCE" for op, _, _ in pickletools.genops(text))
    with pytest.raises(RecordingError, match=r"log\.pt: it has (posix|nt)\.mkdir, which is not read"):
        TorchFile(archive(text, []), "log.pt")
    assert not (tmp_path / "made").exists()


@pytest.mark.parametrize(
    ("shape", "stride"), [((5, 4), (4, 1)), ((10**9, 10**9), (0, 0)), ((3,), (-1,)), ((0,), (1,))]
)
def test_tensors_outside_their_numbers_are_refused(
    torch_names: types.ModuleType, shape: tuple[int, ...], stride: tuple[int, ...]
) -> None:
    raw = saved({"q": Tensor(np.arange(6.0))}, torch_names)
    file = TorchFile(raw, "log.pt")
    tensor = file._tensors["q"]
    object.__setattr__(tensor, "shape", shape)
    object.__setattr__(tensor, "stride", stride)
    with pytest.raises(RecordingError, match=r"log\.pt: variable 'q' .*damaged"):
        file.get(None, "q", 4)


@pytest.mark.parametrize(
    ("raw", "message"),
    [
        (b"not an archive", "before version 1.6"),
        (archive(pickle.dumps({"rate": 200}, protocol=2), []), "there is no tensor"),
        (archive(b"\x80\x02nonsense", []), "not a readable PyTorch file"),
    ],
    ids=["old", "no tensor", "damaged"],
)
def test_other_files_are_one_sentence(raw: bytes, message: str) -> None:
    with pytest.raises(RecordingError, match=message):
        TorchFile(raw, "log.pt")


def test_compressed_members_are_refused(torch_names: types.ModuleType) -> None:
    raw = saved({"q": Tensor(np.zeros(1000))}, torch_names, compress=True)
    with pytest.raises(RecordingError, match="is compressed"):
        TorchFile(raw, "log.pt")


def test_the_log_of_the_quadruped(shared: Path) -> None:
    path = shared / "data" / "go2" / "traj_0.pt"
    file = open_data_file(path, path.name, delimiter=None, header=None)
    file.want(None, "dof_pos", 12)
    q, reference = file.get(None, "dof_pos", 12), file.get(None, "des_dof_pos", 12)
    t = file.get(["time"], None, 1)[:, 0]
    assert q.shape == (4698, 12)
    assert np.diff(t).mean() == pytest.approx(0.005, rel=1e-3)
    # The legs follow what they are commanded.
    assert np.sqrt(np.mean((q - reference) ** 2)) < 0.15
